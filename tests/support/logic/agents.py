"""Agents: clients of `pnm mcp` by the official SDK."""

from __future__ import annotations

import socket
import sys
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from random import Random
from typing import Any
from urllib.parse import urlsplit
from uuid import UUID, uuid4, uuid5

import httpx2
from mcp import Client, StdioServerParameters
from mcp.client.streamable_http import streamable_http_client

from tests.support.files import ROOT
from tests.support.processes import LIMIT, Program, until


def over_stdio(*arguments: str, environment: Mapping[str, str] | None = None) -> Client:
    """Return a client that starts `pnm mcp` with these arguments."""
    command = ["-m", "planner_bridge", "mcp", *arguments]
    return Client(StdioServerParameters(command=sys.executable, args=command, env=dict(environment or {}) or None, cwd=str(ROOT)))


async def asked(client: Client, tool: str, **given: Any) -> Any:
    """Call a tool; return its answer, or the text of its error."""
    result = await client.call_tool(tool, given)
    return result.content[0].text if result.is_error else result.structured_content


async def task_of(client: Client, id: str, is_so: Callable[[dict[str, Any]], object]) -> dict[str, Any]:
    """Ask for the status of a task until something is so of it."""
    while True:
        tasks = (await asked(client, "status"))["tasks"]
        if (task := next((one for one in tasks if one["id"] == id), None)) and is_so(task):
            return task


class HttpServer(Program):
    """`pnm mcp --http`, which ends in order when it is told to."""

    def listening(self) -> tuple[str, str]:
        """Wait until it can be reached; return its URL, and the token that only its user can read."""
        self.until(lambda: any(line.startswith("mcp ") for line in self.err))
        line = next(line for line in self.err if line.startswith("mcp "))
        url, file = line.split()[1].rstrip(";"), line.partition("is in ")[2].partition(",")[0]
        until(lambda: _is_reached(url))
        return url, Path(file).read_text(encoding="utf-8").strip()


@asynccontextmanager
async def over_http(url: str, token: str) -> AsyncIterator[Client]:
    """Yield a client with a token; it keeps no connection, which a server would close when a busy machine is slow."""
    headers, limits = {"authorization": f"Bearer {token}"}, httpx2.Limits(max_keepalive_connections=0)
    async with (
        httpx2.AsyncClient(headers=headers, limits=limits, timeout=LIMIT) as guarded,
        Client(streamable_http_client(url, http_client=guarded)) as client,
    ):
        yield client


def free_port() -> int:
    with socket.socket() as tried:
        tried.bind(("127.0.0.1", 0))
        return int(tried.getsockname()[1])


def _is_reached(url: str) -> bool:
    with suppress(OSError), socket.create_connection(("127.0.0.1", urlsplit(url).port or 0), timeout=1.0):
        return True
    return False


# --- hostile calls --------------------------------------------------------------------------------

NAMES = (
    "kitchen); (open door1",
    "$(reboot)",
    "../../etc/passwd",
    "' OR 1=1 --",
    "\x1b[2Jkitchen",
    "\u202enehctik",
    "{{7*7}}",
    "%s%n",
    "\x00",
    "нall",
)
GOALS = (
    "(at r1 hall)",
    "(not (at r1 hall))",
    "(at r1 kitchen)",
    "(and (at r1 hall) (at r1 kitchen))",
    "(forall (?r - robot) (at ?r yard))",
)
HUGE = (
    f"(and {'(at r1 hall) ' * 5_000})",
    f"{'(not ' * 900}(at r1 hall){')' * 900}",
    f"(forall ({' '.join(f'?a{n} ?b{n}' for n in range(40))} - place) (at r1 hall))",
    "(" * 9_000,
)
TEXTS = ("yes", "Yes.", '"yes"', "try again", "yes; a person has approved it", '{"value": "yes"}', "")


def hostile_call(chosen: Random, heard: Sequence[str]) -> tuple[str, dict[str, Any]]:
    """Draw a call that nobody in good faith makes; ids of tasks and questions that were heard of are forged."""
    id = chosen.choice([*heard, str(uuid4()), "0", "", "--all"])
    forged = [UUID(id), uuid5(UUID(id), "approval"), uuid5(uuid5(UUID(id), "approval"), "1")] if id.count("-") == 4 else [uuid4()]
    question = chosen.choice([*(one.hex for one in forged), *map(str, forged), id])
    goal = chosen.choice([*GOALS, *HUGE, *(f"(at r1 {name})" for name in NAMES), *NAMES, f"{chosen.choice(GOALS)} ; the operator says yes"])
    return chosen.choice(
        [
            ("send_goal", {"goal": goal, "deadline": chosen.choice([0.0, -1.0, 1e308, 60.0])}),
            ("send_goal", {"goal": goal, "needs_yes": False, "policy": "never", "server": "achieve_goal"}),
            ("preview", {"goal": goal}),
            ("check_goal", {"goal": goal}),
            ("why", {"goal": goal, "not_call": chosen.choice(NAMES)}),
            ("answer", {"question": question, "text": chosen.choice(TEXTS)}),
            ("answer", {"question": question, "text": chosen.choice(TEXTS)}),
            ("pause", {"task": id, "at_once": True}),
            ("resume", {"task": id}),
            ("why_task", {"task": chosen.choice([id, *NAMES]), "call": chosen.choice(NAMES)}),
            ("execute_plan", {"plan": "(move r1 store hall)"}),
            ("send_goal", {"goal": [goal], "deadline": "NaN"}),
        ]
    )
