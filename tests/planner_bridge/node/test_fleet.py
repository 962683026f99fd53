"""Robots that are dealt out to the parts of a fleet, and what cannot be divided."""

from __future__ import annotations

from uuid import uuid4

import pytest

from planner_bridge.node.fleet import DealtRobots
from planner_bridge.node.options import PARAMETERS, Options
from planner_bridge.pddl import parse_domain, parse_problem
from pnm.core.machine.bindings import Binding, Bindings
from pnm.errors import InputError
from pnm.files.database.place import place_of
from pnm.journal.fleet import Part
from pnm.tasks import Wanted

DOMAIN = """
(define (domain patrol)
  (:requirements :typing :adl :fluents)
  (:types robot place)
  (:predicates (at ?r - robot ?p - place) (way ?from ?to - place) (MORE))
  (:action drive
    :parameters (?r - robot ?from ?to - place)
    :precondition (and (at ?r ?from) (way ?from ?to) PRE)
    :effect (and (not (at ?r ?from)) (at ?r ?to) EFFECT)))
"""
PROBLEM = """
(define (problem there) (:domain patrol)
  (:objects r1 r2 r3 - robot a b - place)
  (:init (at r1 a) (at r2 a) (at r3 a) (way a b))
  (:goal (at r1 b)))
"""


def dealt(number: int, pre: str = "", effect: str = "", goals: dict[str, str] | None = None, kind: str = "robot") -> DealtRobots:
    domain = DOMAIN.replace("MORE", "more").replace("PRE", pre).replace("EFFECT", effect)
    return DealtRobots(parse_problem(PROBLEM, parse_domain(domain)), kind, Part(number, 2), goals or {})


def wanted(text: str, *, is_plan: bool = False) -> Wanted:
    return Wanted(uuid4(), text, is_plan=is_plan)


def test_a_part_knows_its_own_robots_only() -> None:
    first, second = dealt(1).problem, dealt(2).problem
    assert first.objects_by_type["robot"] == ("r1", "r3")
    assert {*second.init} == {("at", "r2", "a"), ("way", "a", "b")}


def test_a_task_goes_to_the_part_that_has_its_robots_or_to_any() -> None:
    robots = dealt(1, goals={"home": "(at r2 a)"})
    assert [robots.target(wanted(text)) for text in ("", "(at r2 b)", "home", "(way a b)")] == [1, 2, 2, 0]
    assert robots.target(wanted("(drive r2 a b)", is_plan=True)) == 2
    assert robots.goals == {}
    for text in ("(and (at r1 b) (at r2 b))", "(forall (?r - robot) (at ?r b))"):
        with pytest.raises(InputError, match="robots of the parts 1, 2"):
            robots.target(wanted(text))


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ({"pre": "(not (exists (?o - robot) (at ?o ?to)))"}, "a condition of drive is about every robot"),
        ({"kind": "robots"}, "did you mean 'robot'"),
    ],
)
def test_what_cannot_be_divided_is_refused(how: dict[str, str], told: str) -> None:
    with pytest.raises(InputError, match=told):
        dealt(1, **how)


def test_parts_share_what_changes_and_is_about_no_robot() -> None:
    robots = dealt(1, effect="(more)")
    assert [robots.is_shared(fluent) for fluent in (("more",), ("at", "r1", "a"), ("way", "a", "b"))] == [True, False, False]


def test_a_resource_of_several_parts_is_refused() -> None:
    robots = dealt(1)
    robots.check(Bindings({"drive": Binding(resources=("{r}/base",))}))
    with pytest.raises(InputError, match=r"the resource lift of drive is not that of a robot; expected \{r\} in its name"):
        robots.check(Bindings({"drive": Binding(resources=("lift",))}))


@pytest.mark.parametrize("text", ["2", "0/2", "3/2", "a/b", "1/-2"])
def test_what_is_no_part_is_refused(text: str) -> None:
    with pytest.raises(InputError, match="such as 2/4"):
        Part.of(text)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"journal": "tasks.journal"}, "expected a journal postgresql://"),
        ({"journal": ""}, "expected a journal postgresql://"),
        ({"world": "world.yaml"}, "expected a domain and a problem, and no world of plans"),
        ({"part": "3/2"}, "such as 2/4"),
    ],
)
def test_a_node_that_cannot_serve_a_part_is_refused(given: dict[str, str], told: str) -> None:
    values = {parameter.name: parameter.default for parameter in PARAMETERS}
    fleet = {"domain": "domain.pddl", "problem": "problem.pddl", "journal": "postgresql://host/db", "part": "2/2"}
    assert Options.of(values | fleet).part == Part(2, 2)
    with pytest.raises(InputError, match=told):
        Options.of(values | fleet | given)


def test_parts_meet_in_postgresql() -> None:
    assert str(Part(2, 4).journal(place_of("postgresql://a@host/db?name=cell"))) == "postgresql://host:5432/db?name=cell_2"
    with pytest.raises(InputError, match="expected a journal postgresql://"):
        Part(2, 4).journal(place_of("tasks.journal"))
