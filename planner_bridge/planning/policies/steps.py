"""The steps of a policy: which entries follow which, by the outcomes of their actions, as text and as a picture for Graphviz."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Final, NamedTuple

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

    def lines(self) -> Iterator[str]:
        """Yield the step, and a line for each outcome of several; a step that is followed by the next one says nothing of it."""
        then = {one.then for one in self.branches}
        following = "" if len(then) > 1 or then == {(self.number + 1,)} else f" -> {_words(self.branches[0].then)}"
        yield f"  {self.number:8d}.   {self.action}{following}"
        if len(then) > 1:
            yield from (f"                 {one.outcome} ({one.chance:.0%}) -> {_words(one.then)}" for one in self.branches)


def policy_steps(task: PolicyTask, entries: list[SettledPart]) -> list[Step]:
    """Return the steps that may be taken from the initial state on, each once, the nearest to the goal first at every branch."""
    numbers: dict[int, int] = {}
    """The number of each entry, by its place among them."""
    follow: dict[int, list[dict[int, None]]] = {}
    # states of steps that nothing follows yet come first: then every step is followed, however many states there are
    fresh, waiting, seen = [task.initial], list[int](), {task.initial}

    def fitting(state: int) -> int | None:
        return next((at for at, entry in enumerate(entries) if entry.need.holds(state)), None)

    def number(state: int, at: int | None) -> int:
        if task.goal_in(state):
            return GOAL
        return NO_WAY_OUT if at is None else numbers.setdefault(at, len(numbers) + 1)

    while (fresh or waiting) and len(seen) < _STATES:
        state = (fresh or waiting).pop()
        at = fitting(state)
        if number(state, at) > 0 and at is not None:
            action = entries[at].action
            assert action is not None
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
    steps = []
    for at, its in numbers.items():
        action = entries[at].action
        assert action is not None
        ways = zip(action.outcomes, follow.get(at, [{} for _ in action.outcomes]), strict=True)
        steps.append(Step(its, action, entries[at].expected, tuple(Branch(way.name, way.chance, tuple(then)) for way, then in ways)))
    return steps


def _words(then: tuple[int, ...]) -> str:
    return " or ".join({GOAL: "the goal", NO_WAY_OUT: "no way out"}.get(number, str(number)) for number in then) or "?"


def steps_dot(steps: list[Step]) -> str:
    """Return the picture of a policy for Graphviz: a box for every step, an arrow for every outcome."""
    lines = ["digraph policy {", '  rankdir=LR; node [shape=box, style=rounded, fontname="sans-serif", fontsize=11];']
    lines += ['  edge [fontname="sans-serif", fontsize=9]; 0 [label="goal", shape=doublecircle]; "-1" [label="no way out", color=red];']
    for step in steps:
        lines.append(f"  {step.number} [label={json.dumps(f'{step.action}  #{step.number}', ensure_ascii=False)}];")
        several = len(step.branches) > 1
        for one in step.branches:
            label = json.dumps(f"{one.outcome} {one.chance:.0%}" if several else "", ensure_ascii=False)
            lines += (f'  {step.number} -> "{number}" [label={label}];' for number in one.then)
    return "\n".join((*lines, "}", ""))
