; Two independent outcomes of one action; what one of them deletes and the other adds is added.
(define (domain latches)
  (:requirements :strips :non-deterministic)
  (:predicates (left) (right) (shaken) (tool))
  (:action press
    :parameters ()
    :precondition (tool)
    :effect (and (oneof (and) (left)) (oneof (and) (right))))
  (:action kick
    :parameters ()
    :effect (and (oneof (and) (and (left) (right))) (oneof (not (left)) (not (tool)) (and)) (shaken))))
