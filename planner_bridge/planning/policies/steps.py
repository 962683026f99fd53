"""The steps of a policy: which entries follow which, by the outcomes of their actions, as text."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Any, Final, NamedTuple

from planner_bridge.planning.policies.search import SettledPart
from planner_bridge.planning.policies.task import PolicyAction, PolicyTask

MOST: Final = 200
"""Entries that are told; others are counted."""
_STATES: Final = 5_000
GOAL: Final = 0
NO_WAY_OUT: Final = -1


class Branch(NamedTuple):
    """An outcome, its chance, and the numbers of the steps that follow: of several, it depends on what was before."""

    outcome: str
    chance: float
    then: tuple[int, ...]


class Step(NamedTuple):
    """An entry of the policy on its way from the initial state, with a number from 1 on."""

    number: int
    action: PolicyAction
    expected: float
    branches: tuple[Branch, ...]
    entry: int = 0
    """The place of the entry in the policy."""

    def as_json(self) -> dict[str, Any]:
        """Return it as JSON has it: 0 is the goal, and -1 no way out."""
        outcomes = [{"outcome": one.outcome, "chance": round(one.chance, 6), "then": [*one.then]} for one in self.branches]
        whole = {"number": self.number, "action": self.action.name, "arguments": [*self.action.arguments]}
        return whole | {"expected": round(self.expected, 3), "outcomes": outcomes}

    def lines(self) -> Iterator[str]:
        """Yield the step, and a line for each outcome of several; a step that is followed by the next one says nothing of it."""
        then = {one.then for one in self.branches}
        following = "" if len(then) > 1 or then == {(self.number + 1,)} else f" -> {_words(self.branches[0].then)}"
        yield f"  {self.number:8d}.   {self.action}{following}"
        if len(then) > 1:
            yield from (f"                 {one.outcome} ({one.chance:.0%}) -> {_words(one.then)}" for one in self.branches)


def policy_steps(task: PolicyTask, entries: list[SettledPart]) -> list[Step]:
    """Return the steps that may be taken from the initial state on, each once, the nearest to the goal first at every branch.

    Of too many states not each is looked at: then what entries need says what may follow, which may be more than what does.
    """
    numbers: dict[int, int] = {}
    """The number of each entry, by its place among them."""
    follow: dict[int, list[dict[int, None]]] = {}
    # states of steps that nothing follows yet come first: then every step is followed, however many states there are
    fresh, waiting, seen = [task.initial], list[int](), {task.initial}

    def taken(at: int) -> PolicyAction:
        action = entries[at].action
        assert action is not None
        return action

    def fitting(state: int) -> int | None:
        return None if task.goal_in(state) else next((at for at, entry in enumerate(entries) if entry.need.holds(state)), None)

    def number(state: int, at: int | None) -> int:
        if task.goal_in(state):
            return GOAL
        return NO_WAY_OUT if at is None else numbers.setdefault(at, len(numbers) + 1)

    while (fresh or waiting) and len(seen) < _STATES:
        state = (fresh or waiting).pop()
        at = fitting(state)
        if number(state, at) > 0 and at is not None:
            action = taken(at)
            then = follow.setdefault(at, [{} for _ in action.outcomes])
            after = [outcome.after(state) for outcome in action.outcomes]
            places = {one: fitting(one) for one in after}
            distances = {one: 0.0 if place is None else entries[place].distance for one, place in places.items()}
            numbered = {one: number(one, places[one]) for one in sorted(places, key=distances.__getitem__)}
            for one, following in zip(after, then, strict=True):
                following[numbered[one]] = None
            for one in sorted(places, key=distances.__getitem__, reverse=True):
                if one not in seen:
                    seen.add(one)
                    (waiting if places[one] in follow else fresh).append(one)
    every = [*numbers] if fresh or waiting else []
    for at in every:
        action = taken(at)
        for outcome, following in zip(action.outcomes, follow.setdefault(at, [{} for _ in action.outcomes]), strict=True):
            known = outcome.known_after(entries[at].need)
            known = known._replace(false=known.false | task.excluded(known.true))
            for place, part in chain(((None, part) for part in task.goal), ((place, entry.need) for place, entry in enumerate(entries))):
                if known.joined(part).is_possible:
                    its = GOAL if place is None else numbers.setdefault(place, len(numbers) + 1)
                    following[its] = None
                    if place is not None and its > len(every):
                        every.append(place)
                if known.implies(part):
                    break
            else:
                following[NO_WAY_OUT] = None
    steps = []
    for at, its in numbers.items():
        action = taken(at)
        ways = zip(action.outcomes, follow[at], strict=True)
        steps.append(Step(its, action, entries[at].expected, tuple(Branch(way.name, way.chance, tuple(then)) for way, then in ways), at))
    return steps


def _words(then: tuple[int, ...]) -> str:
    return " or ".join({GOAL: "the goal", NO_WAY_OUT: "no way out"}.get(number, str(number)) for number in then) or "?"
