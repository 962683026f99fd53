; A robot greets a visitor, finds out what she wants, and says or shows it. Voice and arm work at the same time.
; Edit the actions: each is one of your action servers.

(define (domain dialogue)
  (:requirements :typing :durative-actions :negative-preconditions)
  (:types person topic - object)

  (:predicates
    (greeted ?person - person)
    (speaking)                                ; one voice: it says one thing at a time
    (knows_wish ?person - person)
    (told ?person - person ?topic - topic)
    (shown ?person - person ?topic - topic))

  (:durative-action greet
    :parameters (?person - person)
    :duration (= ?duration 2)
    :condition (at start (not (speaking)))
    :effect (and (at start (speaking)) (at end (not (speaking))) (at end (greeted ?person))))

  (:durative-action ask_wish                  ; a server that waits for what the visitor says
    :parameters (?person - person)
    :duration (= ?duration 5)
    :condition (and (at start (greeted ?person)) (at start (not (speaking))))
    :effect (and (at start (speaking)) (at end (not (speaking))) (at end (knows_wish ?person))))

  (:durative-action tell
    :parameters (?person - person ?topic - topic)
    :duration (= ?duration 6)
    :condition (and (at start (knows_wish ?person)) (at start (not (speaking))))
    :effect (and (at start (speaking)) (at end (not (speaking))) (at end (told ?person ?topic))))

  (:durative-action point_at
    :parameters (?person - person ?topic - topic)
    :duration (= ?duration 4)
    :condition (at start (knows_wish ?person))
    :effect (at end (shown ?person ?topic))))
