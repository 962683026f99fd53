"""All that walk through a plan agree on what happens when, and on the state after it; and what calls that are under way will change."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st

from planner_bridge.explanations.needed_call import Course
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import (
    EPSILON,
    NotApplicable,
    NotProjectable,
    Progression,
    calls_of,
    happenings,
    projected_state,
    snapshot,
)
from planner_bridge.ordering.interference import forecast
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.loading import load
from planner_bridge.planning.validate import trace, why_invalid
from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.settings import Settings
from pnm.core.execution.events import Stop
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, Holds
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import UNKNOWN, Constant
from pnm.core.machine.plan_graph import GroundAction, Moment, PlanEvent, PlanGraphError
from pnm.core.machine.requests import Ended
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps
from tests.support.files import ROOT
from tests.support.pddl.random_plans import walks
from tests.support.pddl.random_problems import Draw, Features, problems
from tests.support.runs.commands import accepted, begun
from tests.support.runs.handover import SUCCEEDED
from tests.support.runs.plan_graphs import plan_of
from tests.support.runs.simulated import LateBackend
from tests.support.tasks.simulation import TaskSimulation, simulate_tasks

NUDGES = st.sampled_from([0.0, 0.0, 4e-7, 3e-6, 2e-5, 0.001])
"""Seconds by which a step is late: within one happening, and not."""


@st.composite
def plans(draw: Draw) -> tuple[Problem, Plan]:
    """Draw a problem with a plan that can be carried out, events of which come at one time, or nearly so."""
    problem = replace(draw(problems(Features(timed=True))), goal=TRUE)
    plan = draw(walks(problem))
    late = [replace(step, start=step.start + draw(NUDGES)) for step in plan.steps]
    plan = replace(plan, steps=tuple(sorted(late, key=lambda step: step.start)))
    assume(plan.steps and not why_invalid(problem, plan))
    return problem, plan


@given(plans())
@settings(suppress_health_check=list(HealthCheck))
def test_all_that_walk_through_a_plan_agree_on_the_order_and_on_the_state_after_each_moment(drawn: tuple[Problem, Plan]) -> None:
    problem, plan = drawn
    calls, course = calls_of(problem, plan), happenings(problem, plan)
    states = trace(problem, plan)
    assert [time for time, _ in states] == [0.0, *(happening.time for happening in course)]
    together, apart = (Progression(snapshot(initial_knowledge(problem)), unmet=lambda *_: True) for _ in range(2))
    for happening, (_, state) in zip(course, states[1:], strict=True):
        events = [(event, calls[event.call].action) for event in happening.events]
        together.advance(events, happening.changes)
        assert together.state.facts() == state.facts()
        apart.advance((), happening.changes)
        for event in events:
            apart.advance([event])
        started = {event.call for event, action in events if event.moment is Moment.START and action.duration is not None}
        if any(event.call in started for event, _ in events if event.moment is Moment.END):
            return  # of an action that takes no time the effects are simultaneous: what one end adds, the other cannot delete
        assert apart.state.facts() == state.facts()
    assert not Course.of(problem, plan).as_it_is
    try:
        graph = plan_graph(problem, plan)
    except PlanGraphError:  # its causes alone do not give it an order that always works
        return
    places = {event: place for place, happening in enumerate(course) for event in happening.events}
    for ordering in graph.orderings:
        assert places[ordering.before] <= places[ordering.after], ordering
    if not problem.timed and all(call.action.duration is None or call.action.duration > 2 * EPSILON for call in calls):
        foreseen = forecast(graph, graph.order, {}, initial_knowledge(problem))
        left = {fluent: together.state.value(fluent) for fluent in foreseen.needed.writes}
        assert foreseen.values == {fluent: value for fluent, value in left.items() if value is not None and value is not UNKNOWN}


@given(st.lists(st.tuples(st.sampled_from([0.0, 1.0, 2.0]), NUDGES, st.sampled_from([0.0, 1.0, 2.0])), max_size=6))
def test_the_order_of_happenings(drawn: list[tuple[float, float, float]]) -> None:
    """By their times, no two of one time; ends, starts, and ends of what has just started; each start before its end."""
    steps = sorted((PlanStep("toggle", (), start + late, lasts) for start, late, lasts in drawn), key=lambda step: step.start)
    course = happenings(lamp(), Plan(tuple(steps), temporal=True))
    assert all(later.time - earlier.time > EPSILON for earlier, later in pairwise(course))
    seen: list[PlanEvent] = []
    for happening in course:
        starting = {event.call for event in happening.events if event.moment is Moment.START}
        ranks = [(event.call in starting) * (1 + (event.moment is Moment.END)) for event in happening.events]
        assert ranks == sorted(ranks)
        seen += happening.events
    assert len(set(seen)) == len(seen) == 2 * len(steps)
    assert all(seen.index(PlanEvent(call, Moment.START)) < seen.index(PlanEvent(call, Moment.END)) for call in range(len(steps)))


def lamp() -> Problem:
    """A lamp that must be on when `look` begins, and that `toggle` switches off at its end."""
    domain = parse_domain(
        "(define (domain lamps) (:requirements :durative-actions) (:predicates (on) (seen))"
        " (:durative-action toggle :parameters () :duration (>= ?duration 0) :condition () :effect (at end (not (on))))"
        " (:durative-action look :parameters () :duration (= ?duration 1) :condition (at start (on)) :effect (at end (seen))))"
    )
    return parse_problem("(define (problem p) (:domain lamps) (:init (on)) (:goal (seen)))", domain)


def test_the_graph_keeps_the_order_of_events_that_the_validator_has_apart() -> None:
    plan = Plan((PlanStep("toggle", (), 0.0, 1.000003), PlanStep("look", (), 1.0, 1.0)), temporal=True)
    assert why_invalid(lamp(), plan) == ""
    (ordering,) = plan_graph(lamp(), plan).orderings
    assert (ordering.before, ordering.after.call) == (PlanEvent(1, Moment.START), 0)


def test_an_unmet_condition_is_refused_or_noted_or_the_call_is_dropped() -> None:
    problem = replace(lamp(), init={})
    plan = Plan((PlanStep("look", (), 0.0, 1.0),), temporal=True)
    (call,), course = calls_of(problem, plan), happenings(problem, plan)

    def seen(progression: Progression) -> object:
        for happening in course:
            progression.advance([(event, call.action) for event in happening.events])
        return progression.state.value(("seen",))

    noted: list[object] = []
    with pytest.raises(NotApplicable, match="observed"):
        seen(Progression(initial_knowledge(problem)))
    assert seen(Progression(initial_knowledge(problem), unmet=lambda *what: noted.append(what[:2]) or True)) is True
    assert noted == [(0, "start")]
    assert not seen(Progression(initial_knowledge(problem), unmet=lambda *_: False))


# --- the projected state ---


LIT, DOOR, MOVING, ENERGY = ("lit",), ("door",), ("moving",), ("energy",)
OPEN = GroundAction(
    "open",
    start_effects=(Set(MOVING, Constant(True)),),
    end_effects=(Set(MOVING, Constant(False)), Set(DOOR, Constant(True)), Set(ENERGY, Constant(3.0), "decrease")),
    duration=5.0,
)
SHINE = GroundAction("shine", end_condition=Holds(LIT), duration=9.0)


def test_at_any_time_of_a_run_no_robot_is_nowhere(tmp_path: Path) -> None:
    """While a robot moves it is nowhere, and when it has arrived as well until that is reported."""
    problem = load(ROOT / "domains/delivery/domain.pddl", ROOT / "problems/delivery/p01.pddl")

    async def scenario(simulation: TaskSimulation) -> None:
        await simulation.reaches(simulation.want("(and (at parcel1 hall) (at parcel2 kitchen))"))

    simulate_tasks(scenario, problem, chosen=Settings(), make_backend=LateBackend, journal=tmp_path / "journal")
    replay, nowhere, has_settled = Replay(), 0, False
    for step in replay_steps(tmp_path / "journal", TASKS, replay):
        if replay.bases:
            runs = [run.run for run in replay.runs.values() if not run.is_over]
            nowhere += _robots(replay.world) < {"r1", "r2"}
            has_settled |= any(run.settling for run in runs)
            assert _robots(projected_state(replay.world, runs)) == {"r1", "r2"}, step
    assert has_settled
    assert nowhere


@pytest.mark.parametrize("orders", [(), ("1e<0e",)], ids=["", "its end waits for another"])
def test_what_has_ended_changes_numbers_once(orders: tuple[str, ...]) -> None:
    world = KnowledgeBase({ENERGY: 10.0, LIT: True}, sensed={"door": 1.0})
    run = accepted(plan_of(OPEN, SHINE, orders=orders), world=world)
    for settling in ([], ["open()#0"]):
        assert [str(call) for call in run.settling] == settling
        state = projected_state(world, (run,))
        assert (bool(state.value(DOOR)), state.value(ENERGY), bool(state.value(MOVING))) == (True, 7.0, False)
        assert not world.value(DOOR)
        run.handle(Ended(run.open_requests[0], SUCCEEDED), 3.0)


def test_nobody_knows_what_becomes_of_a_call_that_is_being_cancelled() -> None:
    world = KnowledgeBase({ENERGY: 10.0, LIT: True})
    run = accepted(plan_of(OPEN, SHINE), world=world)
    run.handle(Stop(cancel=True), 2.0)
    state = projected_state(world, (run,))
    assert [state.value(fluent) for fluent in (DOOR, ENERGY, MOVING, LIT)] == [UNKNOWN, UNKNOWN, UNKNOWN, True]


def test_a_call_that_cannot_end_is_refused_with_the_reason() -> None:
    world = KnowledgeBase({LIT: False})
    with pytest.raises(NotProjectable, match=r"shine\(\) would end although \(lit\)"):
        projected_state(world, (accepted(plan_of(SHINE), world=world),))


def test_a_call_that_has_not_begun_changes_nothing() -> None:
    world = KnowledgeBase({ENERGY: 10.0})
    run, _ = begun(plan_of(OPEN), world=world)
    assert projected_state(world, (run,)).facts() == world.facts()


def _robots(state: KnowledgeBase) -> set[str]:
    """The robots that are somewhere, or of which that is not known."""
    return {fluent[1] for fluent in state.facts() if fluent[0] == "at"} & {"r1", "r2"}
