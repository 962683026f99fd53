; A robot in a shopping mall shows people the way: speech, pointing and walking in one plan.
;
; Speaking and pointing go on at the same time: `describe_route` is speech, and `over all` it
; demands that the robot points at the shop, which only `point_at` brings about, and only while it
; lasts. So a plan has to start pointing first, then speak, and be silent before the arm is lowered.
;
; For readers who know ROS 2: each action is an action server (speech, arm, base, look-up), and
; `over all` conditions are watched while it works: if the arm drops, the speech is cancelled.
;
; For readers who know PDDL: the planner hopes, the robot finds out. `ask_wish` has the shop the
; person *may* want as a parameter. When the person names another one, the expected effect is not
; observed, and planning goes on from what was observed: (wants ...) another shop.
;
; No failure leads into a dead end. What is described is remembered with the way in which it was,
; so when a person has not understood one way, there are others; a visitor who walks off can
; be followed; and `stop_talking` makes a robot silent that is believed to be speaking for ever.

(define (domain mall_guide)
  (:requirements :typing :durative-actions :negative-preconditions :universal-preconditions :conditional-effects)

  (:types
    robot person - agent
    shop landmark - sight               ; what one can point at
    spot way - object)

  (:constants voice by_landmark screen - way)  ; how a route can be described

  (:predicates
    (at ?agent - agent ?spot - spot)
    (way_between ?from ?to - spot)
    (visible ?sight - sight ?spot - spot)      ; from here, so here one can point at it
    (near ?landmark - landmark ?shop - shop)
    (facing ?robot - robot ?person - person)   ; turned to the person, looking at the face
    (speaking ?robot - robot)                  ; one utterance at a time
    (pointing_at ?robot - robot ?sight - sight)
    (screen_at ?spot - spot)                   ; a large screen that the robot can show a map on
    (may_want ?person - person ?shop - shop)   ; what a person could possibly answer
    (wish_known ?person - person)
    (wants ?person - person ?shop - shop)
    (route_known ?robot - robot ?shop - shop)
    (topic ?person - person ?sight - sight)    ; worth pointing at: the shop looked up, a landmark both can see
    (described ?person - person ?shop - shop ?way - way)
    (guided ?person - person))

  ; --- motion ---------------------------------------------------------------------------------

  ; Whoever walks away no longer looks at anybody.
  (:durative-action walk
    :parameters (?robot - robot ?from ?to - spot)
    :duration (= ?duration 6)
    :condition (and
      (at start (way_between ?from ?to))
      (at start (at ?robot ?from))
      (at start (not (speaking ?robot))))
    :effect (and
      (at start (not (at ?robot ?from)))
      (forall (?person - person) (at start (not (facing ?robot ?person))))
      (at end (at ?robot ?to))))

  ; Walk together to a place from which there is more to see.
  (:durative-action lead
    :parameters (?robot - robot ?person - person ?from ?to - spot)
    :duration (= ?duration 8)
    :condition (and
      (at start (way_between ?from ?to))
      (at start (at ?robot ?from))
      (at start (at ?person ?from))
      (at start (facing ?robot ?person))       ; one asks before one walks off
      (at start (wish_known ?person))
      (at start (not (speaking ?robot))))
    :effect (and
      (at start (not (at ?robot ?from)))
      (at start (not (at ?person ?from)))
      (forall (?anyone - person) (at start (not (facing ?robot ?anyone))))
      (at end (at ?robot ?to))
      (at end (at ?person ?to))))

  (:durative-action turn_to
    :parameters (?robot - robot ?person - person ?spot - spot)
    :duration (= ?duration 2)
    :condition (and
      (at start (not (facing ?robot ?person)))
      (over all (at ?robot ?spot))
      (over all (at ?person ?spot)))
    :effect (and
      (forall (?other - person) (at start (not (facing ?robot ?other))))
      (at end (facing ?robot ?person))))

  ; Hold the arm towards a shop or a landmark; true while it lasts, and at its end no more.
  ; It takes a good deal longer than what is said meanwhile, as no server is exactly on time.
  (:durative-action point_at
    :parameters (?robot - robot ?person - person ?sight - sight ?spot - spot)
    :duration (= ?duration 12)
    :condition (and
      (at start (topic ?person ?sight))
      (at start (visible ?sight ?spot))
      (at start (facing ?robot ?person))
      (at start (not (speaking ?robot)))
      (over all (at ?robot ?spot)))
    :effect (and
      (at start (pointing_at ?robot ?sight))
      (at end (not (pointing_at ?robot ?sight)))))

  ; --- look-up -------------------------------------------------------------------------------

  (:durative-action look_up
    :parameters (?robot - robot ?person - person ?shop - shop)
    :duration (= ?duration 1)
    :condition (at start (wants ?person ?shop))
    :effect (and
      (at end (route_known ?robot ?shop))
      (at end (topic ?person ?shop))))

  ; When the data base does not answer: slower, and by telephone, so nobody else is spoken to.
  (:durative-action ask_colleague
    :parameters (?robot - robot ?person - person ?shop - shop)
    :duration (= ?duration 8)
    :condition (and
      (at start (wants ?person ?shop))
      (at start (not (speaking ?robot))))
    :effect (and
      (at start (speaking ?robot))
      (at end (not (speaking ?robot)))
      (at end (route_known ?robot ?shop))
      (at end (topic ?person ?shop))))

  ; --- speech ---------------------------------------------------------------------------------
  ; Each utterance takes the voice at its start and gives it back at its end.

  ; "Would you please come before me?" Speech in place of motion, for a robot that cannot turn.
  (:durative-action call_over
    :parameters (?robot - robot ?person - person ?spot - spot)
    :duration (= ?duration 6)
    :condition (and
      (at start (not (facing ?robot ?person)))
      (at start (not (speaking ?robot)))
      (over all (at ?robot ?spot))
      (over all (at ?person ?spot)))
    :effect (and
      (at start (speaking ?robot))
      (forall (?other - person) (at start (not (facing ?robot ?other))))
      (at end (not (speaking ?robot)))
      (at end (facing ?robot ?person))))

  (:durative-action ask_wish
    :parameters (?robot - robot ?person - person ?shop - shop ?spot - spot)
    :duration (= ?duration 4)
    :condition (and
      (at start (may_want ?person ?shop))
      (at start (not (wish_known ?person)))
      (at start (not (speaking ?robot)))
      (over all (facing ?robot ?person))
      (over all (at ?robot ?spot))
      (over all (at ?person ?spot)))
    :effect (and
      (at start (speaking ?robot))
      (at end (not (speaking ?robot)))
      (at end (wish_known ?person))
      (at end (wants ?person ?shop))))

  ; "Can you see the fountain?"
  (:durative-action ask_landmark
    :parameters (?robot - robot ?person - person ?landmark - landmark ?spot - spot)
    :duration (= ?duration 3)
    :condition (and
      (at start (visible ?landmark ?spot))
      (at start (not (speaking ?robot)))
      (over all (facing ?robot ?person))
      (over all (at ?robot ?spot))
      (over all (at ?person ?spot)))
    :effect (and
      (at start (speaking ?robot))
      (at end (not (speaking ?robot)))
      (at end (topic ?person ?landmark))))

  ; "It is over there, where I am pointing."
  (:durative-action describe_route
    :parameters (?robot - robot ?person - person ?shop - shop ?spot - spot)
    :duration (= ?duration 5)
    :condition (and
      (at start (route_known ?robot ?shop))
      (at start (wants ?person ?shop))
      (at start (not (speaking ?robot)))
      (over all (pointing_at ?robot ?shop))
      (over all (at ?robot ?spot))
      (over all (at ?person ?spot)))
    :effect (and
      (at start (speaking ?robot))
      (at end (not (speaking ?robot)))
      (at end (described ?person ?shop voice))))

  ; "You see the fountain there? The shop is right behind it."
  (:durative-action describe_by_landmark
    :parameters (?robot - robot ?person - person ?shop - shop ?landmark - landmark ?spot - spot)
    :duration (= ?duration 6)
    :condition (and
      (at start (route_known ?robot ?shop))
      (at start (wants ?person ?shop))
      (at start (near ?landmark ?shop))
      (at start (topic ?person ?landmark))
      (at start (not (speaking ?robot)))
      (over all (pointing_at ?robot ?landmark))
      (over all (at ?robot ?spot))
      (over all (at ?person ?spot)))
    :effect (and
      (at start (speaking ?robot))
      (at end (not (speaking ?robot)))
      (at end (described ?person ?shop by_landmark))))

  ; The map on the screen, read out: slow, but it works for every shop.
  (:durative-action show_on_screen
    :parameters (?robot - robot ?person - person ?shop - shop ?spot - spot)
    :duration (= ?duration 10)
    :condition (and
      (at start (screen_at ?spot))
      (at start (route_known ?robot ?shop))
      (at start (wants ?person ?shop))
      (at start (not (speaking ?robot)))
      (over all (facing ?robot ?person))
      (over all (at ?robot ?spot))
      (over all (at ?person ?spot)))
    :effect (and
      (at start (speaking ?robot))
      (at end (not (speaking ?robot)))
      (at end (described ?person ?shop screen))))

  ; "Did you get that?" Asked once per way of describing; after a "no" another way is left.
  (:durative-action check_understanding
    :parameters (?robot - robot ?person - person ?shop - shop ?way - way ?spot - spot)
    :duration (= ?duration 3)
    :condition (and
      (at start (wants ?person ?shop))
      (at start (described ?person ?shop ?way))
      (at start (not (speaking ?robot)))
      (over all (facing ?robot ?person))
      (over all (at ?robot ?spot))
      (over all (at ?person ?spot)))
    :effect (and
      (at start (speaking ?robot))
      (at end (not (speaking ?robot)))
      (at end (guided ?person))))

  ; Needed only after a failure, when the robot is believed to speak and nothing would end it.
  (:durative-action stop_talking
    :parameters (?robot - robot)
    :duration (= ?duration 1)
    :condition (at start (speaking ?robot))
    :effect (at end (not (speaking ?robot)))))
