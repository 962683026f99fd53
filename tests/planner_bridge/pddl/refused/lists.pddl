;;; What is no sequence of lists.

)
;! f:1:1: this ')' closes nothing; expected '(' or the end of the file

(a))(b)
;! f:1:4: this ')' closes nothing; expected '(' or the end of the file

(a
 (b
;! f:2:2: this '(' is never closed; expected ')' before the end of the file

(a (b)
;! f:1:1: this '(' is never closed; expected ')' before the end of the file

(a ; )
;! f:1:1: this '(' is never closed; expected ')' before the end of the file

(define (domain d)
 (:predicates (p)
 (:action a))
;! f:2:2: this '(' is not closed before the next section; expected ')' before ':action' in line 3
