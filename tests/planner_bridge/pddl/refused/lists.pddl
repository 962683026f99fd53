;;; What is no sequence of lists.

)
;! f:1:1: this ')' closes nothing; expected '(' or the end of the file

(a))(b)
;! f:1:4: this ')' closes nothing; expected '(' or the end of the file

(a
 (b
;! f:2:4: the text ends here; expected '))', for the '(' in line 2 is not closed

(a (b)
;! f:1:7: the text ends here; expected ')', for the '(' in line 1 is not closed

(a ; )
;! f:1:7: the text ends here; expected ')', for the '(' in line 1 is not closed

(define (domain d)
 (:predicates (p)
 (:action a))
;! f:2:2: this '(' is not closed; expected ')' before line 3

(define (domain d)
 (:predicates (p) (:action a))
;! f:2:2: this '(' is not closed before the next section; expected ')' before ':action' in line 2

(define (domain d)
 (:action a
  :precondition (and (p)
    (not (q)
    (r))))
;! f:4:5: this '(' is not closed; expected ')' before line 5

(define (domain d)
 (:predicates
  (p)
  (q)
 )
 (:action a
  :effect (and
    (p)
  )
)
;! f:6:2: this '(' is not closed; expected ')' before line 10
