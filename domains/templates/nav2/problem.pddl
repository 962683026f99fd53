; Your places (each with a row in the table of bindings.yaml), what is so now, and a goal.

(define (problem first)
  (:domain nav2)
  (:objects dock hall kitchen - place)
  (:init (at dock))
  (:goal (and (inspected hall) (inspected kitchen) (at dock))))
