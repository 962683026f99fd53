"""Facts that two parts of a fleet share, as the tasks of both see them."""

from __future__ import annotations

from collections.abc import Iterator
from uuid import UUID, uuid4

import pytest

from planner_bridge.node.fleet import FleetClaims
from planner_bridge.ordering.interference import ReadWriteSets
from planner_bridge.tasks.task import Task
from pnm.core.knowledge_base import KnowledgeBase
from pnm.files.database.place import ServerUrl
from pnm.journal.fleet import Fleet
from pnm.journal.journal import NO_JOURNAL
from pnm.tasks import TaskListener, Wanted
from tests.support.e2e.hosts.parts import PartJournals
from tests.support.e2e.hosts.postgres import PostgresServer

BRIDGE, OWN = ("free", "bc"), ("at", "r1", "a")
NEEDED = ReadWriteSets({BRIDGE: frozenset({True}), OWN: frozenset({True})}, writes={BRIDGE: frozenset({True, False})})


class Side:
    """A part: its knowledge, and its claims."""

    def __init__(self, fleet: Fleet) -> None:
        self.fleet, self.due = fleet, 0
        self.world = KnowledgeBase({BRIDGE: True})
        self.claims = FleetClaims(fleet, self.world, lambda fluent: fluent[0] == "free", self._is_due)

    def _is_due(self) -> None:
        self.due += 1

    def look(self) -> None:
        self.claims.record(self.fleet.look(0).facts)


@pytest.fixture
def journals(postgres: PostgresServer) -> Iterator[PartJournals]:
    journals = PartJournals(ServerUrl.of(postgres.database()))
    yield journals
    journals.close()


def task(id: UUID | None = None) -> Task:
    return Task(Wanted(id or uuid4(), "(cross)"), 1, TaskListener(), lambda: 0.0, NO_JOURNAL)


def test_a_task_waits_for_one_of_another_part_and_knows_then_what_that_has_changed(journals: PartJournals) -> None:
    first, second, one, two = Side(journals.open(1)), Side(journals.open(2)), task(), task()
    assert first.claims.take(one, lambda: NEEDED) == ()
    (conflict,) = second.claims.take(two, lambda: NEEDED) or ()
    assert str(conflict) == f"{one.id.hex[:8]} of part 1: it has claimed (free bc)"
    assert not conflict.yields
    assert conflict.footprint.writes.keys() == {BRIDGE}
    assert second.claims.others() == (conflict,)
    first.world.update({BRIDGE: False, OWN: True})
    first.claims.give(one.id)
    assert first.due == 2
    first.look()
    assert second.claims.take(two, lambda: NEEDED) is None, "its plan is of another world"
    assert second.world.value(BRIDGE) is False
    assert OWN not in second.world.facts()
    assert second.due == 0, "what another part says is not said again"
    assert second.claims.take(two, lambda: NEEDED) == ()
    assert second.claims.others() == ()


def test_what_is_about_robots_only_needs_no_claim(journals: PartJournals) -> None:
    fleet = journals.open(1)
    side = Side(fleet)
    fleet.close()
    assert side.claims.take(task(), lambda: ReadWriteSets({OWN: frozenset({True})})) == ()
    (conflict,) = side.claims.take(task(), lambda: NEEDED) or ()
    assert "cannot be reached" in str(conflict)
    assert side.claims.others() == ()


def test_the_heir_of_a_part_says_what_its_tasks_have_changed(journals: PartJournals) -> None:
    first, second = Side(journals.open(1)), Side(journals.open(2))
    wanted = Wanted(uuid4(), "(cross)")
    journals.keep(1, wanted)
    assert first.claims.take(task(wanted.id), lambda: NEEDED) == ()
    fleet = journals.open(1)  # its process is dead, and had told nobody
    heir = FleetClaims(fleet, KnowledgeBase({BRIDGE: False}), lambda _: True, lambda: None)
    heir.record(fleet.look(0).facts)
    second.look()
    assert second.world.value(BRIDGE) is False
