; Robots patrol a site, look at every waypoint, and come back to their docks before they run flat.
;
; For readers who know ROS 2: the actions have no duration here; the planner only cares about
; their order, and how long an action server takes does not matter. Two robots still work at the
; same time, as the orderings are found afterwards: what depends on nothing waits for nothing.
;
; For readers who know PDDL: (battery ?robot) is a belief until it is measured. If driving took
; more energy than planned, the next plan starts from what the battery monitor says.
;
; No dead end: as long as all goes well, a robot keeps the `reserve` of the place it is at. When
; the battery drops faster, or a way is blocked, `return_home` may use up the reserve, and a robot
; that has none left is towed. A plan needs neither of them before something has gone wrong.

(define (domain patrol)
  (:requirements :typing :numeric-fluents :negative-preconditions)

  (:types robot place)

  (:predicates
    (at ?robot - robot ?place - place)
    (connected ?from ?to - place)
    (dock ?place - place)               ; robots are charged here
    (inspected ?place - place))

  (:functions
    (battery ?robot - robot)            ; per cent
    (full ?robot - robot)               ; per cent after charging; old batteries have less than 100
    (energy ?from ?to - place)          ; per cent that the way takes
    (look_around ?place - place)        ; per cent that an inspection takes: lamps, cameras
    (reserve ?place - place)            ; per cent with which one gets from here to a dock, and
                                        ; with which one can leave on any of the ways from here
    (effort ?robot - robot))            ; what the metric counts

  (:action move
    :parameters (?robot - robot ?from ?to - place)
    :precondition (and
      (at ?robot ?from)
      (connected ?from ?to)
      (>= (battery ?robot) (+ (energy ?from ?to) (reserve ?to))))
    :effect (and
      (not (at ?robot ?from))
      (at ?robot ?to)
      (decrease (battery ?robot) (energy ?from ?to))
      (increase (effort ?robot) (energy ?from ?to))))

  (:action inspect
    :parameters (?robot - robot ?place - place)
    :precondition (and
      (at ?robot ?place)
      (not (inspected ?place))
      (>= (battery ?robot) (+ (look_around ?place) (reserve ?place))))
    :effect (and
      (inspected ?place)
      (decrease (battery ?robot) (look_around ?place))
      (increase (effort ?robot) (look_around ?place))))

  (:action charge
    :parameters (?robot - robot ?dock - place)
    :precondition (and
      (at ?robot ?dock)
      (dock ?dock)
      (< (battery ?robot) (full ?robot)))
    :effect (and
      (assign (battery ?robot) (full ?robot))
      (increase (effort ?robot) 10)))

  ; As `move`, but on the reserve: slowly, and without enough left to inspect anything.
  (:action return_home
    :parameters (?robot - robot ?from ?to - place)
    :precondition (and
      (at ?robot ?from)
      (connected ?from ?to)
      (>= (battery ?robot) (energy ?from ?to))
      (< (battery ?robot) (+ (energy ?from ?to) (reserve ?to))))
    :effect (and
      (not (at ?robot ?from))
      (at ?robot ?to)
      (decrease (battery ?robot) (energy ?from ?to))
      (increase (effort ?robot) (* 3 (energy ?from ?to)))))

  ; A person pushes a robot without reserve to a dock.
  (:action tow
    :parameters (?robot - robot ?from ?dock - place)
    :precondition (and
      (at ?robot ?from)
      (dock ?dock)
      (< (battery ?robot) (reserve ?from)))
    :effect (and
      (not (at ?robot ?from))
      (at ?robot ?dock)
      (increase (effort ?robot) 200))))
