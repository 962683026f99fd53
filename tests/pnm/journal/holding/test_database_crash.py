"""A PostgreSQL that crashes, whose commits are not durable: what was acknowledged is there all the same, each record once."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing, suppress
from itertools import islice
from random import Random
from typing import Any

import pytest

from pnm.files.database.database import Database
from pnm.files.database.place import Place, place_of
from pnm.journal.kept import Damaged, Fenced, JournalError, Rewritten, Row
from pnm.journal.store import JournalFile, KeptJournal
from pnm.journal.tables import LAYOUT
from tests.support.e2e.hosts.crashes import Holder, kill, stop, survive
from tests.support.e2e.hosts.postgres import PostgresServer

CRASHES = 6
"""Of each kind; `python -m tests.pnm.journal.holding --crashes 100` has more."""


@pytest.mark.parametrize("crash", [kill, stop])
def test_what_was_acknowledged_outlives_crashes_of_the_server(crash: Callable[[PostgresServer], None], postgres: PostgresServer) -> None:
    assert survive(place_of(postgres.database()), postgres, crash, seed=1, crashes=CRASHES) > 0, "it has lost what was not durable"


def test_the_lease_outlives_a_crash_that_comes_right_after_it(postgres: PostgresServer) -> None:
    place = place_of(postgres.database())
    file = JournalFile(place, 0.0, 1000.0)
    stop(postgres)
    kept = KeptJournal(place)
    assert kept.holding().epoch == file.epoch
    assert kept.holding().left > 900.0
    kept.close()
    file.close()


def execute(place: Place, sql: str) -> None:
    database = Database(place, LAYOUT)
    driver: Any = database._driver
    driver.run(sql, {})
    database.close()


def test_a_holder_whose_records_were_lost_for_good_ends_by_name_and_writes_nothing(postgres: PostgresServer) -> None:
    place = place_of(postgres.database())
    holder = Holder(place, seed=2)
    holder.work(3)
    holder.reconnect()  # from here on they are durable, and not remembered
    holder.work(1)
    execute(place, "DELETE FROM records WHERE sequence > 2")  # as in a copy that was behind
    for attempt in (lambda: holder.work(1), holder.file.renew):
        with pytest.raises(Fenced, match=r"has lost the records 3 to \d+: .* Nothing is sent any more"):
            attempt()
    kept = KeptJournal(place)
    assert [row.text for _, row in kept.rows()] == holder.kept[:2]
    kept.close()
    holder.file.close()


def test_a_journal_in_which_records_are_missing_says_so(place: Place) -> None:
    file = JournalFile(place, 0.0)
    file.append([Row(0.0, str(number)) for number in range(9)], {})
    file.close()
    execute(place, "DELETE FROM records WHERE sequence IN (1, 4, 5)")
    kept = KeptJournal(place)
    rows = kept.rows()
    assert [number for number, _ in islice(rows, 2)] == [2, 3], "those at the beginning were dropped"
    with pytest.raises(Damaged, match=r"is damaged: the records 4 to 5 are missing; its database has lost them"):
        next(rows)
    kept.close()


def test_whoever_has_read_what_a_crash_has_lost_reads_what_is_there_in_its_place(postgres: PostgresServer) -> None:
    place, random, missed = place_of(postgres.database()), Random(5), 0
    JournalFile(place, 0.0).close()
    kept, read = KeptJournal(place), list[str]()

    def read_on() -> None:
        read.extend(row.text for _, row in kept.rows(len(read)))

    for holder in range(CRASHES):
        file = JournalFile(place, 0.0)
        for commit in range(random.randint(2, 5)):
            file.append([Row(0.0, f"record {number} of commit {commit} of {holder}") for number in range(random.randint(1, 3))], {})
            if random.random() < 0.3:
                file.renew()  # from here on they are durable
        try:
            read_on()
        except Rewritten:
            missed += 1
            read.clear()
            read_on()
        with closing(KeptJournal(place)) as fresh:
            assert read == [row.text for _, row in fresh.rows()]
        kill(postgres)  # the next one goes on with what is left
        file.close()
        with suppress(JournalError):
            kept.last()  # over the connection of before
    kept.close()
    assert missed > 0
