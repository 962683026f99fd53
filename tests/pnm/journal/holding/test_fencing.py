"""A process that may not be the one any more that writes the journal: what was decided is kept, and nothing is done about it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from uuid import UUID

import pytest

from pnm.clock import run_async
from pnm.core.execution.events import Begin, Cancel, Command, Event, Send, Stop
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.resources import Resources
from pnm.journal.codec import RECORDS
from pnm.journal.journal import WrittenJournal
from pnm.journal.kept import Durability, Fenced, Hold, JournalError
from pnm.journal.resume import replayed
from pnm.journal.store import JournalFile
from pnm.tasks import Wanted


class Lapsing(Hold):
    """A right to write that ends and comes back."""

    mine = True
    renewed: Callable[[], None]
    fenced: Callable[[Fenced], None]

    def is_mine(self) -> bool:
        return self.mine

    def keep(self, renewed: Callable[[], None], fenced: Callable[[Fenced], None]) -> None:
        self.renewed, self.fenced = renewed, fenced

    def release(self) -> None:
        """Nothing is to be done."""


class Holder:
    """A run of two calls at the same time, whose process may lose its journal."""

    def __init__(self, path: Path) -> None:
        self.hold = Lapsing()
        self.done: list[Command] = []
        self.fenced: list[Fenced] = []
        file = JournalFile(path, Durability.PROCESS_CRASH, 0.0)
        self.journal = WrittenJournal(file, RECORDS, hold=self.hold, fenced=self.fenced.append)
        world = KnowledgeBase()
        self.journal.begin(world, Resources())
        plan = PlanGraph((ActionCall(0, GroundAction("first")), ActionCall(1, GroundAction("second"))), ())
        self.run = self.journal.make_run(
            generate(plan), Layered(world), id=UUID(int=1), bindings=Bindings(), goal_fields=lambda action: None
        )

    def handle(self, event: Event) -> None:
        self.journal.handle(self.run, event, asyncio.get_running_loop().time(), self.done.extend)

    def left(self, kind: type[Send] | type[Cancel]) -> int:
        """Return how many requests were sent, or cancelled."""
        return sum(isinstance(command, kind) for command in self.done)


def test_nothing_leaves_while_the_lease_may_be_over_and_all_of_it_when_it_is_renewed(tmp_path: Path) -> None:
    async def main() -> None:
        holder = Holder(tmp_path / "j")
        holder.hold.mine = False  # as for a process that was stopped between its commit and what follows from it
        holder.handle(Begin())
        assert (holder.left(Send), holder.journal.may_act()) == (0, False)
        assert len(replayed(tmp_path / "j", RECORDS).requests) == 2
        holder.hold.mine = True
        holder.hold.renewed()
        assert (holder.left(Send), holder.journal.may_act()) == (2, True)
        for request in holder.run.open_requests:
            holder.handle(Accepted(request))
        holder.hold.mine = False
        holder.handle(Stop())
        assert holder.left(Cancel) == 0
        holder.hold.mine = True
        holder.hold.renewed()
        assert holder.left(Cancel) == 2
        holder.journal.close()

    run_async(main(), virtual=True)


@pytest.mark.parametrize("is_told", [True, False], ids=["by the lease", "by a commit"])
def test_a_process_whose_journal_was_taken_over_does_nothing_any_more(tmp_path: Path, is_told: bool) -> None:
    async def main() -> None:
        holder = Holder(tmp_path / "j")
        holder.handle(Begin())
        assert holder.left(Send) == 2
        JournalFile(tmp_path / "j", Durability.PROCESS_CRASH, 0.0).close()
        kept = replayed(tmp_path / "j", RECORDS).requests
        if is_told:
            holder.hold.fenced(Fenced("taken over"))
        first, _ = holder.run.open_requests
        before = len(holder.done)
        for event in (Ended(first, Outcome(OutcomeKind.ABORTED)), Stop()):
            holder.handle(event)
        await asyncio.sleep(60.0)
        assert len(holder.done) == before, "neither another attempt, nor the end of what the other process watches"
        assert not holder.journal.may_act()
        assert len(holder.fenced) == 1
        with pytest.raises(JournalError, match="taken over"):
            holder.journal.accepted(Wanted(UUID(int=2), "late"), 1)
        holder.journal.close()
        assert replayed(tmp_path / "j", RECORDS).requests == kept

    run_async(main(), virtual=True)
