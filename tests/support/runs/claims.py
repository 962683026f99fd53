"""Claims on resources."""

from __future__ import annotations

from uuid import UUID

from pnm.core.execution.events import Command, Send
from pnm.core.execution.resources import Claim


def claim(number: int, *names: str, priority: int = 0, task: int | None = None) -> Claim:
    return Claim(UUID(int=number if task is None else task), UUID(int=number), priority, names)


def names(commands: list[Command]) -> list[str]:
    return [command.request.action.name for command in commands if isinstance(command, Send)]
