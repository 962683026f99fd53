(define (problem slippery) (:domain slippery) (:objects mug glass - cup)
  (:init (wet mug) (wet glass) (towel))
  (:goal (and (held mug) (held glass) (not (broken mug)) (not (broken glass)))))
