"""Transitions that can never fire, and why: whatever servers and the world answer, another one goes first or nothing leads to them."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

from pnm.core.machine.machine import Accepts, Ends
from pnm.core.machine.requests import BEFORE_ACCEPTANCE
from pnm.core.machine.verification.explore import Exploration
from pnm.core.machine.verification.part import Inside, Part, Step


class NeverFires(NamedTuple):
    """A transition that can never fire, and the reason."""

    transition: str
    reason: str

    def __str__(self) -> str:
        return f"{self.transition}: {self.reason}"


def never_fire(part: Part, explored: Exploration) -> list[NeverFires]:
    """Return the transitions of the part that never fire."""
    if not explored.unfired:
        return []
    unfired = {part.steps[number].name for number in explored.unfired}
    marked = {place for together in part.supplies for place in together}.union(part.initial)
    marked.update(place for step in part.steps if step.name not in unfired for place in step.outputs)
    steps = (part.steps[number] for number in explored.unfired)
    return [NeverFires(step.name, _reason(part, step, marked)) for step in steps if not isinstance(step.guard, Inside)]


def _reason(part: Part, step: Step, marked: Collection[str]) -> str:
    if unmarked := [place for place in step.inputs if place not in marked]:
        return f"nothing marks {unmarked[0]}"
    if isinstance(step.guard, Ends) and step.guard.kinds.isdisjoint(BEFORE_ACCEPTANCE):
        for other in part.steps:
            if isinstance(other.guard, Accepts) and other.inputs.keys() == step.inputs.keys():
                return f"such an end implies that the request was accepted, and {other.name} goes first"
    before = part.steps[: part.steps.index(step)]
    earlier = [other.name for other in before if not other.inputs.keys().isdisjoint(step.inputs)]
    return f"where it could, one before it goes first ({', '.join(earlier)})" if earlier else "its places are never marked together"
