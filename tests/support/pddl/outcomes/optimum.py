"""The best that can be done in a problem whose actions have outcomes: over all states that can be reached, where these are few."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, TypeAlias

from tests.support.pddl.outcomes.problem import Chance, State

MOST: Final = 20_000
"""States of the largest problem that is looked at."""
EXACT: Final = 1e-10
"""The largest change of a value at which values count as settled."""

Ends: TypeAlias = list[tuple[float, int]]
Choices: TypeAlias = list[list[Ends]]
"""For every state, by number, and for everything that can be done in it, the states that follow with their chances."""


@dataclass(frozen=True)
class Optimum:
    """The best that can be done.

    Args:
        chance: of the goal; exactly 1 where a policy reaches it whatever the outcomes, if these are fair.
        steps: actions that the goal takes on average, at best; None if it is not sure.
        best: for every state that can be reached, the best chance from it.
    """

    chance: float
    steps: float | None
    best: dict[State, float]


def reached(problem: Chance, most: int = MOST) -> tuple[list[State], Choices] | None:
    """Return all states that can be reached, the first one first, and what can be done in them; None if there are more."""
    numbers, states, choices = {problem.initial: 0}, [problem.initial], Choices()
    for state in states:
        choices.append([])
        for action in () if problem.is_goal(state) else problem.actions:
            if problem.is_possible(action, state):
                ends = problem.successors(action, state)
                for _, after in ends:
                    if numbers.setdefault(after, len(states)) == len(states):
                        states.append(after)
                choices[-1].append([(share, numbers[after]) for share, after in ends])
        if len(states) > most:
            return None
    return states, choices


def optimum(problem: Chance, most: int = MOST) -> Optimum | None:
    """Return the best that can be done; None if there are too many states."""
    found = reached(problem, most)
    if found is None:
        return None
    states, choices = found
    everything, goals = set(range(len(states))), [number for number, state in enumerate(states) if problem.is_goal(state)]
    hopeful = _backwards(choices, goals, everything)
    sure, before = hopeful, everything
    while len(sure) < len(before):
        before = set(sure)
        sure = _backwards(choices, goals, before)
    values = [float(number in before) for number in everything]
    _settle(values, [number for number in hopeful if number not in before], choices, max, 0.0)
    steps = None
    if 0 in before:
        steps = [0.0 for _ in states]
        safe = [[ends for ends in ways if all(after in before for _, after in ends)] for ways in choices]
        _settle(steps, [number for number in sure if number not in set(goals)], safe, min, 1.0)
    return Optimum(values[0], steps[0] if steps else None, dict(zip(states, values, strict=True)))


def _backwards(choices: Choices, goals: Iterable[int], within: set[int]) -> list[int]:
    """Return the states from which a goal may be reached by what leads nowhere else than `within`, the nearest first."""
    before: dict[int, list[int]] = {}
    for number in within:
        for ends in choices[number]:
            if all(after in within for _, after in ends):
                for _, after in ends:
                    before.setdefault(after, []).append(number)
    found = dict.fromkeys(goals)
    order = list(found)
    for number in order:
        new = [one for one in dict.fromkeys(before.get(number, ())) if one not in found]
        found.update(dict.fromkeys(new))
        order.extend(new)
    return order


def _settle(values: list[float], order: list[int], choices: Choices, best: Callable[[Iterable[float]], float], cost: float) -> None:
    """Change the values of states until each is the best of what can be done in it, where everything that is done costs so much."""
    ways: dict[int, list[tuple[float, Ends]]] = {}
    for number in order:
        ways[number] = []
        for ends in choices[number]:
            leaves = sum(share for share, after in ends if after != number)  # until it does: what changes nothing is done again
            if leaves > 0.0:
                ways[number].append((cost / leaves, [(share / leaves, after) for share, after in ends if after != number]))
    change = 1.0
    while change > EXACT:
        change = 0.0
        for number, possible in ways.items():
            new = best(own + sum(share * values[after] for share, after in ends) for own, ends in possible)
            change = max(change, abs(new - values[number]))
            values[number] = new
