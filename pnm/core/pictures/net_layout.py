"""Layout of the blocks of a machine: each place has a line of its own downwards, in the order of time; a transition lies across.

A transition leads from the lines of the places it takes from, by its bar, to those of the places it gives to. Transitions that do not
meet share a row: first those that fire when all goes well, then short ones; what leads back is below. A place between blocks stands in
the block that takes from it; the one that its token comes from has a way out. So every block is laid out by itself.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, TypeAlias

from pnm.core.machine.machine import PetriNetMachine, Rule

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
    """How places stand in a block."""

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
    """Where its rows begin."""
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
    return {key: _laid_out(machine, key, name, places[key], transitions[key], home) for key, name in names.items()}


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


def _laid_out(
    machine: PetriNetMachine, key: BlockKey, name: str, places: Sequence[str], transitions: Sequence[str], home: Mapping[str, BlockKey]
) -> BlockLayout:
    columns, width = _columns(machine, key, places, transitions, home)
    line = {place: column.x for column in columns for place in column.places}
    crossings, rows, right = _crossings(machine, transitions, line)
    stacked = max((len(column.places) for column in columns if column.standing is Standing.CAME_IN), default=0)
    top = max(TOP, TITLE + STACK * stacked)
    return BlockLayout(key, name, columns, crossings, max(width, right + _EDGE), top, top + rows * ROW + _EDGE / 2)


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
