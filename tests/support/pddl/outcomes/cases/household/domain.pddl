; The household (domains/household) with the outcomes of its actions: a door that sticks or is locked, a grasp that misses or drops.
(define (domain household)
  (:requirements :adl :probabilistic-effects)
  (:types robot item place level - object room hallway furniture - place)
  (:predicates
    (at ?robot - robot ?place - place) (in ?robot - robot ?room - room)
    (free ?robot - robot) (holding ?robot - robot ?item - item)
    (on ?item - item ?furniture - furniture) (on_floor ?item - item ?room - room)
    (open ?hallway - hallway) (locked ?hallway - hallway)
    (belongs_to ?place - place ?room - room) (joins ?hallway - hallway ?from ?to - room) (charger ?furniture - furniture)
    (battery ?robot - robot ?level - level) (below ?lower ?level - level) (full ?level - level))
  (:action navigate
    :parameters (?robot - robot ?from ?to - place ?room - room ?level ?lower - level)
    :precondition (and (at ?robot ?from) (in ?robot ?room) (belongs_to ?to ?room) (not (= ?from ?to)) (battery ?robot ?level) (below ?lower ?level))
    :effect (and (not (at ?robot ?from)) (at ?robot ?to) (not (battery ?robot ?level)) (battery ?robot ?lower)))
  (:action cross
    :parameters (?robot - robot ?hallway - hallway ?from ?to - room)
    :precondition (and (at ?robot ?hallway) (in ?robot ?from) (joins ?hallway ?from ?to) (open ?hallway))
    :effect (and (not (in ?robot ?from)) (in ?robot ?to)))
  (:action charge
    :parameters (?robot - robot ?charger - furniture ?level ?full - level)
    :precondition (and (at ?robot ?charger) (charger ?charger) (battery ?robot ?level) (full ?full))
    :effect (and (not (battery ?robot ?level)) (battery ?robot ?full)))
  (:action open_hallway
    :parameters (?robot - robot ?hallway - hallway ?level ?lower - level)
    :precondition (and (at ?robot ?hallway) (not (open ?hallway)) (not (locked ?hallway)) (free ?robot) (battery ?robot ?level) (below ?lower ?level))
    :effect (and (not (battery ?robot ?level)) (battery ?robot ?lower) (probabilistic 0.65 (open ?hallway) 0.15 (locked ?hallway))))
  (:action pick
    :parameters (?robot - robot ?item - item ?furniture - furniture ?room - room ?level ?lower - level)
    :precondition (and (at ?robot ?furniture) (in ?robot ?room) (on ?item ?furniture) (free ?robot) (battery ?robot ?level) (below ?lower ?level))
    :effect (and (not (battery ?robot ?level)) (battery ?robot ?lower)
      (probabilistic 0.5 (and (not (on ?item ?furniture)) (not (free ?robot)) (holding ?robot ?item))
                     0.1 (and (not (on ?item ?furniture)) (on_floor ?item ?room)))))
  (:action pick_up
    :parameters (?robot - robot ?item - item ?room - room ?level ?lower - level)
    :precondition (and (in ?robot ?room) (on_floor ?item ?room) (free ?robot) (battery ?robot ?level) (below ?lower ?level))
    :effect (and (not (battery ?robot ?level)) (battery ?robot ?lower)
      (probabilistic 0.4 (and (not (on_floor ?item ?room)) (not (free ?robot)) (holding ?robot ?item)))))
  (:action place
    :parameters (?robot - robot ?item - item ?furniture - furniture ?level ?lower - level)
    :precondition (and (at ?robot ?furniture) (holding ?robot ?item) (battery ?robot ?level) (below ?lower ?level))
    :effect (and (not (battery ?robot ?level)) (battery ?robot ?lower) (free ?robot) (not (holding ?robot ?item)) (on ?item ?furniture))))
