; A door that may be locked, and a battery: who tries the door with too little of it neither gets round it nor back to the charger.
(define (domain door)
  (:requirements :strips :typing :non-deterministic)
  (:types place level)
  (:predicates
    (at ?p - place) (battery ?l - level) (less ?from ?to - level) (full ?l - level) (charger ?p - place)
    (way ?from ?to - place) (door ?from ?to - place) (shut ?from ?to - place) (open ?from ?to - place) (locked ?from ?to - place))
  (:action drive
    :parameters (?from ?to - place ?l ?m - level)
    :precondition (and (at ?from) (way ?from ?to) (battery ?l) (less ?l ?m))
    :effect (and (not (at ?from)) (at ?to) (not (battery ?l)) (battery ?m)))
  (:action charge
    :parameters (?p - place ?l ?m - level)
    :precondition (and (at ?p) (charger ?p) (battery ?l) (full ?m))
    :effect (and (not (battery ?l)) (battery ?m)))
  (:action try
    :parameters (?from ?to - place ?l ?m - level)
    :precondition (and (at ?from) (door ?from ?to) (shut ?from ?to) (battery ?l) (less ?l ?m))
    :effect (and (not (battery ?l)) (battery ?m) (not (shut ?from ?to)) (oneof (open ?from ?to) (locked ?from ?to))))
  (:action pass
    :parameters (?from ?to - place ?l ?m - level)
    :precondition (and (at ?from) (open ?from ?to) (battery ?l) (less ?l ?m))
    :effect (and (not (at ?from)) (at ?to) (not (battery ?l)) (battery ?m))))
