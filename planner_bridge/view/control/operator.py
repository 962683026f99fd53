"""The operator: carries out the commands of a page in the process that has the tasks, in the ways that other clients have as well."""

from __future__ import annotations

import asyncio
import logging
from typing import Final, assert_never
from uuid import uuid4

from planner_bridge.view.control.commands import (
    MAX_PROBLEM,
    AnswerQuestion,
    CancelTask,
    CheckGoal,
    Command,
    ExplainGoal,
    PauseTask,
    Reply,
    ResumeTask,
    SendGoal,
    SettleRequest,
    StepTask,
    TellFacts,
    read_command,
)
from pnm.errors import InputError, PnmError
from pnm.tasks import ServedWorld, TaskCommands, TaskRefused, Tasks, TaskState, Wanted

_SOON: Final = 2.0
"""Seconds for what robots have to confirm; what takes longer goes on, and the page shows what comes of it."""

_log = logging.getLogger(__name__)


class Operator:
    """Carries out commands on the event loop of the tasks.

    The mutable state is the commands that take their time.

    Args:
        tasks: what is going on.
        commands: how tasks are begun, paused, resumed and cancelled here.
        world: what goals are read in, and facts told to; None where there is only the one task that was begun.
    """

    def __init__(self, tasks: Tasks, commands: TaskCommands, world: ServedWorld | None = None) -> None:
        self._tasks = tasks
        self._commands = commands
        self._world = world
        self._going_on: set[asyncio.Task[Reply]] = set()

    async def reply(self, data: object) -> Reply:
        """Carry out a command, and return the reply to it, at the latest when it has begun."""
        try:
            command = read_command(data)
            work = asyncio.ensure_future(self._carry_out(command))
            self._going_on.add(work)
            work.add_done_callback(self._going_on.discard)
            has_to_be_confirmed = isinstance(command, PauseTask | ResumeTask | CancelTask | StepTask)
            done, _ = await asyncio.wait((work,), timeout=_SOON if has_to_be_confirmed else None)
            if done:
                return work.result()
            work.add_done_callback(_log_refusal)
        except InputError as error:
            position = error.position
            return Reply(error.message, position.line, position.column) if position else Reply(error.message)
        except (PnmError, TaskRefused) as refusal:
            return Reply(str(refusal))
        except Exception as error:
            _log.exception("a command of the page cannot be carried out")
            return Reply(f"{type(error).__name__}: {error}")
        return Reply()

    async def _carry_out(self, command: Command) -> Reply:
        match command:
            case ExplainGoal(goal):
                problem = await self._served.pack(goal)
                if len(problem) > MAX_PROBLEM:
                    raise InputError("the problem is too large to be explained here; `pnm why` takes it")
                return Reply(problem=problem)
            case CheckGoal(goal):
                await self._served.check_goal(goal)
            case SendGoal(goal, priority):
                await self._served.check_goal(goal)
                self._begin(Wanted(uuid4(), goal, priority))
            case PauseTask(task, at_once):
                await self._commands.pause(task, at_once=at_once)
            case ResumeTask(task):
                await self._commands.resume(task)
            case CancelTask(task):
                await self._commands.cancel(task)
            case StepTask(task):
                await self._tasks.step(task)
            case SettleRequest(request, is_done):
                self._tasks.settle(request, is_done=is_done)
            case TellFacts(add, remove, forget):
                await self._served.update(add, remove, forget)
            case AnswerQuestion(question, text):
                self._tasks.answer(question, text)
            case _:
                assert_never(command)
        return Reply()

    @property
    def _served(self) -> ServedWorld:
        if self._world is None:
            raise InputError("this run has one goal, and facts of its own; `pnm serve` takes others")
        return self._world

    def _begin(self, wanted: Wanted) -> None:
        self._commands.begin(wanted)
        ended = next((status for status in self._tasks.status() if status.id == wanted.id), None)
        if ended is not None and ended.state is TaskState.OVER:  # which is kept nowhere if it was never accepted
            raise TaskRefused(ended.reason)


def _log_refusal(work: asyncio.Task[Reply]) -> None:
    if not work.cancelled() and (error := work.exception()):
        _log.warning("what was wanted on the page is refused after all: %s", error)
