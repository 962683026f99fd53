; A robot in a shopping mall is talked to: visitors ask for the way, interrupt it, ask for another way, chat.
;
; Every request is a task of its own, and all tasks share the robot: whoever speaks has its voice, whoever points its
; arm (see bindings.yaml). Nobody has either while an answer is waited for, so another task may talk meanwhile.
;
; For readers who know ROS 2: each action is an action server of the program robot.py, and all facts below are what that
; program senses: it knows what it is pointing at, and what it was told.
;
; For readers who know PDDL: the planner hopes that a visitor will understand. When she says no, hear_answer fails, the
; robot takes back that the way is described, and a new plan describes it once more.

(define (domain mall)
  (:requirements :typing :durative-actions)
  (:types visitor shop)

  (:predicates
    (route_known ?shop - shop)
    (pointing ?shop - shop)
    (described ?visitor - visitor ?shop - shop)
    (asked ?visitor - visitor ?shop - shop)
    (understood ?visitor - visitor ?shop - shop))

  (:durative-action look_up
    :parameters (?shop - shop)
    :duration (= ?duration 0.5)
    :condition ()
    :effect (at end (route_known ?shop)))

  ; Hold the arm towards the shop, for longer than it takes to describe the way.
  (:durative-action point_at
    :parameters (?shop - shop)
    :duration (= ?duration 6)
    :condition (at start (route_known ?shop))
    :effect (and
      (at start (pointing ?shop))
      (at end (not (pointing ?shop)))))

  (:durative-action describe_route
    :parameters (?visitor - visitor ?shop - shop)
    :duration (= ?duration 2)
    :condition (over all (pointing ?shop))
    :effect (at end (described ?visitor ?shop)))

  ; "Did you understand?" The answer comes in its own time.
  (:durative-action ask_understood
    :parameters (?visitor - visitor ?shop - shop)
    :duration (= ?duration 1)
    :condition (at start (described ?visitor ?shop))
    :effect (at end (asked ?visitor ?shop)))

  (:durative-action hear_answer
    :parameters (?visitor - visitor ?shop - shop)
    :duration (= ?duration 0.5)
    :condition (at start (asked ?visitor ?shop))
    :effect (at end (understood ?visitor ?shop))))
