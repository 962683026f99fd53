; A robot tidies up a house with rooms, doors and furniture, as PyRoboSim simulates it.
;
; For readers who know PyRoboSim: `furniture` are its locations, and `items` its objects. Every action is one of its task
; actions (bindings.yaml), and all but two predicates are read from the state of its world (sensing.yaml).

(define (domain household)
  (:requirements :adl :numeric-fluents :derived-predicates)

  (:types
    robot item place - object
    room hallway furniture - place)

  (:predicates
    (at ?robot - robot ?place - place)
    (free ?robot - robot)                      ; holds nothing
    (holding ?robot - robot ?item - item)
    (on ?item - item ?furniture - furniture)   ; or inside
    (open ?place - place)                      ; hallways and furniture
    (seen ?item - item)                        ; the robot knows where exactly to grasp; nothing reports it
    (came_from ?robot - robot ?room - room)    ; the room in which the robot was last, not counting hallways; nothing reports it

    (belongs_to ?place - place ?room - room)   ; furniture to the room that it stands in, a room to itself, a hallway to both of its rooms
    (joins ?hallway - hallway ?from ?to - room)
    (charger ?furniture - furniture)

    (in ?robot - robot ?room - room)           ; these follow from the others
    (reachable ?robot - robot ?room - room)
    (can_charge ?robot - robot))

  (:functions
    (battery ?robot - robot)                   ; per cent
    (navigation_use) (grasp_use) (door_use)    ; what an action needs of it on average, attempts that fail included
    (reserve)                                  ; what must be left for the way to a charger
    (reserve_behind_doors))                    ; the same where a door has to be opened first

  ; In a hallway that is shut, the robot is still on the side that it has come from.
  (:derived (in ?robot - robot ?room - room)
    (or (at ?robot ?room)
        (exists (?furniture - furniture) (and (at ?robot ?furniture) (belongs_to ?furniture ?room)))
        (exists (?hallway - hallway) (and (at ?robot ?hallway) (came_from ?robot ?room)))))

  (:derived (reachable ?robot - robot ?room - room)
    (or (in ?robot ?room)
        (exists (?from - room ?hallway - hallway)
          (and (reachable ?robot ?from) (joins ?hallway ?from ?room) (open ?hallway)))))

  (:derived (can_charge ?robot - robot)
    (exists (?charger - furniture ?room - room)
      (and (charger ?charger) (belongs_to ?charger ?room) (reachable ?robot ?room))))

  ; Drive anywhere that can be reached through open hallways.
  (:action navigate
    :parameters (?robot - robot ?from ?to - place ?room - room)
    :precondition (and
      (at ?robot ?from) (not (= ?from ?to))
      (belongs_to ?to ?room) (reachable ?robot ?room)
      (>= (battery ?robot) (reserve)))
    :effect (and
      (not (at ?robot ?from)) (at ?robot ?to)
      (forall (?last - room) (when (not (= ?last ?room)) (not (came_from ?robot ?last))))
      (came_from ?robot ?room)
      (decrease (battery ?robot) (navigation_use))))

  ; The same to a charger, for which the reserve is there; the battery is full on arrival.
  (:action charge
    :parameters (?robot - robot ?from - place ?charger - furniture ?room - room)
    :precondition (and
      (at ?robot ?from) (not (= ?from ?charger)) (charger ?charger)
      (belongs_to ?charger ?room) (reachable ?robot ?room)
      (> (battery ?robot) 0))
    :effect (and
      (not (at ?robot ?from)) (at ?robot ?charger)
      (assign (battery ?robot) 100)))

  ; Doors and furniture are opened and closed with a free hand, where the robot stands.
  (:action open_hallway
    :parameters (?robot - robot ?hallway - hallway)
    :precondition (and (at ?robot ?hallway) (not (open ?hallway)) (free ?robot) (>= (battery ?robot) (reserve)))
    :effect (and (open ?hallway) (decrease (battery ?robot) (door_use))))

  (:action open
    :parameters (?robot - robot ?furniture - furniture)
    :precondition (and
      (at ?robot ?furniture) (not (open ?furniture)) (free ?robot)
      (or (>= (battery ?robot) (reserve_behind_doors)) (and (can_charge ?robot) (>= (battery ?robot) (reserve)))))
    :effect (and (open ?furniture) (decrease (battery ?robot) (door_use))))

  (:action close
    :parameters (?robot - robot ?furniture - furniture)
    :precondition (and
      (at ?robot ?furniture) (open ?furniture) (free ?robot)
      (or (>= (battery ?robot) (reserve_behind_doors)) (and (can_charge ?robot) (>= (battery ?robot) (reserve)))))
    :effect (and (not (open ?furniture)) (decrease (battery ?robot) (door_use))))

  (:action detect
    :parameters (?robot - robot ?item - item ?furniture - furniture)
    :precondition (and (at ?robot ?furniture) (open ?furniture) (on ?item ?furniture))
    :effect (seen ?item))

  (:action pick
    :parameters (?robot - robot ?item - item ?furniture - furniture)
    :precondition (and
      (at ?robot ?furniture) (open ?furniture) (on ?item ?furniture) (seen ?item) (free ?robot)
      (or (>= (battery ?robot) (reserve_behind_doors)) (and (can_charge ?robot) (>= (battery ?robot) (reserve)))))
    :effect (and
      (not (free ?robot)) (not (on ?item ?furniture)) (holding ?robot ?item)
      (decrease (battery ?robot) (grasp_use))))

  ; Without a free hand no door can be opened, so the robot may always put down what it holds.
  (:action place
    :parameters (?robot - robot ?item - item ?furniture - furniture)
    :precondition (and (at ?robot ?furniture) (open ?furniture) (holding ?robot ?item) (>= (battery ?robot) (reserve)))
    :effect (and
      (free ?robot) (not (holding ?robot ?item)) (on ?item ?furniture)
      (decrease (battery ?robot) (grasp_use)))))
