"""Processes and events in PDDL and in YAML: from one to the other without loss, with their comments."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.cli.convert import exported, imported
from planner_bridge.pddl import parse_domain, read_domain, write_domain
from pnm.core.logic.conditions import Holds
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Arithmetic, Constant, Expression, ValueOf, Variable
from tests.support.files import written
from tests.support.pddl.text import warnings

PDDL = """(define (domain tank)
  (:requirements :strips :typing :numeric-fluents :time)
  (:types
    tank - object)
  (:predicates
    (open ?t - tank)
    (wet))
  (:functions
    (level ?t - tank)
    (flow ?t - tank))
  (:action turn-on
    :parameters (?t - tank)
    :effect (open ?t))
  ; water runs
  (:process fill
    :parameters (?t - tank)
    :precondition (open ?t)
    :effect (increase (level ?t) (* #t (flow ?t))))  ; litres
  (:process leak
    :parameters (?t - tank)
    :effect (decrease (level ?t) (* #t 0.1)))
  ; too late
  (:event overflow
    :parameters (?t - tank)
    :precondition (>= (level ?t) 10)
    :effect (and
      (wet)  ; the floor
      (assign (level ?t) 9))))
"""
YAML = """name: tank
requirements: [strips, typing, numeric-fluents, time]

types:
  - tank - object

predicates:
  - (open ?t - tank)
  - (wet)

functions:
  - (level ?t - tank)
  - (flow ?t - tank)

actions:
  turn-on:
    params: ?t - tank
    effects:
      - (open ?t)

processes:
  # water runs
  fill:
    params: ?t - tank
    preconditions: (open ?t)
    effects:
      - increase: ["(level ?t)", "(flow ?t)"]  # litres
  leak:
    params: ?t - tank
    effects:
      - decrease: ["(level ?t)", 0.1]

events:
  # too late
  overflow:
    params: ?t - tank
    preconditions: {Comparison: [">=", ["(level ?t)", 10]]}
    effects:
      - (wet)  # the floor
      - assign: ["(level ?t)", 9]
"""


def test_they_are_exported_and_come_back(tmp_path: Path) -> None:
    domain = written(tmp_path / "tank.pddl", PDDL)
    assert exported(domain, None).text == YAML
    found = imported(written(tmp_path / "tank.yaml", YAML))
    assert not found.warnings
    assert found.texts["domain.pddl"] == PDDL
    assert read_domain(written(tmp_path / "again.pddl", found.texts["domain.pddl"])) == read_domain(domain)


@pytest.mark.parametrize(
    ("change", "rate"),
    [
        ("(* #t 2)", Constant(2.0)),
        ("(* 2 #T)", Constant(2.0)),
        ("#t", Constant(1.0)),
        ("(* #t (level))", ValueOf(("level",))),
        ("(* 2 #t (level))", Arithmetic("*", (Constant(2.0), ValueOf(("level",))))),
        ("(* #t (- (level)))", Arithmetic("-", (ValueOf(("level",)),))),
    ],
)
def test_rates_are_read_and_written_without_loss(change: str, rate: Expression) -> None:
    head = "(define (domain d) (:requirements :adl :numeric-fluents :time) (:predicates (on)) (:functions (level))"
    domain = parse_domain(f"{head} (:process p :parameters (?x) :precondition (on) :effect (decrease (level) {change})))")
    assert domain.warnings == ()
    effects = (Set(("level",), rate, "decrease"),)
    assert domain.processes == {"p": ActionSchema("p", (Variable("?x"),), Holds(("on",)), end_effects=effects)}
    assert domain.actions == {}
    assert parse_domain(write_domain(domain)) == domain


def test_the_requirement_is_missed() -> None:
    domain = parse_domain("(define (domain d) (:predicates (on))\n (:event e :parameters () :effect (on)))")
    assert warnings(domain) == ["2:2: warning: :time is needed here but not among the :requirements"]
