; Two robots, two docks, seven waypoints. Neither robot can do its share without charging.
;
;    dock1 ----10---- gate ----15---- fence ----10---- mast
;      |               |               |                |
;     10              15              15               15
;      |               |               |                |
;    yard ----15---- barn ----20---- pond ----10---- dock2
;      |                                                |
;      '---15--- shed ----15---- quarry -------15-------'

(define (problem patrol-p03)
  (:domain patrol)

  (:objects
    r1 r2 - robot
    dock1 dock2 gate fence mast pond barn yard shed quarry - place)

  (:init
    (at r1 dock1) (= (battery r1) 70) (= (full r1) 100) (= (effort r1) 0)
    (at r2 dock2) (= (battery r2) 70) (= (full r2) 100) (= (effort r2) 0)
    (dock dock1) (dock dock2)

    (connected dock1 gate)   (connected gate dock1)
    (connected gate fence)   (connected fence gate)
    (connected fence mast)   (connected mast fence)
    (connected fence pond)   (connected pond fence)
    (connected mast dock2)   (connected dock2 mast)
    (connected pond dock2)   (connected dock2 pond)
    (connected pond barn)    (connected barn pond)
    (connected gate barn)    (connected barn gate)
    (connected barn yard)    (connected yard barn)
    (connected yard dock1)   (connected dock1 yard)
    (connected yard shed)    (connected shed yard)
    (connected shed quarry)  (connected quarry shed)
    (connected quarry dock2) (connected dock2 quarry)

    (= (energy dock1 gate) 10)   (= (energy gate dock1) 10)
    (= (energy gate fence) 15)   (= (energy fence gate) 15)
    (= (energy fence mast) 10)   (= (energy mast fence) 10)
    (= (energy fence pond) 15)   (= (energy pond fence) 15)
    (= (energy mast dock2) 15)   (= (energy dock2 mast) 15)
    (= (energy pond dock2) 10)   (= (energy dock2 pond) 10)
    (= (energy pond barn) 20)    (= (energy barn pond) 20)
    (= (energy gate barn) 15)    (= (energy barn gate) 15)
    (= (energy barn yard) 15)    (= (energy yard barn) 15)
    (= (energy yard dock1) 10)   (= (energy dock1 yard) 10)
    (= (energy yard shed) 15)    (= (energy shed yard) 15)
    (= (energy shed quarry) 15)  (= (energy quarry shed) 15)
    (= (energy quarry dock2) 15) (= (energy dock2 quarry) 15)

    (= (look_around dock1) 2)    (= (reserve dock1) 0)
    (= (look_around dock2) 2)    (= (reserve dock2) 0)
    (= (look_around gate) 2)     (= (reserve gate) 15)
    (= (look_around fence) 2)    (= (reserve fence) 25)
    (= (look_around mast) 2)     (= (reserve mast) 15)
    (= (look_around pond) 2)     (= (reserve pond) 20)
    (= (look_around barn) 2)     (= (reserve barn) 30)
    (= (look_around yard) 2)     (= (reserve yard) 15)
    (= (look_around shed) 2)     (= (reserve shed) 30)
    (= (look_around quarry) 2)   (= (reserve quarry) 15))

  (:goal (and
    (inspected gate)
    (inspected fence)
    (inspected mast)
    (inspected pond)
    (inspected barn)
    (inspected yard)
    (inspected shed)
    (inspected quarry)
    (at r1 dock1)
    (at r2 dock2)))

  (:metric minimize (+ (effort r1) (effort r2))))
