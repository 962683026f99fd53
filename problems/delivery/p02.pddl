; Two robots, three parcels. Two parcels wait in the store, whose lift serves one robot at a time;
; the third lies on the floor of the kitchen.
;
;     store ----4---- hall ------4------ kitchen
;       |            /    \                 |
;       5          6     [door2]            6
;       |         /          \              |
;     corridor ------6------ office --------'      (door2: 4 m, open)
;
; The office is nearest through door2; when it is shut, a robot can open it, or drive round by the
; corridor or the kitchen.

(define (problem delivery-p02)
  (:domain delivery)

  (:objects
    r1 r2 - robot
    parcel1 parcel2 parcel3 - parcel
    store hall corridor kitchen office - place
    door2 - door)

  (:init
    (at r1 store) (empty r1) (gripper r1) (= (speed r1) 1)
    (at r2 hall)  (empty r2)              (= (speed r2) 1)
    (at parcel1 store)
    (at parcel2 kitchen)                ; on the floor: to be picked up
    (at parcel3 store)

    (station store) (free store)
    (takes_parcels store) (takes_parcels hall) (takes_parcels corridor)
    (takes_parcels kitchen) (takes_parcels office)

    (connected store hall)       (connected hall store)
    (connected hall kitchen)     (connected kitchen hall)
    (connected store corridor)   (connected corridor store)
    (connected corridor hall)    (connected hall corridor)
    (connected corridor office)  (connected office corridor)
    (connected kitchen office)   (connected office kitchen)
    (leads door2 hall office)    (leads door2 office hall)
    (open door2)

    (= (distance store hall) 4)      (= (distance hall store) 4)
    (= (distance hall kitchen) 4)    (= (distance kitchen hall) 4)
    (= (distance store corridor) 5)  (= (distance corridor store) 5)
    (= (distance corridor hall) 6)   (= (distance hall corridor) 6)
    (= (distance corridor office) 6) (= (distance office corridor) 6)
    (= (distance kitchen office) 6)  (= (distance office kitchen) 6)
    (= (distance hall office) 4)     (= (distance office hall) 4))

  (:goal (and
    (at parcel1 office)
    (at parcel2 hall)
    (at parcel3 hall)))

  (:metric minimize (total-time)))
