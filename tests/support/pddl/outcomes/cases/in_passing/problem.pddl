; From a, a push reaches the goal by b or by c; from b a further one would end in the pit.
(define (problem in_passing) (:domain in_passing) (:objects a b c d - place)
  (:init (ball a) (next a b) (next b c) (next c d) (wanted b) (wanted c) (pit d))
  (:goal (exists (?p - place) (and (ball ?p) (wanted ?p)))))
