;;; Derived predicates, object fluents, preferences, constraints and tasks, added to a larger domain.

(:derived (near ?a ?b))
;! 2:1: ':derived' takes 2 operands, found 1

(:derived near (idle))
;! 2:11: expected a predicate with variables such as (name ?x - type), found 'near'

(:derived (near ?a) (idle))
;! 2:11: expected (near ?a - room ?b - room), found 1 variable

(:derived (near ?a ?a) (idle))
;! 2:20: the variable '?a' is there twice

(:derived (near ?a hall) (idle))
;! 2:20: expected a variable such as ?x, found 'hall'

(:derived (near ?a - robot ?b) (idle))
;! 2:11: '?a' is of type robot; expected room

(:derived (charge ?r) (idle))
;! 2:12: 'charge' is a function; expected a predicate

(:derived (busy) (idle)) (:action a :effect (busy))
;! 2:45: 'busy' is a derived predicate; no effect can change it

(:derived (busy) (idle)) (:durative-action a :duration () :effect (at end (not (busy))))
;! 2:80: 'busy' is a derived predicate; no effect can change it

(:derived (busy) (not (busy)))
;! 2:1: the derived predicate 'busy' follows from the absence of 'busy'; expected no such circle

(:derived (busy) (and (idle) (forall (?l - room) (not (dirty ?l)))))
(:derived (dirty ?l) (exists (?r - robot) (at ?r ?l))) (:derived (at ?r ?l) (and (busy) (linked ?l ?l)))
;! 2:1: the derived predicate 'busy' follows from the absence of 'dirty', 'dirty' from 'at', 'at' from 'busy'; expected no such circle

(:derived (busy) (imply (busy) (idle)))
;! 2:1: the derived predicate 'busy' follows from the absence of 'busy'; expected no such circle

(:action a :precondition (= (home hall) hall))
;! 2:35: 'hall' is of type room; expected robot

(:action a :precondition (= (home hall)))
;! 2:26: '=' takes 2 operands, found 1

(:action a :precondition (= (place) 3))
;! 2:29: (place ?r - robot) takes 1 argument, found 0

(:action a :parameters (?r - robot) :precondition (= (home ?r) 3))
;! 2:64: unknown object '3'; expected one of hall

(:action a :parameters (?r - robot) :precondition (> (home ?r) 3))
;! 2:54: the values of 'home' are objects (room); expected a number

(:action a :parameters (?r - robot) :precondition (= (home ?r) (charge ?r)))
;! 2:64: expected an object or a variable, found (charge ...)

(:action a :parameters (?r - robot) :precondition (dirty (charge ?r)))
;! 2:58: expected an object or a variable, found (charge ...)

(:action a :parameters (?r - robot) :precondition (dirty (owner hall)))
;! 2:58: '?owner' is of type robot; expected room

(:action a :parameters (?r - robot) :effect (assign (home ?r) ?r))
;! 2:63: '?r' is of type robot; expected room

(:action a :parameters (?r - robot) :effect (assign (home ?r) (owner hall)))
;! 2:63: 'owner' is of type robot; expected room

(:action a :parameters (?r - robot) :effect (assign (home ?r) 3))
;! 2:63: unknown object '3'; expected one of hall

(:action a :parameters (?r - robot) :effect (increase (home ?r) 3))
;! 2:45: the values of 'home' are objects (room); expected (assign ...)

(:action a :parameters (?r - robot) :effect (assign (charge ?r) hall))
;! 2:65: expected a number or a function in parentheses, found 'hall'

(:action a :parameters (?r - robot) :effect (home ?r))
;! 2:46: 'home' is a function; expected a predicate

(:durative-action a :parameters (?r - robot) :duration (= ?duration (area (home ?r))))
;! 2:75: (home ...) cannot be an argument here; expected an object or a variable

(:action a :precondition (or (idle) (preference p (busy))))
;! 2:38: 'preference' cannot stand here; expected it in a goal, a precondition or :constraints, and there only inside and, forall

(:action a :precondition (preference p (preference q (busy))))
;! 2:41: 'preference' cannot stand here; expected it in a goal, a precondition or :constraints, and there only inside and, forall

(:action a :precondition (preference p))
;! 2:26: expected (preference NAME CONDITION), found 1 part

(:action a :precondition (preference p (busy) (idle)))
;! 2:26: expected (preference NAME CONDITION), found 3 parts

(:action a :precondition (preference ?p (busy)))
;! 2:38: expected the name of a preference, found '?p'

(:durative-action a :duration () :condition (preference p (idle)))
;! 2:59: expected (at start ...), (over all ...), (at end ...), one of them; found (idle)

(:durative-action a :duration () :condition (preference p (at start (preference q (idle)))))
;! 2:59: a preference cannot stand inside another

(:durative-action a :duration () :effect (when (preference p (at start (idle))) (at end (busy))))
;! 2:48: a preference cannot stand in the condition of an effect

(:durative-action a :duration () :effect (when (at end (idle)) (at start (busy))))
;! 2:42: an effect 'at start' cannot depend on a condition 'at end'; expected one 'at start'

(:durative-action a :duration () :condition (or (at start (idle)) (at end (busy))))
;! 2:45: expected (at start ...), (over all ...), (at end ...), and or forall; found (or ...)

(:durative-action a :duration () :condition (not (over all (idle))))
;! 2:45: expected (at start ...), (over all ...), (at end ...), and or forall; found (not ...)

(:constraints (or (always (idle)) (always (busy))))
;! 2:15: expected and, forall, preference, at end, always, sometime, at-most-once, sometime-after, sometime-before, within, always-within, hold-during, hold-after; found (or ...)

(:constraints (within (idle)))
;! 2:15: 'within' takes 1 time and 1 condition, found 1 part

(:constraints (always (idle) (busy)))
;! 2:15: 'always' takes 1 condition, found 2 parts

(:constraints (within -1 (idle)))
;! 2:23: expected a time of at least 0, found '-1'

(:constraints (hold-during 1 x (idle)))
;! 2:30: expected a number, found 'x'

(:constraints (always (sometime (idle))))
;! 2:24: 'sometime' cannot stand here; expected it in :constraints

(:constraints (preference p (preference q (always (idle)))))
;! 2:29: a preference cannot stand inside another

(:constraints (always (dirty ?l)))
;! 2:30: unknown variable '?l'; none is declared
