;;; Domains as a whole.

; nothing
;! 1:1: the file is empty; expected (define (domain NAME) ...)

(defie (domain d))
;! 1:2: expected 'define', found 'defie'

define
;! 1:1: expected (define (domain NAME) ...), found 'define'

()
;! 1:1: expected (define (domain NAME) ...), found ()

(define)
;! 1:1: expected (define (domain NAME) ...), found (define)

(define d)
;! 1:9: expected (domain NAME), found 'd'

(define (domain))
;! 1:9: expected (domain NAME), found (domain)

(define (problem p))
;! 1:9: expected (domain NAME), found (problem ...); this file is not a domain: the domain comes first, then the problem

(define (domain 3))
;! 1:17: expected the name of a domain, found '3'

(define (domain (d)))
;! 1:17: expected the name of a domain, found (d)

(define (domain d))
(define (domain e))
;! 2:1: expected the end of the file after (define (domain NAME) ...), found (define ...)

(define (domain d)
 predicates)
;! 2:2: expected a section such as (:predicates ...), found 'predicates'

(define (domain d)
 (predicates))
;! 2:2: expected a section such as (:predicates ...), found (predicates)

(define (domain d)
 (:predicate))
;! 2:3: unknown section ':predicate'; did you mean ':predicates'?

(define (domain d)
 (:init))
;! 2:3: unknown section ':init'; expected one of :requirements, :predicates, :types, :constants, :functions, :action, :durative-action, :derived, :constraints, :process, :event, :task, :method

(define (domain d)
 (:predicates (p)
 (:action a))
;! 2:2: this '(' is not closed; expected ')' before line 3
