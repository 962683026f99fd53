"""Pictures of a plan as SVG and as Graphviz text.

There is a box per step in the order of time, and an arrow where one waits for another, with the fact it waits for. In the SVG, a box
has the number of its step in `data-step`, and all looks are classes: a page that shows the picture gives it its own.

Arrows to another line of columns are written as numbers, `→ #7` behind the one and `#3 →` before the other; so is what the end of a
step waits for, below it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from typing import Final, NamedTuple

from pnm.core.logic.expressions import Fluent, fluent_text
from pnm.core.machine.plan_graph import ActionCall, Flow, Moment, PlanGraph, Step, WaitUntil, every_step, flows, in_order
from pnm.core.pictures.export import quoted
from pnm.core.pictures.xml_text import COLOUR, cut, picture, short, xml
from pnm.errors import counted

# --- where each step stands -----------------------------------------------------------------
#
# In the order of time, in rows that fit on paper.
# Steps stand in columns: a step is one column behind the last of those that its start waits for. They stand in lanes, from top to
# bottom: a step follows one that it waits for in its lane, with as many arguments in common as possible, so that what one robot does is
# a line. After so many columns as fit on paper the picture goes on below, as a line of text does.


COLUMNS: Final = 5
"""Columns beside each other, where steps are boxes."""


@dataclass(frozen=True, slots=True)
class Cell:
    """The position of a step."""

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
    def size(self) -> tuple[int, int, int]:
        """The numbers of rows, of lines of columns, and of columns beside each other."""
        positions = [(cell.row, cell.line, cell.column) for cell in self.cells.values()]
        rows, lines, columns = map(max, zip((-1, -1, -1), *positions, strict=True))
        return 1 + rows, 1 + lines, 1 + columns


def laid_out(flow: Flow, across: int = COLUMNS) -> PlanLayout:
    """Return the layout of steps, `across` columns beside each other at most, and of the orderings that do not follow from others."""
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


# --- the words of a step --------------------------------------------------------------------


class StepWords(NamedTuple):
    """Words of a step."""

    name: str
    what: str
    """Its subject."""
    whole: str
    """Both, with all else that is known."""


def words_of(step: Step) -> StepWords:
    """Return the words of a step."""
    if isinstance(step, ActionCall):
        duration = "" if step.action.duration is None else f", {step.action.duration:g} s"
        what = str(step.action.operation) if step.action.operation is not None else ", ".join(step.action.arguments)
        return StepWords(step.action.name, what, f"{step}, planned at {step.planned:g} s{duration}")
    if isinstance(step, WaitUntil):
        return StepWords("wait until", str(step.condition), f"{step}, {step.limit:g} s at most")
    inner = [str(one) for flow in flows(step) for one in every_step(flow.steps)]
    return StepWords(type(step).__name__.lower(), f"{len(inner)} steps", "\n".join((str(step), *inner)))


def held(step: Step) -> Iterator[tuple[str, Flow]]:
    """Yield the contents of a step, with words for them."""
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


# --- as SVG ---------------------------------------------------------------------------------


_BOX: Final = (196, 46)
"""Width and height of a box, in pixels."""
_PITCH: Final = (312, 74)
"""From one column to the next, and from one row to the next."""
_MARGIN: Final = (64, 24)
_BETWEEN: Final = 26
"""More room between lines of columns."""
_LETTERS: Final = 27
"""Letters of a text in a box; longer ones are cut off, and are whole when they are pointed at."""
_FACT: Final = 16
"""Letters of a fact at an arrow."""
_FACTS: Final = 4
"""Facts above each other where arrows end."""
_NUMBERS: Final = _FACT - 4
"""Letters of the numbers of other steps."""
_STYLE: Final = (
    "text{{font:12px sans-serif;fill:{text}}}.name{{font-weight:bold}}"
    ".fact{{fill:{run};paint-order:stroke;stroke:{surface};stroke-width:3px}}.far{{fill:{dim}}}rect{{fill:{surface};stroke:{edge}}}path{{fill:none;stroke:{edge}}}.rule{{stroke:{line}}}"
).format_map(COLOUR)


def plan_svg(plan: PlanGraph, title: str = "", *, style: str = _STYLE) -> str:
    """Return the picture of a plan, and below it that of what its steps hold; the same plan gives the same text.

    The style is CSS; it is empty where the picture is part of a page that has looks for it.
    """
    sections = [("", laid_out(plan.flow)), *((name, laid_out(flow)) for step in plan.every_step for name, flow in held(step))]
    columns = max(1, *(layout.size[2] for _, layout in sections))
    width = 2 * _MARGIN[0] + (columns - 1) * _PITCH[0] + _BOX[0]
    height, drawn = 0, []
    for name, layout in sections:
        drawn.append(f'<g transform="translate(0 {height})">')
        if name:
            drawn.append(f'<path class="rule" d="M0 0H{width}"/><text x="8" y="16">{xml(name)}</text>')
        lines = {index: cell.line for index, cell in layout.cells.items()}
        arrows = [arrow for arrow in layout.arrows if not arrow.is_for_the_end and lines[arrow.before] == lines[arrow.after]]
        drawn += (*_rules(layout, width), *_paths(layout, arrows), *_facts(layout, arrows), *_numbered_arrows(layout))
        drawn += (*chain.from_iterable(map(_box, layout.cells.values())), "</g>")
        rows, lines_of_columns, _ = layout.size
        height += 2 * _MARGIN[1] + max(rows - 1, 0) * _PITCH[1] + _BOX[1] + max(lines_of_columns - 1, 0) * _BETWEEN
    return picture("plan", title or f"a plan of {counted(len(plan.calls), 'call')}", style, width, height, drawn)


def _corner(cell: Cell) -> tuple[int, int]:
    """Return where the upper left corner of the box of a cell is."""
    x = _MARGIN[0] + cell.column * _PITCH[0]
    return x, _MARGIN[1] + cell.row * _PITCH[1] + cell.line * _BETWEEN


def _rules(layout: PlanLayout, width: int) -> Iterator[str]:
    """Yield the separators of lines of columns."""
    tops: dict[int, int] = {}
    for cell in layout.cells.values():
        tops[cell.line] = min(tops.get(cell.line, _corner(cell)[1]), _corner(cell)[1])
    for line, top in tops.items():
        if line:
            y = top - (_PITCH[1] - _BOX[1] + _BETWEEN) // 2
            yield f'<path class="rule" d="M0 {y}H{width}"/>'


def _box(cell: Cell) -> Iterator[str]:
    (x, y), (name, what, whole) = _corner(cell), words_of(cell.step)
    yield f'<g data-step="{cell.step.index}"><title>{xml(whole)}</title>'
    yield f'<rect x="{x}" y="{y}" width="{_BOX[0]}" height="{_BOX[1]}" rx="6"/>'
    yield f'<text class="name" x="{x + 8}" y="{y + 19}">{xml(cut(name, _LETTERS - 8))}</text>'
    yield f'<text class="far" x="{x + _BOX[0] - 6}" y="{y + 19}" text-anchor="end">#{cell.step.index}</text>'
    yield f'<text x="{x + 8}" y="{y + 36}">{xml(cut(what, _LETTERS))}</text></g>'


def _paths(layout: PlanLayout, arrows: Iterable[Arrow]) -> Iterator[str]:
    """Yield arrows between boxes of one line of columns; where other boxes are in the way, they go between two rows."""
    occupied = {(cell.row, cell.column) for cell in layout.cells.values()}
    detours = Counter[int]()
    for arrow in arrows:
        before, after = layout.cells[arrow.before], layout.cells[arrow.after]
        (x1, y1), (x2, y2) = _corner(before), _corner(after)
        (from_x, from_y), (to_x, to_y) = (x1 + _BOX[0], y1 + _BOX[1] // 2), (x2, y2 + _BOX[1] // 2)
        between = range(before.column + 1, after.column)
        if between and (before.row != after.row or any((after.row, column) in occupied for column in between)):
            nearer = 3 * (detours[after.row] % 3)
            channel = y2 - 12 + nearer if before.row <= after.row else y2 + _BOX[1] + 24 - nearer  # `ends after` is nearer still
            detours[after.row] += 1
            way = f"C{from_x + 40} {from_y} {from_x + 20} {channel} {from_x + 58} {channel}H{to_x - 58}C{to_x - 20} {channel} {to_x - 40}"
        else:
            way = f"C{from_x + 50} {from_y} {to_x - 50}"
        facts = " ".join(map(fluent_text, arrow.protects))
        yield f"<g><title>{xml(f'#{arrow.before} before #{arrow.after} {facts}'.strip())}</title>"
        yield f'<path d="M{from_x} {from_y}{way} {to_y} {to_x} {to_y}" marker-end="url(#tip)"/></g>'


def _facts(layout: PlanLayout, arrows: Iterable[Arrow]) -> Iterator[str]:
    """Yield the facts of arrows, above each other where these end; the last one there is room for counts the others."""
    coming: dict[int, list[Arrow]] = {}
    for arrow in arrows:
        if arrow.protects:
            coming.setdefault(arrow.after, []).append(arrow)
    for index, together in coming.items():
        x, y = _corner(layout.cells[index])
        for number, arrow in enumerate(together[:_FACTS]):
            others = [fact for other in together[_FACTS - 1 :] for fact in other.protects] if number == _FACTS - 1 else list(arrow.protects)
            at = y + _BOX[1] // 2 - 5 - 13 * number
            text, whole = facts_of(tuple(others), _FACT), " ".join(map(fluent_text, others))
            yield f'<text class="fact" x="{x - 8}" y="{at}" text-anchor="end">{xml(text)}<title>{xml(whole)}</title></text>'


def _numbered_arrows(layout: PlanLayout) -> Iterator[str]:
    """Yield the parts written as numbers: arrows to other lines of columns, at both ends, and what the end of a step waits for."""
    leaving, coming, ending = (dict[int, list[int]]() for _ in range(3))
    for arrow in layout.arrows:
        if arrow.is_for_the_end:
            ending.setdefault(arrow.after, []).append(arrow.before)
        elif layout.cells[arrow.before].line != layout.cells[arrow.after].line:
            leaving.setdefault(arrow.before, []).append(arrow.after)
            coming.setdefault(arrow.after, []).append(arrow.before)
    for index, cell in layout.cells.items():
        x, y = _corner(cell)
        if index in leaving:
            yield f'<text class="far" x="{x + _BOX[0] + 4}" y="{y + _BOX[1] - 4}">→ {short(numbers(leaving[index]), _NUMBERS)}</text>'
        if index in coming:
            others = short(numbers(coming[index]), _NUMBERS)
            yield f'<text class="far" x="{x - 4}" y="{y + _BOX[1] - 4}" text-anchor="end">{others} →</text>'
        if index in ending:
            yield f'<text class="far" x="{x + 8}" y="{y + _BOX[1] + 12}">ends after {short(numbers(ending[index]), _NUMBERS)}</text>'


# --- as Graphviz text -----------------------------------------------------------------------
#
# What a step holds stands in a frame, to which a dotted arrow leads.


_DOT_LETTERS: Final = 40


def plan_dot(plan: PlanGraph) -> str:
    """Return the picture of a plan; the same plan gives the same text."""
    look = 'node [shape=box, style=rounded, fontname="sans-serif", fontsize=11]; edge [fontname="sans-serif", fontsize=9]'
    lines = ["digraph plan {", f"  rankdir=LR; {look};", *_steps(plan.flow, "  ")]
    for step in plan.every_step:
        for number, (title, flow) in enumerate(held(step)):
            lines.append(
                f'  subgraph cluster_{step.index}_{number} {{ label={quoted(title)}; color=gray; fontname="sans-serif"; fontsize=10;'
            )
            lines += (*_steps(flow, "    "), "  }")
            later = {arrow.after for arrow in laid_out(flow).arrows if not arrow.is_for_the_end}
            lines += (f"  {step.index} -> {first.index} [style=dotted];" for first in flow.steps if first.index not in later)
    return "\n".join((*lines, "}", ""))


def _steps(flow: Flow, indent: str) -> Iterator[str]:
    """Yield steps in the order of time, which is the order in which Graphviz places them, and their arrows."""
    layout = laid_out(flow)
    for cell in sorted(layout.cells.values(), key=lambda cell: (cell.line, cell.column, cell.row)):
        words = words_of(cell.step)
        label = f"{words.name}  #{cell.step.index}\n{cut(words.what, _DOT_LETTERS)}"
        yield f"{indent}{cell.step.index} [label={quoted(label)}, tooltip={quoted(words.whole)}];"
    for arrow in layout.arrows:
        look = ", style=dashed, constraint=false" if arrow.is_for_the_end else ""
        label = (
            f"ends after {facts_of(arrow.protects, _DOT_LETTERS)}".rstrip()
            if arrow.is_for_the_end
            else facts_of(arrow.protects, _DOT_LETTERS)
        )
        yield f"{indent}{arrow.before} -> {arrow.after} [label={quoted(label)}{look}];"
