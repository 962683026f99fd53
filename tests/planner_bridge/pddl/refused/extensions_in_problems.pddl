;;; Sections of problems that use the extensions of PDDL.

(:init (= (home r2) r2)) (:goal ())
;! 2:21: 'r2' is of type robot; expected room

(:init (= (home r2) 3)) (:goal ())
;! 2:21: unknown object '3'; expected one of hall, kitchen

(:init (= (home r2) (place r2))) (:goal ())
;! 2:21: expected an object, found (place ...)

(:init (dirty (home r2))) (:goal ())
;! 2:15: (home ...) cannot be an argument here; expected an object or a variable

(:goal ()) (:metric minimize (is-violated p))
;! 2:43: unknown preference 'p'; none is declared

(:goal (preference pref (idle))) (:metric minimize (is-violated pre))
;! 2:65: unknown preference 'pre'; did you mean 'pref'?

(:goal (preference p (idle))) (:metric minimize (is-violated (p)))
;! 2:62: expected the name of a preference, found (p)

(:goal (preference p (idle))) (:metric minimize (is-violated))
;! 2:49: 'is-violated' takes 1 operand, found 0

(:goal (> (is-violated p) 0))
;! 2:12: 'is-violated' cannot stand here; expected it in :metric

(:goal (not (preference p (idle))))
;! 2:14: 'preference' cannot stand here; expected it in a goal, a precondition or :constraints, and there only inside and, forall
