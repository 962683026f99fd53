"""The commands of the page, who carries them out, and the page in a process of its own beside the command whose journal it shows.

A command goes through the channel of the page's process to the operator in the process that has the tasks.
"""

from __future__ import annotations

import asyncio
import json
import logging
import select
import socket
import subprocess
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
from pathlib import Path
from types import TracebackType
from typing import Any, Final
from uuid import UUID, uuid4

from pnm.errors import InputError, PnmError, not_installed
from pnm.files.process import own_environment, own_python
from pnm.files.yaml_nodes import parse_value
from pnm.tasks import ServedWorld, TaskCommands, TaskRefused, Tasks, TaskState, Wanted

# --- commands -------------------------------------------------------------------------------------
# What people may want on the page, as it comes from a browser; and the reply.


MAX_TEXT: Final = 100_000
"""Characters of a goal, a fact or an answer."""
_LONG: Final = 1_000
"""Characters of a refusal."""
MAX_PROBLEM: Final = 20_000
"""Characters of a problem that is explained: it fits into a pipe with the refusals of others, so nobody waits to write it."""


class Controlled(Enum):
    """The part that the page may control."""

    NOTHING = "nothing"
    RUN = "run"
    """The one task of `pnm run`."""
    NODE = "node"
    """All tasks of a node, and what it knows; it takes goals."""


@dataclass(frozen=True, slots=True)
class Reply:
    """The reply to a command.

    Args:
        refused: why; empty if it was not.
        line: in a text that is wrong, from 1.
        column: in that line, from 1.
        problem: what is to be explained, as it goes from one process to the other; browsers do not get it.
        plans: the hand-written plans that can be started, with the values of their parameters as texts; None for one without a value.
    """

    refused: str = ""
    line: int = 0
    column: int = 0
    problem: str = ""
    plans: Mapping[str, Mapping[str, str | None]] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        """Return it as it is sent: what is long quotes what was wanted."""
        cut = self.refused if len(self.refused) <= _LONG else f"{self.refused[: _LONG - 1]}…"
        return asdict(replace(self, refused=cut.encode("utf-8", "replace").decode()))


def _text(data: Mapping[str, object], name: str) -> str:
    value = data.get(name, "")
    if not isinstance(value, str) or len(value) > MAX_TEXT:
        raise InputError(f"expected a text of {MAX_TEXT} characters at most under {name!r}")
    try:
        value.encode()
    except UnicodeEncodeError as error:
        raise InputError(f"expected a text under {name!r}, found half of a character") from error
    return value


def _texts(data: Mapping[str, object], name: str) -> tuple[str, ...]:
    values = data.get(name, [])
    if not isinstance(values, list):
        raise InputError(f"expected a list of texts under {name!r}")
    return tuple(_text({name: value}, name) for value in values)


def _flag(data: Mapping[str, object], name: str) -> bool:
    value = data.get(name)
    if not isinstance(value, bool):
        raise InputError(f"expected true or false under {name!r}")
    return value


def _id(data: Mapping[str, object], name: str) -> UUID:
    try:
        return UUID(_text(data, name))
    except ValueError as error:
        raise InputError(f"expected an id under {name!r}") from error


def _task(data: Mapping[str, object]) -> UUID | None:
    return _id(data, "task") if data.get("task") else None


_COMMANDS: Final = (
    *("check", "why", "look", "goal", "plans", "start", "pause", "resume", "cancel", "take", "give", "step", "settle", "tell", "answer"),
)
"""The values of ``do``."""
_CONFIRMED: Final = ("pause", "resume", "cancel", "take", "give", "step")
"""Those that robots have to confirm."""

# --- place ----------------------------------------------------------------------------------------

_HOST: Final = "127.0.0.1"
_COMING: Final = 1024
"""Connections that may come at once, as after a restart when all browsers come back."""


def listening(port: int) -> socket.socket:
    """Return a socket for the page at a port, any free one for 0; raise an `InputError` if that is in use, or an extra is not installed."""
    try:
        import starlette  # noqa: F401
        import uvicorn  # noqa: F401, an extra, like starlette
    except ModuleNotFoundError as error:
        raise not_installed("the page", error, "view") from error
    opened = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        opened.bind((_HOST, port))
        opened.listen(_COMING)
    except OSError as error:
        opened.close()
        raise InputError(f"the page cannot be at port {port}: {error.strerror}; --view=0 takes any that is free") from error
    return opened


def url_of(opened: socket.socket) -> str:
    """Return where the page is."""
    return f"http://{_HOST}:{opened.getsockname()[1]}"


# --- operator -------------------------------------------------------------------------------------
# The operator: carries out the commands of a page in the process that has the tasks, in the ways that other clients have as well.


_SOON: Final = 2.0
"""Seconds for what robots have to confirm; what takes longer goes on, and the page shows what comes of it."""

_log = logging.getLogger(__name__)


class Operator:
    """Carries out commands on the event loop of the tasks; without a world there is only the one task that was begun.

    The mutable state is the commands that take their time.
    """

    def __init__(self, tasks: Tasks, commands: TaskCommands, world: ServedWorld | None = None) -> None:
        self._tasks = tasks
        self._commands = commands
        self._world = world
        self._going_on: set[asyncio.Task[Reply]] = set()

    async def reply(self, data: object) -> Reply:
        """Carry out a command, and return the reply to it, at the latest when it has begun."""
        try:
            if not isinstance(data, Mapping):
                raise InputError("expected an object with the command under 'do'")
            work = asyncio.ensure_future(self._carry_out(data))
            self._going_on.add(work)
            work.add_done_callback(self._going_on.discard)
            done, _ = await asyncio.wait((work,), timeout=_SOON if data.get("do") in _CONFIRMED else None)
            if done:
                return work.result()

            def log_refusal(work: asyncio.Task[Reply]) -> None:
                if not work.cancelled() and (error := work.exception()):
                    _log.warning("an order from the page is refused: %s", error)

            work.add_done_callback(log_refusal)
        except InputError as error:
            position = error.position
            return Reply(error.message, position.line, position.column) if position else Reply(error.message)
        except (PnmError, TaskRefused) as refusal:
            return Reply(str(refusal))
        except Exception as error:
            _log.exception("a command of the page cannot be carried out")
            return Reply(f"{type(error).__name__}: {error}")
        return Reply()

    async def _carry_out(self, data: Mapping[str, object]) -> Reply:
        """Read a command and carry it out; raise an `InputError` if it is none."""
        match data.get("do"):
            case "why" | "look":  # why a goal cannot be reached from the world as it is, or what a plan for it would do, or take
                problem = await self._served.pack(_text(data, "goal"))
                if len(problem) > MAX_PROBLEM:
                    raise InputError("the problem is too large to be explained here; `pnm why` takes it")
                return Reply(problem=problem)
            case "check":
                await self._served.check_goal(_text(data, "goal"))
            case "goal":
                goal, priority = _text(data, "goal"), data.get("priority", 0)
                if not isinstance(priority, int) or isinstance(priority, bool) or not -(2**31) <= priority < 2**31:
                    raise InputError("expected a whole number under 'priority'")
                await self._served.check_goal(goal)
                self._begin(Wanted(uuid4(), goal, priority))
            case "plans":
                plans = self._tasks.plans()
                texts = {
                    name: {
                        known: value if value is None or isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)
                        for known, value in given.items()
                    }
                    for name, given in plans.items()
                }
                return Reply(plans=texts)
            case "start":
                name, given = _text(data, "plan"), data.get("given", {})
                if name not in self._tasks.plans() or not isinstance(given, Mapping):
                    raise InputError(f"expected a plan that is loaded under 'plan', and parameters under 'given', found {name[:40]!r}")
                values = {str(key): parse_value(_text(given, key), key) for key in given}
                self._begin(Wanted(uuid4(), name, parameters=values, is_plan=True))
            case "pause":
                await self._commands.pause(_task(data), at_once="at_once" in data and _flag(data, "at_once"))
            case "resume":
                await self._commands.resume(_task(data))
            case "cancel":
                await self._commands.cancel(_task(data))
            case "take":  # what may still be at work is said as what is refused
                return Reply(await self._commands.take(_text(data, "name"), reason=_text(data, "reason")))
            case "give":
                await self._commands.give(_text(data, "name"))
            case "step":
                await self._tasks.step(_id(data, "task"))
            case "settle":
                self._tasks.settle(_id(data, "request"), is_done=_flag(data, "is_done"))
            case "tell":
                await self._served.update(_texts(data, "add"), _texts(data, "remove"), _texts(data, "forget"))
            case "answer":
                self._tasks.answer(_id(data, "question"), _text(data, "text"))
            case other:
                raise InputError(f"expected one of {', '.join(_COMMANDS)} under 'do', found {str(other)[:40]!r}")
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


# --- process --------------------------------------------------------------------------------------
# The page in a process of its own, beside the command whose journal it shows: nothing that it does can hold the command up.


_READY: Final = 60.0
"""Seconds in which the process has to say where the page is."""
_ENDS: Final = 5.0
"""Seconds in which it has to end."""


class PageProcess:
    """The page, at a port of this computer, until it is closed or this process is dead.

    The mutable state is whether it knows its journal, and who carries out what people want on it, on which event loop.

    Args:
        port: where it is; any that is free for 0.
        controlled: what those may control who have its token, which is in its URL then.

    Raises:
        InputError: the port is in use, or what serves the page is not installed.
    """

    def __init__(self, port: int, controlled: Controlled = Controlled.NOTHING) -> None:
        self._process = subprocess.Popen(
            own_python("-m", "planner_bridge.view", str(port), controlled.value),
            env=own_environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C is for the command, which ends the page
        )
        assert self._process.stdout is not None
        is_said = select.select([self._process.stdout], [], [], _READY)[0]
        self.url: Final = self._process.stdout.readline().strip() if is_said else ""
        self._is_told = False
        self._operator: tuple[Operator, asyncio.AbstractEventLoop] | None = None
        self._working: set[asyncio.Task[None]] = set()
        self._writing = threading.Lock()
        self._reader = threading.Thread(target=self._read, daemon=True)
        if not self.url.startswith("http"):
            self.close()
            raise InputError(self.url or "the page could not be started")
        self._reader.start()

    def follow(self, journal: str, rates: Path | None = None, faults: Path | None = None) -> None:
        """Show a journal, which need not be there yet, and odds by rates or by faults, if there are some; what is named first counts."""
        if not self._is_told:
            self._is_told = True
            self._write({"journal": journal, "rates": rates and str(rates), "faults": faults and str(faults)})

    def operate(self, operator: Operator) -> None:
        """Have an operator carry out, on the event loop that runs here, what people want on the page from now on."""
        self._operator = operator, asyncio.get_running_loop()

    async def ended(self) -> None:
        """Return when the process has ended."""
        over, loop = asyncio.Event(), asyncio.get_running_loop()

        def wait() -> None:
            self._reader.join()
            with suppress(RuntimeError):  # the loop is over already
                loop.call_soon_threadsafe(over.set)

        threading.Thread(target=wait, daemon=True).start()
        await over.wait()

    def close(self) -> None:
        """End the page."""
        with suppress(BrokenPipeError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        try:
            self._process.wait(_ENDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._reader.ident is not None:
            self._reader.join(_ENDS)
        if self._process.stdout is not None:
            self._process.stdout.close()

    def __enter__(self) -> PageProcess:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _read(self) -> None:
        """Have each command that the page sends carried out, and reply to it."""
        assert self._process.stdout is not None
        for line in self._process.stdout:
            wanted = json.loads(line)
            number, refused = wanted["number"], Reply("there is nothing yet that could be controlled")
            if self._operator is not None:
                operator, loop = self._operator
                try:
                    loop.call_soon_threadsafe(self._begin, operator, number, wanted["command"])
                    continue
                except RuntimeError:  # the loop is closed
                    refused = Reply("it is over: nothing is left that could be controlled")
            self._reply(number, refused)

    def _begin(self, operator: Operator, number: int, command: object) -> None:
        async def work() -> None:
            self._reply(number, await operator.reply(command))

        task = asyncio.ensure_future(work())
        self._working.add(task)
        task.add_done_callback(self._working.discard)

    def _reply(self, number: int, reply: Reply) -> None:
        self._write({"number": number, "reply": reply.as_json()})

    def _write(self, value: Any) -> None:
        with self._writing, suppress(BrokenPipeError, ValueError):  # it has ended, or is closed
            if self._process.stdin is not None:
                self._process.stdin.write(f"{json.dumps(value)}\n")
                self._process.stdin.flush()
