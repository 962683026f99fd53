"""Layout of steps as a picture: where each step stands, in the order of time, in rows that fit on paper.

Steps stand in columns: a step is one column behind the last of those that its start waits for. They stand in lanes, from top to
bottom: a step follows one that it waits for in its lane, with as many arguments in common as possible, so that what one robot does is
a line. After so many columns as fit on paper the picture goes on below, as a line of text does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from pnm.core.logic.expressions import Fluent
from pnm.core.machine.plan_graph import ActionCall, Flow, Moment, Step, in_order

COLUMNS: Final = 5
"""Columns beside each other, where steps are boxes."""


@dataclass(frozen=True, slots=True)
class Cell:
    """Where a step stands."""

    step: Step
    line: int
    """Which line of columns it is in, from 0."""
    column: int
    """From 0, within the line, in the order of time."""
    row: int
    """From 0, downwards; those of a line of columns follow those of the lines above."""


@dataclass(frozen=True, slots=True)
class Arrow:
    """Steps one of which waits for the other, by their numbers."""

    before: int
    after: int
    protects: tuple[Fluent, ...]
    """The facts for whose sake it does."""
    is_for_the_end: bool
    """Whether the end of the step waits, and not its start."""


@dataclass(frozen=True, slots=True)
class PlanLayout:
    """Cells and arrows of a flow."""

    cells: Mapping[int, Cell]
    """By the number of the step."""
    arrows: tuple[Arrow, ...]

    @property
    def rows(self) -> int:
        """How many rows there are."""
        return 1 + max((cell.row for cell in self.cells.values()), default=-1)

    @property
    def lines(self) -> int:
        """How many lines of columns there are."""
        return 1 + max((cell.line for cell in self.cells.values()), default=-1)

    @property
    def columns(self) -> int:
        """How many columns are beside each other at most."""
        return 1 + max((cell.column for cell in self.cells.values()), default=-1)


def laid_out(flow: Flow, across: int = COLUMNS) -> PlanLayout:
    """Return the layout of the steps of a flow, without what they hold, and of the orderings that do not follow from others.

    Args:
        flow: the steps.
        across: columns beside each other, at most.
    """
    steps = {step.index: step for step in flow.steps}
    order = [event.call for event in in_order(flow) if event.moment is Moment.START]
    waits_for: dict[int, set[int]] = {index: set() for index in steps}
    for ordering in flow.orderings:
        if ordering.after.moment is Moment.START and ordering.after.call != ordering.before.call:
            waits_for[ordering.after.call].add(ordering.before.call)
    columns: dict[int, int] = {}
    for index in order:
        columns[index] = 1 + max((columns[before] for before in waits_for[index]), default=-1)
    lanes = _lanes(sorted(order, key=columns.__getitem__), columns, waits_for, steps)
    return PlanLayout(_cells(columns, lanes, steps, across), _arrows(flow, order, waits_for))


def _lanes(order: list[int], columns: Mapping[int, int], waits_for: Mapping[int, set[int]], steps: Mapping[int, Step]) -> dict[int, int]:
    """Return the lane of each step: no two steps of a column have the same."""
    lanes: dict[int, int] = {}
    last: list[int] = []
    """By lane, the step that stands in it last."""
    for index in order:
        mine = _arguments(steps[index])
        free = [lane for lane, there in enumerate(last) if columns[there] < columns[index]]
        likeness = {lane: (last[lane] in waits_for[index], len(mine & _arguments(steps[last[lane]])), -lane) for lane in free}
        liked = [lane for lane in free if likeness[lane][0] or likeness[lane][1]]
        lane = max(liked, key=likeness.__getitem__) if liked else len(last)
        last[lane : lane + 1] = [index]
        lanes[index] = lane
    return lanes


def _arguments(step: Step) -> frozenset[str]:
    return frozenset(step.action.arguments) if isinstance(step, ActionCall) else frozenset()


def _cells(columns: Mapping[int, int], lanes: Mapping[int, int], steps: Mapping[int, Step], across: int) -> dict[int, Cell]:
    """Return the cells: of the lanes, only those that a line of columns uses are rows of it."""
    used: dict[int, set[int]] = {}
    for index, column in columns.items():
        used.setdefault(column // across, set()).add(lanes[index])
    rows: dict[tuple[int, int], int] = {}
    for line in sorted(used):
        for lane in sorted(used[line]):
            rows[line, lane] = len(rows)
    cells: dict[int, Cell] = {}
    for index, column in columns.items():
        line, place = divmod(column, across)
        cells[index] = Cell(steps[index], line, place, rows[line, lanes[index]])
    return cells


def _arrows(flow: Flow, order: list[int], waits_for: Mapping[int, set[int]]) -> tuple[Arrow, ...]:
    """Return an arrow for each pair of steps one of which waits for the other, unless it waits for a third one that does."""
    behind: dict[int, set[int]] = {}
    """For every step, all that it waits for, directly or not."""
    needed: set[tuple[int, int]] = set()
    for index in order:
        before = waits_for[index]
        indirect = set[int]().union(*(behind[other] for other in before))
        behind[index] = before | indirect
        needed |= {(other, index) for other in before - indirect}
    found: dict[tuple[int, int, bool], dict[Fluent, None]] = {}
    for ordering in flow.orderings:
        before_call, after_call, at_end = ordering.before.call, ordering.after.call, ordering.after.moment is Moment.END
        if (at_end or (before_call, after_call) in needed) and before_call != after_call:
            found.setdefault((before_call, after_call, at_end), {}).update(dict.fromkeys(ordering.protects))
    return tuple(Arrow(before, after, tuple(facts), at_end) for (before, after, at_end), facts in found.items())
