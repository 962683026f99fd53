(define (problem orchard) (:domain orchard) (:objects apple pear plum - fruit)
  (:init (on_tree apple) (on_tree pear) (on_tree plum))
  (:goal (forall (?f - fruit) (fallen ?f))))
