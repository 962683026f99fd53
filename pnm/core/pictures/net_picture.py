"""Picture of a whole machine as SVG: a box for each step, where the picture of its plan has it, with its places and transitions.

Places are circles with their tokens, each with a line downwards; a transition is a bar, and its arcs lead across from the lines of the
places it takes from, which have a dot there, to those of the places it gives to, which have a tip. What it asks is its title.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from pnm.core.machine.machine import PetriNetMachine, Rule
from pnm.core.machine.plan_graph import Flow
from pnm.core.pictures.export import COLOURS, guard_data
from pnm.core.pictures.net_layout import GAP, ROW, STACK, TITLE, BlockKey, BlockLayout, Column, Crossing, Frame, Standing, block_layouts
from pnm.core.pictures.plan_layout import laid_out
from pnm.core.pictures.step_words import cut, facts_of, held, numbers
from pnm.core.pictures.svg import picture, xml
from pnm.errors import counted

_ACROSS: Final = 2
"""Blocks beside each other."""
_MARGIN: Final = 24
_BETWEEN: Final = (56, 26)
"""Between blocks, to the right and downwards."""
_RADIUS: Final = 8
_NAME: Final = 12
"""Letters of a line of the name of a place."""
_LABEL: Final = 19
"""Letters beside a place that came in."""
_STYLE: Final = (
    "text{font:9.5px sans-serif;fill:#263238}.name{font-weight:bold;font-size:12px}.far{font-size:9px;fill:#546e7a}"
    ".fact{font-size:9px;fill:#1565c0}.event{font-size:8.5px;paint-order:stroke;stroke:#fff;stroke-width:2px}.box{fill:#fafafa;stroke:#90a4ae}"
    ".bar,.dot{fill:#263238}circle{fill:#fff;stroke-width:1.5px}path{fill:none;stroke:#78909c}.line{stroke:#cfd8dc}"
    ".rule{stroke:#cfd8dc}"
)


@dataclass(frozen=True, slots=True)
class _Placed:
    """A block and where its upper left corner is."""

    layout: BlockLayout
    x: float
    y: float
    group: int
    """Blocks beside each other are of one group."""
    column: int


def net_svg(machine: PetriNetMachine, title: str = "") -> str:
    """Return the picture of a machine; the same machine gives the same text."""
    layouts = block_layouts(machine)
    sections = [("", machine.plan.flow), *((name, flow) for step in machine.plan.every_step for name, flow in held(step))]
    blocks: dict[BlockKey, _Placed] = {}
    titles: list[tuple[str, float]] = []
    blocks[Frame.BEGIN] = _Placed(layouts[Frame.BEGIN], _MARGIN, _MARGIN, -1, 0)
    y = _MARGIN + layouts[Frame.BEGIN].height + _BETWEEN[1]
    for name, flow in sections:
        if name:
            titles.append((name, y))
            y += TITLE
        for placed in _section(flow, layouts, y, len(blocks)):
            blocks[placed.layout.key] = placed
        y = max(placed.y + placed.layout.height for placed in blocks.values()) + _BETWEEN[1]
    blocks[Frame.END] = _Placed(layouts[Frame.END], _MARGIN, y, -2, 0)
    width = max(placed.x + placed.layout.width for placed in blocks.values()) + _MARGIN
    height = y + layouts[Frame.END].height + _MARGIN
    stands = {
        place: (placed, placed.x + column.x, placed.y + _head(placed.layout, column) + STACK * number)
        for placed in blocks.values()
        for column in placed.layout.columns
        if column.standing in (Standing.CAME_IN, Standing.OWN)
        for number, place in enumerate(column.places)
    }
    drawn = [f'<path class="rule" d="M0 {at:g}H{width:g}"/><text x="8" y="{at + 15:g}">{xml(name)}</text>' for name, at in titles]
    for placed in blocks.values():
        drawn += _block(machine, placed, stands)
    return picture("net", title or f"a machine of {counted(len(machine.plan.calls), 'call')}", _STYLE, width, height, drawn)


def _section(flow: Flow, layouts: Mapping[BlockKey, BlockLayout], top: float, group: int) -> Iterator[_Placed]:
    """Yield the blocks of a flow, in lines below each other; each row is as high as its highest block, each column as wide."""
    cells = sorted(laid_out(flow, _ACROSS).cells.values(), key=lambda cell: (cell.row, cell.column))
    widths: dict[int, float] = {}
    heights: dict[int, float] = {}
    for cell in cells:
        layout = layouts[cell.step.index]
        widths[cell.column] = max(widths.get(cell.column, 0.0), layout.width)
        heights[cell.row] = max(heights.get(cell.row, 0.0), layout.height)
    lefts = {column: _MARGIN + sum(widths[before] + _BETWEEN[0] for before in range(column)) for column in widths}
    tops: dict[int, float] = {}
    for row, height in heights.items():
        tops[row], top = top, top + height + _BETWEEN[1]
    for cell in cells:
        yield _Placed(layouts[cell.step.index], lefts[cell.column], tops[cell.row], group + cell.line, cell.column)


def _block(machine: PetriNetMachine, placed: _Placed, stands: Mapping[str, tuple[_Placed, float, float]]) -> Iterator[str]:
    layout = placed.layout
    depths: dict[float, int] = {}
    for crossing in layout.crossings:
        for x in (*(x for x, _ in crossing.inputs), *crossing.outputs, *crossing.back):
            depths[x] = max(depths.get(x, 0), crossing.row + (x in crossing.back))
    yield f'<g transform="translate({placed.x:g} {placed.y:g})"><title>{xml(layout.name)}</title>'
    yield f'<rect class="box" width="{layout.width:g}" height="{layout.height:g}" rx="6"/>'
    yield f'<text class="name" x="10" y="16">{xml(cut(layout.name, int(layout.width / 7)))}</text>'
    lines = (f"M{column.x:g} {_head(layout, column):g}V{_y(layout, depths[column.x]):g}" for column in layout.columns if column.x in depths)
    yield f'<path class="line" d="{"".join(lines)}"/>'
    for number, column in enumerate(layout.columns):
        yield from _column(machine, layout, column, number % 2 == 1)
    for crossing in layout.crossings:
        yield from _crossing(machine, layout, crossing)
    yield "</g>"
    for column in layout.columns:
        if column.standing is Standing.WAY_OUT:
            x, y = placed.x + column.x, placed.y + _head(layout, column)
            for place in column.places:
                there, to_x, to_y = stands[place]
                if there.group == placed.group and there.column == placed.column + 1:
                    edge, bend = placed.x + layout.width, there.x - 40
                    yield (
                        f'<path d="M{x:g} {y:g}H{edge:g}C{edge + 40:g} {y:g} {bend:g} {to_y:g} {there.x:g} {to_y:g}H{to_x - _RADIUS:g}"'
                        ' marker-end="url(#tip)"/>'
                    )


def _y(layout: BlockLayout, row: int) -> float:
    return layout.top + (row + 0.7) * ROW


def _head(layout: BlockLayout, column: Column) -> float:
    """Return where the first place of a line is."""
    return TITLE + _RADIUS + 4 if column.standing is Standing.CAME_IN else layout.top - _RADIUS - 4


def _column(machine: PetriNetMachine, layout: BlockLayout, column: Column, is_raised: bool) -> Iterator[str]:
    x, y = column.x, _head(layout, column)
    match column.standing:
        case Standing.CAME_IN:
            for number, place in enumerate(column.places):
                at = y + STACK * number
                yield from _place(machine, place, x, at)
                fact = facts_of(machine.orderings[place].protects, _LABEL) if place in machine.orderings else ""
                words = f"{_names(machine, machine.net.preset(place))} {fact}".strip()
                yield f'<text class="fact" x="{x + _RADIUS + 3:g}" y="{at + 3:g}">{xml(cut(words, _LABEL))}</text></g>'
        case Standing.OWN:
            (place,) = column.places
            yield from _place(machine, place, x, y)
            yield from _over(place.removeprefix(f"{layout.name} "), x, y, is_raised, "")
            yield "</g>"
        case Standing.ELSEWHERE:
            (place,) = column.places
            yield f'<g><title>{xml(place)}</title><path d="M{x - 4:g} {y:g}L{x:g} {y - 4:g}L{x + 4:g} {y:g}L{x:g} {y + 4:g}z"/>'
            yield from _over(f"from {_names(machine, machine.net.preset(place))}", x, y, is_raised, "far")
            yield "</g>"
        case Standing.WAY_OUT:
            takers = [taker for place in column.places for taker in machine.net.postset(place)]
            yield f'<g><title>{xml(chr(10).join(column.places))}</title><path class="tip" d="M{x - 4:g} {y - 5:g}l8 5l-8 5z"/>'
            yield from _over(f"→ {_names(machine, takers)}", x, y, is_raised, "far")
            yield "</g>"


def _place(machine: PetriNetMachine, place: str, x: float, y: float) -> Iterator[str]:
    """Yield the beginning of a group with a place and its tokens."""
    tokens = machine.initial[place]
    yield f'<g><title>{xml(place)}</title><circle cx="{x:g}" cy="{y:g}" r="{_RADIUS}" stroke="{COLOURS[machine.role(place)]}"/>'
    if tokens:
        yield f'<text x="{x:g}" y="{y + 3.5:g}" text-anchor="middle">{"●" if tokens == 1 else tokens}</text>'


def _over(words: str, x: float, y: float, is_raised: bool, kind: str) -> Iterator[str]:
    """Yield words over a place, in two lines if they are long; every second one is higher, so that neighbours do not meet."""
    lines = words.split(" ", 1) if len(words) > _NAME else [words]
    for number, line in enumerate(reversed(lines)):
        at = y - _RADIUS - 4 - 10 * number - 20 * is_raised
        yield f'<text class="{kind}" x="{x:g}" y="{at:g}" text-anchor="middle">{xml(cut(line, _NAME))}</text>'


def _names(machine: PetriNetMachine, transitions: Sequence[str]) -> str:
    """Return of which steps transitions are."""
    steps = {machine.rules[name].call for name in transitions}
    frame = "" if None not in steps else Frame.BEGIN.value if machine.start_place in machine.net.inputs[transitions[0]] else Frame.END.value
    return " ".join(filter(None, (frame, numbers(step for step in steps if step is not None))))


def _crossing(machine: PetriNetMachine, layout: BlockLayout, crossing: Crossing) -> Iterator[str]:
    rule, y = machine.rules[crossing.transition], _y(layout, crossing.row)
    below = _y(layout, crossing.row + 1)
    first, _ = crossing.inputs[0]
    lines = f"M{first:g} {y:g}H{max((crossing.bar, *crossing.outputs)):g}"
    tips = [f"M{x:g} {y:g}l-6 -3v6z" for x in crossing.outputs]
    if crossing.back:
        lines += f"M{crossing.bar:g} {y:g}V{below:g}H{crossing.back[0]:g}"
        tips += [f"M{x:g} {below:g}l6 -3v6z" for x in crossing.back]
    dots = "".join(f"M{x - 2.5:g} {y:g}a2.5 2.5 0 1 0 5 0a2.5 2.5 0 1 0 -5 0z" for x, _ in crossing.inputs)
    yield f'<g class="transition"><title>{xml(_asks(crossing.transition, rule))}</title><path d="{lines}"/>'
    yield f'<path class="tip" d="{"".join(tips)}"/><path class="dot" d="{dots}"/>'
    yield f'<rect class="bar" x="{crossing.bar - 1.5:g}" y="{y - 5:g}" width="3" height="10"/>'
    for x, weight in crossing.inputs:
        if weight > 1:
            yield f'<text class="event" x="{x + 3:g}" y="{y + 8:g}">{weight}</text>'
    yield f'<text class="event" x="{crossing.bar + GAP:g}" y="{y - 3:g}">{xml(" ".join((rule.name, *crossing.resources)))}</text></g>'


def _asks(name: str, rule: Rule) -> str:
    """Return what a transition asks and does, in words."""
    asked = guard_data(rule.guard)
    kind = re.sub(r"(?<!^)(?=[A-Z])", " ", asked.pop("kind")).lower()
    values = ", ".join(str(value) for key, value in asked.items() if key != "call" and value not in (None, (), ""))
    does = f"does: {rule.action.value}" if rule.action else ""
    return "\n".join(filter(None, (name, f"when: {kind}{f' {values}' if values else ''}", does)))
