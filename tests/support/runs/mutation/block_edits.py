"""Edits of blocks in place, behind the back of the machine that was built from them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from random import Random
from typing import Final

from pnm.core.machine.machine import MachineBlocks

Edit = Callable[[MachineBlocks, Random], None]


def ports(blocks: MachineBlocks, random: Random) -> None:
    number = random.randrange(len(blocks.placed))
    block = blocks.placed[number]
    found = [list(places) for places in block.ports]
    places = random.choice([*filter(None, found)])
    match random.randrange(3):
        case 0:
            places.pop(random.randrange(len(places)))
        case 1:
            places.append(random.randrange(-2, blocks.count_places + 2))
        case _:
            random.shuffle(found)
    blocks.placed[number] = replace(block, ports=tuple(map(tuple, found)))


def places(blocks: MachineBlocks, random: Random) -> None:
    number = random.randrange(len(blocks.placed))
    block = blocks.placed[number]
    blocks.placed[number] = replace(block, place=block.place + random.choice([-1, 1]))


def steps(blocks: MachineBlocks, random: Random) -> None:
    one, other = (random.randrange(len(blocks.placed)) for _ in range(2))
    terms, title = blocks.placed[other].terms, blocks.placed[other].title
    blocks.placed[one] = replace(blocks.placed[one], terms=terms, title=title)


def templates(blocks: MachineBlocks, random: Random) -> None:
    one, other = (random.randrange(len(blocks.placed)) for _ in range(2))
    blocks.placed[one] = replace(blocks.placed[one], template=blocks.placed[other].template)


def regions(blocks: MachineBlocks, random: Random) -> None:
    one, other = random.choice(blocks.regions), random.choice(blocks.regions)
    match random.randrange(3):
        case 0:
            one.owner = random.choice([None, *(block.step.index for block in blocks.placed if block.step), 99])
        case 1:
            one.flow, other.flow = other.flow, one.flow
        case _:
            one.borders = one.borders[1:]


def parts(blocks: MachineBlocks, random: Random) -> None:
    """Give a block a changed copy of its template."""
    number = random.randrange(len(blocks.placed))
    template = blocks.placed[number].template
    part = random.choice(["inputs", "outputs", "rules", "failures", "restarts", "budgets", "alive", "settling"])
    found = [*getattr(template, part)]
    random.shuffle(found)
    template = replace(template, **{part: tuple(found[random.randrange(2) :])})
    blocks.placed[number] = replace(blocks.placed[number], template=template)


BLOCK_EDITS: Final[tuple[Edit, ...]] = (ports, places, steps, templates, regions, parts)
