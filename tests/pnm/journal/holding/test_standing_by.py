"""Standing by: a process replays a journal while another one writes it, and goes on with it when that one is gone."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from uuid import UUID

import pytest

from planner_bridge.tasks.result import TASKS
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.resources import Resources
from pnm.errors import InputError
from pnm.files.database.place import Place, place_of
from pnm.journal.journal import WrittenJournal
from pnm.journal.kept import JournalChoice, JournalError, Row
from pnm.journal.records import KnowledgeDelta, SharedBegan, TaskAccepted, knowledge_now
from pnm.journal.resume import Follower, Taken, stand_by, take_up
from pnm.journal.store import JournalFile
from pnm.tasks import Wanted
from tests.support.e2e.hosts.postgres import PostgresServer
from tests.support.processes import until

OTHER = Wanted(UUID(int=2), "(other)")


def begun(taken: Taken, world: KnowledgeBase, origin: str = "here") -> WrittenJournal:
    journal = taken.write()
    journal.begin(world, Resources(), began=SharedBegan({}, origin=origin))
    return journal


def test_a_process_that_stands_by_goes_on_with_all_that_was_kept(place: Place) -> None:
    async def main() -> None:
        world, waits = KnowledgeBase(), asyncio.Queue[str]()
        first = begun(take_up(JournalChoice(place), TASKS, "here"), world)
        standing = asyncio.ensure_future(stand_by(JournalChoice(place), TASKS, "here", waits.put_nowait))
        assert "pid" in await waits.get()
        for number in range(20):
            world.update({("seen", str(number)): True})
        first.accepted(OTHER, 1)
        first.close()
        second = await standing
        assert waits.empty()
        assert second.replay is not None
        assert second.replay.world.facts() == world.facts()
        assert [task.accepted.wanted for task in second.replay.unfinished] == [OTHER]
        second.write().close()

    run_async(main())


def drop(server: PostgresServer, is_missed: Callable[[], bool]) -> None:
    server.drop_connections()
    until(is_missed)


def cut(server: PostgresServer, is_missed: Callable[[], bool]) -> None:
    with server.stopped():
        until(is_missed)


def restart(server: PostgresServer, is_missed: Callable[[], bool]) -> None:
    server.stop_at_once()
    until(is_missed)
    server.start_again()


@pytest.mark.parametrize("harm", [drop, cut, restart])
def test_a_process_whose_connection_is_lost_goes_on_standing_by(
    harm: Callable[[PostgresServer, Callable[[], bool]], None], postgres: PostgresServer, caplog: pytest.LogCaptureFixture
) -> None:
    place = place_of(postgres.database())

    def is_missed() -> bool:
        return "it is tried again" in caplog.text

    async def main() -> None:
        world, waits = KnowledgeBase(), asyncio.Queue[str]()
        taken = take_up(JournalChoice(place, lease=1000.0), TASKS, "here")
        first = begun(taken, world)
        standing = asyncio.ensure_future(stand_by(JournalChoice(place), TASKS, "here", waits.put_nowait))
        holder = await waits.get()
        await asyncio.to_thread(harm, postgres, is_missed)
        again = asyncio.ensure_future(waits.get())
        await asyncio.wait((again, standing), return_when=asyncio.FIRST_COMPLETED)
        assert again.done(), standing
        assert await again == holder, "that it stands by again is said"
        assert caplog.text.count("it is tried again") == 1, "and what is wrong once"
        with suppress(JournalError):  # the connection of the holder was lost as well
            taken.file.renew()
        taken.file.renew()
        first.accepted(OTHER, 1)
        first.close()
        second = await standing
        assert second.replay is not None
        assert [task.accepted.wanted for task in second.replay.unfinished] == [OTHER]
        second.write().close()

    run_async(main())


def test_a_process_that_has_another_world_does_not_stand_by(place: Place) -> None:
    async def main() -> None:
        first = begun(take_up(JournalChoice(place), TASKS, "here"), KnowledgeBase())
        with pytest.raises(InputError, match=r"pid \d+ holds .*, for another domain, problem or world"):
            await stand_by(JournalChoice(place), TASKS, "there", pytest.fail)
        with pytest.raises(InputError, match=r"pid \d+ holds the journal"):
            take_up(JournalChoice(place), TASKS, "here")
        first.close()

    run_async(main())


def test_a_place_that_cannot_be_used_is_an_error_at_once(tmp_path: Path) -> None:
    for place, what in ((tmp_path, "it cannot be a journal"), (place_of("postgresql://127.0.0.1:1/none"), "refused")):
        with pytest.raises(InputError, match=what):
            run_async(stand_by(JournalChoice(place), TASKS, "here", pytest.fail))


def cut_after_commit(file: JournalFile) -> None:
    """Have the answer to the next commit get lost."""
    driver: Any = file._database._driver
    run = driver.run

    def lost(sql: str, values: Any) -> Any:
        answer = run(sql, values)
        if sql == "COMMIT":
            raise TimeoutError("no answer")
        return answer

    driver.run = lost


def test_what_was_committed_without_an_answer_is_there_once_and_who_has_read_it_begins_again(postgres: PostgresServer) -> None:
    place = place_of(postgres.database())
    file = JournalFile(place, 0.0, 1000.0)
    world = KnowledgeBase()
    seen = [KnowledgeDelta(0, {("seen", name): True}, {}) for name in "abc"]

    def rows(*records: Any) -> list[Row]:
        return [Row(0.0, TASKS.text(record)) for record in records]

    file.append(rows(SharedBegan({}), knowledge_now(0, world), seen[0]), {})
    follower = Follower(place, TASKS)
    cut_after_commit(file)
    with pytest.raises(JournalError, match="no answer"):
        file.append(rows(seen[1], TaskAccepted(OTHER, 1, 0.0)), {})
    follower.catch_up()
    assert follower.unfinished() == ()
    assert list(follower.replay.tasks) == [OTHER.id], "it was committed"
    file.renew()
    file.append(rows(seen[1], seen[2]), {})  # its task was refused meanwhile, for nobody knew
    follower.catch_up()
    assert list(follower.replay.tasks) == []
    assert {fluent[1:] for fluent in follower.replay.world.facts()} == {("a",), ("b",), ("c",)}
    follower.close()
    file.close()
