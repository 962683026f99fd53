; Who is there, what there is to talk about, and a goal.

(define (problem first)
  (:domain dialogue)
  (:objects ada - person bakery - topic)
  (:init)
  (:goal (and (told ada bakery) (shown ada bakery))))
