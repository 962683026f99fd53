; By the door it is four steps, for which the battery lasts; round it three more steps.
(define (problem door) (:domain door)
  (:objects dock lobby hall garden terrace yard room - place l0 l1 l2 l3 l4 l5 l6 l7 - level)
  (:init (at dock) (charger dock) (battery l4) (full l7)
    (less l7 l6) (less l6 l5) (less l5 l4) (less l4 l3) (less l3 l2) (less l2 l1) (less l1 l0)
    (way dock lobby) (way lobby dock) (way lobby hall) (way hall lobby)
    (way hall garden) (way garden terrace) (way terrace yard) (way yard room)
    (door hall room) (shut hall room))
  (:goal (at room)))
