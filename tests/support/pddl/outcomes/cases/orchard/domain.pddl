; Outcomes for each of all objects: every fruit on the tree may fall when it is shaken.
(define (domain orchard)
  (:requirements :adl :non-deterministic)
  (:types fruit)
  (:predicates (on_tree ?f - fruit) (fallen ?f - fruit))
  (:action shake
    :parameters ()
    :effect (forall (?f - fruit) (when (on_tree ?f) (oneof (and) (and (not (on_tree ?f)) (fallen ?f)))))))
