; One arm sorts things into boxes. Edit the actions: each is one of your action servers.

(define (domain pick-place)
  (:requirements :typing :durative-actions)
  (:types thing place - object)

  (:predicates
    (on ?thing - thing ?place - place)
    (holds ?thing - thing)
    (empty)                                   ; the gripper holds nothing
    (reachable ?place - place))

  (:durative-action pick
    :parameters (?thing - thing ?place - place)
    :duration (= ?duration 4)
    :condition (and (at start (empty)) (at start (reachable ?place)) (at start (on ?thing ?place)))
    :effect (and (at start (not (empty))) (at end (not (on ?thing ?place))) (at end (holds ?thing))))

  (:durative-action place
    :parameters (?thing - thing ?place - place)
    :duration (= ?duration 3)
    :condition (and (at start (holds ?thing)) (at start (reachable ?place)))
    :effect (and (at end (not (holds ?thing))) (at end (empty)) (at end (on ?thing ?place)))))
