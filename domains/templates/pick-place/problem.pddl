; Your things and places, what is so now, and a goal. Facts that a sensor reports need not be here.

(define (problem first)
  (:domain pick-place)
  (:objects cup bolt - thing table box shelf - place)
  (:init (empty) (on cup table) (on bolt table) (reachable table) (reachable box) (reachable shelf))
  (:goal (and (on cup shelf) (on bolt box))))
