"""Commands: what people may want on the page, as it comes from a browser; and the reply."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from enum import Enum
from typing import Any, Final, TypeAlias
from uuid import UUID

from pnm.errors import InputError

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
class CheckGoal:
    """A goal to be checked only: mistakes are reported."""

    goal: str


@dataclass(frozen=True, slots=True)
class ExplainGoal:
    """Say why a goal cannot be reached from the world as it is, or what a plan for it would do."""

    goal: str


@dataclass(frozen=True, slots=True)
class SendGoal:
    """Begin a task for a goal."""

    goal: str
    priority: int


@dataclass(frozen=True, slots=True)
class PauseTask:
    """Pause a task, or all."""

    task: UUID | None
    at_once: bool


@dataclass(frozen=True, slots=True)
class ResumeTask:
    """Let a task go on, or all."""

    task: UUID | None


@dataclass(frozen=True, slots=True)
class CancelTask:
    """End a task, or all."""

    task: UUID | None


@dataclass(frozen=True, slots=True)
class StepTask:
    """Let one request of a paused task leave."""

    task: UUID


@dataclass(frozen=True, slots=True)
class SettleRequest:
    """Have a request that is under way count as done, or as failed."""

    request: UUID
    is_done: bool


@dataclass(frozen=True, slots=True)
class TellFacts:
    """Record facts as so, as not so, and as unknown."""

    add: tuple[str, ...]
    remove: tuple[str, ...]
    forget: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class AnswerQuestion:
    """Answer a question to a person."""

    question: UUID
    text: str


Command: TypeAlias = (
    CheckGoal | ExplainGoal | SendGoal | PauseTask | ResumeTask | CancelTask | StepTask | SettleRequest | TellFacts | AnswerQuestion
)


@dataclass(frozen=True, slots=True)
class Reply:
    """The reply to a command.

    Args:
        refused: why; empty if it was not.
        line: in a text that is wrong, from 1.
        column: in that line, from 1.
        problem: what is to be explained, as it goes from one process to the other; browsers do not get it.
    """

    refused: str = ""
    line: int = 0
    column: int = 0
    problem: str = ""

    def as_json(self) -> dict[str, Any]:
        """Return it as it is sent: what is long quotes what was wanted."""
        cut = self.refused if len(self.refused) <= _LONG else f"{self.refused[: _LONG - 1]}…"
        return asdict(replace(self, refused=cut.encode("utf-8", "replace").decode()))


def read_command(data: object) -> Command:
    """Read a command; raise an `InputError` if it is none."""
    if not isinstance(data, Mapping):
        raise InputError("expected an object with the command under 'do'")
    read = _READERS.get(str(data.get("do")))
    if read is None:
        raise InputError(f"expected one of {', '.join(_READERS)} under 'do', found {str(data.get('do'))[:40]!r}")
    return read(data)


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


def _priority(data: Mapping[str, object]) -> int:
    value = data.get("priority", 0)
    if not isinstance(value, int) or isinstance(value, bool) or not -(2**31) <= value < 2**31:
        raise InputError("expected a whole number under 'priority'")
    return value


def _id(data: Mapping[str, object], name: str) -> UUID:
    try:
        return UUID(_text(data, name))
    except ValueError as error:
        raise InputError(f"expected an id under {name!r}") from error


def _task(data: Mapping[str, object]) -> UUID | None:
    return _id(data, "task") if data.get("task") else None


_READERS: Final[Mapping[str, Callable[[Mapping[str, object]], Command]]] = {
    "check": lambda data: CheckGoal(_text(data, "goal")),
    "why": lambda data: ExplainGoal(_text(data, "goal")),
    "goal": lambda data: SendGoal(_text(data, "goal"), _priority(data)),
    "pause": lambda data: PauseTask(_task(data), "at_once" in data and _flag(data, "at_once")),
    "resume": lambda data: ResumeTask(_task(data)),
    "cancel": lambda data: CancelTask(_task(data)),
    "step": lambda data: StepTask(_id(data, "task")),
    "settle": lambda data: SettleRequest(_id(data, "request"), _flag(data, "is_done")),
    "tell": lambda data: TellFacts(_texts(data, "add"), _texts(data, "remove"), _texts(data, "forget")),
    "answer": lambda data: AnswerQuestion(_id(data, "question"), _text(data, "text")),
}
"""The values of ``do``."""
