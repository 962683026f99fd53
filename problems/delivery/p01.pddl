; Two robots, two parcels.
;
;    store ----4---- hall ----4---- kitchen
;      |                               |
;      '----5---- corridor ---[door1]--'      (3 m; the door is shut)
;
; The way through the hall is shorter. When it is blocked, the corridor and its door are left.

(define (problem delivery-p01)
  (:domain delivery)

  (:objects
    r1 r2 - robot
    parcel1 parcel2 - parcel
    store hall corridor kitchen - place
    door1 - door)

  (:init
    (at r1 store) (empty r1) (= (speed r1) 1)
    (at r2 hall)  (empty r2) (= (speed r2) 1)
    (at parcel1 store)
    (at parcel2 store)

    (station store) (free store)

    (connected store hall)     (connected hall store)
    (connected hall kitchen)   (connected kitchen hall)
    (connected store corridor) (connected corridor store)
    (leads door1 corridor kitchen) (leads door1 kitchen corridor)

    (= (distance store hall) 4)       (= (distance hall store) 4)
    (= (distance hall kitchen) 4)     (= (distance kitchen hall) 4)
    (= (distance store corridor) 5)   (= (distance corridor store) 5)
    (= (distance corridor kitchen) 3) (= (distance kitchen corridor) 3))

  (:goal (and
    (at parcel1 hall)
    (at parcel2 kitchen)))

  (:metric minimize (total-time)))
