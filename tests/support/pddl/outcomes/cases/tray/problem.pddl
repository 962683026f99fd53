(define (problem tray) (:domain tray) (:objects mug glass bowl - cup)
  (:init (back))
  (:goal (and (exists (?c - cup) (and (delivered ?c) (not (lost ?c))))
              (forall (?c - cup) (imply (lost ?c) (delivered ?c))))))
