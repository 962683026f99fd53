"""Plans for tests that carry them out: one that calls another, and one whose recovery ends with `replan`."""

from __future__ import annotations

from pnm.actions.faults import Fault, FaultKind, Faults

GUIDE = """
actions:
  go: {params: [place], duration: 5}
  say: {type: kb_action}
outer:
  params: [shop]
  plan:
    - go: {place: door}
    - inner: {place: {LocalQuery: shop}}
    - say: {operation: {LocalUpdate: [heard, {LocalQuery: told}]}}
inner:
  params: [place]
  results: [told]
  timeout: 60
  plan:
    - say: {operation: {LocalUpdate: [secret, 1]}}
    - go: {}
    - say: {operation: {LocalUpdate: [told, {LocalQuery: place}]}}
"""

PATROL = """
name: patrol
types: [robot room - object]
predicates:
  - (at ?r - robot ?x - room)
  - (way ?x ?y - room)
actions:
  move:
    params: ?r - robot ?from ?to - room
    duration: 3
    preconditions: {at_start: ["(at ?r ?from)", "(way ?from ?to)"]}
    effects: {at_start: [not: "(at ?r ?from)"], at_end: ["(at ?r ?to)"]}
problem:
  objects: r1 - robot a b c - room
  init: [(at r1 a), (way a b), (way a c), (way c b)]
results: [note]
initial_knowledge: {note: 7}
goal: (at r1 b)
plan:
  - move: {r: r1, from: a, to: b}
    recoveries: {during: {aborted: [replan]}}
"""
BLOCKED = Faults((Fault("move(r1, a, b)", FaultKind.ABORT),))
"""The only way of that plan."""
