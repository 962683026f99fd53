; A goal that an outcome reaches which was not wanted: the ball often stops half-way, where it is wanted as well.
(define (domain in_passing)
  (:requirements :adl :non-deterministic)
  (:types place)
  (:predicates (ball ?p - place) (next ?from ?to - place) (wanted ?p - place) (pit ?p - place))
  (:action push
    :parameters (?from ?mid ?to - place)
    :precondition (and (ball ?from) (next ?from ?mid) (next ?mid ?to) (not (pit ?from)))
    :effect (and (not (ball ?from)) (oneof (ball ?mid) (ball ?to) (ball ?to) (ball ?from))))
  (:action nudge
    :parameters (?from ?to - place)
    :precondition (and (ball ?from) (next ?from ?to) (not (pit ?from)))
    :effect (and (not (ball ?from)) (oneof (ball ?to) (ball ?from)))))
