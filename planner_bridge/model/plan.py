"""Plans and planning results, as planners return them, and plans as text.

The text has one call a line, such as ``0.0: (move r1 hall kitchen) [5.0]``, times optional.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from functools import cache
from math import ceil
from operator import attrgetter
from typing import Any, Final, Protocol

from planner_bridge.model.grounding import initial_knowledge, modelled_duration
from planner_bridge.model.problem import Problem
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.expressions import State
from pnm.errors import InputError, Position, counted, suggestion


@dataclass(frozen=True, slots=True)
class PlanStep:
    """A ground action and when it starts, in seconds; its position, in a sequential plan."""

    action: str
    arguments: tuple[str, ...] = ()
    start: float = 0.0
    duration: float = 0.0
    outcome: str = ""
    """The name of the expected one, if the action has several: the first by default."""

    def __str__(self) -> str:
        return f"{self.action}({', '.join(self.arguments)}){self.outcome and f' -> {self.outcome}'}"


@dataclass(frozen=True, slots=True)
class Plan:
    """Steps in the order of their starts."""

    steps: tuple[PlanStep, ...] = ()
    temporal: bool = False
    """Whether starts and durations are times; otherwise the steps follow one another."""
    cost: float | None = None
    """By the metric of the problem; None without one."""
    seconds: float | None = None
    """Until all is carried out, if nothing fails; None for a plan with times, and where nothing is known about its calls."""
    is_best: bool = False
    """Whether it is proved that no plan is better: costs less, or without a metric takes less time or has fewer steps."""
    above: float | None = None
    """How far it is above the best plan at most, as a part of that; None where no bound is known, or was asked for."""
    until: float = 0.0
    """When it is over, in seconds, if that is after its last step: processes go on."""

    def __str__(self) -> str:
        if not self.steps and not self.until:
            return "nothing to do: the goal is empty, holds already, or comes by itself"
        parts = [counted(len(self.steps), "call"), *([f"{self.makespan:.1f} s"] if self.temporal else ())]
        parts += [f"{self.seconds:.0f} s expected"] if self.seconds is not None else ()
        parts += [f"cost {self.cost:g}"] if self.cost is not None else ()
        if self.is_best:
            parts.append("no plan is better")
        elif self.above is not None and self.above <= 1.0:  # a bound that is farther off says nothing
            parts.append(f"at most {ceil(100.0 * self.above)} % above the best")
        head = ", ".join(parts)
        lines = (
            f"  {step.start:8.2f} s  {step}  [{step.duration:.2f} s]" if self.temporal else f"  {number:8d}.   {step}"
            for number, step in enumerate(self.steps, 1)
        )
        waits = (f"  {self.until:8.2f} s  the end",) if self.until else ()
        return "\n".join((head, *lines, *waits))

    @property
    def value(self) -> float:
        """Its measure: the cost by a metric, else the expected seconds, else those that it says itself, else the number of steps."""
        if self.cost is not None or self.seconds is not None:
            return self.seconds or 0.0 if self.cost is None else self.cost
        return self.makespan if self.temporal else float(len(self.steps))

    @property
    def makespan(self) -> float:
        """The time from the start to the end."""
        return max((self.until, *(step.start + step.duration for step in self.steps)))


class PlanningStatus(Enum):
    """The result of a search for a plan."""

    SOLVED = "solved"
    UNSOLVABLE = "proved unsolvable"
    NO_PLAN = "no plan found"
    TIMED_OUT = "time-out"
    CANCELLED = "cancelled"
    OUT_OF_MEMORY = "out of memory"
    UNSUPPORTED = "unsupported"
    INVALID = "invalid input"
    CRASHED = "planner crashed"
    INVALID_PLAN = "plan not valid"
    DISAGREEMENT = "validators disagree"


class Policy(Protocol):
    """Says what to do wherever the outcomes of actions may lead."""

    @property
    def problem(self) -> Problem:
        """The problem whose goal it reaches, from whatever state."""

    @property
    def entries(self) -> tuple[tuple[Any, ...], ...]:
        """All that it says, as values that a journal keeps."""

    @property
    def chance(self) -> float:
        """That of the goal."""

    @property
    def is_proved(self) -> bool:
        """Whether it is proved to reach the goal."""

    @property
    def policies(self) -> tuple[Policy, ...]:
        """Those that may be followed, the best one first: several, if it becomes better while robots work."""

    def follow(self, policy: Any, /) -> None:
        """Note which one of them is followed."""

    def stretch(self, state: KnowledgeBase, /) -> Plan | None:
        """Return what to do from a state up to the next action with several outcomes, or to the goal; None if it says nothing of it."""


@dataclass(frozen=True, slots=True)
class PlanningResult:
    """The answer of a planner: a valid plan, or why there is none."""

    status: PlanningStatus
    plan: Plan | None = None
    message: str = ""
    planner: str = ""
    """The planner that found the plan, or did not; the members of a portfolio, joined by commas."""
    policy: Policy | None = None
    """What the plan is the beginning of, where actions have several outcomes."""

    @property
    def reason(self) -> str:
        """The status and the planner's message."""
        return f"{self.status.value}{f': {self.message}' if self.message else ''}"


class CancelToken(Protocol):
    """Set from another thread to end a search; a `threading.Event` is one."""

    def is_set(self) -> bool:
        """Whether to stop."""


_LINE: Final = re.compile(r"\s*(?:(?P<time>[0-9.eE+-]+)\s*:)?\s*\((?P<call>[^()]*)\)\s*(?:\[(?P<duration>[0-9.eE+-]+)\])?\s*")
_END: Final = ": @PlanEND"
"""Stands after the time of the end, of a plan that goes on after its last step."""
GAP: Final = 0.001
"""Seconds between the end of a call and the start of the next one, where the text has no times."""
ASSUMED_SECONDS: Final = 1.0
"""Seconds of a call of which nothing is known, as planners count them."""
LONGEST: Final = 1_000_000
"""Characters of a plan."""


def read_plan(text: str, problem: Problem, name: str = "plan") -> Plan:
    """Read a plan with the actions and objects of the problem; empty lines and comments, from a semicolon on, do not count."""
    if len(text) > LONGEST:
        raise InputError(f"{name}: {len(text)} characters; a plan may have {LONGEST}")
    steps: list[PlanStep] = []
    state, now, until, names = initial_knowledge(problem), 0.0, 0.0, SpelledNames(problem)
    for number, line in enumerate(text.splitlines(), 1):
        content = line.partition(";")[0]
        if content.strip().endswith(_END):
            until = _number(content.strip().removesuffix(_END), Position(name, number, 1)) or 0.0
        elif content.strip():
            step = _step(content, names, state, Position(name, number, len(content) - len(content.lstrip()) + 1), now)
            steps.append(step)
            now = step.start + step.duration + GAP
    return Plan(tuple(sorted(steps, key=attrgetter("start"))), problem.is_timed, until=until)


def read_call(problem: Problem, text: str, origin: str) -> PlanStep:
    """Return the call that is written as ``move(r1, a, b)`` or as ``(move r1 a b)``; raise an `InputError` for other names."""
    name, bracket, arguments = text.strip().partition("(")
    if name:
        text = f"({name} {arguments.replace(',', ' ')}" if bracket else f"({name})"
    try:
        steps = read_plan(" ".join(text.split()) or "()", problem).steps
    except InputError as error:
        raise InputError(error.message, Position(origin)) from error
    if len(steps) != 1:
        raise InputError("expected a call such as move(r1, a, b)", Position(origin))
    return steps[0]


class SpelledNames:
    """The names of a problem, found however they are spelled: capitals do not count in PDDL."""

    def __init__(self, problem: Problem) -> None:
        self.actions = {name.lower(): schema for name, schema in problem.domain.actions.items()}
        self.objects = {name.lower(): name for name in problem.objects}
        self.of_types = cache(lambda types: {name.lower(): name for kind in types for name in problem.objects_by_type.get(kind, ())})

    def step(self, action: str, arguments: Iterable[str], start: float, duration: float) -> PlanStep:
        """Return a step as a planner spells it; raise a `KeyError` if there is no such name."""
        return PlanStep(self.actions[action.lower()].name, tuple([self.objects[name.lower()] for name in arguments]), start, duration)


def _step(line: str, names: SpelledNames, state: State, position: Position, now: float) -> PlanStep:
    match = _LINE.fullmatch(line)
    if match is None or not match["call"].split():
        raise InputError(f"expected a call such as (move r1 hall kitchen), found {line.strip()[:60]!r}", position)
    action, *given = match["call"].lower().split()
    schema = names.actions.get(action)
    if schema is None:
        known = [one.name for one in names.actions.values()]
        hint = suggestion(action, known) or f"expected one of {', '.join(known) or 'none, for there is no domain'}"
        raise InputError(f"there is no action {action!r}; {hint}", position)
    if len(given) != len(schema.parameters):
        expected = " ".join(variable.name for variable in schema.parameters) or "none"
        raise InputError(f"{schema.name} takes {len(schema.parameters)} arguments ({expected}), found {len(given)}", position)
    arguments: list[str] = []
    for variable, argument in zip(schema.parameters, given, strict=True):
        fitting = names.of_types(variable.types)
        if argument not in fitting:
            known = sorted(fitting.values())
            hint = suggestion(argument, known) or f"expected one of {', '.join(known[:8]) or 'none, for there are none'}"
            raise InputError(f"{argument!r} is no object for {variable.name} of {schema.name}; {hint}", position)
        arguments.append(fitting[argument])
    duration = _number(match["duration"], position)
    if duration is None:
        duration = modelled_duration(schema, tuple(arguments), state)
    start = _number(match["time"], position)
    return PlanStep(schema.name, tuple(arguments), now if start is None else start, duration or 0.0)


def _number(text: str | None, position: Position) -> float | None:
    try:
        return None if text is None else float(text)
    except ValueError as error:
        raise InputError(f"expected a number of seconds, found {text!r}", position) from error


def plan_text(plan: Plan) -> str:
    """Return the plan in the format of the planning competitions."""
    if not plan.temporal:
        return "".join(f"({' '.join((step.action, *step.arguments))})\n" for step in plan.steps)
    lines = [f"{step.start:.6f}: ({' '.join((step.action, *step.arguments))}) [{step.duration:.6f}]\n" for step in plan.steps]
    return "".join((*lines, *((f"{plan.until:.6f}{_END}\n",) if plan.until else ())))
