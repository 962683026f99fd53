"""Parts of plans are replaced by better ones, and the whole still solves its problem."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from threading import Event

import pytest

from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.model.rates import NO_RATES, Call, Counts, End
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.loading import load
from planner_bridge.planning import kairos
from planner_bridge.planning.parts import better_parts, can_have_parts, narrowed
from planner_bridge.planning.solve import solve
from planner_bridge.planning.validate import why_invalid
from tests.support.files import ROOT
from tests.support.pddl.problems import matches, rooms

VAN = """
(define (domain van)
  (:requirements :strips :typing :numeric-fluents :negative-preconditions)
  (:types place parcel)
  (:predicates (at ?a - place) (lies ?p - parcel ?a - place) (loaded ?p - parcel))
  (:functions (charge) (room))
  (:action drive :parameters (?from ?to - place) :precondition (and (at ?from) (>= (charge) 1))
    :effect (and (not (at ?from)) (at ?to) (decrease (charge) 1)))
  (:action plug_in :parameters () :precondition (at depot) :effect (assign (charge) 4))
  (:action load :parameters (?p - parcel ?a - place) :precondition (and (at ?a) (lies ?p ?a) (>= (room) 1))
    :effect (and (loaded ?p) (not (lies ?p ?a)) (decrease (room) 1)))
  (:action unload :parameters (?p - parcel ?a - place) :precondition (and (at ?a) (loaded ?p))
    :effect (and (not (loaded ?p)) (lies ?p ?a) (increase (room) 1)))
  (:constants depot shop - place))
"""


def plan_of(*calls: str) -> Plan:
    """A sequential plan of calls such as ``move r1 a b``."""
    words = [call.split() for call in calls]
    return Plan(tuple(PlanStep(name, tuple(arguments)) for name, *arguments in words))


def improved(problem: Problem, plan: Plan) -> list[str]:
    """Return the calls of the plan once no part can be made better."""
    assert not why_invalid(problem, plan)
    best = plan

    def solve_part(part: Problem, old: Sequence[PlanStep], _: float | None) -> Plan | None:
        found = solve(part, improve=0.2).plan
        return found if found and len(found.steps) < len(old) else None

    def take(other: Plan) -> bool:
        nonlocal best
        if why_invalid(problem, other) or len(other.steps) >= len(best.steps):
            return False
        best = other
        return True

    assert all(better_parts(problem, plan, solve_part, take))
    return [" ".join((step.action, *step.arguments)) for step in best.steps]


def test_detours_are_cut_short() -> None:
    problem = rooms(goal="(and (clean c) (clean b) (at r1 a) (at r2 c))", ways="ab ba bc cb ac ca")
    detour = plan_of(
        *("move r1 a b", "move r1 b c", "sweep r1 c", "move r1 c b", "move r1 b a"), *("move r2 a b", "sweep r2 b", "move r2 b c")
    )
    assert len(improved(problem, detour)) == 4  # the other robot comes by anyway


def test_ways_are_gone_once_for_two_things_and_the_charge_still_suffices() -> None:
    parcels = ["p1", "p2", "p3", "p4"]
    lie = " ".join(f"(lies {parcel} depot)" for parcel in parcels)
    goal = " ".join(f"(lies {parcel} shop)" for parcel in parcels)
    text = f"""(define (problem p) (:domain van) (:objects {" ".join(parcels)} - parcel)
      (:init (at depot) {lie} (= (charge) 4) (= (room) 2)) (:goal (and {goal} (>= (charge) 1))))"""
    one_by_one = [
        *("load p1 depot", "drive depot shop", "unload p1 shop", "drive shop depot"),
        *("load p2 depot", "drive depot shop", "unload p2 shop", "drive shop depot", "plug_in"),
        *("load p3 depot", "drive depot shop", "unload p3 shop", "drive shop depot"),
        *("load p4 depot", "drive depot shop", "unload p4 shop"),
    ]
    left = improved(parse_problem(text, parse_domain(VAN)), plan_of(*one_by_one))
    assert len(left) < len(one_by_one)
    assert sum(call.startswith("drive") for call in left) == 3


def test_a_part_leaves_no_more_of_a_number_than_the_rest_needs() -> None:
    parcels = [f"p{number}" for number in range(9)]
    lie = " ".join(f"(lies {parcel} shop)" for parcel in parcels)
    goal = " ".join(f"(lies {parcel} depot)" for parcel in parcels)
    text = f"""(define (problem p) (:domain van) (:objects {" ".join(parcels)} - parcel)
      (:init (at depot) {lie} (= (charge) 3) (= (room) 9)) (:goal (and {goal})))"""
    plan = plan_of(
        *("plug_in", "drive depot shop", *(f"load {parcel} shop" for parcel in parcels), "drive shop depot"),
        *(f"unload {parcel} depot" for parcel in parcels),
    )
    demanded: list[str] = []
    problem = parse_problem(text, parse_domain(VAN))
    next(better_parts(problem, plan, lambda part, steps, _: demanded.append(str(part.goal)), lambda plan: False))
    assert "(>= (charge) 1)" in demanded[0], "for one more drive, where the charge is 3"


@pytest.mark.parametrize("problem", [matches(1), rooms(goal="(and (clean a) (preference p (at r1 b)))", ways="ab ba")])
def test_of_plans_with_times_or_preferences_no_part_is_replaced(problem: Problem) -> None:
    assert not can_have_parts(problem)
    assert can_have_parts(rooms())


def test_parts_are_first_tried_with_arguments_that_the_plan_has() -> None:
    problem = rooms(goal="(and (clean b) (at r1 a))", ways="ab ba bc cb ac ca")
    by_way_of_c = plan_of("move r1 a b", "sweep r1 b", "move r1 b c", "move r1 c a", "move r1 a b", "move r1 b c", "move r1 c a")
    others: list[bool] = []

    def noted(part: Problem, *_: object) -> None:
        others.append(solve(replace(part, goal=rooms(goal="(at r2 b)").goal), improve=0.0).plan is not None)

    assert all(better_parts(problem, by_way_of_c, noted, lambda plan: False))
    assert others == sorted(others), "with any arguments only once those of the plan have been tried"
    assert {*others} == {False, True}


def test_a_household_is_tidied_up_with_few_calls_once_it_is_known_which_things_are_needed() -> None:
    house = ROOT / "domains" / "household"
    problem = load(house / "domain.pddl", house / "problem4.pddl")
    first = solve(problem, improve=0.0).plan
    assert first is not None
    search = kairos.kairos.Planner().start(kairos.parse_for_kairos(narrowed(problem, first.steps)), anytime=True, threads=1)
    began, calls = time.process_time(), len(first.steps)
    while calls > 40 and time.process_time() < began + 1.0:  # with all things, that takes four seconds
        found = search.next_plan(0.05)
        calls = calls if found is None else len(found.steps)
    search.stop()
    assert calls <= 40 < len(first.steps)


def test_with_learned_seconds_calls_like_those_of_the_plan_are_weighed_by_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    house, parse, weighed = ROOT / "domains" / "household", kairos.parse_for_kairos, Event()
    problem = load(house / "domain.pddl", house / "problem4.pddl")

    def noted(asked: Problem) -> object:
        if "navigate-argument-0" in asked.domain.predicates and asked.metric is not None and asked.goal == problem.goal:
            weighed.set()
        return parse(asked)

    monkeypatch.setattr(kairos, "parse_for_kairos", noted)
    monkeypatch.setattr(kairos, "_ALONE", 0.0)  # else it begins some seconds later
    drive = Call("navigate", "navigate", ("robot", "table", "pantry", "kitchen"))
    learned = NO_RATES.grown("journal", 1, [(drive, Counts.of(End.SUCCEEDED, 5.0))])
    assert solve(problem, improve=20.0, cancel=weighed, learned=learned).plan
    assert weighed.is_set()


def test_parts_wait_until_the_search_has_brought_nothing_better_for_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where processors are shared, both together find a good plan much later."""
    of, brought, tried = kairos._Best.of, list[float](), list[float]()

    def noted(self: kairos._Best, searches: Iterable[object]) -> bool:
        is_better = of(self, searches)  # type: ignore[arg-type]
        if is_better:
            brought.append(time.process_time())
        return is_better

    def parts(*_: object) -> Iterator[bool]:
        while True:
            tried.append(time.process_time() - brought[-1])
            yield True

    monkeypatch.setattr(kairos._Best, "of", noted)
    monkeypatch.setattr("planner_bridge.planning.parts.better_parts", parts)
    house = ROOT / "domains" / "household"
    assert solve(load(house / "domain.pddl", house / "problem4.pddl"), improve=1.0).plan
    assert min(tried, default=1.0) >= kairos._ALONE
