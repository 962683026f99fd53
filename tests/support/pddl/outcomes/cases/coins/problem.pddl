(define (problem coins) (:domain coins) (:init (fresh)) (:goal (won)))
