;;; Sections of problems, added to a small problem.

(:goa (idle))
;! 2:2: unknown section ':goa'; did you mean ':goal'?

(:goal)
;! 2:1: expected (:goal CONDITION), found 0 conditions

(:goal (idle) (idle))
;! 2:1: expected (:goal CONDITION), found 2 conditions

(:goal ())
(:goal (idle))
;! 3:1: a second :goal section; the first is in line 2

(:goal (at r2 nowhere))
;! 2:15: unknown object 'nowhere'; expected one of hall, kitchen

(:goal (at r2 kitchn))
;! 2:15: unknown object 'kitchn'; did you mean 'kitchen'?

(:goal (at r2))
;! 2:8: (at ?r - robot ?l - room) takes 2 arguments, found 1

(:goal (at kitchen r2))
;! 2:12: 'kitchen' is of type room; expected robot

(:goal (sometime (idle)))
;! 2:9: 'sometime' cannot stand here; expected it in :constraints

(:goal (xyz))
;! 2:9: unknown predicate 'xyz'; expected one of at, idle

(:goal (> (charge r2) ?duration))
;! 2:23: '?duration' can only be used in the conditions and effects of a durative action

(:objects 5 - room)
;! 2:11: expected the name of an object, found '5'

(:init idle)
;! 2:8: expected a fact, (= FUNCTION VALUE) or (at TIME ...), found 'idle'

(:init (idel))
;! 2:9: unknown predicate 'idel'; did you mean 'idle'?

(:init (at r2 ?x))
;! 2:15: unknown variable '?x'; none is declared

(:init (at -1 (idle)))
;! 2:12: expected a time of at least 0, found '-1'

(:init (at r2 (idle)))
;! 2:15: expected an object or a variable, found (idle)

(:init (at 5 hall))
;! 2:12: unknown object '5'; expected one of r2

(:init (= (charge r2) hall))
;! 2:23: expected a number, found 'hall'

(:init (idle) (not (idle)))
;! 2:15: (idle) has another value before; expected one value

(:init (at 5 (idle)) (at 5.0 (not (idle))))
;! 2:22: (idle) has another value before; expected one value

(:init (oneof (idle)))
;! 2:8: uncertain initial states (oneof in :init) are not supported yet; a contingent planner, which unified-planning lacks, would be needed

(:init (unknown (idle)))
;! 2:8: uncertain initial states (unknown in :init) are not supported yet; a contingent planner, which unified-planning lacks, would be needed

(:init (or (idle)))
;! 2:8: uncertain initial states (or in :init) are not supported yet; a contingent planner, which unified-planning lacks, would be needed

(:init (and (idle)))
;! 2:9: 'and' cannot stand here; expected a predicate

(:goal ()) (:metric minimise (total-time))
;! 2:12: expected (:metric minimize EXPRESSION) or (:metric maximize EXPRESSION)
