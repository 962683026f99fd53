"""One semantics: ours, Kairos' validator, unified-planning and the simulated world agree.

Where they do not, `tests/support/pddl/random_problems.py` and the tests here leave out what others take differently,
with the reason, and the last tests state which way we take it.
"""

from __future__ import annotations

import asyncio
from dataclasses import replace
from math import inf
from typing import Any
from uuid import UUID

import pytest
import unified_planning.shortcuts as up
from hypothesis import HealthCheck, Phase, assume, event, given, note, settings, strategies as st
from unified_planning.engines import UPSequentialSimulator
from unified_planning.exceptions import UPInvalidActionError

from planner_bridge.model.grounding import dynamic_names, ground_action, initial_knowledge
from planner_bridge.model.plan import Plan, plan_text
from planner_bridge.model.problem import Problem
from planner_bridge.model.world import simulated_backend
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem, write_domain, write_problem
from planner_bridge.planning.kairos import validate
from planner_bridge.planning.lower_bound import lower_bound
from planner_bridge.planning.solve import solve
from planner_bridge.planning.unified_planning import to_unified_planning
from planner_bridge.planning.validate import trace, why_invalid
from pnm.clock import run_async
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import TRUE, evaluate
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.effects import changes, names_written
from pnm.core.logic.expressions import Fluent, State, same_value
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import Moment, PlanGraph, PlanGraphError
from pnm.core.machine.verification.verify import verify
from pnm.executor import Executor
from tests.support.pddl.random_plans import apart, goal_of, ground_calls, plans_for, walks
from tests.support.pddl.random_problems import Features, conditions_on, fluents, problems, states

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")  # unified-planning calls pyparsing by its old names
up.get_environment().credits_stream = None
up.get_environment().error_used_name = False  # an object may be called as an action is

FOREIGN = Features(foreign=True)
UNSHRUNK = (Phase.explicit, Phase.reuse, Phase.generate)
"""A failure is shown as it was found: unified-planning takes so long for one example that making it smaller takes minutes."""


def examples(number: int, phases: tuple[Phase, ...] = tuple(Phase)) -> settings:
    return settings(max_examples=number, phases=phases, suppress_health_check=list(HealthCheck))


def show(problem: Problem, plan: Plan) -> None:
    """Let hypothesis print the texts of a failing example."""
    note(f"{write_domain(problem.domain)}\n{write_problem(problem)}\n{plan_text(plan)}")


def differences(problem: Problem, one: State, other: State) -> list[tuple[Fluent, object, object]]:
    """The fluents that have not the same value in both states."""
    known = [*fluents(problem, problem.domain.predicates), *fluents(problem, problem.domain.functions)]
    return [(fluent, one.value(fluent), other.value(fluent)) for fluent in known if not same_value(one.value(fluent), other.value(fluent))]


# --- unified-planning ----------------------------------------------------------------------


def foreign_fluent(theirs: Any, fluent: Fluent) -> Any:
    return theirs.fluent(fluent[0])(*(theirs.object(argument) for argument in fluent[1:]))


def state_after(simulator: Any, theirs: Any, state: Any, action: str, arguments: tuple[str, ...]) -> Any:
    """What unified-planning makes of a state by an action; None where it cannot be done."""
    try:
        return simulator.apply(state, theirs.action(action), [theirs.object(argument) for argument in arguments])
    except UPInvalidActionError:  # the precondition is false whatever the state is
        return None


@examples(12, UNSHRUNK)
@given(st.data())
def test_conditions_and_effects_mean_what_they_mean_to_unified_planning(data: st.DataObject) -> None:
    problem = data.draw(problems(FOREIGN))
    asked = [ActionSchema(f"c{number}", precondition=data.draw(conditions_on(problem, FOREIGN))) for number in range(6)]
    domain = replace(
        problem.domain, constants=problem.objects, actions={one.name: one for one in (*problem.domain.actions.values(), *asked)}
    )
    problem = replace(problem, domain=domain, own_objects={}, init=data.draw(states(problem)))
    ours, theirs = initial_knowledge(problem), to_unified_planning(problem)
    simulator = UPSequentialSimulator(theirs, error_on_failed_checks=False)
    state = simulator.get_initial_state()
    assert simulator.is_goal(state) is evaluate(problem.goal, ours)
    known = [one for one in (*fluents(problem, domain.predicates), *fluents(problem, domain.functions)) if theirs.has_fluent(one[0])]
    for name, arguments in ground_calls(problem):
        action = ground_action(domain.actions[name], arguments)
        after = state_after(simulator, theirs, state, name, arguments)
        assert (after is not None) is evaluate(action.precondition, ours), action
        if after is not None:
            predicted = initial_knowledge(problem)
            predicted.update(changes(action.end_effects, ours))
            found = {one: float(after.get_value(foreign_fluent(theirs, one)).constant_value()) for one in known}
            assert found == {one: float(predicted.value(one) or 0) for one in known}, action  # type: ignore[arg-type]


# --- Kairos --------------------------------------------------------------------------------

KINDS = {
    "one after the other": Features(),
    "at the same times": Features(timed=True, exists=False),  # Kairos overlooks what an exists has looked at besides what made it true
    "at different times": Features(timed=True),
}


def drawn_plan(data: st.DataObject, kind: str) -> tuple[Problem, Plan]:
    problem = data.draw(problems(KINDS[kind]))
    plan = data.draw(plans_for(problem))
    return problem, apart(plan) if kind == "at different times" and problem.is_timed else plan


@pytest.mark.parametrize("kind", KINDS)
def test_verdicts_on_plans_and_states_are_those_of_kairos(kind: str) -> None:
    @examples(25)
    @given(st.data())
    def check(data: st.DataObject) -> None:
        problem, plan = drawn_plan(data, kind)
        show(problem, plan)
        assert parse_problem(write_problem(problem), parse_domain(write_domain(problem.domain))) == problem
        for goal in (problem.goal, TRUE):
            asked = replace(problem, goal=goal)
            ours, theirs = why_invalid(asked, plan), validate(asked, plan)
            event("valid" if not ours else ours.split(":")[0].rsplit(",")[-1].split(" at ")[0])
            assert (not ours) == (not theirs), f"ours: {ours or 'valid'}; Kairos: {theirs or 'valid'}"
        if not ours:
            final = trace(asked, plan)[-1][1].facts()
            assert not validate(replace(problem, goal=goal_of(problem, final)), plan)

    check()


# --- execution -----------------------------------------------------------------------------


def executed(problem: Problem, graph: PlanGraph, *, sensed: bool) -> tuple[RunResult, KnowledgeBase, KnowledgeBase]:
    """How a plan ends on simulated robots, what the world is then like, and what is believed of it."""
    bindings = Bindings(assumed=frozenset() if sensed else dynamic_names(problem))
    backend, beliefs = simulated_backend(problem, bindings), initial_knowledge(problem)
    machine = generate(graph, bindings)
    verify(machine)

    async def main() -> RunResult:
        await backend.open(beliefs)
        for change in () if sensed else problem.timed:
            asyncio.get_running_loop().call_at(change.time, beliefs.update, change.changes)
        run = Run(machine, Layered(beliefs), id=UUID(int=7), bindings=bindings, goal_fields=backend.client.goal_fields)
        result = await Executor(run, backend.client).execute()
        await asyncio.sleep(1.0)  # the last reports
        await backend.close()
        return result

    return run_async(main(), virtual=True), backend.robots.world.truth, beliefs


def lasts(problem: Problem, plan: Plan) -> bool:
    """Whether every durative action takes time: a robot does not start and end at the same moment."""
    return all(problem.domain.actions[step.action].duration is None or step.duration for step in plan.steps)


def check_execution(problem: Problem, plan: Plan, *, sensed: bool) -> None:
    """Execute a valid plan by its causes and compare where it leads with what the semantics predicts."""
    show(problem, plan)
    try:
        graph = plan_graph(problem, plan)
    except PlanGraphError:
        event("refused: calls must start or end at exactly the same time")
        starts = [step.start for step in plan.steps] + [step.start + step.duration for step in plan.steps]
        assert len(set(starts)) < len(starts)
        return
    result, truth, beliefs = executed(problem, graph, sensed=sensed)
    is_as_planned = result.goal and all(call.attempts <= 1 for call in result.calls)
    if not is_as_planned and any(ordering.after.moment is Moment.END for ordering in graph.orderings):
        # An end comes when its time is up. A plan that leaves no slack may have it too early; then the call is made once more, or there
        # is a new plan.
        event("failed: an end did not wait for others")
        return
    event("executed")
    assert result.goal, result.reason
    # what comes true by itself may come true after the last call, which may be earlier than planned
    alone = {fluent for change in problem.timed for fluent in change.changes}
    assert not [one for one in differences(problem, truth, trace(problem, plan)[-1][1]) if one[0] not in alone]
    assert not [one for one in differences(problem, beliefs, truth) if one[0] not in alone]


def executable(problem: Problem) -> Problem:
    """The problem with those timed facts only that nobody else changes.

    A call whose effects are so already is skipped, even if a timed fact is about to undo them.
    """
    writers = (names_written((*schema.start_effects, *schema.end_effects)) for schema in problem.domain.actions.values())
    written = frozenset().union(*writers)
    return replace(problem, timed=tuple(one for one in problem.timed if one.time and not written & {fluent[0] for fluent in one.changes}))


@pytest.mark.parametrize("timed", [False, True])
def test_execution_leads_where_the_semantics_says(timed: bool) -> None:
    @examples(25, UNSHRUNK)
    @given(st.data(), st.booleans())
    def check(data: st.DataObject, sensed: bool) -> None:
        problem = executable(replace(data.draw(problems(Features(timed=timed))), goal=TRUE))
        # a walk leaves no slack before what it must not be later than, so all timed facts come before the first step
        plan = data.draw(walks(problem, max((change.time for change in problem.timed), default=-1.0) + 1.0))
        assume(plan.steps and lasts(problem, plan))
        if data.draw(st.booleans()):
            problem = replace(problem, goal=goal_of(problem, trace(problem, plan)[-1][1].facts()))
        check_execution(problem, plan, sensed=sensed)

    check()


def test_an_add_for_every_object_undoes_no_delete_if_there_is_no_object() -> None:
    """As in `assignments`, which planners and lower bounds are told by."""
    action = "(:action a :parameters () :effect (and (forall (?x - u) (p)) (not (p))))"
    domain = parse_domain(f"(define (domain d) (:requirements :adl :typing) (:types u) (:predicates (p)) {action})")
    problem = parse_problem("(define (problem x) (:domain d) (:init (p)) (:goal (not (p))))", domain)
    assert [step.action for step in solve(problem).plan.steps] == ["a"]
    assert lower_bound(problem, None, inf) == pytest.approx(1.0)
    one = parse_problem("(define (problem x) (:domain d) (:objects o - u) (:init (p)) (:goal (not (p))))", domain)
    assert solve(one).plan is None
