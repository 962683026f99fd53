(define (problem no_towel) (:domain slippery) (:objects mug glass - cup)
  (:init (wet mug) (wet glass))
  (:goal (and (held mug) (held glass) (not (broken mug)) (not (broken glass)))))
