"""Sensors that listen, and what is known from them."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.readiness import refuse_unfit
from pnm.ros.backend import sensor_readiness
from pnm.ros.node.graph import snapshot
from pnm.ros.sensors import Sensors
from tests.support.pddl.sensed_world import PROBLEM
from tests.support.processes import LIMIT


@asynccontextmanager
async def opened(ros, sensing):
    """What is known, and the sensors, whether they fit or not."""
    world = KnowledgeBase(objects=PROBLEM.objects_by_type)
    listener = Sensors(ros, sensing, world, 1.0)
    try:
        await listener.open()
        yield world, listener
    finally:
        await listener.close()


@asynccontextmanager
async def listening(ros, sensing):
    """What is known from sensors; those that can never work are refused."""
    async with opened(ros, sensing) as (world, listener):
        refuse_unfit(sensor_readiness(listener.uses(), await ros.ask(lambda: snapshot(ros.node))))
        yield world


async def becomes(world: KnowledgeBase, fluent, value) -> None:
    """Wait until it is so."""
    changed = asyncio.Event()
    stop = world.listen(lambda _: changed.set())
    try:
        async with asyncio.timeout(LIMIT):
            while world.value(fluent) != value:
                changed.clear()
                await changed.wait()
    finally:
        stop()
