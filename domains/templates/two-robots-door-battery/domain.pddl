; Two robots carry things between rooms. A door shuts now and then, and batteries run low.
; Edit the actions: each is one of your action servers. What must hold when a goal is sent is `at start`, what
; must hold meanwhile `over all`.

(define (domain two-robots-door-battery)
  (:requirements :typing :durative-actions :numeric-fluents :negative-preconditions)
  (:types robot item - movable place - object)

  (:predicates
    (at ?thing - movable ?place - place)
    (free ?robot - robot)                     ; it does nothing else: keeps the planner from two drives of one robot at once
    (holds ?robot - robot ?item - item)
    (empty ?robot - robot)
    (linked ?from ?to - place)                ; one can simply drive there
    (behind_door ?from ?to - place)           ; there is the door in between
    (door_open)
    (charger ?place - place))

  (:functions (battery ?robot - robot))       ; 0 to 1, as in sensor_msgs/BatteryState

  (:durative-action drive
    :parameters (?robot - robot ?from ?to - place)
    :duration (= ?duration 5)
    :condition (and (at start (free ?robot)) (at start (at ?robot ?from)) (at start (linked ?from ?to))
      (at start (>= (battery ?robot) 0.3)))
    :effect (and (at start (not (free ?robot))) (at start (not (at ?robot ?from)))
      (at end (free ?robot)) (at end (at ?robot ?to)) (at end (decrease (battery ?robot) 0.1))))

  (:durative-action pass_door                 ; cancelled when the door shuts on the way
    :parameters (?robot - robot ?from ?to - place)
    :duration (= ?duration 6)
    :condition (and (at start (free ?robot)) (at start (at ?robot ?from)) (at start (behind_door ?from ?to))
      (over all (door_open)) (at start (>= (battery ?robot) 0.3)))
    :effect (and (at start (not (free ?robot))) (at start (not (at ?robot ?from)))
      (at end (free ?robot)) (at end (at ?robot ?to)) (at end (decrease (battery ?robot) 0.1))))

  (:durative-action open_door
    :parameters ()
    :duration (= ?duration 2)
    :condition (at start (not (door_open)))
    :effect (at end (door_open)))

  (:durative-action charge
    :parameters (?robot - robot ?place - place)
    :duration (= ?duration 20)
    :condition (and (at start (free ?robot)) (over all (at ?robot ?place)) (at start (charger ?place)))
    :effect (and (at start (not (free ?robot))) (at end (free ?robot)) (at end (assign (battery ?robot) 1))))

  (:durative-action grasp
    :parameters (?robot - robot ?item - item ?place - place)
    :duration (= ?duration 3)
    :condition (and (at start (free ?robot)) (at start (empty ?robot)) (at start (at ?item ?place)) (over all (at ?robot ?place)))
    :effect (and (at start (not (free ?robot))) (at end (free ?robot)) (at start (not (empty ?robot)))
      (at end (not (at ?item ?place))) (at end (holds ?robot ?item))))

  (:durative-action release
    :parameters (?robot - robot ?item - item ?place - place)
    :duration (= ?duration 2)
    :condition (and (at start (free ?robot)) (at start (holds ?robot ?item)) (over all (at ?robot ?place)))
    :effect (and (at start (not (free ?robot))) (at end (free ?robot)) (at end (empty ?robot))
      (at end (not (holds ?robot ?item))) (at end (at ?item ?place)))))
