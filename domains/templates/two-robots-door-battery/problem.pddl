; Your robots, places and things, what is so now, and a goal. Facts that a sensor reports need not be here.

(define (problem first)
  (:domain two-robots-door-battery)
  (:objects r1 r2 - robot hall store lab - place sample - item)
  (:init
    (at r1 hall) (free r1) (empty r1) (= (battery r1) 0.9)
    (at r2 store) (free r2) (empty r2) (= (battery r2) 0.2)       ; too little: r2 has to charge first
    (linked hall store) (linked store hall) (behind_door hall lab) (behind_door lab hall)
    (charger store) (at sample lab))                              ; the door is shut
  (:goal (and (at sample store) (at r2 hall))))
