"""Nature: processes and events (PDDL+), and what they do to a state while time passes.

- A process goes on while its condition holds. Its effects say by how much numbers change in a second; those of several add up (Fox and
  Long 2006, *Modelling Mixed Discrete-Continuous Domains for Planning*).
- An event comes about as soon as its condition holds, which its effects make false.
- At a *turn* a condition changes. Between turns numbers are integrated (Runge and Kutta, fourth order); turns are found by bisection. What
  becomes true and false again within a step is overlooked.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Final, NamedTuple

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TOLERANCE, Condition, evaluate, ground, names
from pnm.core.logic.domain import ActionSchema, ProblemModel
from pnm.core.logic.effects import Changes, Effects, assignments, changes, ground_effects
from pnm.core.logic.expressions import NOTHING, Fluent, OnlyObjects, Truth, absent_value, choices, is_number, same_value, value_of
from pnm.errors import InputError

STEP: Final = 0.1
"""Seconds of a step of the integration; more where there would be more than `MOST` of them."""
MOST: Final = 10_000
"""Steps, and turns, that are looked at."""


class GroundProcess(NamedTuple):
    """A process or an event with objects for its parameters."""

    name: str
    condition: Condition
    effects: Effects


class Nature:
    """All that may happen by itself in a problem."""

    def __init__(self, problem: ProblemModel) -> None:
        objects = OnlyObjects(problem.objects_by_type)

        def of(schemas: Iterable[ActionSchema]) -> list[GroundProcess]:
            return [
                GroundProcess(schema.name, ground(schema.precondition, env), ground_effects(schema.end_effects, env))
                for schema in schemas
                for env in choices(schema.parameters, objects, NOTHING)
            ]

        self._processes, self._events = of(problem.domain.processes.values()), of(problem.domain.events.values())
        self.moved = problem.domain.moved
        every, base = (*self._processes, *self._events), problem.domain.rules.base
        self._over_numbers = [one.condition for one in every if not self.moved.isdisjoint(base(names(one.condition)))]
        """The conditions that may change as time passes."""

    def pass_time(self, state: KnowledgeBase, seconds: float, watched: Iterable[Condition] = ()) -> Iterator[float]:
        """Let time pass in a state, which changes; yield how many seconds have passed at first, at every turn, and at the end.

        Args:
            watched: further conditions whose changes are turns.

        Raises an `InputError` if there is no end to what happens.
        """
        conditions, going_on, truths, is_turn = [*self._over_numbers, *watched], list[GroundProcess](), list[Truth](), True
        passed, step, turns = 0.0, max(STEP, seconds / MOST), 0
        self._react(state)
        yield passed
        while passed < seconds:
            if is_turn:
                going_on = [process for process in self._processes if evaluate(process.condition, state) is True]
                truths = [evaluate(condition, state) for condition in conditions]
            before = {fluent: value for fluent in _rates(going_on, state) if is_number(value := state.value(fluent))}
            if not before:
                break
            near, far = 0.0, min(step, seconds - passed)
            _move(state, going_on, before, far)
            is_turn = [evaluate(condition, state) for condition in conditions] != truths
            while is_turn and far - near > TOLERANCE:
                _move(state, going_on, before, middle := (near + far) / 2)
                near, far = (near, middle) if [evaluate(one, state) for one in conditions] != truths else (middle, far)
            passed += far
            if is_turn:
                _move(state, going_on, before, far)
                turns += 1
                if turns > MOST:
                    raise InputError(f"processes begin and end more than {MOST} times in {seconds:g} s")
                self._react(state)
                yield passed
        yield seconds

    def foresee(self, state: KnowledgeBase, seconds: float, watched: Iterable[Condition] = ()) -> Iterator[tuple[float, Changes]]:
        """Yield the same times, each with what will have changed since the one before; the state stays as it is."""
        ahead = KnowledgeBase(state.facts(), objects=state.objects_by_type(), rules=state.rules)
        before = ahead.facts()
        for passed in self.pass_time(ahead, seconds, watched):
            now = ahead.facts()
            changed: Changes = {fluent: value for fluent, value in now.items() if not same_value(before.get(fluent), value)}
            yield passed, changed | {fluent: absent_value(value) for fluent, value in before.items() if fluent not in now}
            before = now

    def _react(self, state: KnowledgeBase) -> None:
        """Let the events come about whose conditions hold, and those that follow from them."""
        for _ in range(MOST):
            events = [event for event in self._events if evaluate(event.condition, state) is True]
            if not events:
                return
            state.record(changes(tuple([effect for event in events for effect in event.effects]), state))
        raise InputError(f"the event {events[0].name} has no end: its effects leave its condition true")


def _rates(processes: Iterable[GroundProcess], state: KnowledgeBase) -> dict[Fluent, float]:
    """Return by how much numbers change in a second."""
    rates: dict[Fluent, float] = {}
    for process in processes:
        for fluent, effect, env in assignments(process.effects, state):
            if is_number(amount := value_of(effect.value, state, env)):
                rates[fluent] = rates.get(fluent, 0.0) + (amount if effect.operation == "increase" else -amount)
    return rates


def _move(state: KnowledgeBase, processes: Iterable[GroundProcess], before: Mapping[Fluent, float], seconds: float) -> None:
    """Record the numbers as they are so many seconds later."""
    total, last = dict.fromkeys(before, 0.0), dict.fromkeys(before, 0.0)
    for part, weight in ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
        state.record({fluent: value + last[fluent] * part * seconds for fluent, value in before.items()})
        rates = _rates(processes, state)
        last = {fluent: rates.get(fluent, 0.0) for fluent in before}
        total = {fluent: total[fluent] + weight * last[fluent] for fluent in before}
    state.record({fluent: value + total[fluent] * seconds / 6.0 for fluent, value in before.items()})
