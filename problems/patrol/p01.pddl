; One robot, three waypoints on a ring, and enough energy for one round, either way round.
;
;    dock1 ----10---- gate
;      |               |
;     10              15
;      |               |
;    yard ----15---- barn

(define (problem patrol-p01)
  (:domain patrol)

  (:objects
    r1 - robot
    dock1 gate barn yard - place)

  (:init
    (at r1 dock1) (= (battery r1) 80) (= (full r1) 100) (= (effort r1) 0)
    (dock dock1)

    (connected dock1 gate) (connected gate dock1)
    (connected gate barn)  (connected barn gate)
    (connected barn yard)  (connected yard barn)
    (connected yard dock1) (connected dock1 yard)

    (= (energy dock1 gate) 10) (= (energy gate dock1) 10)
    (= (energy gate barn) 15)  (= (energy barn gate) 15)
    (= (energy barn yard) 15)  (= (energy yard barn) 15)
    (= (energy yard dock1) 10) (= (energy dock1 yard) 10)

    (= (look_around dock1) 2)    (= (reserve dock1) 0)
    (= (look_around gate) 2)     (= (reserve gate) 15)
    (= (look_around barn) 2)     (= (reserve barn) 30)
    (= (look_around yard) 2)     (= (reserve yard) 15))

  (:goal (and
    (inspected gate)
    (inspected barn)
    (inspected yard)
    (at r1 dock1)))

  (:metric minimize (effort r1)))
