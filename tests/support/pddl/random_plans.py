"""Strategies for hypothesis: small random plans of PDDL problems, and the states they lead to."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import product

from hypothesis import strategies as st

from planner_bridge.model.grounding import initial_knowledge, modelled_duration
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.planning.validate import why_invalid
from pnm.core.logic.conditions import TRUE, All, Compare, Condition, Holds, Not
from pnm.core.logic.expressions import Constant, Fluent, Value, ValueOf
from tests.support.pddl.random_problems import STARTS, Draw, fluents


def ground_calls(problem: Problem) -> list[tuple[str, tuple[str, ...]]]:
    """Return every ground action: its name and its arguments."""
    return [
        (schema.name, arguments)
        for schema in problem.domain.actions.values()
        for arguments in product(*(problem.objects_by_type[parameter.types[0]] for parameter in schema.parameters))
    ]


@st.composite
def _steps(draw: Draw, problem: Problem, begin: float = 0.0) -> PlanStep:
    """Draw a step; its duration fits the initial state more often than not."""
    action, arguments = draw(st.sampled_from(ground_calls(problem)))
    if not problem.is_timed:
        return PlanStep(action, arguments)
    shortest = max(0.0, modelled_duration(problem.domain.actions[action], arguments, initial_knowledge(problem)) or 0.5)
    duration = draw(st.sampled_from([shortest, shortest, shortest, shortest + 0.5, 1.0, 0.0]))
    return PlanStep(action, arguments, begin + draw(STARTS), duration)


def as_plan(problem: Problem, steps: Iterable[PlanStep]) -> Plan:
    """Return the steps as a plan: in the order of their starts when these are times."""
    if problem.is_timed:
        return Plan(tuple(sorted(steps, key=lambda step: step.start)), temporal=True)
    return Plan(tuple(replace(step, start=float(number)) for number, step in enumerate(steps)))


def apart(plan: Plan) -> Plan:
    """Return the plan with no two events at one time, in the order in which they were."""
    return replace(plan, steps=tuple(replace(step, start=step.start + (number + 1) / 128) for number, step in enumerate(plan.steps)))


@st.composite
def _walks(draw: Draw, problem: Problem, begin: float) -> tuple[list[PlanStep], list[PlanStep]]:
    """Draw steps that can all be taken, wherever they lead, and steps each of which cannot be taken with those before it."""
    anywhere = replace(problem, goal=TRUE)
    taken: list[PlanStep] = []
    refused: list[PlanStep] = []
    for step in draw(st.lists(_steps(problem, begin), min_size=4, max_size=8)) if ground_calls(problem) else ():
        (refused if why_invalid(anywhere, as_plan(problem, [*taken, step])) else taken).append(step)
    return taken, refused


def walks(problem: Problem, begin: float = 0.0) -> st.SearchStrategy[Plan]:
    """Draw a plan of steps that can all be taken, from a time on; where they lead does not matter."""
    return _walks(problem, begin).map(lambda found: as_plan(problem, found[0]))


@st.composite
def plans_for(draw: Draw, problem: Problem) -> Plan:
    """Draw a plan: one that can be carried out, one that is a little different, or any."""
    if not ground_calls(problem):
        return as_plan(problem, ())
    match draw(st.sampled_from(["walk", "one too many", "changed", "any"])):
        case "walk":
            return draw(walks(problem))
        case "one too many":
            taken, refused = draw(_walks(problem, 0.0))
            return as_plan(problem, [*taken, *refused[:1]])
        case "any":
            return as_plan(problem, draw(st.lists(_steps(problem), min_size=1, max_size=4)))
        case _:
            return draw(one_step_changed(problem, draw(walks(problem))))


@st.composite
def one_step_changed(draw: Draw, problem: Problem, plan: Plan) -> Plan:
    """Draw a plan that differs from this one in one step."""
    steps = list(plan.steps)
    if not steps or draw(st.booleans()):
        steps.insert(draw(st.integers(0, len(steps))), draw(_steps(problem)))
        return as_plan(problem, steps)
    place = draw(st.integers(0, len(steps) - 1))
    step = steps.pop(place)
    match draw(st.sampled_from(["drop", "move", "stretch", "repeat"])):
        case "move":
            steps.append(replace(step, start=max(0.0, step.start + draw(st.sampled_from([0.5, -0.5, 0.001, -0.001, 1.0])))))
        case "stretch":
            steps.insert(place, replace(step, duration=max(0.0, step.duration + draw(st.sampled_from([0.5, -0.5, 0.0005, 0.002])))))
        case "repeat":
            steps[place:place] = [step, step]
    return as_plan(problem, steps)


def goal_of(problem: Problem, state: Mapping[Fluent, Value]) -> Condition:
    """Return that everything is as it is in the state."""
    facts = [Holds(one) if state.get(one) else Not(Holds(one)) for one in fluents(problem, problem.domain.predicates)]
    numbers = [Compare("=", ValueOf(one), Constant(state[one])) for one in fluents(problem, problem.domain.functions)]
    return All((*facts, *numbers))
