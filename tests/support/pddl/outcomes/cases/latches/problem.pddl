(define (problem latches) (:domain latches) (:init (tool)) (:goal (and (left) (right))))
