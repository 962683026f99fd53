"""The route for commands: for those who have the token, and for nobody else."""

from __future__ import annotations

import asyncio
import hmac
import json
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from starlette.requests import Request
from starlette.responses import Response

from planner_bridge.view.control.channel import Channel
from planner_bridge.view.control.commands import MAX_TEXT, Controlled
from planner_bridge.view.control.shown_json import ShownResponse
from pnm.errors import PnmError

if TYPE_CHECKING:
    from planner_bridge.explanations.answer import Answer
    from pnm.core.knowledge_base import KnowledgeBase

_MAX_BODY: Final = 4 * MAX_TEXT
_LEVELS: Final = 8
"""How deep a value may be nested that is looked at as a command."""
_TYPE: Final = "application/json"
"""Of bodies: no form of another page can have it."""


@dataclass(frozen=True)
class Control:
    """What may be controlled, by whom, and the way there.

    Args:
        what: may be controlled.
        token: its holder may control it.
        channel: the way to the process that has the tasks.
    """

    what: Controlled
    token: str
    channel: Channel
    turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    """Held while something is explained: one thing after the other."""

    async def look(self, request: Request) -> Response:
        """Answer with what may be controlled."""
        return self._refusal(request) or ShownResponse({"what": self.what.value})

    async def do(self, request: Request, world: Callable[[], Awaitable[KnowledgeBase]]) -> Response:
        """Have a command carried out, and answer with the reply; what is explained is explained from a world."""
        if refusal := self._refusal(request):
            return refusal
        if request.headers.get("content-type", "").partition(";")[0].strip() != _TYPE:
            return _refused(f"expected a command as {_TYPE}", 415)
        body = bytearray()
        async for part in request.stream():
            body += part
            if len(body) > _MAX_BODY:
                return _refused(f"expected {_MAX_BODY} bytes at most", 413)
        try:
            command = json.loads(body)
        except (ValueError, RecursionError):
            return _refused("expected a command as JSON", 400)
        if _is_deep(command):
            return _refused("expected a command with texts and lists of texts, found lists in lists", 400)
        reply = await self.channel.ask(command)
        if reply.problem:
            try:
                return ShownResponse({"answers": [answer.as_json() for answer in await self._explained(reply.problem, world)]})
            except PnmError as error:
                return _refused(str(error), 409)
        told = {name: value for name, value in reply.as_json().items() if name != "problem"}
        return ShownResponse(told, 409 if reply.refused else 200)

    async def _explained(self, problem: str, world: Callable[[], Awaitable[KnowledgeBase]]) -> tuple[Answer, ...]:
        """Explain a problem: in this process, because that takes a processor, which the tasks need."""
        from planner_bridge.explanations.goal_now import answered  # here, because it takes its time to import

        async with self.turn:
            return await asyncio.to_thread(answered, problem, await world())

    def _refusal(self, request: Request) -> Response | None:
        if self.what is Controlled.NOTHING:
            return _refused("this page controls nothing: start it with --view-controls", 403)
        kind, _, given = request.headers.get("authorization", "").partition(" ")
        if kind != "Bearer" or not hmac.compare_digest(given.encode("latin-1", "replace"), self.token.encode()):
            return _refused("only who has the token of this page may do that: it is in the URL that was printed when it was started", 403)
        return None


def _is_deep(value: object, levels: int = _LEVELS) -> bool:
    """Return whether a value is nested deeper than commands are: the process that has the tasks reads no such thing."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return levels == 0 or any(_is_deep(entry, levels - 1) for entry in inner)


def _nowhere(_: str) -> None:
    """Write to nobody."""


NO_CONTROL: Final = Control(Controlled.NOTHING, "", Channel(_nowhere))


def _refused(why: str, status: int) -> Response:
    return ShownResponse({"refused": why}, status)
