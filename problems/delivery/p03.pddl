; Three robots, one of them slow; four parcels, two stations with a lift each, two doors.
;
;     store ----4---- hall ------4------ kitchen
;       |            /   |                  |
;       5       [door1]  5               [door2]
;       |         /      |                  |
;     corridor   |      lab ------4------ garage
;       |        |     /
;       '---6--- office        office - lab: 5 m; door1: 3 m, shut; door2: 6 m, open
;
; One robot can open door1 for another. The garage has two ways in, one of them through door2.

(define (problem delivery-p03)
  (:domain delivery)

  (:objects
    r1 r2 r3 - robot
    parcel1 parcel2 parcel3 parcel4 - parcel
    store hall corridor kitchen office lab garage - place
    door1 door2 - door)

  (:init
    (at r1 store)  (empty r1) (gripper r1) (= (speed r1) 1)
    (at r2 office) (empty r2) (gripper r2) (= (speed r2) 1)
    (at r3 garage) (empty r3)              (= (speed r3) 0.5)
    (at parcel1 garage)
    (at parcel2 kitchen)                ; on the floor: to be picked up
    (at parcel3 store)
    (at parcel4 corridor)               ; on the floor, too

    (station store)  (free store)
    (station garage) (free garage)
    (takes_parcels store) (takes_parcels hall) (takes_parcels corridor)
    (takes_parcels kitchen) (takes_parcels office) (takes_parcels lab)
    (takes_parcels garage)

    (connected store hall)      (connected hall store)
    (connected hall kitchen)    (connected kitchen hall)
    (connected store corridor)  (connected corridor store)
    (connected corridor office) (connected office corridor)
    (connected hall lab)        (connected lab hall)
    (connected office lab)      (connected lab office)
    (connected lab garage)      (connected garage lab)
    (leads door1 hall office)    (leads door1 office hall)
    (leads door2 kitchen garage) (leads door2 garage kitchen)
    (open door2)

    (= (distance store hall) 4)      (= (distance hall store) 4)
    (= (distance hall kitchen) 4)    (= (distance kitchen hall) 4)
    (= (distance store corridor) 5)  (= (distance corridor store) 5)
    (= (distance corridor office) 6) (= (distance office corridor) 6)
    (= (distance hall lab) 5)        (= (distance lab hall) 5)
    (= (distance office lab) 5)      (= (distance lab office) 5)
    (= (distance kitchen garage) 6)  (= (distance garage kitchen) 6)
    (= (distance hall office) 3)     (= (distance office hall) 3)
    (= (distance lab garage) 4)      (= (distance garage lab) 4))

  (:goal (and
    (at parcel1 kitchen)
    (at parcel2 office)
    (at parcel3 kitchen)
    (at parcel4 office)))

  (:metric minimize (total-time)))
