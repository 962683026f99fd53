; Robots deliver parcels in a building.
;
; For readers who know ROS 2: a PDDL action is what you would call a skill. Each action below is
; performed by an action server (bindings.yaml says which), and its parameters fill the goal message.
; `at start` says what must hold when the goal is sent, `over all` what must hold while it is
; executed, `at end` what must hold, or has changed, when it has succeeded.
;
; For readers who know PDDL: every condition is checked on the robots while they work, and every
; effect is looked for before an action counts as done. What an action changes `at start` is
; taken back when it fails, so that a failed `move` does not leave a robot nowhere.

(define (domain delivery)
  (:requirements :typing :durative-actions :numeric-fluents :negative-preconditions)

  (:types
    robot parcel - movable              ; what can be somewhere
    place door - object)

  (:predicates
    (at ?thing - movable ?place - place)
    (carries ?robot - robot ?parcel - parcel)
    (empty ?robot - robot)              ; carries nothing; a robot has room for one parcel
    (connected ?from ?to - place)       ; one can simply drive from here to there
    (leads ?door - door ?from ?to - place) ; as `connected`, but with a door in between
    (open ?door - door)                 ; doors may fall shut, or be shut by people, at any time
    (station ?place - place)            ; a loading station: parcels on shelves, a lift to load them
    (free ?station - place))            ; nobody uses the lift of this station

  (:functions
    (distance ?from ?to - place)        ; metres, for connected places and for doors
    (speed ?robot - robot))             ; metres per second

  ; Drive along an open corridor. While driving the robot is at no place.
  (:durative-action move
    :parameters (?robot - robot ?from ?to - place)
    :duration (= ?duration (/ (distance ?from ?to) (speed ?robot)))
    :condition (and
      (at start (connected ?from ?to))
      (at start (at ?robot ?from)))
    :effect (and
      (at start (not (at ?robot ?from)))
      (at end (at ?robot ?to))))

  ; Drive through a door. It must stay open all the time: when it closes, the robot is stopped.
  (:durative-action pass_door
    :parameters (?robot - robot ?door - door ?from ?to - place)
    :duration (= ?duration (/ (distance ?from ?to) (speed ?robot)))
    :condition (and
      (at start (leads ?door ?from ?to))
      (at start (at ?robot ?from))
      (over all (open ?door)))
    :effect (and
      (at start (not (at ?robot ?from)))
      (at end (at ?robot ?to))))

  (:durative-action open_door
    :parameters (?robot - robot ?door - door ?from ?to - place)
    :duration (= ?duration 3)
    :condition (and
      (at start (leads ?door ?from ?to))
      (over all (at ?robot ?from)))
    :effect (at end (open ?door)))

  ; Load a parcel from the shelf with the lift of the station. There is one lift: it is taken at
  ; the start and free again at the end. If somebody pushes the robot away, loading is cancelled.
  (:durative-action load
    :parameters (?robot - robot ?parcel - parcel ?station - place)
    :duration (= ?duration 4)
    :condition (and
      (at start (station ?station))
      (at start (free ?station))
      (at start (empty ?robot))
      (over all (at ?robot ?station))
      (at start (at ?parcel ?station)))
    :effect (and
      (at start (not (free ?station)))
      (at start (not (empty ?robot)))
      (at start (not (at ?parcel ?station)))
      (at end (carries ?robot ?parcel))
      (at end (free ?station))))

  ; Pick a parcel up from the floor, anywhere but at a station: slow, but a lost parcel, or one
  ; that a robot had to put down half-way, can still be fetched.
  (:durative-action pick_up
    :parameters (?robot - robot ?parcel - parcel ?place - place)
    :duration (= ?duration 8)
    :condition (and
      (at start (not (station ?place)))
      (at start (empty ?robot))
      (over all (at ?robot ?place))
      (at start (at ?parcel ?place)))
    :effect (and
      (at start (not (empty ?robot)))
      (at start (not (at ?parcel ?place)))
      (at end (carries ?robot ?parcel))))

  ; Put the parcel down, at any place.
  (:durative-action unload
    :parameters (?robot - robot ?parcel - parcel ?place - place)
    :duration (= ?duration 2)
    :condition (and
      (at start (carries ?robot ?parcel))
      (over all (at ?robot ?place)))
    :effect (and
      (at start (not (carries ?robot ?parcel)))
      (at end (at ?parcel ?place))
      (at end (empty ?robot)))))
