"""Drives a run: events in from clients, clock and knowledge; commands out to them. Decides nothing."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from typing import assert_never, cast

from pnm.actions.base import ActionClient
from pnm.events import Begin, Cancel, Command, Event, KnowledgeChanged, Send, Stop, Tick, Wake
from pnm.expressions import Fluent, Unknown, Value
from pnm.results import RunResult
from pnm.run import Run


class Executor:
    """One run and the client that carries out its actions, on one asyncio loop.

    The mutable state is the inbox of events, the timer, and whether a knowledge change waits in the inbox.
    """

    def __init__(self, run: Run, client: ActionClient) -> None:
        self.run = run
        self._client = client
        self._inbox: asyncio.Queue[Event] = asyncio.Queue()
        self._timer: asyncio.TimerHandle | None = None
        self._change_waits = False

    def stop(self, *, cancel: bool = True, reason: str = "cancelled") -> None:
        """End the run: start nothing more; cancel what runs, or wait for it."""
        self._inbox.put_nowait(Stop(cancel, reason))

    async def execute(self) -> RunResult:
        """Run to the end and return how it ended; the run's own limits bound the time.

        Cancelling the task stops the run: what its actions are doing is cancelled and waited for.
        """
        stop_listening = self.run.knowledge.world.listen(self._changed)
        self._inbox.put_nowait(Begin())
        try:
            while not self.run.over:
                try:
                    event = await self._inbox.get()
                except asyncio.CancelledError:
                    cast("asyncio.Task[object]", asyncio.current_task()).uncancel()
                    event = Stop()
                if isinstance(event, KnowledgeChanged):
                    self._change_waits = False
                for command in self.run.handle(event, asyncio.get_running_loop().time()):
                    self._do(command)
        except BaseException:
            for request in self.run.open_requests:  # nobody will hear of them any more
                self._client.cancel(request)
            raise
        finally:
            stop_listening()
            self._wake_at(None)
        return self.run.result()

    def _do(self, command: Command) -> None:
        match command:
            case Send(request):
                self._client.send(request, self._inbox.put_nowait)
            case Cancel(request):
                self._client.cancel(request)
            case Wake(at):
                self._wake_at(at)
            case _:
                assert_never(command)

    def _wake_at(self, at: float | None) -> None:
        if self._timer:
            self._timer.cancel()
        self._timer = None if at is None else asyncio.get_running_loop().call_at(at, self._inbox.put_nowait, Tick())

    def _changed(self, changes: Mapping[Fluent, Value | Unknown]) -> None:
        if not self._change_waits:
            self._change_waits = True
            self._inbox.put_nowait(KnowledgeChanged())
