"""What has happened in a simulation, moment by moment, and its digest: the same seed gives the same digest, wherever it runs."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias, TypeVar
from uuid import UUID

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.requests import OutcomeKind
from pnm.journal.codec import RECORDS, Codec
from pnm.journal.records import Record
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps
from tests.support.runs.simulation.plans import Scenario


@dataclass(frozen=True, slots=True)
class Started:
    """A process has opened the journal: what had it before is fenced off."""

    time: float
    process: str
    epoch: int


@dataclass(frozen=True, slots=True)
class Committed:
    """A process has committed records."""

    time: float
    process: str
    epoch: int
    rows: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Suffered:
    """Something has happened to a process, to its disk, or to a server."""

    time: float
    who: str
    what: str


@dataclass(frozen=True, slots=True)
class Sent:
    """A process has sent a request, or asked for one again that another process may have sent."""

    time: float
    process: str
    task: UUID
    request: UUID
    call: str
    is_again: bool = False


@dataclass(frozen=True, slots=True)
class CancelSent:
    """A process has asked for a request to be cancelled."""

    time: float
    process: str
    request: UUID


@dataclass(frozen=True, slots=True)
class Heard:
    """A report about a request has reached a process; its end if there is a kind."""

    time: float
    process: str
    request: UUID
    report: str
    kind: OutcomeKind | None = None


@dataclass(frozen=True, slots=True)
class Began:
    """A robot has begun to carry out a request; `life` counts the restarts of its server."""

    time: float
    request: UUID
    call: str
    life: int


@dataclass(frozen=True, slots=True)
class Finished:
    """A robot has come to the end of a request, with this truth behind what it reports."""

    time: float
    request: UUID
    kind: OutcomeKind


@dataclass(frozen=True, slots=True)
class Lied:
    """A server has reported an end that is not so, or that is another one."""

    time: float
    request: UUID
    call: str
    kind: OutcomeKind


Moment: TypeAlias = Started | Committed | Suffered | Sent | CancelSent | Heard | Began | Finished | Lied
M = TypeVar("M")


@dataclass
class Story:
    """The whole of a simulation. The mutable state is all but the scenario."""

    scenario: Scenario
    codec: Codec = RECORDS
    moments: list[Moment] = field(default_factory=list)
    truth: KnowledgeBase = field(default_factory=KnowledgeBase)
    """The true world in the end."""
    clashes: list[str] = field(default_factory=list)
    """Resources that more requests used at once than may, by the robots' own log."""
    beliefs: KnowledgeBase | None = None
    """What the last process knew of the world in the end."""
    records: list[Record] = field(default_factory=list)
    """Those of the journal that is left."""
    replay: Replay = field(default_factory=Replay)
    """Of them."""
    failures: list[str] = field(default_factory=list)
    """Errors of our processes that nothing has handled, and tasks that have not ended."""

    def of(self, kind: type[M]) -> Iterator[M]:
        """Yield the moments of a kind."""
        return (moment for moment in self.moments if isinstance(moment, kind))

    def read(self, journal: Path) -> None:
        """Read the journal that is left, and replay it."""
        try:
            self.records.extend(step.record for step in replay_steps(journal, self.codec, self.replay))
        except Exception as error:
            self.failures.append(f"the journal that is left cannot be replayed: {type(error).__name__}: {error}")

    @property
    def digest(self) -> str:
        """The digest of everything."""
        digest = hashlib.sha256()
        for entry in (*self.moments, *self.failures, *self.clashes, *map(self.codec.text, self.records)):
            digest.update(f"{entry!r}\n".encode())
        return digest.hexdigest()
