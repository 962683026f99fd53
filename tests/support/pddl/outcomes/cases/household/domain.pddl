; The household (domains/household) with the outcomes of its actions: a door that sticks or is locked, a grasp that misses or drops.
(define (domain household)
  (:requirements :adl :numeric-fluents :probabilistic-effects)
  (:types robot item place - object room hallway furniture - place)
  (:predicates
    (at ?robot - robot ?place - place) (in ?robot - robot ?room - room)
    (free ?robot - robot) (holding ?robot - robot ?item - item)
    (on ?item - item ?furniture - furniture) (on_floor ?item - item ?room - room)
    (open ?hallway - hallway) (locked ?hallway - hallway)
    (belongs_to ?place - place ?room - room) (joins ?hallway - hallway ?from ?to - room) (charger ?furniture - furniture))
  (:functions (battery ?robot - robot))
  (:action navigate
    :parameters (?robot - robot ?from ?to - place ?room - room)
    :precondition (and (at ?robot ?from) (in ?robot ?room) (belongs_to ?to ?room) (not (= ?from ?to)) (>= (battery ?robot) 10))
    :effect (and (not (at ?robot ?from)) (at ?robot ?to) (decrease (battery ?robot) 10)))
  (:action cross
    :parameters (?robot - robot ?hallway - hallway ?from ?to - room)
    :precondition (and (at ?robot ?hallway) (in ?robot ?from) (joins ?hallway ?from ?to) (open ?hallway))
    :effect (and (not (in ?robot ?from)) (in ?robot ?to)))
  (:action charge
    :parameters (?robot - robot ?charger - furniture)
    :precondition (and (at ?robot ?charger) (charger ?charger))
    :effect (assign (battery ?robot) 100))
  (:action open_hallway
    :parameters (?robot - robot ?hallway - hallway)
    :precondition (and (at ?robot ?hallway) (not (open ?hallway)) (not (locked ?hallway)) (free ?robot) (>= (battery ?robot) 10))
    :effect (and (decrease (battery ?robot) 10) (probabilistic 0.65 (open ?hallway) 0.15 (locked ?hallway))))
  (:action pick
    :parameters (?robot - robot ?item - item ?furniture - furniture ?room - room)
    :precondition (and (at ?robot ?furniture) (in ?robot ?room) (on ?item ?furniture) (free ?robot) (>= (battery ?robot) 10))
    :effect (and (decrease (battery ?robot) 10)
      (probabilistic 0.5 (and (not (on ?item ?furniture)) (not (free ?robot)) (holding ?robot ?item))
                     0.1 (and (not (on ?item ?furniture)) (on_floor ?item ?room)))))
  (:action pick_up
    :parameters (?robot - robot ?item - item ?room - room)
    :precondition (and (in ?robot ?room) (on_floor ?item ?room) (free ?robot) (>= (battery ?robot) 10))
    :effect (and (decrease (battery ?robot) 10)
      (probabilistic 0.4 (and (not (on_floor ?item ?room)) (not (free ?robot)) (holding ?robot ?item)))))
  (:action place
    :parameters (?robot - robot ?item - item ?furniture - furniture)
    :precondition (and (at ?robot ?furniture) (holding ?robot ?item) (>= (battery ?robot) 10))
    :effect (and (decrease (battery ?robot) 10) (free ?robot) (not (holding ?robot ?item)) (on ?item ?furniture))))
