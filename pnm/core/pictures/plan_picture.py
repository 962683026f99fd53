"""Picture of a plan as SVG: a box per step in the order of time, an arrow where one waits for another, with the fact it waits for.

A box has the number of its step in `data-step`, and all looks are classes: a page that shows the picture gives it its own.

Arrows to another line of columns are written as numbers, `→ #7` behind the one and `#3 →` before the other; so is what the end of a
step waits for, below it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from html import escape
from typing import Final, assert_never

from pnm.core.logic.expressions import fluent_text
from pnm.core.machine.plan_graph import ActionCall, Choice, Flow, Junction, Loop, PlanGraph, Step, every_step, flows
from pnm.core.pictures.plan_layout import COLUMNS, Arrow, Cell, PlanLayout, laid_out

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
_STYLE: Final = (
    "text{font:11px sans-serif;fill:#263238}.name{font-weight:bold;font-size:12px}.fact{font-size:9.5px;fill:#1565c0;"
    "paint-order:stroke;stroke:#fff;stroke-width:3px}.far{font-size:9.5px;fill:#546e7a}rect{fill:#eceff1;stroke:#546e7a}"
    "path{fill:none;stroke:#78909c}.rule{stroke:#cfd8dc}.tip{fill:#78909c;stroke:none}.paper{fill:#fff;stroke:none}"
)


def plan_svg(plan: PlanGraph, title: str = "", *, style: str = _STYLE) -> str:
    """Return the picture of a plan, and below it that of what its steps hold; the same plan gives the same text.

    Args:
        plan: the plan.
        title: what the picture is called.
        style: its looks, as CSS; empty where it is part of a page that has looks for it.
    """
    sections = [("", laid_out(plan.flow)), *((name, laid_out(flow)) for step in plan.every_step for name, flow in _held(step))]
    columns = max(1, *(layout.columns for _, layout in sections))
    width = 2 * _MARGIN[0] + (columns - 1) * _PITCH[0] + _BOX[0]
    height, drawn = 0, []
    for name, layout in sections:
        drawn.append(f'<g transform="translate(0 {height})">')
        if name:
            drawn.append(f'<path class="rule" d="M0 0H{width}"/><text x="8" y="16">{escape(name)}</text>')
        drawn += (*_section(layout, width), "</g>")
        height += 2 * _MARGIN[1] + max(layout.rows - 1, 0) * _PITCH[1] + _BOX[1] + max(layout.lines - 1, 0) * _BETWEEN
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" height="{height}" role="img">',
        f"<title>{escape(title or f'a plan of {len(plan.calls)} calls')}</title>{style and f'<style>{style}</style>'}",
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path class="tip" d="M0 0L8 4L0 8z"/></marker></defs>',
        f'<rect class="paper" width="{width}" height="{height}"/>',
        *drawn,
        "</svg>",
    ]
    return "\n".join((*parts, ""))


def _held(step: Step) -> Iterator[tuple[str, Flow]]:
    """Yield what a step holds, with words for it."""
    match step:
        case Loop(condition=condition, body=body):
            yield f"#{step.index} is repeated while {condition}, {step.limit} times at most", body
        case Choice(condition=condition, then=then, otherwise=otherwise):
            yield f"#{step.index} if {condition}", then
            yield f"#{step.index} otherwise", otherwise
        case ActionCall():
            for recovery in step.recoveries:
                if recovery.chain.steps:
                    yield f"#{step.index} after {', '.join(sorted(recovery.causes))}; then {recovery.then.value}", recovery.chain
        case Junction():
            pass
        case _:
            assert_never(step)


def _section(layout: PlanLayout, width: int) -> Iterator[str]:
    yield from _rules(layout, width)
    labels = Counter[int]()
    for arrow in layout.arrows:
        if not arrow.is_for_the_end and layout.cells[arrow.before].line == layout.cells[arrow.after].line:
            yield from _arrow(layout, arrow, labels[arrow.after])
            labels[arrow.after] += bool(arrow.protects)
    yield from _numbered_arrows(layout)
    for cell in layout.cells.values():
        yield from _box(cell)


def _corner(cell: Cell) -> tuple[int, int]:
    """Return where the upper left corner of the box of a cell is."""
    x = _MARGIN[0] + cell.column % COLUMNS * _PITCH[0]
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
    (x, y), (name, what, whole) = _corner(cell), _words(cell.step)
    yield f'<g data-step="{cell.step.index}"><title>{escape(whole)}</title>'
    yield f'<rect x="{x}" y="{y}" width="{_BOX[0]}" height="{_BOX[1]}" rx="6"/>'
    yield f'<text class="name" x="{x + 8}" y="{y + 19}">{escape(_cut(name, _LETTERS - 8))}</text>'
    yield f'<text class="far" x="{x + _BOX[0] - 6}" y="{y + 19}" text-anchor="end">#{cell.step.index}</text>'
    yield f'<text x="{x + 8}" y="{y + 36}">{escape(_cut(what, _LETTERS))}</text></g>'


def _words(step: Step) -> tuple[str, str, str]:
    """Return the name of a step, what it is about, and both with all else that is known."""
    if isinstance(step, ActionCall):
        duration = "" if step.action.duration is None else f", {step.action.duration:g} s"
        what = str(step.action.operation) if step.action.operation is not None else ", ".join(step.action.arguments)
        return step.action.name, what, f"{step}, planned at {step.planned:g} s{duration}"
    inner = [str(one) for flow in flows(step) for one in every_step(flow.steps)]
    return type(step).__name__.lower(), f"{len(inner)} steps", "\n".join((str(step), *inner))


def _arrow(layout: PlanLayout, arrow: Arrow, labels: int) -> Iterator[str]:
    """Yield an arrow between boxes of one line of columns, above as many labels as other arrows have there."""
    (x1, y1), (x2, y2) = _corner(layout.cells[arrow.before]), _corner(layout.cells[arrow.after])
    (from_x, from_y), (to_x, to_y) = (x1 + _BOX[0], y1 + _BOX[1] // 2), (x2, y2 + _BOX[1] // 2)
    facts = " ".join(map(fluent_text, arrow.protects))
    yield f"<g><title>{escape(f'#{arrow.before} before #{arrow.after} {facts}'.strip())}</title>"
    yield f'<path d="M{from_x} {from_y}C{from_x + 50} {from_y} {to_x - 50} {to_y} {to_x} {to_y}" marker-end="url(#tip)"/>'
    if arrow.protects:
        more = f" +{len(arrow.protects) - 1}" if len(arrow.protects) > 1 else ""
        shown = _cut(fluent_text(arrow.protects[0]), _FACT - len(more)) + more
        yield f'<text class="fact" x="{to_x - 8}" y="{to_y - 5 - 11 * labels}" text-anchor="end">{escape(shown)}</text>'
    yield "</g>"


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
            yield f'<text class="far" x="{x + _BOX[0] + 4}" y="{y + _BOX[1] - 4}">→ {_numbers(leaving[index])}</text>'
        if index in coming:
            yield f'<text class="far" x="{x - 4}" y="{y + _BOX[1] - 4}" text-anchor="end">{_numbers(coming[index])} →</text>'
        if index in ending:
            yield f'<text class="far" x="{x + 8}" y="{y + _BOX[1] + 12}">ends after {_numbers(ending[index])}</text>'


def _numbers(others: Iterable[int]) -> str:
    return _cut(" ".join(f"#{other}" for other in sorted(others)), _FACT - 4)


def _cut(text: str, letters: int) -> str:
    return text if len(text) <= letters else f"{text[: letters - 1]}…"
