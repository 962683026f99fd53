; Chances that sum to less than 1: the rest changes nothing. An attempt with the key cannot be made again.
(define (domain lock)
  (:requirements :strips :negative-preconditions :probabilistic-effects)
  (:predicates (key) (open) (jammed))
  (:action turn_key
    :parameters ()
    :precondition (key)
    :effect (and (not (key)) (probabilistic 0.7 (open))))
  (:action pick_lock
    :parameters ()
    :precondition (not (jammed))
    :effect (probabilistic 0.3 (open) 0.2 (jammed))))
