; The more is on the tray, the more may fall: each thing on it by its own chance, if the robot does not go slowly.
(define (domain tray)
  (:requirements :adl :probabilistic-effects)
  (:types cup)
  (:predicates (on_tray ?c - cup) (delivered ?c - cup) (lost ?c - cup) (slow_allowed) (back))
  (:action load
    :parameters (?c - cup)
    :precondition (and (back) (not (on_tray ?c)) (not (lost ?c)) (not (delivered ?c)))
    :effect (on_tray ?c))
  (:action go
    :parameters ()
    :precondition (back)
    :effect (and (not (back))
      (forall (?c - cup) (when (on_tray ?c) (and (not (on_tray ?c))
        (probabilistic 0.8 (delivered ?c) 0.15 (lost ?c) 0.05 (and (lost ?c) (delivered ?c))))))))
  (:action return
    :parameters ()
    :precondition (not (back))
    :effect (back)))
