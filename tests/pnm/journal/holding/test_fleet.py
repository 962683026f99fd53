"""What the parts of a fleet share in a database: goals, claims and facts."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import Thread
from uuid import UUID, uuid4

import pytest

from pnm.errors import InputError
from pnm.files.database.place import ServerUrl
from pnm.journal.fleet import Fleet
from pnm.journal.kept import JournalError
from pnm.tasks import Code, TaskEnding, Wanted
from tests.support.e2e.hosts.parts import PartJournals
from tests.support.e2e.hosts.postgres import PostgresServer

BRIDGE, FLAG = ("free", "bc"), ("raised",)
Opens = Callable[..., Fleet]


@pytest.fixture
def place(postgres: PostgresServer) -> ServerUrl:
    return ServerUrl.of(postgres.database())


@pytest.fixture
def journals(place: ServerUrl) -> Iterator[PartJournals]:
    journals = PartJournals(place)
    yield journals
    journals.close()


@pytest.fixture
def opens(journals: PartJournals) -> Opens:
    return journals.open


def wanted(**more: object) -> Wanted:
    return Wanted(uuid4(), "(raised)", **more)  # type: ignore[arg-type]


def test_of_many_goals_each_is_taken_by_one_part(opens: Opens) -> None:
    parts = [opens(number, 4) for number in (1, 2, 3, 4)]
    goals = [wanted() for _ in range(200)]
    for goal in goals:
        assert parts[0].add(goal, 0, 1000)
    taken: dict[int, set[UUID]] = {}

    def take(fleet: Fleet) -> None:
        for _ in range(20):
            taken[fleet.part.number] = {one.id for one in fleet.look(5).taken}

    threads = [Thread(target=take, args=(fleet,)) for fleet in parts]
    assert len(parts[0].look(100).taken) == 50, "its share of those that wait"
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(map(len, taken.values())) == len(set().union(*taken.values())) == len(goals)


def test_a_goal_is_begun_until_the_journal_has_it_and_told_at_its_door_when_that_says_how_it_ended(
    opens: Opens, journals: PartJournals
) -> None:
    door, other = opens(1), opens(2)
    goal = wanted(deadline=100.0)
    assert door.add(goal, 2, 1)
    assert not door.add(goal, 2, 10), "the id is known"
    assert not door.add(wanted(), 2, 1), "as many wait as may"
    assert not door.look(5).taken, "it is for the other part"
    for _ in range(2):  # the process that took it first has died
        (taken,) = other.look(5).taken
        assert taken.id == goal.id
        assert taken.deadline is not None
        assert 0.0 < taken.deadline < 100.0
    journals.keep(2, goal)
    assert not other.look(5).taken
    ending = TaskEnding(Code.GOAL_REACHED, "the goal holds")
    journals.keep(2, goal, ending)
    assert not door.look(5).ended
    other.look(5)
    assert door.look(5).ended == [(goal.id, ending)]
    assert not door.look(5).ended
    assert door.of_door() == [(goal, ending)]


def test_a_cancelled_goal_is_not_taken_any_more_or_told_to_the_part_that_has_it(opens: Opens) -> None:
    door, other = opens(1), opens(2)
    ending, waiting, taken = TaskEnding(Code.CANCELLED, "enough"), wanted(), wanted()
    door.add(taken, 0, 10)
    other.look(1)
    door.add(waiting, 0, 10)
    for goal in (waiting, taken):
        door.cancel(goal.id, ending)
    news = other.look(5)
    assert ([one.id for one in news.taken], news.cancelled) == ([taken.id], [taken.id])
    assert door.look(5).ended == [(waiting.id, ending)]


def test_of_two_parts_one_writes_a_fact_and_the_other_knows_it_when_it_may(opens: Opens) -> None:
    first, second = opens(1), opens(2)
    one, two = uuid4(), uuid4()
    assert first.claim(one, (FLAG,), ()) == ([], {})
    assert second.claim(two, (FLAG,), ()) == ([], {}), "both read"
    assert first.claim(one, (), (BRIDGE,)) == ([], {})
    for reads, writes in (((BRIDGE,), ()), ((), (BRIDGE,))):
        (against,), _ = second.claim(two, reads, writes)
        assert against == (one, 1, BRIDGE, True)
    (against,), _ = second.claim(two, (), (FLAG,))
    assert against == (one, 1, FLAG, False)
    assert {claim.fluent for claim in second.others()} == {BRIDGE, FLAG}
    first.changed({BRIDGE: False})
    first.give(one)
    first.look(0)
    assert second.claim(two, (BRIDGE,), (BRIDGE,)) == ([], {BRIDGE: False})
    assert second.look(0).facts == {}


def test_claims_outlive_their_process_as_long_as_the_task(opens: Opens, journals: PartJournals) -> None:
    first, second = opens(1), opens(2)
    lasting, over = wanted(), wanted()
    journals.keep(1, lasting)
    first.claim(lasting.id, (), (BRIDGE,))
    first.claim(over.id, (), (FLAG,))
    second.changed({FLAG: True})
    second.look(0)
    heir = opens(1)
    assert heir.claimed == {BRIDGE}
    assert {claim.fluent for claim in second.others()} == {BRIDGE}
    assert heir.look(0).facts == {FLAG: True}
    first.changed({BRIDGE: True})
    with pytest.raises(JournalError, match="another process has taken over the part 1/2"):
        first.look(5)


def test_a_fleet_of_other_parts_or_files_is_refused(opens: Opens) -> None:
    opens(1)
    for how, told in (({"count": 3}, "begun with 2 parts"), ({"origin": "other"}, "begun with other files")):
        with pytest.raises(InputError, match=told):
            opens(2, **how)


def test_a_lost_connection_is_an_error_until_it_is_waited_for(opens: Opens, postgres: PostgresServer) -> None:
    fleet = opens(1)
    postgres.drop_connections()
    with pytest.raises(JournalError):
        fleet.add(wanted(), 0, 10)
    with pytest.raises(JournalError):
        fleet.wait(0.1)
    fleet.wait(0.1)
    assert fleet.add(wanted(), 0, 10)
