; A robot in a shopping mall is talked to: visitors ask for the way, interrupt it, ask for another way, chat.
;
; Every request is a task of its own, and all tasks share the robot: whoever speaks has its voice, whoever points its
; arm (see bindings.yaml). Nobody has either while an answer is waited for, so another task may talk meanwhile.
;
; For readers who know ROS 2: each action is an action server of the program robot.py, and all facts below are what that
; program senses: it knows what it has said, and what it was told.
;
; For readers who know PDDL: the planner hopes that a visitor will understand. When she says no, hear_answer fails, the
; robot takes back that it was shown and described, and a new plan does that once more.

(define (domain mall)
  (:requirements :typing :durative-actions)
  (:types visitor shop)

  (:predicates
    (route_known ?shop - shop)
    (pointed_out ?visitor - visitor ?shop - shop)
    (described ?visitor - visitor ?shop - shop)
    (asked ?visitor - visitor ?shop - shop)
    (understood ?visitor - visitor ?shop - shop))

  (:durative-action look_up
    :parameters (?shop - shop)
    :duration (= ?duration 0.5)
    :condition ()
    :effect (at end (route_known ?shop)))

  ; Arm and voice go together as long as both are free: the plan lets them begin at the same time.
  (:durative-action point_at
    :parameters (?visitor - visitor ?shop - shop)
    :duration (= ?duration 3)
    :condition (at start (route_known ?shop))
    :effect (at end (pointed_out ?visitor ?shop)))

  (:durative-action describe_route
    :parameters (?visitor - visitor ?shop - shop)
    :duration (= ?duration 2)
    :condition (at start (route_known ?shop))
    :effect (at end (described ?visitor ?shop)))

  ; "Did you understand?" The answer comes in its own time.
  (:durative-action ask_understood
    :parameters (?visitor - visitor ?shop - shop)
    :duration (= ?duration 1)
    :condition (and
      (at start (pointed_out ?visitor ?shop))
      (at start (described ?visitor ?shop)))
    :effect (at end (asked ?visitor ?shop)))

  (:durative-action hear_answer
    :parameters (?visitor - visitor ?shop - shop)
    :duration (= ?duration 0.5)
    :condition (at start (asked ?visitor ?shop))
    :effect (at end (understood ?visitor ?shop))))
