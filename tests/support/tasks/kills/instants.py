"""When a process is killed, and what kills it there."""

from __future__ import annotations

import os
import random
import signal
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NoReturn, TypeAlias

from pnm.journal.kept import Row
from pnm.journal.store import JournalFile


@dataclass(frozen=True, slots=True)
class AtCommit:
    """Just before a commit, or just after it: the process kills itself; commits are counted from its birth."""

    commit: int
    before: bool


@dataclass(frozen=True, slots=True)
class AtMessage:
    """When the robots get a message from it, which are counted from its birth; what it does at that moment is left to chance."""

    message: int


@dataclass(frozen=True, slots=True)
class AtTime:
    """Some seconds after its birth."""

    seconds: float


@dataclass(frozen=True, slots=True)
class DiskFull:
    """The disk is full when the robots get this message, for some seconds; then the process is killed, or goes on."""

    message: int
    seconds: float
    is_killed: bool


Instant: TypeAlias = AtCommit | AtMessage | AtTime | DiskFull

_KINDS: Final = 4


def random_instant(rng: random.Random) -> Instant:
    """Draw an instant: early ones are as likely as all later ones together, so that restarts are killed as well."""
    kind, commits = rng.randrange(_KINDS), rng.choice([rng.randrange(1, 4), rng.randrange(4, 14)])
    match kind:
        case 0:
            return AtTime(rng.uniform(0.005, 0.1))
        case 1:
            return AtMessage(rng.randrange(1, 5))
        case _:
            return AtCommit(commits, before=rng.random() < 0.5)


def die() -> NoReturn:
    """End this process as nothing else than the kernel can."""
    os.kill(os.getpid(), signal.SIGKILL)
    raise AssertionError("it goes on after SIGKILL")


def die_in_journals(instant: AtCommit) -> None:
    """Have this process kill itself at one of the commits of its journal."""
    append, left = JournalFile.append, instant.commit

    def dying(file: JournalFile, rows: Sequence[Row], parts: Mapping[str, str]) -> None:
        nonlocal left
        left -= 1
        if left == 0 and instant.before:
            die()
        append(file, rows, parts)
        if left == 0:
            die()

    JournalFile.append = dying  # type: ignore[method-assign]
