"""Picture of a plan as SVG: a box per step in the order of time, an arrow where one waits for another, with the fact it waits for.

A box has the number of its step in `data-step`, and all looks are classes: a page that shows the picture gives it its own.

Arrows to another line of columns are written as numbers, `→ #7` behind the one and `#3 →` before the other; so is what the end of a
step waits for, below it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Final

from pnm.core.logic.expressions import fluent_text
from pnm.core.machine.plan_graph import PlanGraph
from pnm.core.pictures.plan_layout import Arrow, Cell, PlanLayout, laid_out
from pnm.core.pictures.step_words import cut, facts_of, held, numbers, words_of
from pnm.core.pictures.svg import picture, xml
from pnm.errors import counted

_BOX: Final = (196, 46)
"""Width and height of a box, in pixels."""
_PITCH: Final = (312, 74)
"""From one column to the next, and from one row to the next."""
_MARGIN: Final = (64, 24)
_BETWEEN: Final = 26
"""More room between lines of columns."""
_LETTERS: Final = 30
"""Letters of a text in a box; longer ones are cut off, and are whole when they are pointed at."""
_FACT: Final = 19
"""Letters of a fact at an arrow."""
_FACTS: Final = 4
"""Facts above each other where arrows end."""
_NUMBERS: Final = _FACT - 4
"""Letters of the numbers of other steps."""
_STYLE: Final = (
    "text{font:11px sans-serif;fill:#263238}.name{font-weight:bold;font-size:12px}.fact{font-size:9.5px;fill:#1565c0;"
    "paint-order:stroke;stroke:#fff;stroke-width:3px}.far{font-size:9.5px;fill:#546e7a}rect{fill:#eceff1;stroke:#546e7a}"
    "path{fill:none;stroke:#78909c}.rule{stroke:#cfd8dc}"
)


def plan_svg(plan: PlanGraph, title: str = "", *, style: str = _STYLE) -> str:
    """Return the picture of a plan, and below it that of what its steps hold; the same plan gives the same text.

    Args:
        plan: the plan.
        title: what the picture is called.
        style: its looks, as CSS; empty where it is part of a page that has looks for it.
    """
    sections = [("", laid_out(plan.flow)), *((name, laid_out(flow)) for step in plan.every_step for name, flow in held(step))]
    columns = max(1, *(layout.columns for _, layout in sections))
    width = 2 * _MARGIN[0] + (columns - 1) * _PITCH[0] + _BOX[0]
    height, drawn = 0, []
    for name, layout in sections:
        drawn.append(f'<g transform="translate(0 {height})">')
        if name:
            drawn.append(f'<path class="rule" d="M0 0H{width}"/><text x="8" y="16">{xml(name)}</text>')
        drawn += (*_section(layout, width), "</g>")
        height += 2 * _MARGIN[1] + max(layout.rows - 1, 0) * _PITCH[1] + _BOX[1] + max(layout.lines - 1, 0) * _BETWEEN
    return picture("plan", title or f"a plan of {counted(len(plan.calls), 'call')}", style, width, height, drawn)


def _section(layout: PlanLayout, width: int) -> Iterator[str]:
    yield from _rules(layout, width)
    cells = layout.cells
    drawn = [arrow for arrow in layout.arrows if not arrow.is_for_the_end and cells[arrow.before].line == cells[arrow.after].line]
    yield from _paths(layout, drawn)
    yield from _facts(layout, drawn)
    yield from _numbered_arrows(layout)
    for cell in layout.cells.values():
        yield from _box(cell)


def _corner(cell: Cell) -> tuple[int, int]:
    """Return where the upper left corner of the box of a cell is."""
    x = _MARGIN[0] + cell.column * _PITCH[0]
    return x, _MARGIN[1] + cell.row * _PITCH[1] + cell.line * _BETWEEN


def _rules(layout: PlanLayout, width: int) -> Iterator[str]:
    """Yield what separates lines of columns."""
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
            at = y + _BOX[1] // 2 - 5 - 11 * number
            yield f'<text class="fact" x="{x - 8}" y="{at}" text-anchor="end">{xml(facts_of(tuple(others), _FACT))}</text>'


def _numbered_arrows(layout: PlanLayout) -> Iterator[str]:
    """Yield what is written as numbers: arrows to other lines of columns, at both ends, and what the end of a step waits for."""
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
            yield f'<text class="far" x="{x + _BOX[0] + 4}" y="{y + _BOX[1] - 4}">→ {cut(numbers(leaving[index]), _NUMBERS)}</text>'
        if index in coming:
            yield f'<text class="far" x="{x - 4}" y="{y + _BOX[1] - 4}" text-anchor="end">{cut(numbers(coming[index]), _NUMBERS)} →</text>'
        if index in ending:
            yield f'<text class="far" x="{x + 8}" y="{y + _BOX[1] + 12}">ends after {cut(numbers(ending[index]), _NUMBERS)}</text>'
