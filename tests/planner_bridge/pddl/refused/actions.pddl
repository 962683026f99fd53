;;; Actions, added to a small domain.

(:action)
;! 2:1: expected a name after ':action', found nothing

(:action (a))
;! 2:10: expected the name of an action, found (a)

(:action a :efect (idle))
;! 2:12: unknown key ':efect' in the action 'a'; did you mean ':effect'?

(:action a (idle))
;! 2:12: expected one of :parameters, :precondition, :effect, :vars; found (idle)

(:action a :effect)
;! 2:12: expected a value after ':effect', found nothing

(:action a :precondition :effect (idle))
;! 2:12: expected a value after ':precondition', found ':effect'

(:action a :effect (idle) :effect (idle))
;! 2:27: a second :effect; expected one

(:action a :parameters ?x)
;! 2:24: expected the parameters in parentheses, found '?x'

(:action a :parameters (?x ?X))
;! 2:28: the variable '?X' is there twice

(:action a :precondition idle)
;! 2:26: expected a condition in parentheses, found 'idle'

(:action a :precondition (idel))
;! 2:27: unknown predicate 'idel'; did you mean 'idle'?

(:action a :precondition (charge hall))
;! 2:27: 'charge' is a function; expected a predicate

(:action a :precondition ((idle)))
;! 2:27: expected the name of a predicate, found (idle)

(:action a :precondition (idle hall))
;! 2:26: (idle) takes 0 arguments, found 1

(:action a :precondition (at hall))
;! 2:26: (at ?r - robot ?l - room) takes 2 arguments, found 1

(:action a :precondition (at hall hall))
;! 2:30: 'hall' is of type room; expected robot

(:action a :parameters (?r - robot) :precondition (at ?r ?r))
;! 2:58: '?r' is of type robot; expected room

(:action a :parameters (?r - robot) :precondition (at ?r hal))
;! 2:58: unknown object 'hal'; did you mean 'hall'?

(:action a :effect (xyz))
;! 2:21: unknown predicate 'xyz'; expected one of at, idle

(:action a :precondition (iff (idle) (idle)))
;! 2:27: unknown predicate 'iff'; expected one of at, idle

(:action a :parameters (?robot) :precondition (at ?robt hall))
;! 2:51: unknown variable '?robt'; did you mean '?robot'?

(:action a :precondition (at ?r hall))
;! 2:30: unknown variable '?r'; none is declared

(:action a :precondition (at (r) hall))
;! 2:30: expected an object or a variable, found (r)

(:action a :precondition (not))
;! 2:26: 'not' takes 1 operand, found 0

(:action a :precondition (imply (idle)))
;! 2:26: 'imply' takes 2 operands, found 1

(:action a :precondition (forall ?x (idle)))
;! 2:34: expected variables in parentheses, found '?x'

(:action a :precondition (and (exists (?r - robot) (idle)) (at ?r hall)))
;! 2:64: unknown variable '?r'; none is declared

(:action a :precondition (assign (total-cost) 3))
;! 2:27: 'assign' cannot stand here; expected a predicate

(:action a :precondition (= hall 3))
;! 2:34: unknown object '3'; expected one of hall

(:action a :precondition (= (total-cost) hall))
;! 2:29: expected an object or a variable, found (total-cost)

(:action a :precondition (< hall 3))
;! 2:29: expected a number or a function in parentheses, found 'hall'

(:action a :precondition (< (idle) 3))
;! 2:30: 'idle' is a predicate; expected a function

(:action a :precondition (< (total-time) 3))
;! 2:30: unknown function 'total-time'; did you mean 'total-cost'?

(:action a :precondition (< (charge) 3))
;! 2:29: (charge ?r - robot) takes 1 argument, found 0

(:action a :precondition (< charge 3))
;! 2:29: (charge ?r - robot) takes 1 argument, found 0

(:action a :precondition (< (+ 1) 3))
;! 2:29: '+' takes at least 2 operands, found 1

(:action a :precondition (< (- 1 2 3) 3))
;! 2:29: '-' takes 1 or 2 operands, found 3

(:action a :precondition (< (/ 1) 3))
;! 2:29: '/' takes 2 operands, found 1

(:action a :precondition (< 1e999 3))
;! 2:29: the number 1e999 is too large

(:action a :precondition (< ?duration 3))
;! 2:29: '?duration' can only be used in the conditions and effects of a durative action

(:action a :effect idle)
;! 2:20: expected an effect in parentheses, found 'idle'

(:action a :effect (or (idle)))
;! 2:20: 'or' cannot stand in an effect; expected a fact, not, forall, when or assign

(:action a :effect (not (not (idle))))
;! 2:26: 'not' cannot stand here; expected a predicate

(:action a :effect (not idle))
;! 2:25: expected a fact in parentheses, found 'idle'

(:action a :effect (= (total-cost) 3))
;! 2:20: '=' cannot stand in an effect; expected (assign FUNCTION VALUE)

(:action a :effect (increase (total-cost)))
;! 2:20: 'increase' takes 2 operands, found 1

(:action a :effect (increase (total) 1))
;! 2:31: unknown function 'total'; did you mean 'total-cost'?

(:action a :effect (oneof))
;! 2:20: expected (oneof EFFECT ...), found 0 parts

(:action a :effect (probabilistic 0.5))
;! 2:20: expected (probabilistic CHANCE EFFECT ...), found 1 part

(:action a :effect (probabilistic (idle) 0.5))
;! 2:35: expected a chance from 0 to 1, found (idle)

(:action a :effect (probabilistic half (idle)))
;! 2:35: expected a chance from 0 to 1, found 'half'

(:action a :effect (probabilistic 1/0 (idle)))
;! 2:35: expected a chance from 0 to 1, found '1/0'

(:action a :effect (probabilistic -0.1 (idle)))
;! 2:35: expected a chance from 0 to 1, found '-0.1'

(:action a :effect (probabilistic 1.5 (idle)))
;! 2:35: expected a chance from 0 to 1, found '1.5'

(:action a :effect (probabilistic 0.7 (idle) 0.5 (and)))
;! 2:20: the chances sum to 1.2; expected 1 at most

(:action a :effect (oneof (or (idle))))
;! 2:27: 'or' cannot stand in an effect; expected a fact, not, forall, when or assign

(:action a :precondition (oneof (idle) (and)))
;! 2:27: 'oneof' cannot stand here; expected it in :effect

(:durative-action a)
;! 2:1: the durative action 'a' has no :duration; expected :duration (= ?duration ...), or () for any

(:durative-action a :duration 3)
;! 2:31: expected (= ?duration ...), <=, >= or and of these; found '3'

(:durative-action a :duration (< ?duration 3))
;! 2:31: expected (= ?duration ...), <=, >= or and of these; found (< ...)

(:durative-action a :duration (= 3 4))
;! 2:34: expected ?duration, found '3'

(:durative-action a :duration (= ?duration ?duration))
;! 2:44: '?duration' can only be used in the conditions and effects of a durative action

(:durative-action a :duration () :precondition (idle))
;! 2:34: unknown key ':precondition' in the durative action 'a'; did you mean ':condition'?

(:durative-action a :duration () :condition (idle))
;! 2:45: expected (at start ...), (over all ...), (at end ...), and or forall; found (idle)

(:durative-action a :duration () :effect (and (idle)))
;! 2:47: expected (at start ...), (at end ...), and, forall or when; found (idle)

(:durative-action a :duration () :effect (over all (idle)))
;! 2:42: expected (at start ...), (at end ...), and, forall or when; found (over ...)

(:process p :parameters (?r - robot) :effect (idle))
;! 2:46: a process changes numbers as time passes; expected (increase FUNCTION (* #t RATE)) or decrease, found (idle)

(:process p :parameters (?r - robot) :effect (assign (charge ?r) (* #t 2)))
;! 2:46: a process changes numbers as time passes; expected (increase FUNCTION (* #t RATE)) or decrease, found (assign ...)

(:process p :parameters (?r - robot) :effect (increase (charge ?r) 2))
;! 2:68: expected a change in a second, (* #t RATE), found '2'

(:process p :parameters (?r - robot) :effect (increase (charge ?r) (* #t #t)))
;! 2:68: expected a change in a second, (* #t RATE), found (* ...)

(:process p :parameters (?r - robot) :effect (increase (charge ?r) (* 2 (+ 1 #t))))
;! 2:68: expected a change in a second, (* #t RATE), found (* ...)

(:event e :parameters (?r - robot) :effect (increase (charge ?r) (* #t 2)))
;! 2:69: continuous effects (#t) outside a process are not supported yet; a process (:process) in their place would be needed

(:event e :effect (oneof (idle) (and)))
;! 2:1: e happens by itself; preferences and several outcomes are for actions

(:event e :precondition (preference (idle)) :effect (idle))
;! 2:1: e happens by itself; preferences and several outcomes are for actions

(:event)
;! 2:1: expected a name after ':event', found nothing
