"""Files of bindings and faults that are refused, and an action they are about; domains in which robots find or drop things."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from pnm.core.logic.domain import FluentKind, Signature, Vocabulary
from pnm.core.machine.plan_graph import GroundAction
from pnm.errors import InputError


def error(read: Callable[[Path], object], path: Path) -> str:
    """The message of the refusal, with FILE for the path."""
    with pytest.raises(InputError) as caught:
        read(path)
    assert caught.value.position is not None
    return str(caught.value).replace(str(path), "FILE")


MOVE = GroundAction("move", ("r1", "hall", "lab"), ("robot", "from", "to"), duration=12.0)
WORDS = Vocabulary(
    {"move": {"robot": ("robot",), "from": ("place",), "to": ("room",)}, "wait": {}},
    frozenset({"at", "battery", "dark", "near", "temperature"}),
    frozenset({"r1", "lab"}),
    derived=frozenset({"near"}),
    signatures={"temperature": Signature(FluentKind.NUMBER, (("room",),)), "dark": Signature(FluentKind.FACT, (("room",),))},
    types={kind: frozenset({kind, "object"}) for kind in ("robot", "place")} | {"room": frozenset({"room", "place", "object"})},
    types_of={"r1": frozenset({"robot", "object"}), "lab": frozenset({"room", "place", "object"})},
    outcomes={"move": ("there", "slipped")},
)

TIDY: tuple[str, str] = (
    """
(define (domain tidy) (:requirements :strips :typing :adl)
  (:types room item - object cup plate - item)
  (:predicates (in ?i - item ?r - room) (searched ?r - room) (held ?i - item) (clean ?i - item) (free))
  (:action search :parameters (?room - room) :effect (searched ?room))
  (:action pick :parameters (?i - item ?r - room) :precondition (and (in ?i ?r) (free))
    :effect (and (held ?i) (not (in ?i ?r)) (not (free))))
  (:action wash :parameters (?i - item) :precondition (held ?i) :effect (and (clean ?i) (free) (not (held ?i)))))
""",
    """
(define (problem p) (:domain tidy) (:objects kitchen hall - room) (:init (free))
  (:goal (and (forall (?r - room) (searched ?r)) (forall (?i - item) (clean ?i)))))
""",
)
"""Domain and problem: things that are found in rooms are to be clean."""
FINDS: str = """
actions:
  search:
    type: pyrobosim_msgs/action/DetectObjects
    goal: {target_object: "?room"}
    found:
      field: detected_objects
      type: cup
      facts: ["(in ?found ?room)"]
      simulated: {of: "?room", table: {kitchen: [{name: mug}, {name: glass 2}], hall: [{name: "7"}]}}
"""
"""Its bindings, with what there is to be found."""

CUPS: tuple[str, str] = (
    """
(define (domain cups) (:requirements :strips :typing :non-deterministic) (:types cup)
  (:predicates (table ?c - cup) (held ?c - cup) (floor ?c - cup))
  (:action pick :parameters (?c - cup) :precondition (table ?c)
    :effect (oneof (and (held ?c) (not (table ?c))) (and (floor ?c) (not (table ?c))) (and)))
  (:action lift :parameters (?c - cup) :precondition (floor ?c) :effect (and (table ?c) (not (floor ?c)))))""",
    "(define (problem p) (:domain cups) (:objects mug - cup) (:init (table mug)) (:goal (held mug)))",
)
"""Domain and problem: a grasp holds a cup, drops it or misses it."""
DROPS: str = """
faults:
  - {action: pick, outcome: "2", times: 1}
  - {action: pick, outcome: "3", after: 1, times: 1}
  - {action: pick, outcome: "1", after: 2}
"""
"""Faults: the first grasp drops it, the second one misses it, the third one holds it."""
TOLD: str = """
actions:
  pick:
    server: gripper
    type: porter_msgs/action/Grip
    goal: {object: "?c", close: true}
    outcomes: {"1": {field: code, eq: DONE}, "2": {field: code, eq: SLIPPED}, "3": {field: code, eq: OUT_OF_REACH}}
"""
"""Bindings by which the code of the result tells which it was."""
