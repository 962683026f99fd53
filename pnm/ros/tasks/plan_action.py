"""The action ``plan``: answers plan requests, from the current state, without execution."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from functools import partial
from typing import Any, Final
from uuid import UUID

from pnm.errors import InputError
from pnm.ros.action_server.goal_server import GoalCallbacks, GoalResult, GoalServer
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.tasks.goal_actions import status_of
from pnm.ros.tasks.task_messages import made_fields, seconds
from pnm.tasks import Code, MadePlan, Make

NAME: Final = "plan"
SECOND: Final = 1.0
"""Seconds between two feedback messages about a search."""

_log = logging.getLogger(__name__)


class PlanningServer:
    """The action server for plan requests, which are rejected while `closed` returns a reason.

    The mutable state is the searches by goal, and those whose clients have cancelled them.
    """

    def __init__(self, ros: RosThread, make: Make, closed: Callable[[], str]) -> None:
        self._make = make
        self._loop = asyncio.get_running_loop()
        self._searches: dict[UUID, asyncio.Task[MadePlan]] = {}
        self._cancel_asked: set[UUID] = set()
        self._closed = closed
        self._server = GoalServer(ros, "pnm_interfaces/action/MakePlan", NAME, GoalCallbacks(self._accept, self._cancel))

    def __repr__(self) -> str:
        return f"<PlanningServer {len(self._searches)} searches>"

    async def open(self) -> None:
        """Bring the server up."""
        await self._server.open()

    async def close(self) -> None:
        """Cancel all searches, and take the server down."""
        for search in self._searches.values():
            search.cancel()
        if self._searches:
            await asyncio.wait(self._searches.values())
        await self._server.close()

    async def _accept(self, goal: UUID, request: Any) -> str:
        if reason := self._closed():
            return reason
        search = self._loop.create_task(self._search(request))
        feeding = self._loop.create_task(self._feed(goal))
        self._searches[goal] = search
        search.add_done_callback(partial(self._end, goal, feeding))
        return ""

    def _cancel(self, goal: UUID) -> None:
        if goal in self._searches:
            self._cancel_asked.add(goal)
            self._searches[goal].cancel()

    async def _search(self, request: Any) -> MadePlan:
        try:
            return await self._make(request.goal.strip(), request.planner.strip(), seconds("timeout", request.timeout))
        except InputError as error:
            return MadePlan(Code.INVALID_GOAL, str(error))
        except Exception as error:
            _log.exception("a plan cannot be looked for")
            return MadePlan(Code.ERROR, f"{type(error).__name__}: {error}")

    def _end(self, goal: UUID, feeding: asyncio.Task[None], search: asyncio.Task[MadePlan]) -> None:
        feeding.cancel()
        del self._searches[goal]
        made = MadePlan(Code.CANCELLED, "the search was given up") if search.cancelled() else search.result()
        status = status_of(made.code, goal in self._cancel_asked)
        self._cancel_asked.discard(goal)
        self._server.end(goal, lambda: GoalResult(status, made_fields(made)))

    async def _feed(self, goal: UUID) -> None:
        began = self._loop.time()
        while True:
            await asyncio.sleep(SECOND)
            self._server.feed(goal, {"seconds": self._loop.time() - began})
