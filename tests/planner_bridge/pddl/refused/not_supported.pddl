;;; What we cannot plan for or execute, added to a small domain.

(:action a :observe (idle))
;! 2:12: sensing actions (:observe) are not supported yet; a contingent planner, which unified-planning lacks, would be needed

(:durative-action a :duration () :effect (at start (oneof (idle) (and))))
;! 2:52: outcomes at the start of a durative action are not supported yet; a request whose robot says how it has begun would be needed

(:durative-action a :duration () :effect (oneof (at start (idle)) (at end (idle))))
;! 2:42: outcomes at the start of a durative action are not supported yet; a request whose robot says how it has begun would be needed

(:durative-action a :parameters (?r - robot) :duration () :effect (increase (charge ?r) (* #t 2)))
;! 2:92: continuous effects (#t) outside a process are not supported yet; a process (:process) in their place would be needed

(:durative-action a :duration () :effect (when (over all (idle)) (at end (idle))))
;! 2:48: conditional effects on a condition 'over all' are not supported yet; a watch over what is not required would be needed

(:durative-action a :duration (at end (= ?duration 3)))
;! 2:31: durations that are decided at the end are not supported yet; a bound that is only known when the action ends would be needed
