; One robot, and not enough energy for the whole round: it has to come back and charge. The gate need
; not be inspected; it is only on the way.
;
;    dock1 ----10---- gate ----15---- fence
;      |               |               |
;     10              15              15
;      |               |               |
;    yard ----15---- barn ----20---- pond

(define (problem patrol-p02)
  (:domain patrol)

  (:objects
    r1 - robot
    dock1 gate fence pond barn yard - place)

  (:init
    (at r1 dock1) (= (battery r1) 70) (= (full r1) 100) (= (effort r1) 0)
    (dock dock1)

    (connected dock1 gate) (connected gate dock1)
    (connected gate fence) (connected fence gate)
    (connected fence pond) (connected pond fence)
    (connected pond barn)  (connected barn pond)
    (connected gate barn)  (connected barn gate)
    (connected barn yard)  (connected yard barn)
    (connected yard dock1) (connected dock1 yard)

    (= (energy dock1 gate) 10) (= (energy gate dock1) 10)
    (= (energy gate fence) 15) (= (energy fence gate) 15)
    (= (energy fence pond) 15) (= (energy pond fence) 15)
    (= (energy pond barn) 20)  (= (energy barn pond) 20)
    (= (energy gate barn) 15)  (= (energy barn gate) 15)
    (= (energy barn yard) 15)  (= (energy yard barn) 15)
    (= (energy yard dock1) 10) (= (energy dock1 yard) 10)

    (= (look_around dock1) 2)    (= (reserve dock1) 0)
    (= (look_around gate) 2)     (= (reserve gate) 15)
    (= (look_around fence) 2)    (= (reserve fence) 30)
    (= (look_around pond) 2)     (= (reserve pond) 45)
    (= (look_around barn) 2)     (= (reserve barn) 30)
    (= (look_around yard) 2)     (= (reserve yard) 15))

  (:goal (and
    (inspected fence)
    (inspected pond)
    (inspected barn)
    (inspected yard)
    (at r1 dock1)))

  (:metric minimize (effort r1)))
