"""Agents: clients of `pnm mcp` by the official SDK."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any

from mcp import Client, StdioServerParameters

from tests.support.files import ROOT


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
