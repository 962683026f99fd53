(define (problem lock) (:domain lock) (:init (key)) (:goal (open)))
