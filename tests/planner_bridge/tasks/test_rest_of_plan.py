"""When the rest of a plan is used again, when late reports are waited for, and what is due until it can be done."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from itertools import pairwise

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import calls_of
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve, achieve_at
from planner_bridge.tasks.replanning import MAX_SHORTENED, Decision, History, Limits, PlanAgain, Progress, ResumePlan, decide, shortened
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.faults import Fault, FaultKind, Faults, HiddenChange
from pnm.clock import run_async
from pnm.core.execution.call_results import CallResult
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Holds, Not, evaluate
from pnm.core.logic.expressions import Variable
from pnm.core.logic.trajectory import Constraint
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.machine.requests import CallOutcome
from tests.support.pddl.problems import ROOMS, matches, rooms
from tests.support.runs.simulated import LateBackend
from tests.support.tasks.node import EAGER, simulated
from tests.support.tasks.replanning import aborts, pursued
from tests.support.tasks.simulation import TaskSimulation

OVER_B = [("move", "r1", "a", "b"), ("move", "r1", "b", "c")]


def decided(problem: Problem, steps: list[tuple[str, ...]], done: int = 0) -> Decision:
    """What follows a run of these steps, the first of which are done, if the world now is as the problem says."""
    graph = plan_graph(problem, Plan(tuple(PlanStep(step[0], step[1:], float(number)) for number, step in enumerate(steps))))
    calls = tuple(CallResult(call, CallOutcome.SUCCEEDED if call.index < done else CallOutcome.WAITING) for call in graph.calls)
    return decide(problem, Progress(graph, calls), KnowledgeBase(problem.init, objects=problem.objects_by_type), History(), Limits())[0]


def clean(room: str) -> Holds:
    return Holds(("clean", room))


IN_B = Holds(("at", "r1", "b"))
KEPT = [
    Constraint("always", (Not(clean("?x")),), (), (Variable("?x", ("room",)),)),
    Constraint("sometime", (IN_B,)),
    Constraint("sometime-after", (IN_B, Holds(("at", "r1", "c")))),
    Constraint("sometime-before", (Holds(("at", "r1", "c")), IN_B)),
    Constraint("at-most-once", (Holds(("at", "r1", "a")),)),
    Constraint("at end", (Not(IN_B),)),
]
BROKEN = [
    (Constraint("always", (Not(IN_B),)), "the end of move(r1, a, b) would violate (always (not (at r1 b)))"),
    (Constraint("sometime-before", (IN_B, clean("a"))), "the end of move(r1, a, b) would violate (sometime-before (at r1 b) (clean a))"),
    (Constraint("sometime", (clean("d"),)), "the rest of the plan would leave (sometime (clean d)) unfulfilled"),
    (Constraint("sometime-after", (IN_B, clean("d"))), "the rest of the plan would leave (sometime-after (at r1 b) (clean d)) unfulfilled"),
    (Constraint("at end", (IN_B,)), "the rest of the plan would leave (at end (at r1 b)) unfulfilled"),
    (Constraint("within", (IN_B,), (90.0,)), "the times of the plan matter to (within 90 (at r1 b))"),
]


@pytest.mark.parametrize("constraint", KEPT, ids=str)
def test_the_rest_of_a_plan_that_keeps_the_constraints_is_used(constraint: Constraint) -> None:
    problem = replace(rooms(init="(at r1 a)", goal="(at r1 c)"), constraints=(constraint,))
    assert isinstance(decided(problem, OVER_B), ResumePlan)


@pytest.mark.parametrize(("constraint", "why"), BROKEN, ids=lambda value: str(value) if isinstance(value, Constraint) else "")
def test_the_rest_of_a_plan_that_breaks_a_constraint_is_not_used(constraint: Constraint, why: str) -> None:
    problem = rooms(init="(at r1 a)", goal="(at r1 c)")
    assert decided(replace(problem, constraints=(constraint,)), OVER_B) == PlanAgain(frozenset(), why)
    problem = replace(problem, domain=replace(problem.domain, constraints=(constraint,)))
    assert decided(problem, OVER_B) == PlanAgain(frozenset(), why)


def test_the_rest_of_a_network_of_tasks_is_used_and_otherwise_the_whole_network_is_planned_for() -> None:
    network = replace(rooms(init="(at r1 b)", goal="(at r1 c)"), network="(:htn)")
    rest = decided(network, OVER_B, done=1)
    assert isinstance(rest, ResumePlan)
    assert [str(call) for call in rest.rest.calls] == ["move(r1, b, c)#0"]
    elsewhere = replace(rooms(init="(at r1 d)", goal="(at r1 c)"), network="(:htn)")
    assert decided(elsewhere, OVER_B, done=1) == PlanAgain(
        frozenset(), "move(r1, b, c) would start although (at r1 b) is false; the whole network of tasks is planned for once more"
    )


@pytest.mark.parametrize("what", ["strike(m0)", "mend(f0, m0)"])
def test_late_reports_are_waited_for_before_anything_is_decided(what: str) -> None:
    problem = matches(1)
    faults = Faults((Fault(what, FaultKind.ABORT, times=1),))
    backend = LateBackend(problem, Bindings(), faults)
    settings = Settings(bindings=Bindings({"strike": Binding(retries=0), "mend": Binding(retries=0)}))
    result = run_async(achieve_at(backend, problem, settings, TaskObserver()), virtual=True)
    truth = evaluate(problem.goal, backend.robots.world.truth)
    assert result.goal_reached is truth
    assert what != "strike(m0)" or result.goal_reached


def test_a_report_about_things_unheard_of_does_not_disturb_planning() -> None:
    strange = HiddenChange({("at", "zz", "b"): True, ("flies", "r1"): True}, at=0.5)
    faults = Faults(aborts("move(r1, b, c)").faults, (strange,))
    result, _ = pursued(rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc ba ad dc"), faults)
    assert result.goal_reached


def timed_rooms(time: float) -> Problem:
    """Room b opens at a time."""
    text = ROOMS.replace("(clean ?a - room))", "(clean ?a - room) (open ?a - room))", 1)
    domain = parse_domain(text.replace("(way ?a ?b))\n    :effect", "(way ?a ?b) (open ?b))\n    :effect"))
    things = f"(:objects r1 - robot a b - room) (:init (at r1 a) (way a b) (at {time} (open b)))"
    return parse_problem(f"(define (problem p) (:domain rooms) {things} (:goal (at r1 b)))", domain)


@pytest.mark.parametrize("assumed", [frozenset[str](), frozenset({"open"})])
def test_a_fact_that_comes_true_by_itself_is_waited_for_whether_or_not_it_is_sensed(assumed: frozenset[str]) -> None:
    result, _ = pursued(timed_rooms(4.0), bindings=Bindings(assumed=assumed))
    assert result.goal_reached, result.reason
    assert result.calls[0].started is not None
    assert result.calls[0].started >= 4.0


def test_nothing_happens_in_a_world_after_its_task() -> None:
    for _ in range(5):
        _, truth = pursued(
            rooms(init="(at r1 a)", goal="(at r1 b)"), Faults(changes=(HiddenChange({("at", "r1", "b"): False}, at=100_000.0),))
        )
        assert truth.value(("at", "r1", "b")) is True


@pytest.mark.parametrize("kind", FaultKind)
@pytest.mark.parametrize("times", [1, 2, 3, None])
@pytest.mark.parametrize("what", ["move(r1, a, b)", "move(r2, a, d)", "move", "sweep(r1, c)"])
def test_any_fault_ends_in_the_goal_or_in_a_named_failure(kind: FaultKind, times: int | None, what: str) -> None:
    problem = rooms(goal="(and (at r1 c) (at r2 c) (clean c))")
    bindings = Bindings({"move": Binding(timeout=3.0), "sweep": Binding(timeout=3.0)})
    result, _ = pursued(problem, Faults((Fault(what, kind, times=times),)), bindings=bindings)
    assert result.goal_reached or "; no plan without " in result.reason or result.reason.startswith("the limit")
    assert result.goal_reached or result.failures


def test_a_task_may_take_as_long_as_its_plan() -> None:
    domain = parse_domain("""(define (domain d) (:requirements :durative-actions) (:predicates (done))
      (:durative-action grow :parameters () :duration (= ?duration 5000) :condition () :effect (at end (done))))""")
    problem = parse_problem("(define (problem p) (:domain d) (:init) (:goal (done)))", domain)
    assert achieve(None, problem).goal_reached
    assert not achieve(None, problem, settings=Settings(limits=Limits(seconds=3600.0))).goal_reached


@pytest.mark.parametrize(("calls", "left_out"), [(MAX_SHORTENED, 1), (MAX_SHORTENED + 1, 0)])
def test_calls_that_are_needless_are_left_out_of_what_is_not_too_long(calls: int, left_out: int) -> None:
    domain = parse_domain(
        """(define (domain d) (:types p) (:predicates (at ?x - p) (lit)) (:action light :effect (lit))
        (:action go :parameters (?x ?y - p) :precondition (at ?x) :effect (and (at ?y) (not (at ?x)))))"""
    )
    places = [f"p{number}" for number in range(calls)]
    text = f"(define (problem q) (:domain d) (:objects {' '.join(places)} - p) (:init (lit) (at p0)) (:goal (and (lit) (at {places[-1]}))))"
    problem, ways = parse_problem(text, domain), pairwise(places)
    plan = Plan((PlanStep("light"), *(PlanStep("go", way, float(number + 1)) for number, way in enumerate(ways))))
    ends = (Ordering(PlanEvent(index, Moment.END), PlanEvent(index + 1, Moment.START)) for index in range(calls - 1))
    progress = Progress.beginning(PlanGraph(tuple(calls_of(problem, plan)), tuple(ends), problem.goal, problem.domain.rules))
    assert len(shortened(progress, initial_knowledge(problem)).rest) == calls - left_out


# --- a run that is to be replaced, and cannot be handed over yet ---------------------------------

WORKSHOP = """
(define (domain workshop) (:requirements :durative-actions) (:predicates (light) (quiet) (mended) (dry) (can) (painted) (sanded))
  (:durative-action start :parameters () :duration (= ?duration 8) :effect (and (at start (light)) (at end (quiet))))
  (:durative-action mend :parameters () :duration (= ?duration 5) :condition (at start (light))
    :effect (and (at start (not (quiet))) (at end (mended))))
  (:durative-action sand :parameters () :duration (= ?duration 20) :effect (at end (sanded)))
  (:durative-action paint :parameters () :duration (= ?duration 5)
    :condition (and (at start (mended)) (at start (quiet)) (at start (dry))) :effect (at end (painted)))
  (:durative-action fetch :parameters () :duration (= ?duration 5) :condition (at start (mended)) :effect (at end (can)))
  (:durative-action spray :parameters () :duration (= ?duration 5) :condition (at start (can)) :effect (at end (painted))))
"""
BENCH = Bindings({name: Binding(resources=("bench",)) for name in ("mend", "sand")}, assumed=frozenset({"quiet"}))


PAINTING = parse_problem("(define (problem p) (:domain workshop) (:init (dry)) (:goal (painted)))", parse_domain(WORKSHOP))


@pytest.mark.parametrize("is_dry_again", [False, True])
@simulated(PAINTING, chosen=replace(EAGER, bindings=BENCH))
async def test_a_new_plan_that_is_due_is_made_once_the_call_that_was_waited_for_has_begun_or_is_not_needed_any_more(
    simulation: TaskSimulation, is_dry_again: bool
) -> None:
    """The end of `start` waits for `mend`, and that for the bench: until then nothing of the run can be handed over."""
    await simulation.begun("(sanded)")
    task = simulation.want("(painted)")
    await simulation.sees(task, "ended", "start()")
    simulation.knowledge.update({("dry",): False})  # without which nothing is painted
    await asyncio.sleep(1.0)
    assert not simulation.seen(task, "replanned")
    if is_dry_again:
        simulation.knowledge.update({("dry",): True})
    await simulation.sees(task, "sent", "mend()")
    await asyncio.sleep(0.5)
    assert bool(simulation.seen(task, "replanned")) is not is_dry_again
    assert not simulation.seen(task, "ended", "mend()"), "it was handed over"
    await simulation.reaches(task)
