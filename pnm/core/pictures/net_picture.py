"""Picture of a whole machine as SVG: a box for each step, where the picture of its plan has it, with its places and transitions.

Places are circles with their tokens, each with a line downwards; a transition is a bar, and its arcs lead across from the lines of the
places it takes from, which have a dot there, to those of the places it gives to, which have a tip. What it asks is its title.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, TypeAlias

from pnm.core.machine.guards import Rule
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import Flow
from pnm.core.pictures.export import COLOURS, guard_data
from pnm.core.pictures.plan_picture import facts_of, held, laid_out, numbers
from pnm.core.pictures.xml_text import cut, picture, xml
from pnm.errors import counted

# --- where places and transitions stand -----------------------------------------------------
#
# Each place has a line of its own downwards, in the order of time; a transition lies across.
#
# A transition leads from the lines of the places it takes from, by its bar, to those of the places it gives to. Transitions that do not
# meet share a row: first those that fire when all goes well, then short ones; what leads back is below. A place between blocks stands in
# the block that takes from it; the one that its token comes from has a way out. So every block is laid out by itself.


PITCH: Final = 46
"""Pixels from one place to the next."""
ROW: Final = 15
"""Pixels from one row to the next."""
TITLE: Final = 24
"""Pixels for the title of a block."""
TOP: Final = TITLE + 64
"""Pixels above the first row, at least: the title, the names of places in two rows, and the places."""
STACK: Final = 17
"""Pixels from one place to the next of those that came in."""
_STACKED: Final = 12
"""Places that came in above each other, at most."""
_LABEL: Final = 112
"""Pixels for what is written beside places that came in."""
_LETTER: Final = 4.7
"""Pixels of a letter at a transition."""
GAP: Final = 6
"""Pixels between the line of a place and the bar of a transition, and between the bar and its name."""
_EDGE: Final = 16


class Frame(Enum):
    """Blocks of what belongs to no step."""

    BEGIN = "begin"
    END = "end"


BlockKey: TypeAlias = int | Frame
"""The number of a step, or the frame."""


class Standing(Enum):
    """The arrangement of places in a block."""

    CAME_IN = "they belong to orderings, or to what holds the step"
    OWN = "it belongs to the block"
    ELSEWHERE = "it stands in another block, and the block takes from it"
    WAY_OUT = "they stand in other blocks, and the block gives to all of them at once"


@dataclass(frozen=True, slots=True)
class Column:
    """A line of a block downwards."""

    standing: Standing
    places: tuple[str, ...]
    x: float


@dataclass(frozen=True, slots=True)
class Crossing:
    """A transition: where it lies, and which lines it connects."""

    transition: str
    row: int
    bar: float
    """The x of its bar."""
    inputs: tuple[tuple[float, int], ...]
    """The x of each line it takes from, and how many tokens."""
    outputs: tuple[float, ...]
    """The x of each line that it gives to and that is behind its bar."""
    back: tuple[float, ...]
    """Those before it: they are reached a row below."""
    resources: tuple[str, ...] = ()
    """Resources that it takes, with a minus, or gives back, with a plus."""


@dataclass(frozen=True, slots=True)
class BlockLayout:
    """The layout of a block, in pixels from its upper left corner."""

    key: BlockKey
    name: str
    """Of the step, with which the names of its places and transitions begin."""
    columns: tuple[Column, ...]
    crossings: tuple[Crossing, ...]
    width: float
    top: float
    """The beginning of its rows."""
    height: float


def block_layouts(machine: PetriNetMachine) -> Mapping[BlockKey, BlockLayout]:
    """Return the layouts of all blocks; every place stands in one of them, and every transition lies in one of them."""
    home = _homes(machine)
    names: dict[BlockKey, str] = {
        Frame.BEGIN: Frame.BEGIN.value,
        **{step.index: str(step) for step in machine.plan.every_step},
        Frame.END: Frame.END.value,
    }
    places: dict[BlockKey, list[str]] = {key: [] for key in names}
    for place, key in home.items():
        places[key].append(place)
    transitions: dict[BlockKey, list[str]] = {key: [] for key in names}
    for name, rule in machine.rules.items():
        transitions[_block_of(machine, name, rule)].append(name)
    layouts: dict[BlockKey, BlockLayout] = {}
    for key, name in names.items():
        columns, width = _columns(machine, key, places[key], transitions[key], home)
        crossings, rows, right = _crossings(machine, transitions[key], {place: column.x for column in columns for place in column.places})
        stacked = max((len(column.places) for column in columns if column.standing is Standing.CAME_IN), default=0)
        top = max(TOP, TITLE + STACK * stacked)
        layouts[key] = BlockLayout(key, name, columns, crossings, max(width, right + _EDGE), top, top + rows * ROW + _EDGE / 2)
    return layouts


def _block_of(machine: PetriNetMachine, name: str, rule: Rule) -> BlockKey:
    if rule.call is not None:
        return rule.call
    return Frame.BEGIN if machine.start_place in machine.net.inputs[name] else Frame.END


def _homes(machine: PetriNetMachine) -> dict[str, BlockKey]:
    """Return the block in which each place stands, in the order of time."""
    inside: dict[str, BlockKey] = {place: step for step, places in machine.blocks.items() for place in places}
    home: dict[str, BlockKey] = {}
    for place in machine.time_order.when:
        if place in inside:
            home[place] = inside[place]
        elif place in machine.orderings or place in machine.border_places:
            taker = machine.net.postset(place)[0]
            home[place] = _block_of(machine, taker, machine.rules[taker])
        else:
            home[place] = Frame.BEGIN if place == machine.start_place or place in machine.resource_places else Frame.END
    return home


def _columns(
    machine: PetriNetMachine, key: BlockKey, places: Sequence[str], transitions: Sequence[str], home: Mapping[str, BlockKey]
) -> tuple[tuple[Column, ...], float]:
    """Return the lines downwards, and the width that they take."""
    net = machine.net
    between = machine.orderings.keys() | machine.border_places
    taken_together: dict[tuple[str, ...], list[str]] = {}
    for place in places:
        if place in between:
            taken_together.setdefault(net.postset(place), []).append(place)
    others = [place for name in transitions for place in (*net.inputs[name], *net.outputs[name])]
    outside = dict.fromkeys(place for place in others if home[place] != key and place not in machine.resource_places)
    elsewhere = [place for place in outside if any(place in net.inputs[name] for name in transitions)]
    given_together: dict[tuple[str, ...], list[str]] = {}
    for place in outside:
        if place not in elsewhere:
            given_together.setdefault(net.preset(place), []).append(place)
    groups: list[tuple[Standing, Sequence[str]]] = [
        *((Standing.CAME_IN, group[at : at + _STACKED]) for group in taken_together.values() for at in range(0, len(group), _STACKED)),
        *((Standing.ELSEWHERE, [place]) for place in elsewhere),
        *((Standing.OWN, [place]) for place in _with_counters(machine, [place for place in places if place not in between])),
        *((Standing.WAY_OUT, group) for group in given_together.values()),
    ]
    columns: list[Column] = []
    x = _EDGE
    for standing, group in groups:
        columns.append(Column(standing, tuple(group), x if standing is Standing.CAME_IN else x + PITCH / 2))
        x += _LABEL if standing is Standing.CAME_IN else PITCH
    return tuple(columns), x + _EDGE


def _with_counters(machine: PetriNetMachine, places: Sequence[str]) -> list[str]:
    """Return the places with each counter behind the first place that transitions take from together with it."""
    when, net = machine.time_order.when, machine.net
    own = set(places) - machine.record_places

    def position(place: str) -> tuple[int, int]:
        beside = (other for name in net.postset(place) for other in net.inputs[name] if other in own)
        return min((when[other] for other in beside), default=when[place]) if place in machine.budget_places else when[place], when[place]

    return sorted(places, key=position)


def _main_line(machine: PetriNetMachine, transitions: Sequence[str]) -> frozenset[str]:
    """Return the transitions that fire when all goes well."""
    takers: dict[str, list[str]] = {}
    for name in transitions:
        rule = machine.rules[name]
        if rule.guard.goes_well and rule.cause is None:
            for place in machine.net.inputs[name]:
                takers.setdefault(place, []).append(name)
    found: dict[str, None] = {}
    here = min(takers, key=machine.time_order.when.__getitem__, default=None)
    while here in takers and (name := takers[here][0]) not in found:
        found[name] = None
        here = min(machine.net.outputs[name], key=machine.time_order.when.__getitem__, default=None)
    return frozenset(found)


def _crossings(machine: PetriNetMachine, transitions: Sequence[str], line: Mapping[str, float]) -> tuple[tuple[Crossing, ...], int, float]:
    """Return where the transitions lie, how many rows they take, and how far they reach to the right."""
    found: list[tuple[Crossing, float, float]] = []
    """With where each begins and ends."""
    for name in transitions:
        inputs, outputs = machine.net.inputs[name], machine.net.outputs[name]
        taken = sorted((line[place], weight) for place, weight in inputs.items() if place in line)
        given = sorted({line[place] for place in outputs if place in line})
        after = taken[-1][0]
        resources = [
            *(f"−{resource}" for place, resource in machine.resource_places.items() if place in inputs),
            *(f"+{resource}" for place, resource in machine.resource_places.items() if place in outputs),
        ]
        bar = after + GAP
        crossing = Crossing(
            name, 0, bar, tuple(taken), tuple(x for x in given if x > bar), tuple(x for x in given if x < bar), tuple(resources)
        )
        written = bar + GAP + _LETTER * len(" ".join((machine.rules[name].name, *resources)))
        found.append((crossing, min(taken[0][0], *given), max(written, bar, *given)))
    main = _main_line(machine, transitions)
    found.sort(key=lambda one: (one[0].transition not in main, bool(one[0].back), one[2] - one[1]))
    rows: list[list[tuple[float, float]]] = []
    """By row, what is taken of it."""
    placed: list[Crossing] = []
    for crossing, begin, end in found:
        height = 2 if crossing.back else 1
        row = 0
        while any(begin < right and left < end for taken in rows[row : row + height] for left, right in taken):
            row += 1
        rows += [[] for _ in range(row + height - len(rows))]
        for taken_row in rows[row : row + height]:
            taken_row.append((begin, end))
        placed.append(replace(crossing, row=row))
    return tuple(placed), len(rows), max((end for _, _, end in found), default=0.0)


# --- as SVG ---------------------------------------------------------------------------------


_ACROSS: Final = 2
"""Blocks beside each other."""
_MARGIN: Final = 24
_BETWEEN: Final = (56, 26)
"""Between blocks, to the right and downwards."""
_RADIUS: Final = 8
_NAME: Final = 12
"""Letters of a line of the name of a place."""
_LETTERS: Final = 19
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
                fact = facts_of(machine.orderings[place].protects, _LETTERS) if place in machine.orderings else ""
                words = f"{_names(machine, machine.net.preset(place))} {fact}".strip()
                yield f'<text class="fact" x="{x + _RADIUS + 3:g}" y="{at + 3:g}">{xml(cut(words, _LETTERS))}</text></g>'
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
    """Return the checks and acts of a transition, in words."""
    asked = guard_data(rule.guard)
    kind = re.sub(r"(?<!^)(?=[A-Z])", " ", asked.pop("kind")).lower()
    values = ", ".join(str(value) for key, value in asked.items() if key != "call" and value not in (None, (), ""))
    does = f"does: {rule.action.value}" if rule.action else ""
    return "\n".join(filter(None, (name, f"when: {kind}{f' {values}' if values else ''}", does)))
