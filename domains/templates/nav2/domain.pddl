; A robot drives with Nav2, inspects places and comes home. Edit the actions: each is one of your action servers.
; A drive may begin anywhere: after one that has failed, the robot is at no place.

(define (domain nav2)
  (:requirements :adl :durative-actions)
  (:types place)

  (:predicates
    (at ?place - place)
    (busy)                                    ; the robot does one thing at a time
    (inspected ?place - place))

  (:durative-action navigate_to_pose
    :parameters (?to - place)
    :duration (= ?duration 10)                ; an estimate; `pnm learn` finds better ones
    :condition (and (at start (not (busy))) (at start (not (at ?to))))
    :effect (and (at start (busy)) (at start (forall (?place - place) (not (at ?place))))
      (at end (not (busy))) (at end (at ?to))))

  (:durative-action inspect
    :parameters (?place - place)
    :duration (= ?duration 3)
    :condition (and (at start (not (busy))) (over all (at ?place)))
    :effect (and (at start (busy)) (at end (not (busy))) (at end (inspected ?place)))))
