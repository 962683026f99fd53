"""The web application of the page: its files, the state after any record, and the changes as they come, as server-sent events.

It is for browsers on this computer alone. A page of somebody else that such a browser shows may send requests here as well, and may
have named this computer itself (DNS rebinding): so only requests to a name of this computer are answered, and of none but our page.
"""

from __future__ import annotations

import asyncio
import hmac
import json
import re
import socket
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from itertools import count
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar
from uuid import UUID, uuid4

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles
from starlette.types import ASGIApp, Receive, Scope, Send

from planner_bridge.explanations.history import JournalHistory, RunHistory
from planner_bridge.pipeline.odds import NOTHING_KNOWN, KnownRobots
from planner_bridge.view.follow import Feed, Reader
from planner_bridge.view.serving import MAX_TEXT, Controlled, Reply
from planner_bridge.view.story import Followed, Story, Thing, View, detail, named, view_of
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, Condition, conjuncts, evaluate, names
from pnm.core.logic.expressions import fluent_text
from pnm.core.machine.plan_graph import PlanGraph
from pnm.core.pictures.plan_picture import held, laid_out, words_of
from pnm.core.pictures.xml_text import TOKENS
from pnm.errors import InputError, PnmError, printable
from pnm.files.database.place import Place
from pnm.tasks import percent

if TYPE_CHECKING:
    from planner_bridge.view.metrics import Metrics


def shown_json(value: object) -> str:
    """Return a value as JSON on one line, in whose texts nothing controls anything or turns the order of letters around."""
    return printable(json.dumps(value, ensure_ascii=False, allow_nan=False))


class ShownResponse(JSONResponse):
    """An answer to a browser."""

    def render(self, content: Any) -> bytes:
        """Return the answer as it is sent."""
        return shown_json(content).encode()


PAGE: Final = Path(__file__).parent / "page"
NAMES: Final = ("127.0.0.1", "localhost")
"""The names of this computer in requests that are answered."""
HEADERS: Final = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
WATCHING: Final = 512
"""Browsers that may watch at the same time: each of them is sent everything."""
_SHARED: Final = 32
"""Frames and answers that are kept for other browsers, which mostly ask for the same."""
COLOURS: Final = "\n".join((":root{", *(f"--{name}:light-dark({light},{dark});" for name, (light, dark) in TOKENS.items()), "}"))
"""The stylesheet of the colours, which the page shares with pictures."""
_DIGITS: Final = 40

T = TypeVar("T")
K = TypeVar("K")


class Shared(Generic[K, T]):
    """What was made last, by keys that do not change, each with what else has to be kept for it. That is its mutable state."""

    def __init__(self) -> None:
        self._made: dict[K, tuple[T, object]] = {}

    def once(self, key: K, make: Callable[[], T], kept: object = None) -> T:
        """Return what is made of a key: what was made before, if it is among the last ones."""
        made = self._made.pop(key, None) or (make(), kept)
        self._made[key] = made  # the last that was asked for
        if len(self._made) > _SHARED:
            del self._made[next(iter(self._made))]
        return made[0]

    def forget(self, key: K) -> None:
        """Make it anew when it is asked for again."""
        self._made.pop(key, None)


class ViewApp:
    """The application."""

    def __init__(self, place: Place, feed: Feed, past: Reader[Story], control: Control, known: KnownRobots = NOTHING_KNOWN) -> None:
        self._place = place
        self._feed = feed
        self._past = past
        self._control = control
        self._metrics: Metrics | None = None
        """Those that somebody has asked for."""
        self._counts, self._reads = asyncio.Lock(), asyncio.Lock()
        """Whoever has a whole journal read waits for the others here, and not on a thread: all that is shown needs those."""
        self._name = PurePath(str(place).partition("?")[0]).stem
        self._key = uuid4().hex
        """Of this journal as this process reads it: numbers of records that a browser has from elsewhere mean nothing here."""
        self._frames = Shared[tuple[int, int], bytes]()
        """As they are sent, by the identities of the views before and after."""
        self._answers = Shared[str, asyncio.Future[Response]]()
        """By what is asked, of records that are there, or under way."""
        routes = [
            Route("/", self._page),
            Route("/state", partial(self._told, tell=lambda story: self._frame(None, view_of(story)))),
            Route("/call", partial(self._told_of_call, tell=detail)),
            Route("/why", self._why),
            Route("/plan", partial(self._of_run, tell=lambda _, run: run, response=lambda run: ShownResponse(drawn(run)))),
            Route(
                "/policy", partial(self._of_run, tell=Followed.by, response=lambda of: Response(of.picture(), 200, None, "image/svg+xml"))
            ),
            Route("/day", self._day),
            Route("/events", self._events),
            Route("/metrics", self._numbers),
            Route("/control", control.look),
            Route("/control", partial(control.do, world=self._projected, known=known), methods=["POST"]),
            Route("/page/tokens.css", lambda _: Response(COLOURS, media_type="text/css")),
            Mount("/page", StaticFiles(directory=PAGE)),
        ]
        self.asgi: Final = _Guarded(Starlette(routes=routes))

    async def _page(self, request: Request) -> Response:
        return FileResponse(PAGE / "index.html")

    async def _why(self, request: Request) -> Response:
        """Answer with why a call is in its plan, and why it began when it did or what it waits for, as it was after a record.

        The journal is read anew for that: this is asked by people, now and then.
        """
        from planner_bridge.explanations.run_questions import explained  # here, because it takes its time to import

        def asked(story: Story, run: UUID, index: int) -> tuple[UUID, int, int] | None:
            return (run, index, story.number) if run in story.runs else None

        def answered(about: tuple[UUID, int, int]) -> Response:
            return ShownResponse([answer.as_json() for answer in explained(self._place, *about)])

        async with self._reads:
            return await self._told_of_call(request, asked, answered)

    def close(self) -> None:
        """Read no more for numbers."""
        if self._metrics is not None:
            self._metrics.close()

    async def _numbers(self, request: Request) -> Response:
        """Answer with the numbers of the journal for Prometheus."""
        from planner_bridge.view.metrics import Metrics  # here, because few ask for them, and what it needs is an extra

        try:
            self._metrics = self._metrics or Metrics(self._place)
            async with self._counts:
                return Response(await asyncio.to_thread(self._metrics.text), media_type="text/plain; version=0.0.4")
        except PnmError as error:
            return _refused(str(error), 503)

    async def _day(self, request: Request) -> Response:
        """Answer with all tasks of the journal, read anew: this is asked by people, now and then."""
        try:
            async with self._reads:
                return ShownResponse(await asyncio.to_thread(day_of, self._place))
        except PnmError as error:
            return _refused(str(error), 409)

    async def _projected(self) -> KnowledgeBase:
        """Return the world as it will be when what is under way has ended."""
        from planner_bridge.model.progression import projected_state  # here, because it takes its time to import

        def told(story: Story) -> KnowledgeBase:
            return projected_state(story.world, (run.executed().run for run in story.runs.values() if not run.is_over))

        world = await self._feed.asked((await self._feed.newest()).number, told, self._past)
        if world is None:
            raise InputError("nothing is known yet of the world")
        return world

    async def _told_of_call(
        self, request: Request, tell: Callable[[Story, UUID, int], T | None], response: Callable[[T], Response] = ShownResponse
    ) -> Response:
        """Answer with what is told of the call that the request names."""
        run, _, index = request.query_params.get("call", "").partition("/")
        number = _number(index)
        if number is None or not re.fullmatch("[0-9a-f]{32}", run):
            return _refused(f"expected call=RUN/NUMBER, found {_quoted(request.query_params.get('call', ''))}", 400)
        return await self._told(request, lambda story: tell(story, UUID(run), number), response)

    async def _of_run(self, request: Request, tell: Callable[[Story, RunHistory], T | None], response: Callable[[T], Response]) -> Response:
        """Answer with what is told of a run that has begun by a record."""

        def told(story: Story) -> T | None:
            chosen = {id.hex: run for id, run in story.runs.items()}.get(request.query_params.get("run", ""))
            return None if chosen is None else tell(story, chosen)

        return await self._told(request, told, response)

    async def _told(
        self, request: Request, tell: Callable[[Story], T | None], response: Callable[[T], Response] = ShownResponse
    ) -> Response:
        """Answer with what is told after the record that the request names, or after the last one by a time."""
        number, time = _number(request.query_params.get("at", "")), request.query_params.get("time", "")
        if number is None and not re.fullmatch(r"-?\d{1,15}(\.\d{1,20})?", time):
            return _refused(f"expected at=NUMBER, found {_quoted(request.query_params.get('at', ''))}", 400)
        if number is None or request.query_params.keys() == {"at"}:  # numbers alone mean something else in a journal that is written anew
            return await self._answered(number, time, tell, response)
        key = f"{request.url.path}?{request.url.query}"
        answering = self._answers.once(key, lambda: asyncio.ensure_future(self._answered(number, time, tell, response)))
        is_there = False
        try:
            answer = await asyncio.shield(answering)
            is_there = answer.status_code == 200
            return answer
        finally:
            if not is_there:
                self._answers.forget(key)

    async def _answered(
        self, number: int | None, time: str, tell: Callable[[Story], T | None], response: Callable[[T], Response]
    ) -> Response:
        try:
            if number is None:
                newest = (await self._feed.newest()).number
                number = await self._feed.asked(newest, lambda story: story.record_at(float(time)), self._past) or 0
            told = await self._feed.asked(number, tell, self._past)
            if told is None:
                return _refused(f"there is nothing of that after record {number}", 404)
            return await asyncio.to_thread(response, told)  # nobody else waits for that
        except PnmError as error:
            return _refused(str(error), 409)

    async def _events(self, request: Request) -> Response:
        """Stream frames, from what the browser has seen last."""
        last = _number(request.headers.get("last-event-id") or request.query_params.get("after", ""))
        seen: View | None = None
        if last is not None and request.query_params.get("of") == self._key:
            try:
                now = self._feed.view  # which most have seen that have lost their connection
                seen = now if last == now.number else await self._feed.asked(last, view_of, self._past)
            except PnmError:
                seen = None  # which is told as a problem, with the whole state

        def sent(before: View | None, after: View) -> bytes:
            return f"id: {after.number}\nretry: 1000\ndata: {shown_json(self._frame(before, after))}\n\n".encode()

        async def stream() -> AsyncIterator[bytes]:
            nonlocal seen
            async for view in self._feed.views():  # a frame is made once for all who have seen the same
                yield self._frames.once((id(seen), id(view)), partial(sent, seen, view), kept=(seen, view))
                seen = view

        if self._feed.watching >= WATCHING:
            return _refused(f"{WATCHING} browsers watch already; close one of them", 503)
        return StreamingResponse(stream(), media_type="text/event-stream")

    def _frame(self, before: View | None, after: View) -> dict[str, Any]:
        own = {"journal": self._key, "name": self._name, "host": socket.gethostname(), "watching": self._feed.watching}
        return {**own, **frame(before, after)}


class _Guarded:
    """Answers requests to this computer alone, and of our page alone, with headers that keep it among its own files."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return

        async def guarded(message: Any) -> None:
            if message["type"] == "http.response.start":
                own = [(name.encode(), value.encode()) for name, value in HEADERS.items()]
                message["headers"] = [*((name, value) for name, value in message["headers"] if name.decode() not in HEADERS), *own]
            await send(message)

        port = scope["server"][1]
        hosts = {f"{name}:{port}" for name in NAMES}
        given = {name.decode(): value.decode("latin-1") for name, value in scope["headers"]}
        app = self._app
        if given.get("host") not in hosts:
            app = _refused(f"expected a request to {' or '.join(sorted(hosts))}", 421)
        elif given.get("origin", f"http://{given['host']}") not in {f"http://{host}" for host in hosts}:
            app = _refused("only its own page may ask here", 403)
        await app(scope, receive, guarded)


def day_of(place: Place) -> list[dict[str, Any]]:
    """Return the tasks of a journal in times of day, with when each robot was at work for them, as JSON."""
    history = JournalHistory.read(place)
    told = []
    for id, task in history.tasks.items():
        clock, busy = task.accepted.wall - task.time, dict[str, list[tuple[float, float]]]()
        for run in task.runs:
            for attempt in (history.attempts[request] for sent in run.sent.values() for request in sent):
                end = clock + (history.time if attempt.ended is None else attempt.ended)
                busy.setdefault(run.lane(attempt.action), []).append((clock + attempt.sent, end))
        ended = None if task.ended is None else clock + task.ended
        own = {"id": id.hex, "accepted": task.accepted.wall, "ended": ended, "busy": busy, "plans": task.plans}
        told.append({**named(task), **own, "code": task.ending.code.word if task.ending else "", "reason": task.reason})
    return [{**task, "seconds": (task["ended"] or task["accepted"]) - task["accepted"]} for task in told]


def drawn(run: RunHistory) -> list[dict[str, Any]]:
    """Return where the steps of a plan stand, and their arrows, as JSON: first those of the plan, then what its steps hold."""
    plan, told = run.source.plan, []
    reaching = goal_calls(plan, run.state)
    for name, flow in [("", plan.flow), *((name, flow) for step in plan.every_step for name, flow in held(step))]:
        layout = laid_out(flow, sys.maxsize)
        cells = [
            {"step": index, "column": cell.column, "row": cell.row, "reaches_goal": index in reaching, **words_of(cell.step)._asdict()}
            for index, cell in layout.cells.items()
        ]
        arrows = [{**asdict(arrow), "protects": [*map(fluent_text, arrow.protects)]} for arrow in layout.arrows]
        told.append({"name": name, "cells": cells, "arrows": arrows})
    return told


def goal_calls(plan: PlanGraph, state: KnowledgeBase) -> frozenset[int]:
    """Return the calls that reach the goal from a state if all goes as planned: for each part of it the last that makes it true."""
    from planner_bridge.model.progression import Progression, snapshot  # here, because it takes its time to import

    walk = Progression(snapshot(state), unmet=lambda *_: True)
    read = {part: plan.rules.base(names(part)) for part in conjuncts(plan.goal) if part is not TRUE}
    was, reaching = {part: evaluate(part, walk.state) is True for part in read}, dict[Condition, int]()
    for event in plan.order if read else ():
        changed = {fluent[0] for fluent in walk.advance([(event, plan.calls[event.call].action)])}
        for part in (part for part, on in read.items() if not changed.isdisjoint(on)):
            is_so = evaluate(part, walk.state) is True
            if is_so and not was[part]:
                reaching[part] = event.call
            was[part] = is_so
    return frozenset(call for part, call in reaching.items() if was[part])


def _number(text: str) -> int | None:
    """Return the number that a request has given; None if it has not, or one that is longer than any."""
    return int(text) if text.isdecimal() and len(text) <= _DIGITS else None


def _quoted(text: str) -> str:
    return repr(text[:_DIGITS]) if text else "nothing"


def _refused(why: str, status: int) -> Response:
    return ShownResponse({"refused": why}, status)


# --- frames ---------------------------------------------------------------------------------------
# What is sent to a browser, the whole state or what has changed in it.


_HEAD: Final = ("number", "time", "began", "first", "problem", "clock")
PARTS: Final = tuple(part.name for part in fields(View) if part.name not in _HEAD)
"""The parts of a view that have things by key."""


def frame(before: View | None, after: View) -> dict[str, Any]:
    """Return the frame that makes of what a browser has seen what is so now: the whole state if it has seen nothing.

    In its parts, None stands for what is not there any more.
    """
    parts: dict[str, dict[str, Thing | None]] = {}
    for name in PARTS:
        old: Mapping[str, Thing] = {} if before is None else getattr(before, name)
        new: Mapping[str, Thing] = getattr(after, name)
        if old is not new:
            changes = dict[str, Thing | None].fromkeys(old.keys() - new.keys())
            changes |= {key: thing for key, thing in new.items() if (was := old.get(key)) is not thing and was != thing}
            if changes:
                parts[name] = changes
    return {**{name: getattr(after, name) for name in _HEAD}, "is_whole": before is None, "parts": parts}


# --- commands -------------------------------------------------------------------------------------
# Those who have the token may have them carried out, and nobody else. They go to the process that has started this one: a line of
# JSON for every command, and one for its reply.


_LIMIT: Final = 30.0
"""Seconds for a reply."""
_OPEN: Final = 32
"""Commands that wait for their replies at the same time: their replies fit into a pipe, so nobody waits to write one."""


class Channel:
    """The end of the page. The mutable state is what waits for replies, by the numbers of commands."""

    def __init__(self, write: Callable[[str], None]) -> None:
        self._write = write
        self._numbers = count(1)
        self._waiting: dict[int, asyncio.Future[Reply]] = {}

    async def ask(self, command: Mapping[str, Any]) -> Reply:
        """Send a command on, and return the reply."""
        if len(self._waiting) >= _OPEN:
            return Reply("too much is asked for at once; try again in a moment")
        number = next(self._numbers)
        replied: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
        self._waiting[number] = replied
        try:
            self._write(json.dumps({"number": number, "command": command}))
            async with asyncio.timeout(_LIMIT):
                return await replied
        except TimeoutError:
            return Reply(f"there was no answer within {_LIMIT:g} s; the order may still be carried out")
        except BrokenPipeError:
            return Reply("the process that has the tasks has ended")
        finally:
            del self._waiting[number]

    def hear(self, line: str) -> None:
        """Take in a line from the other end, on the event loop."""
        heard = json.loads(line)
        waiting = self._waiting.get(heard["number"])
        if waiting is not None and not waiting.done():
            waiting.set_result(Reply(**heard["reply"]))


_MAX_BODY: Final = 4 * MAX_TEXT
_LEVELS: Final = 8
"""The depth of a nested value that may be a command."""
_TYPE: Final = "application/json"
"""Of bodies: no form of another page can have it."""


@dataclass(frozen=True)
class Control:
    """The controls of the page: what, by whom, and how."""

    what: Controlled
    token: str
    channel: Channel
    turn: asyncio.Lock = field(default_factory=asyncio.Lock)
    """Held while something is explained: one thing after the other."""

    async def look(self, request: Request) -> Response:
        """Answer with what may be controlled."""
        return self._refusal(request) or ShownResponse({"what": self.what.value})

    async def do(self, request: Request, world: Callable[[], Awaitable[KnowledgeBase]], known: KnownRobots) -> Response:
        """Have a command carried out, and answer with the reply; goals are explained, and looked at, from a world."""
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
        is_look = isinstance(command, dict) and command.get("do") == "look"
        if is_look and self.turn.locked():  # whoever types goes on to do so, and asks again
            return _refused("another goal is looked at just now", 503)
        reply = await self.channel.ask(command)
        if reply.problem:
            from planner_bridge.explanations.goal_now import answered  # here, because it takes its time to import

            try:
                async with self.turn:  # in this process, because it takes a processor, which the tasks need
                    if is_look:
                        return ShownResponse(await asyncio.to_thread(looked_at, reply.problem, await world(), known))
                    answers = await asyncio.to_thread(answered, reply.problem, await world())
                return ShownResponse({"answers": [answer.as_json() for answer in answers]})
            except PnmError as error:
                return _refused(str(error), 409)
        told = {name: value for name, value in reply.as_json().items() if name != "problem" and value != {}}
        return ShownResponse(told, 409 if reply.refused else 200)

    def _refusal(self, request: Request) -> Response | None:
        if self.what is Controlled.NOTHING:
            return _refused("this page controls nothing: start it with --view-controls", 403)
        kind, _, given = request.headers.get("authorization", "").partition(" ")
        if kind != "Bearer" or not hmac.compare_digest(given.encode("latin-1", "replace"), self.token.encode()):
            return _refused("this needs the token of the page: it is in the URL that was printed at the start", 403)
        return None


def looked_at(packed: str, world: KnowledgeBase, known: KnownRobots) -> dict[str, Any]:
    """Return what a plan for the goal of a problem that was packed would take, from a world, or why none is found soon, as JSON.

    Its odds are those without a new plan; they, and its seconds, are None where they are not known.
    """
    from planner_bridge.explanations.goal_now import first_plan  # here, because it takes its time to import
    from planner_bridge.pipeline.roll_outs import odds_of_goal
    from planner_bridge.tasks.settings import Settings

    problem, bindings, found = first_plan(packed, world, known.rates)
    if found.plan is None:
        return {"calls": None, "reason": found.reason}
    settings = Settings(bindings=bindings, learned=known.rates)
    told = odds_of_goal(problem, found.plan, settings, known.faults, policy=found.policy, seconds=0.0).told if known else None
    seconds = told.median if told and told.chance else found.plan.makespan if found.plan.temporal else None
    odds = {"chance": percent(told.chance), "rests_on": told.rests} if told else {"chance": None, "rests_on": ""}
    return {"calls": len(found.plan.steps), "seconds": seconds, **odds}


def _is_deep(value: object, levels: int = _LEVELS) -> bool:
    """Return whether a value is nested deeper than commands are: the process that has the tasks reads no such thing."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return levels == 0 or any(_is_deep(entry, levels - 1) for entry in inner)


NO_CONTROL: Final = Control(Controlled.NOTHING, "", Channel(lambda _: None))


def serve_page(
    place: Place,
    opened: socket.socket,
    ended: Callable[[], Awaitable[object]] | None = None,
    control: Control = NO_CONTROL,
    known: KnownRobots = NOTHING_KNOWN,
) -> None:
    """Serve the page of a journal at a socket until a signal ends it, or `ended` does; without `control` nothing can be controlled.

    What is known of robots gives odds.

    A second signal, and one during a page that is slow, leave at once.
    """

    class Server(uvicorn.Server):
        """Tells browsers that nothing more comes, so that they do not hold up the end."""

        async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
            await feed.close()
            await super().shutdown(sockets)

    reader, past = (Reader[Story](place, known) for _ in range(2))
    feed = Feed(reader)
    app = ViewApp(place, feed, past, control, known)
    config = uvicorn.Config(
        app.asgi, log_config=None, log_level="critical", access_log=False, lifespan="off", ws="none", server_header=False
    )
    server = Server(config)

    async def serve() -> None:
        async def wait() -> None:
            if ended is not None:
                await ended()
                server.should_exit = True

        waiting = asyncio.create_task(wait())
        try:
            await server.serve(sockets=[opened])
        finally:
            waiting.cancel()

    with suppress(KeyboardInterrupt):
        asyncio.run(serve())
    reader.close()
    past.close()
    app.close()
