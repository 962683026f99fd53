"""A journal that cannot be written, or may not: nothing new is sent, what runs can be cancelled, and it goes on when it can."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from uuid import UUID

import pytest

from pnm.core.execution.events import Begin, Cancel, Command, Event, Send, Stop, Tick
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.resources import Resources
from pnm.journal.codec import RECORDS
from pnm.journal.journal import WrittenJournal
from pnm.journal.kept import Fenced, Hold, JournalError, Row
from pnm.journal.records import Happened
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps, replayed
from pnm.journal.store import JournalFile
from pnm.tasks import Code, TaskEnding, Wanted
from tests.support.runs.plan_graphs import plan_of


class FullFile(JournalFile):
    """A journal file on a disk that is full at times."""

    is_full = False
    refused = 0

    def append(self, rows: Sequence[Row], parts: Mapping[str, str]) -> None:
        if self.is_full:
            self.refused += 1
            raise JournalError("no space left on device")
        super().append(rows, parts)


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


class Deployment:
    """A run of two calls, at the same time or by these orders one after the other, and what is done about it."""

    def __init__(self, path: Path, *orders: str) -> None:
        self.path, self.file, self.hold = path, FullFile(path, 0.0), Lapsing()
        self.done: list[Command] = []
        self.fenced: list[Fenced] = []
        self.journal = WrittenJournal(self.file, RECORDS, hold=self.hold, fenced=self.fenced.append)
        world = KnowledgeBase()
        self.journal.begin(world, Resources())
        machine = generate(plan_of(GroundAction("first"), GroundAction("second"), orders=orders))
        self.run = self.journal.make_run(machine, Layered(world), id=UUID(int=1), bindings=Bindings(), goal_fields=lambda action: None)

    def handle(self, event: Event) -> None:
        self.journal.handle(self.run, event, asyncio.get_running_loop().time(), self.done.extend)

    def succeeded(self, request: UUID) -> None:
        self.handle(Ended(request, Outcome(OutcomeKind.SUCCEEDED)))

    @property
    def sent(self) -> list[str]:
        return [command.request.action.name for command in self.done if isinstance(command, Send)]

    @property
    def cancelled(self) -> list[UUID]:
        return [command.request for command in self.done if isinstance(command, Cancel)]

    def kept(self) -> int:
        """Return how many events of the run are kept."""
        return sum(isinstance(step.record, Happened) for step in replay_steps(self.path, RECORDS, Replay()))


@asynccontextmanager
async def deployed(path: Path, *orders: str) -> AsyncIterator[Deployment]:
    """A deployment, whose journal is closed afterwards."""
    deployment = Deployment(path, *orders)
    yield deployment
    deployment.journal.close()


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "j"


IN_TURN = "0e<1s"


# --- a disk that is full ---


async def test_nothing_is_sent_until_it_is_kept(path: Path) -> None:
    async with deployed(path, IN_TURN) as deployment:
        deployment.handle(Begin())
        assert deployment.sent == ["first"]
        deployment.file.is_full = True
        (first,) = deployment.run.open_requests
        deployment.succeeded(first)
        await asyncio.sleep(10.0)
        assert deployment.sent == ["first"]
        assert deployment.journal.blocked
        deployment.file.is_full = False
        await asyncio.sleep(2.0)
        assert deployment.sent == ["first", "second"]
        assert not deployment.journal.blocked
    replay = replayed(path, RECORDS)
    assert [str(request.action) for request in replay.requests.values()] == ["first()", "second()"]


async def test_what_is_only_heard_is_committed_with_what_comes_next_or_a_moment_later(path: Path) -> None:
    async with deployed(path, IN_TURN) as deployment:
        deployment.handle(Begin())
        (first,) = deployment.run.open_requests
        deployment.handle(Accepted(first))
        assert deployment.kept() == 1
        deployment.succeeded(first)
        assert deployment.kept() == 3, "before the next request is sent, all that led to it is kept"
        assert deployment.sent == ["first", "second"]
        (second,) = deployment.run.open_requests
        deployment.handle(Accepted(second))
        await asyncio.sleep(0.0)
        assert deployment.kept() == 4
        deployment.succeeded(second)
        assert deployment.run.over
        assert deployment.kept() == 5, "nobody hears of an end that is not kept"


async def test_what_runs_can_be_cancelled_meanwhile_and_what_waits_is_not_cancelled_before_it_is_sent(path: Path) -> None:
    async with deployed(path, IN_TURN) as deployment:
        deployment.handle(Begin())
        (first,) = deployment.run.open_requests
        deployment.file.is_full = True
        deployment.succeeded(first)
        (second,) = deployment.run.open_requests
        await asyncio.sleep(60.0)
        deployment.handle(Stop())
        assert deployment.cancelled == []
        deployment.file.is_full = False
        await asyncio.sleep(2.0)
        kinds = [type(command) for command in deployment.done if isinstance(command, Send | Cancel)]
        assert kinds == [Send, Send, *[Cancel] * len(deployment.cancelled)]
        assert set(deployment.cancelled) <= {second}


async def test_a_task_is_accepted_as_soon_as_there_is_space_though_nothing_else_was_to_be_kept(path: Path) -> None:
    async with deployed(path) as deployment:
        await asyncio.sleep(1.0)
        deployment.file.is_full = True
        for _ in range(2):
            with pytest.raises(JournalError, match="no space"):
                deployment.journal.accepted(Wanted(UUID(int=2), "(open door1)"), 1)
            await asyncio.sleep(10.0)
        deployment.file.is_full = False
        deployment.journal.accepted(Wanted(UUID(int=3), "(open door1)"), 2)
    assert [*replayed(path, RECORDS).tasks] == [UUID(int=3)]


async def test_a_full_disk_is_tried_once_a_second_however_much_is_to_be_kept(path: Path) -> None:
    async with deployed(path) as deployment:
        deployment.handle(Begin())
        deployment.file.is_full = True
        for _ in range(100):
            deployment.handle(Tick())
        await asyncio.sleep(0.1)
        at_once = deployment.file.refused
        await asyncio.sleep(10.5)
        assert deployment.file.refused - at_once == 10
        deployment.journal.close()
        refused = deployment.file.refused
        await asyncio.sleep(10.0)
        assert deployment.file.refused == refused, "it is closed"


async def test_nobody_hears_how_a_task_has_ended_before_that_is_kept(path: Path) -> None:
    ending = TaskEnding(Code.CANCELLED, "by its client")
    async with deployed(path) as deployment:
        heard = list[str]()
        deployment.journal.accepted(Wanted(UUID(int=1), "goal"), 1)
        deployment.file.is_full = True
        deployment.journal.over(UUID(int=1), ending, lambda: heard.append("over"))
        await asyncio.sleep(10.0)
        assert heard == []
        deployment.file.is_full = False
        await asyncio.sleep(2.0)
        assert heard == ["over"]
    assert [task.ending for task in replayed(path, RECORDS).tasks.values()] == [ending]


# --- a process that may not be the one any more ---


async def test_nothing_leaves_while_the_lease_may_be_over_and_all_of_it_when_it_is_renewed(path: Path) -> None:
    async with deployed(path) as deployment:
        hold = deployment.hold
        hold.mine = False  # as for a process that was stopped between its commit and what follows from it
        deployment.handle(Begin())
        assert (deployment.sent, deployment.journal.may_act()) == ([], False)
        assert len(replayed(deployment.path, RECORDS).requests) == 2
        hold.mine = True
        hold.renewed()
        assert (deployment.sent, deployment.journal.may_act()) == (["first", "second"], True)
        for request in deployment.run.open_requests:
            deployment.handle(Accepted(request))
        hold.mine = False
        deployment.handle(Stop())
        assert deployment.cancelled == []
        hold.mine = True
        hold.renewed()
        assert len(deployment.cancelled) == 2


@pytest.mark.parametrize("is_told", [True, False], ids=["by the lease", "by a commit"])
async def test_a_process_whose_journal_was_taken_over_does_nothing_any_more(path: Path, is_told: bool) -> None:
    kept: list[object] = []
    async with deployed(path) as deployment:
        deployment.handle(Begin())
        assert deployment.sent == ["first", "second"]
        JournalFile(deployment.path, 0.0).close()
        kept.append(replayed(deployment.path, RECORDS).requests)
        if is_told:
            deployment.hold.fenced(Fenced("taken over"))
        first, _ = deployment.run.open_requests
        before = len(deployment.done)
        for event in (Ended(first, Outcome(OutcomeKind.ABORTED)), Stop()):
            deployment.handle(event)
        await asyncio.sleep(60.0)
        assert len(deployment.done) == before, "neither another attempt, nor the end of what the other process watches"
        assert not deployment.journal.may_act()
        assert len(deployment.fenced) == 1
        with pytest.raises(JournalError, match="taken over"):
            deployment.journal.accepted(Wanted(UUID(int=2), "late"), 1)
    assert [replayed(path, RECORDS).requests] == kept
