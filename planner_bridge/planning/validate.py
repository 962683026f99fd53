"""Plan validation: our own validator, by the semantics that is executed, beside that of Kairos.

The rules are those of PDDL 2.1 (section 8) and 2.2, read as Kairos' validator reads them:

- What is one happening is said in `planner_bridge.model.progression`.
- At one happening no step may change what another looks at, nor may two change the same fluent,
  unless both add it, both delete it, or both only increase or decrease it. Looked at is what a
  number is calculated from, and what decided a condition: of ``(or (p) (q))`` with `p` true that
  is `p` alone. PDDL 2.1 counts every fluent that is mentioned; Kairos is as lenient as we are, and
  also overlooks what an ``exists`` has found to be false. The bounds of a duration, and what
  derived facts follow from, do not count, there as here.
- An over-all condition must hold from just after the happening of the start until just before
  that of the end: nowhere when both are one.
- A duration may miss its bounds by a thousandth of a second.
- A state is in force until the next one, also for ``hold-during`` and ``hold-after``; Kairos looks at
  those states only that begin within the time.
- Processes and events are those of `pnm.core.nature`; constraints are looked at where something begins, ends or comes about.
- All timed facts come true, those after the last step too, before the goal is looked at.
- A number without a value cannot be changed, `total-cost` excepted, nor can it be compared. Kairos
  refuses a plan as soon as it meets one, even where it does not matter: in an effect whose
  condition is false, or in ``(or (> (f) 0) (p))`` when `p` is true.

Which tasks of a hierarchical problem the steps carry out is not looked at.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import Final

import kairos

from planner_bridge.model.grounding import ground_step, initial_knowledge
from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus, PlanStep, plan_text
from planner_bridge.model.problem import TOTAL_COST, Problem
from planner_bridge.model.progression import ConstraintProgression, Happening, NotApplicable, Progression, happenings, snapshot
from planner_bridge.planning.kairos import DEFAULT_PLANNER, validate
from planner_bridge.planning.normal_form import calculates_with_whole_numbers, in_whole_numbers
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TOLERANCE, evaluate, explanation
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.effects import assignments, possible_assignments
from pnm.core.logic.expressions import UNKNOWN, Constant, Expression, Fluent, State, Unknown, Value, fluent_text, value_of
from pnm.core.logic.trajectory import moments, observed_of
from pnm.core.machine.plan_graph import GroundAction, Moment
from pnm.core.nature import Nature
from pnm.errors import InputError, PnmError

DURATION_TOLERANCE: Final = 1e-3
"""Seconds by which a duration may miss its bounds."""
_BY_ITSELF: Final = -1
"""Stands for a step where facts change by themselves."""


class InvalidPlan(PnmError):
    """The plan does not solve its problem: because of one of its steps, or as a whole."""

    def __init__(self, reason: str, step: int | None = None) -> None:
        super().__init__(reason)
        self.step = step


def why_invalid(problem: Problem, plan: Plan) -> str:
    """Return why the plan does not solve the problem, in one sentence; empty when it does."""
    try:
        last_state(problem, plan)
    except InvalidPlan as reason:
        return str(reason)
    return ""


def last_state(problem: Problem, plan: Plan) -> KnowledgeBase:
    """Return the state that the plan leads to; raise `InvalidPlan` if it does not solve the problem."""
    constraints = (*problem.domain.constraints, *problem.constraints)
    samples = sorted({time for constraint in constraints for time in moments(constraint)})
    states = _states(problem, plan, samples)
    time, state = next(states)
    progression = ConstraintProgression(constraints, state, time)
    for time, state in states:
        if violated := progression.advance(state, time):
            raise InvalidPlan(f"{violated} is violated at {time:g} s: {observed_of(violated, state)}")
    for constraint in progression.unfulfilled(state, time):
        raise InvalidPlan(f"{constraint} is not fulfilled at the end: {observed_of(constraint, state)}")
    return state


def trace(problem: Problem, plan: Plan) -> tuple[tuple[float, KnowledgeBase], ...]:
    """Return the initial state and the state after each happening, with their times in seconds; the plan must be valid."""
    return tuple((time, snapshot(state)) for time, state in _states(problem, plan))


def _states(problem: Problem, plan: Plan, samples: Iterable[float] = ()) -> Iterator[tuple[float, KnowledgeBase]]:
    """Yield the initial state and the state after each happening, with their times: always the same object, which changes.

    At the sample times the state in force is yielded again.
    """
    waiting = deque(samples)
    steps = _steps(problem, plan)
    simulation = Progression(initial_knowledge(problem), nature=Nature(problem) if problem.domain.nature else None)
    now = 0.0
    yield now, simulation.state
    for happening in happenings(problem, plan):
        when = f" at {happening.time:g} s" if plan.temporal else ""
        while waiting and waiting[0] < happening.time - TOLERANCE:
            yield waiting.popleft(), simulation.state
        try:
            for passed in simulation.pass_time(happening.time - now):
                yield now + passed, simulation.state
            now = happening.time
            for event in happening.events:
                if event.moment is Moment.START:
                    steps[event.call].check_duration(simulation.state)
            _check_interference(happening, steps, simulation, when)
            changes = simulation.advance([(event, steps[event.call].action) for event in happening.events], happening.changes)
        except NotApplicable as error:
            raise InvalidPlan(f"{steps[error.call]} cannot {error.stage}{when}: {error}", error.call) from error
        except InputError as error:
            raise InvalidPlan(str(error)) from error
        for fluent, value in changes.items():
            if value is UNKNOWN and fluent[0].lower() != TOTAL_COST:
                raise InvalidPlan(f"{fluent_text(fluent)} is changed{when}, but it has no value, or is given none")
        yield happening.time, simulation.state
    if evaluate(problem.goal, simulation.state) is not True:
        expected, observed = explanation(problem.goal, simulation.state)
        raise InvalidPlan(f"the goal does not hold at the end: expected {expected}; observed {observed}")


@dataclass(frozen=True, slots=True)
class _Step:
    number: int
    schema: ActionSchema
    action: GroundAction
    duration: float
    """In seconds; 0 when the action is instantaneous."""

    def __str__(self) -> str:
        return f"step {self.number}, {self.action},"

    def check_duration(self, state: State) -> None:
        env = self.schema.environment(self.action.arguments)
        for constraint in self.schema.duration or ():
            bound = value_of(constraint.bound, state, env)
            excess = self.duration - bound if isinstance(bound, int | float) else float("inf")
            over = 0.0 if constraint.operation == ">=" else excess
            under = 0.0 if constraint.operation == "<=" else -excess
            if max(over, under) > DURATION_TOLERANCE + TOLERANCE:
                shown = "unknown" if isinstance(bound, Unknown) else f"{bound:g}"
                raise InvalidPlan(f"{self} cannot take {self.duration:g} s: expected {constraint}; observed a bound of {shown}")


def _steps(problem: Problem, plan: Plan) -> list[_Step]:
    """Return the steps with their ground actions; a step that is none, because a name, a type or a time is wrong, is refused."""
    objects = {name: frozenset(members) for name, members in problem.objects_by_type.items()}
    steps: list[_Step] = []
    for index, step in enumerate(plan.steps):
        if wrong := _wrong(step, problem, objects):
            raise InvalidPlan(f"step {index + 1}, {step}, {wrong}")
        schema = problem.domain.actions[step.action]
        duration = None if schema.duration is None else step.duration
        try:
            action = ground_step(problem.domain, step.action, step.arguments, duration, step.outcome, problem.members)
        except InputError as error:
            raise InvalidPlan(f"step {index + 1}, {step}, is wrong: {error}") from error
        steps.append(_Step(index + 1, schema, action, duration or 0.0))
    return steps


def _wrong(step: PlanStep, problem: Problem, objects: Mapping[str, frozenset[str]]) -> str:
    """Return the mistake of the step as it is written; empty for none."""
    schema = problem.domain.actions.get(step.action)
    if schema is None:
        return "is no action of the domain"
    if not (isfinite(step.start) and isfinite(step.duration) and step.start >= 0.0 and step.duration >= 0.0):
        return f"starts at {step.start:g} s and takes {step.duration:g} s: expected times from 0 on"
    if len(step.arguments) != len(schema.parameters):
        return f"has {len(step.arguments)} arguments: expected {len(schema.parameters)}"
    for variable, argument in zip(schema.parameters, step.arguments, strict=True):
        if not any(argument in objects[kind] for kind in variable.types):
            known = argument in objects["object"]
            return f"has {argument} for {variable}: {'it is of another type' if known else 'there is no such object'}"
    return ""


@dataclass(frozen=True, slots=True)
class _ReadRecorder:
    """A state that records which fluents are read."""

    state: State
    read: set[Fluent] = field(default_factory=set)

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        self.read.add(fluent)
        return self.state.value(fluent)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        return self.state.objects(types)


def _check_interference(happening: Happening, steps: Sequence[_Step], simulation: Progression, when: str) -> None:
    """Refuse two steps at one happening if one changes what the other reads, or both change the same fluent in different ways."""
    if len({event.call for event in happening.events}) + bool(happening.timed) < 2:
        return
    readers: dict[Fluent, list[int]] = {}
    writers: dict[Fluent, list[tuple[int, str]]] = {}
    for event in happening.events:
        action = simulation.running.get(event.call, steps[event.call].action)
        starts = event.moment is Moment.START
        recorder = _ReadRecorder(simulation.state)
        evaluate(action.precondition if starts else action.end_condition, recorder)
        effects = action.start_effects if starts else action.end_effects
        for fluent, effect, _ in assignments(effects, recorder):
            writers.setdefault(fluent, []).append((event.call, _kind_of_change(effect.operation, effect.value)))
        for _, effect, env in possible_assignments(effects, recorder):
            value_of(effect.value, recorder, env)
        for fluent in recorder.read:
            readers.setdefault(fluent, []).append(event.call)
    for fluent, value in happening.changes.items():
        writers.setdefault(fluent, []).append((_BY_ITSELF, _kind_of_change("assign", Constant(value))))
    for fluent, written in writers.items():
        read = readers.get(fluent, [])
        involved = {call for call, _ in written}.union(read)
        kinds = {kind for _, kind in written}
        if len(involved) > 1 and (read or len(kinds) > 1 or kinds == {"assign"}):
            first, second = ("what changes by itself" if call == _BY_ITSELF else f"{steps[call]}" for call in sorted(involved)[:2])
            reason = f"both have to do with {fluent_text(fluent)}, which changes"
            raise InvalidPlan(f"{first} and {second} get in each other's way{when}: {reason}")


def _kind_of_change(operation: str, value: Expression) -> str:
    """Return ``add`` for an increase or decrease, the truth value for a fact, else ``assign``: the first two commute with their like."""
    if operation in ("increase", "decrease"):
        return "add"
    return "assign" if operation != "assign" or not isinstance(value, Constant) or not isinstance(value.value, bool) else str(value.value)


def validated(problem: Problem, result: PlanningResult, parsed: kairos.Problem | None = None) -> PlanningResult:
    """Return the result if both validators accept its plan; else one without a plan, but a reason. `parsed` is the problem for Kairos."""
    if result.plan is None:
        return result
    verdicts = {"Kairos' validator": validate(problem, result.plan, parsed), "our own": why_invalid(problem, result.plan)}
    if not any(verdicts.values()):
        is_best = result.plan.is_best and not problem.unknown and calculates_with_whole_numbers(in_whole_numbers(problem))
        return replace(result, plan=replace(result.plan, is_best=is_best))
    status = PlanningStatus.INVALID_PLAN if all(verdicts.values()) else PlanningStatus.DISAGREEMENT
    reasons = "; ".join(f"{validator} says: {why or 'valid'}" for validator, why in verdicts.items())
    return PlanningResult(status, message=f"{reasons}; the plan: {' '.join(plan_text(result.plan).split())}", planner=result.planner)


def explained(problem: Problem, result: PlanningResult) -> PlanningResult:
    """Return a result; if no plan was found, with our own reason, if any; without one only whole numbers and known facts prove anything."""
    if result.status not in (PlanningStatus.UNSOLVABLE, PlanningStatus.NO_PLAN):
        return result
    from planner_bridge.planning.reachability import why_unknown, why_unreachable  # here, because most searches find a plan

    if reason := why_unreachable(problem):
        return replace(result, status=PlanningStatus.UNSOLVABLE, message=reason)
    if problem.unknown:
        facts = f"{len(problem.unknown)} {'facts are' if len(problem.unknown) > 1 else 'fact is'} unknown"
        return replace(result, status=PlanningStatus.NO_PLAN, message=why_unknown(problem) or f"{facts}, and counted as false")
    asked = in_whole_numbers(problem) if result.planner == DEFAULT_PLANNER else problem
    if result.status is PlanningStatus.UNSOLVABLE and not calculates_with_whole_numbers(asked):
        message = f"{result.planner} says that there is none, but this is no proof: with decimals it calculates differently"
        return replace(result, status=PlanningStatus.NO_PLAN, message=message)
    return result
