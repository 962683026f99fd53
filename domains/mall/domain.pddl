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
  (:requirements :strips :typing)
  (:types visitor shop)

  (:predicates
    (route_known ?visitor - visitor ?shop - shop)
    (pointed_out ?visitor - visitor ?shop - shop)
    (described ?visitor - visitor ?shop - shop)
    (asked ?visitor - visitor ?shop - shop)
    (understood ?visitor - visitor ?shop - shop))

  ; The way that is good for this visitor.
  (:action look_up
    :parameters (?visitor - visitor ?shop - shop)
    :precondition ()
    :effect (route_known ?visitor ?shop))

  ; Arm and voice go together when both are free: neither of the two waits for the other.
  (:action point_at
    :parameters (?visitor - visitor ?shop - shop)
    :precondition (route_known ?visitor ?shop)
    :effect (pointed_out ?visitor ?shop))

  (:action describe_route
    :parameters (?visitor - visitor ?shop - shop)
    :precondition (route_known ?visitor ?shop)
    :effect (described ?visitor ?shop))

  ; "Did you understand?" The answer comes in its own time.
  (:action ask_understood
    :parameters (?visitor - visitor ?shop - shop)
    :precondition (and (pointed_out ?visitor ?shop) (described ?visitor ?shop))
    :effect (asked ?visitor ?shop))

  (:action hear_answer
    :parameters (?visitor - visitor ?shop - shop)
    :precondition (asked ?visitor ?shop)
    :effect (understood ?visitor ?shop)))
