; An outcome under a condition: a wet cup may slip out of the hand and break, a dry one never does.
(define (domain slippery)
  (:requirements :adl :probabilistic-effects)
  (:types cup)
  (:predicates (wet ?c - cup) (held ?c - cup) (broken ?c - cup) (towel))
  (:action dry
    :parameters (?c - cup)
    :precondition (and (towel) (not (held ?c)))
    :effect (not (wet ?c)))
  (:action pick
    :parameters (?c - cup)
    :precondition (and (not (held ?c)) (not (broken ?c)))
    :effect (and (held ?c) (when (wet ?c) (probabilistic 0.4 (broken ?c))))))
