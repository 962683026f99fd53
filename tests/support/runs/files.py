"""Files of bindings and faults that are refused, and an action they are about; and a domain in which robots find what nobody knew."""

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
