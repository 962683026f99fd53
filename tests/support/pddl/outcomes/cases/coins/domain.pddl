; Alternatives that are there twice are twice as likely, and what leaves nothing changed can be tried again.
(define (domain coins)
  (:requirements :strips :non-deterministic)
  (:predicates (fresh) (won) (lost) (second))
  (:action even
    :parameters ()
    :precondition (fresh)
    :effect (and (not (fresh)) (oneof (won) (lost))))
  (:action uneven
    :parameters ()
    :precondition (fresh)
    :effect (and (not (fresh)) (oneof (won) (lost) (won) (second))))
  (:action again
    :parameters ()
    :precondition (second)
    :effect (oneof (and) (and) (and (won) (not (second))) (and (lost) (not (second))) (and (won) (not (second)))))
  (:action wait
    :parameters ()
    :precondition (fresh)
    :effect (oneof (and) (and))))
