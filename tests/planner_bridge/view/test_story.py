"""The story: what a state alone does not say, told record by record."""

from __future__ import annotations

from uuid import UUID

from planner_bridge.view.story import Story, view_of
from pnm.core.logic.expressions import UNKNOWN
from pnm.journal.records import WORLD, KnowledgeBegan, KnowledgeDelta, SharedBegan, TaskAccepted, TaskNoted
from pnm.knowledge.people import HelpAsked, HelpEnded
from pnm.tasks import Wanted

AT = ("at", "r1", "hall")


def told(*records: object) -> Story:
    """A story of the world, and of records that follow one second after the other."""
    story = Story()
    for number, record in enumerate((SharedBegan({}), KnowledgeBegan(WORLD, {AT: True}, sensed={"at": 0.5}), *records), 1):
        story.apply(number, float(number), record)
    return story


def test_what_is_not_reported_any_more_says_what_it_was() -> None:
    stale = told(KnowledgeDelta(WORLD, {AT: UNKNOWN})).facts["(at r1 hall)"]
    assert (stale["value"], stale["was"], stale["source"], stale["since"]) == ("unknown", "true", "sensed", 3.0)
    still = told(KnowledgeDelta(WORLD, {AT: UNKNOWN}), KnowledgeDelta(WORLD, {AT: UNKNOWN})).facts["(at r1 hall)"]
    assert (still["value"], still["was"]) == ("unknown", "true")
    again = told(KnowledgeDelta(WORLD, {AT: UNKNOWN}), KnowledgeDelta(WORLD, {AT: False})).facts["(at r1 hall)"]
    assert (again["value"], again["was"]) == ("false", "")


def test_the_clock_is_known_from_a_task_on() -> None:
    assert told().clock is None
    accepted = TaskAccepted(Wanted(UUID(int=1), "(at r1 hall)"), 1, 1000.0)
    assert told(accepted).clock == 997.0
    assert view_of(told(accepted)).clock == 997.0


def test_questions_about_lost_requests_stand_beside_those_how_to_go_on() -> None:
    task, one, other = UUID(int=1), UUID(int=8), UUID(int=9)
    records = [
        TaskAccepted(Wanted(task, "(at r1 hall)"), 1, 1000.0),
        TaskNoted(task, HelpAsked(one, "Was it carried out?", ("yes", "no"), one)),
        TaskNoted(task, HelpAsked(other, "How does it go on?")),
        TaskNoted(task, HelpEnded("a person says so", one)),
        TaskNoted(task, HelpEnded("a person says that it is to be tried again")),
    ]
    asked = [{name: question["choices"] for name, question in told(*records[:count]).questions.items()} for count in range(2, 6)]
    assert asked[1] == {one.hex: ("yes", "no"), other.hex: ("try again", "give up")}
    assert asked[0] == {one.hex: ("yes", "no")}
    assert asked[2:] == [{other.hex: ("try again", "give up")}, {}]
