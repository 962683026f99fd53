"""A journal that cannot be written: nothing new is sent, what runs can be cancelled, and it goes on when there is space again."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from pathlib import Path
from uuid import UUID

import pytest

from pnm.clock import run_async
from pnm.core.execution.events import Begin, Cancel, Command, Send, Stop, Tick
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.resources import Resources
from pnm.journal.codec import RECORDS
from pnm.journal.journal import WrittenJournal
from pnm.journal.records import Happened
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps, replayed
from pnm.journal.store import Durability, JournalError, JournalFile, Row
from pnm.tasks import Code, TaskEnding, Wanted


class FullFile(JournalFile):
    """A journal file on a disk that is full at times."""

    is_full = False
    refused = 0

    def append(self, rows: Sequence[Row], parts: Mapping[str, str]) -> None:
        if self.is_full:
            self.refused += 1
            raise JournalError("no space left on device")
        super().append(rows, parts)


class Deployment:
    """A run of two calls, one after the other, and what is done about it."""

    def __init__(self, path: Path) -> None:
        self.file = FullFile(path, Durability.PROCESS_CRASH, 0.0)
        self.journal = WrittenJournal(self.file, RECORDS)
        self.done: list[Command] = []
        world = KnowledgeBase()
        self.journal.begin(world, Resources())
        after = Ordering(PlanEvent(0, Moment.END), PlanEvent(1, Moment.START))
        plan = PlanGraph((ActionCall(0, GroundAction("first")), ActionCall(1, GroundAction("second"))), (after,))
        self.run: Run = self.journal.make_run(
            generate(plan), Layered(world), id=UUID(int=1), bindings=Bindings(), goal_fields=lambda action: None
        )

    def handle(self, event: object) -> None:
        self.journal.handle(self.run, event, asyncio.get_running_loop().time(), self.done.extend)  # type: ignore[arg-type]

    @property
    def sent(self) -> list[str]:
        return [command.request.action.name for command in self.done if isinstance(command, Send)]

    @property
    def cancelled(self) -> list[UUID]:
        return [command.request for command in self.done if isinstance(command, Cancel)]


def test_nothing_is_sent_until_it_is_kept(tmp_path: Path) -> None:
    async def main() -> None:
        deployment = Deployment(tmp_path / "j")
        deployment.handle(Begin())
        assert deployment.sent == ["first"]
        deployment.file.is_full = True
        (first,) = deployment.run.open_requests
        deployment.handle(Ended(first, Outcome(OutcomeKind.SUCCEEDED)))
        await asyncio.sleep(10.0)
        assert deployment.sent == ["first"]
        assert deployment.journal.blocked
        deployment.file.is_full = False
        await asyncio.sleep(2.0)
        assert deployment.sent == ["first", "second"]
        assert not deployment.journal.blocked
        deployment.journal.close()

    run_async(main(), virtual=True)
    replay = replayed(tmp_path / "j", RECORDS)
    assert [str(request.action) for request in replay.requests.values()] == ["first()", "second()"]


def test_what_is_only_heard_is_committed_with_what_comes_next_or_a_moment_later(tmp_path: Path) -> None:
    def kept() -> int:
        return sum(isinstance(step.record, Happened) for step in replay_steps(tmp_path / "j", RECORDS, Replay()))

    async def main() -> None:
        deployment = Deployment(tmp_path / "j")
        deployment.handle(Begin())
        (first,) = deployment.run.open_requests
        deployment.handle(Accepted(first))
        assert kept() == 1
        deployment.handle(Ended(first, Outcome(OutcomeKind.SUCCEEDED)))
        assert kept() == 3, "before the next request is sent, all that led to it is kept"
        assert deployment.sent == ["first", "second"]
        (second,) = deployment.run.open_requests
        deployment.handle(Accepted(second))
        await asyncio.sleep(0.0)
        assert kept() == 4
        deployment.handle(Ended(second, Outcome(OutcomeKind.SUCCEEDED)))
        assert deployment.run.over
        assert kept() == 5, "nobody hears of an end that is not kept"
        deployment.journal.close()

    run_async(main(), virtual=True)


def test_what_runs_can_be_cancelled_meanwhile_and_what_waits_is_not_cancelled_before_it_is_sent(tmp_path: Path) -> None:
    async def main() -> None:
        deployment = Deployment(tmp_path / "j")
        deployment.handle(Begin())
        (first,) = deployment.run.open_requests
        deployment.file.is_full = True
        deployment.handle(Ended(first, Outcome(OutcomeKind.SUCCEEDED)))
        (second,) = deployment.run.open_requests
        await asyncio.sleep(60.0)
        deployment.handle(Stop())
        assert deployment.cancelled == []
        deployment.file.is_full = False
        await asyncio.sleep(2.0)
        kinds = [type(command) for command in deployment.done if isinstance(command, Send | Cancel)]
        assert kinds == [Send, Send, *[Cancel] * len(deployment.cancelled)]
        assert set(deployment.cancelled) <= {second}
        deployment.journal.close()

    run_async(main(), virtual=True)


def test_a_task_is_accepted_as_soon_as_there_is_space_though_nothing_else_was_to_be_kept(tmp_path: Path) -> None:
    async def main() -> None:
        deployment = Deployment(tmp_path / "j")
        await asyncio.sleep(1.0)
        deployment.file.is_full = True
        for _ in range(2):
            with pytest.raises(JournalError, match="no space"):
                deployment.journal.accepted(Wanted(UUID(int=2), "(open door1)"), 1)
            await asyncio.sleep(10.0)
        deployment.file.is_full = False
        deployment.journal.accepted(Wanted(UUID(int=3), "(open door1)"), 2)
        deployment.journal.close()

    run_async(main(), virtual=True)
    assert [*replayed(tmp_path / "j", RECORDS).tasks] == [UUID(int=3)]


def test_a_full_disk_is_tried_once_a_second_however_much_is_to_be_kept(tmp_path: Path) -> None:
    async def main() -> None:
        deployment = Deployment(tmp_path / "j")
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

    run_async(main(), virtual=True)


def test_nobody_hears_how_a_task_has_ended_before_that_is_kept(tmp_path: Path) -> None:
    async def main() -> None:
        deployment, heard = Deployment(tmp_path / "j"), list[str]()
        deployment.journal.accepted(Wanted(UUID(int=1), "goal"), 1)
        deployment.file.is_full = True
        deployment.journal.over(UUID(int=1), TaskEnding(Code.CANCELLED, "by its client"), lambda: heard.append("over"))
        await asyncio.sleep(10.0)
        assert heard == []
        deployment.file.is_full = False
        await asyncio.sleep(2.0)
        assert heard == ["over"]
        deployment.journal.close()

    run_async(main(), virtual=True)
    (task,) = replayed(tmp_path / "j", RECORDS).tasks.values()
    assert task.ending == TaskEnding(Code.CANCELLED, "by its client")
