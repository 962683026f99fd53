"""Words for steps in pictures: what is written into a box, at an arrow, and above what a step holds."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from pnm.core.logic.expressions import Fluent, fluent_text
from pnm.core.machine.plan_graph import ActionCall, Flow, Step, every_step, flows


class StepWords(NamedTuple):
    """Words of a step."""

    name: str
    what: str
    """What it is about."""
    whole: str
    """Both, with all else that is known."""


def words_of(step: Step) -> StepWords:
    """Return the words of a step."""
    if isinstance(step, ActionCall):
        duration = "" if step.action.duration is None else f", {step.action.duration:g} s"
        what = str(step.action.operation) if step.action.operation is not None else ", ".join(step.action.arguments)
        return StepWords(step.action.name, what, f"{step}, planned at {step.planned:g} s{duration}")
    inner = [str(one) for flow in flows(step) for one in every_step(flow.steps)]
    return StepWords(type(step).__name__.lower(), f"{len(inner)} steps", "\n".join((str(step), *inner)))


def held(step: Step) -> Iterator[tuple[str, Flow]]:
    """Yield what a step holds, with words for it."""
    for one in step.held:
        if one.flow.steps or not isinstance(step, ActionCall):
            yield f"#{step.index} {one.when}", one.flow


def facts_of(protects: tuple[Fluent, ...], letters: int) -> str:
    """Return the first of the facts that an ordering protects, and how many more there are; nothing if there is none."""
    if not protects:
        return ""
    more = f" +{len(protects) - 1}" if len(protects) > 1 else ""
    return cut(fluent_text(protects[0]), letters - len(more)) + more


def numbers(others: Iterable[int]) -> str:
    """Return the numbers of steps."""
    return " ".join(f"#{other}" for other in sorted(others))


def cut(text: str, letters: int) -> str:
    """Return a text that has so many letters at most."""
    return text if len(text) <= letters else f"{text[: letters - 1]}…"
