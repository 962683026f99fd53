"""One process writes a journal at a time: the lock of a file, and the lease of a journal in PostgreSQL."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from pnm.files.database.lock import this_process
from pnm.files.database.place import Place, place_of
from pnm.journal.kept import Fenced, HeldByAnother, JournalChoice, JournalError, Row, StandBys
from pnm.journal.lease import Lease, take
from pnm.journal.store import JournalFile, KeptJournal
from tests.support.e2e.hosts.postgres import PostgresServer
from tests.support.processes import LIMIT, Program, until

HOLDER = """
import sys
from pnm.files.database.place import place_of
from pnm.journal.kept import JournalChoice
from pnm.journal.lease import take
held = take(JournalChoice(place_of(sys.argv[1])))
print("taken", flush=True)
sys.stdin.readline()
import time
time.sleep(1000.0)
"""


def try_to_take(place: Place, seconds: float = 1000.0) -> None:
    file, hold = take(JournalChoice(place, lease=seconds))
    hold.release()
    file.close()


@pytest.fixture
def holder(tmp_path: Path) -> Iterator[Program]:
    program = Program(["-c", HOLDER, str(tmp_path / "j")], {})
    program.until(lambda: "taken" in program.out)
    yield program
    program.close()


def test_the_lock_of_a_file_is_free_when_its_process_is_dead_and_not_before(tmp_path: Path, holder: Program) -> None:
    for _ in range(2):
        with pytest.raises(HeldByAnother, match=rf"pid {holder.process.pid} holds the journal .*/j"):
            try_to_take(tmp_path / "j")
        holder.process.send_signal(signal.SIGSTOP)
    holder.process.kill()
    holder.process.wait(LIMIT)
    try_to_take(tmp_path / "j")
    try_to_take(tmp_path / "j")


def test_a_place_is_held_once(place: Place) -> None:
    file, hold = take(JournalChoice(place, lease=1000.0))
    with pytest.raises(HeldByAnother, match=f"pid {os.getpid()} holds the journal"):
        try_to_take(place)
    assert hold.is_mine()
    hold.release()
    file.close()
    try_to_take(place)


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_a_holder_trusts_its_own_clock_from_before_it_asked_and_is_done_earlier_than_others_may_begin(postgres: PostgresServer) -> None:
    place, clock = place_of(postgres.database()), Clock()
    file = JournalFile(place, 0.0, 10.0)
    lease = Lease(file, 10.0, clock.now, clock)
    clock.now += 8.9
    assert lease.is_mine()
    clock.now += 0.2
    assert not lease.is_mine(), "although its database has heard nothing of the time"
    lease.renew()
    assert lease.is_mine()
    file.close()


def test_a_holder_sees_who_stands_by_and_misses_who_does_not_any_more(postgres: PostgresServer, caplog: pytest.LogCaptureFixture) -> None:
    place, clock = place_of(postgres.database()), Clock()
    file = JournalFile(place, 0.0, 10.0)
    lease = Lease(file, 10.0, clock.now, clock)

    def renewed_after(seconds: float) -> StandBys:
        clock.now += seconds
        lease.renew()
        return lease.stand_bys()

    assert renewed_after(9.0) == StandBys(), "one that has always been alone misses nobody"
    other = KeptJournal(place)
    other.wait(0.0)
    assert renewed_after(3.0) == StandBys((this_process(),), 0.0)
    other.close()
    until(lambda: not file._database.do(lambda driver: driver.waiting()))
    assert not renewed_after(3.0).are_missed, "it may be back"
    assert renewed_after(3.0).are_missed
    assert renewed_after(3.0) == StandBys((this_process(),), 9.0)
    assert caplog.text.count("no other node stands by any more") == 1
    other = KeptJournal(place)
    other.wait(0.0)
    assert renewed_after(3.0) == StandBys((this_process(),), 0.0)
    other.close()
    file.close()


def test_a_lease_is_renewed_while_the_event_loop_is_alive_and_not_while_it_hangs(postgres: PostgresServer) -> None:
    place = place_of(postgres.database())

    async def main() -> None:
        file, hold = take(JournalChoice(place, lease=0.5))
        renewed, fenced = asyncio.Queue[None](), asyncio.get_running_loop().create_future()
        hold.keep(lambda: renewed.put_nowait(None), fenced.set_result)
        for _ in range(5):  # for longer than the lease is
            await renewed.get()
        assert hold.is_mine()
        with pytest.raises(HeldByAnother):
            try_to_take(place)
        kept = KeptJournal(place)
        until(lambda: kept.holding().left < 0.0)  # on this thread, which is that of the event loop
        assert not hold.is_mine()
        other, theirs = take(JournalChoice(place, lease=1000.0))
        assert isinstance(await fenced, Fenced)
        assert not hold.is_mine()
        assert theirs.is_mine()
        for one in (file, other, kept):
            one.close()

    asyncio.run(main())


def test_a_server_that_goes_away_is_tried_again_until_it_is_there(postgres: PostgresServer) -> None:
    place = place_of(postgres.database())

    async def main() -> None:
        file, hold = take(JournalChoice(place, lease=1.0))
        renewed = asyncio.Queue[None]()
        hold.keep(lambda: renewed.put_nowait(None), pytest.fail)
        await renewed.get()
        postgres.drop_connections()
        for _ in range(2):
            await renewed.get()
        assert hold.is_mine()
        hold.release()
        file.close()

    asyncio.run(main())


def test_a_server_that_does_not_answer_is_an_error_in_time_and_nothing_is_lost(postgres: PostgresServer) -> None:
    place = place_of(postgres.database())
    file = JournalFile(place, 0.0, 1000.0)
    with postgres.stopped():
        with pytest.raises(JournalError, match=r"cannot be written: .*timed out"):
            file.append([Row(0.0, "a")], {})
        with pytest.raises(JournalError, match="there is no connection"):
            file.append([Row(0.0, "a")], {})
        with pytest.raises(JournalError, match="cannot be reached"):
            file.renew()
    file.renew()
    file.append([Row(0.0, "a"), Row(0.0, "b")], {})
    kept = KeptJournal(place)
    assert [row.text for _, row in kept.rows()] == ["a", "b"]
    kept.close()
    file.close()
