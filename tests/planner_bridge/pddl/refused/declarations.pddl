;;; Requirements, types, constants, predicates and functions, added to a small domain.

(:requirements :)
;! 2:16: expected the name of a requirement, found ':'

(:requirements (a))
;! 2:16: expected a requirement such as :typing, found (a)

(:types a - b b - a)
;! 2:9: the type 'a' is a kind of itself

(:types object - thing)
;! 2:9: the type 'object' is a kind of itself

(:types a -)
;! 2:11: expected a type after '-', found nothing

(:types a - (either))
;! 2:13: expected a type or (either TYPE ...), found (either)

(:types a - (or a b))
;! 2:13: expected a type or (either TYPE ...), found (or ...)

(:types é)
;! 2:9: 'é' cannot name a type; expected letters, digits and _ - . @

(:types ?x)
;! 2:9: expected the name of a type, found '?x'

(:constants c - rom)
;! 2:17: unknown type 'rom'; did you mean 'room'?

(:constants c - x)
;! 2:17: unknown type 'x'; expected one of object, robot, room, thing

(:predicates p)
;! 2:14: expected a predicate in parentheses such as (name ?x - type), found 'p'

(:predicates ())
;! 2:14: expected a predicate in parentheses such as (name ?x - type), found ()

(:predicates (p x))
;! 2:17: expected a variable such as ?x, found 'x'

(:predicates (p ?))
;! 2:17: expected a variable such as ?x, found '?'

(:predicates (IDLE ?x))
;! 2:14: the predicate 'idle' is declared twice, and differently; the first time in line 1

(:predicates (forall ?x))
;! 2:15: 'forall' is a word of PDDL and cannot name a predicate

(:functions (CHARGE))
;! 2:13: the function 'charge' is declared twice, and differently; the first time in line 1

(:functions (total-cost) - room)
;! 2:13: the function 'total-cost' is declared twice, and differently; the first time in line 1

(:functions (home) - rom)
;! 2:22: unknown type 'rom'; did you mean 'room'?

(:functions (idle))
;! 2:13: the function 'idle' has the name and the number of arguments of a predicate
