"""Crashes of a PostgreSQL under a process that keeps records, and the check of what is left."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from random import Random

from pnm.files.database.place import Place
from pnm.journal.kept import JournalError, Row
from pnm.journal.store import JournalFile, KeptJournal
from tests.support.e2e.hosts.postgres import PostgresServer
from tests.support.processes import until


def kill(server: PostgresServer) -> None:
    server.kill_a_backend()
    server.wait_ready()


def stop(server: PostgresServer) -> None:
    server.stop_at_once()
    server.start_again()


class Holder:
    """A process that keeps records in random portions. The mutable state is what was acknowledged, and what was not."""

    def __init__(self, place: Place, seed: int) -> None:
        self.random = Random(seed)
        self.file = JournalFile(place, 0.0, 1000.0)
        self.kept: list[str] = []
        self.waiting: list[str] = []

    def work(self, commits: int) -> None:
        """Keep records, and renew the lease at times."""
        for _ in range(commits):
            number = len(self.kept) + len(self.waiting)
            self.waiting += [str(number + one) for one in range(self.random.randint(1, 4))]
            self.file.append([Row(0.0, text) for text in self.waiting], {f"part {number}": "whole"})
            self.kept, self.waiting = self.kept + self.waiting, []
            if self.random.random() < 0.1:
                self.file.renew()

    def reconnect(self) -> None:
        """Renew the lease until that succeeds."""

        def renewed() -> bool:
            with suppress(JournalError):
                self.file.renew()
                return True
            return False

        until(renewed)


def survive(place: Place, server: PostgresServer, crash: Callable[[PostgresServer], None], seed: int, crashes: int) -> int:
    """Crash a server several times, and check what is left each time; return how many records had to be written again."""
    holder, kept, lost = Holder(place, seed), KeptJournal(place), 0
    for number in range(crashes):
        holder.work(holder.random.randint(1, 30))
        crash(server)
        with suppress(JournalError):
            kept.last()  # over the connection of before
        lost += len(holder.kept) - kept.last()
        with suppress(JournalError):  # nobody knows whether that was committed
            holder.work(1)
        holder.reconnect()
        assert [(sequence, row.text) for sequence, row in kept.rows()] == [*enumerate(holder.kept, 1)], f"crash {number} of seed {seed}"
        assert kept.part("part 0") == "whole"
    holder.file.close()
    kept.close()
    return lost
