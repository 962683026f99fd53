"""The process that is killed: tasks with a journal, whose robots are at the other end of a wire."""

from __future__ import annotations

import asyncio
import logging
import os
import socket
import sys
import traceback
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from uuid import UUID

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.tasks.result import TASKS
from planner_bridge.tasks.task_manager import TaskManager
from pnm.actions.backend import ClientBackend
from pnm.clock import FollowingLoop, run_async
from pnm.journal.kept import JournalChoice
from pnm.journal.records import SharedBegan
from pnm.journal.resume import take_up
from pnm.language.runner import PlanRunner
from pnm.tasks import TaskEnding, TaskListener
from tests.support.tasks.kills.instants import AtCommit, Instant, die_in_journals
from tests.support.tasks.kills.scenario import Scenario
from tests.support.tasks.kills.wire import DistantRobots, TaskTaken

ORIGIN = "the world of the scenario"


@dataclass
class _Ends(TaskListener):
    """Notes which tasks are over."""

    over: set[UUID] = field(default_factory=set)
    news: asyncio.Event = field(default_factory=asyncio.Event)

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        self.over.add(task)
        self.news.set()


async def carry_out(scenario: Scenario, journal_file: Path, end: socket.socket, instant: Instant | None) -> None:
    """Carry out all tasks, or what other processes have left of them."""
    if isinstance(instant, AtCommit):
        die_in_journals(instant)
    robots = DistantRobots(end)
    listening = asyncio.ensure_future(robots.wire.listen())
    taken = take_up(JournalChoice(journal_file), TASKS, ORIGIN)
    journal, replay = taken.write(), taken.replay
    loop = asyncio.get_running_loop()
    if replay:
        assert isinstance(loop, FollowingLoop)
        loop.continue_from(replay.now)
    knowledge = replay.world if replay else initial_knowledge(scenario.problem)
    runner = PlanRunner({}, ClientBackend(robots), knowledge, None, journal, replay)
    if not replay:
        journal.begin(knowledge, runner.resources, began=SharedBegan(runner.resources.capacities, runner.prefix, ORIGIN))
    manager = TaskManager(scenario.problem, runner, scenario.settings, scenario.read_goal)
    ends = _Ends()
    manager.listen(ends)
    if replay:
        manager.restore(replay)
        ends.over |= {id for id, task in replay.tasks.items() if task.ending is not None}
    for wanted in scenario.tasks:
        if not (replay and wanted.id in replay.tasks):  # its client was not told that it is accepted, and asks again
            manager.begin(wanted)
            robots.wire.say(TaskTaken(wanted.id))
    while not {wanted.id for wanted in scenario.tasks} <= ends.over:
        ends.news.clear()
        await ends.news.wait()
    await manager.close()
    journal.close()
    listening.cancel()


def live(scenario: Scenario, journal: Path, end: socket.socket, instant: Instant | None, log: Path) -> NoReturn:
    """Be that process, from here to its end: its exit status is 0 if all tasks are over. What goes wrong goes to the log."""
    status = 1
    try:
        with log.open("ab") as file:
            os.dup2(file.fileno(), sys.stderr.fileno())
        logging.getLogger().setLevel(logging.ERROR)
        run_async(carry_out(scenario, journal, end, instant))
        status = 0
    except BaseException:
        log.open("a").write(traceback.format_exc())
    finally:
        os._exit(status)
