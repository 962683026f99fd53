(define (problem already) (:domain latches) (:init (left) (right)) (:goal (and (left) (right))))
