"""Tasks that cannot go on ask a person for help, if that is wanted."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from dataclasses import replace

import pytest

from planner_bridge.tasks.replanning import Limits
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.logic.computed_values import MISSING
from pnm.core.logic.expressions import Fluent, Value
from pnm.core.machine.bindings import Binding, Bindings
from pnm.knowledge.source import SourceError
from pnm.tasks import PROPOSED, Code, TaskState
from tests.support.logic.people import Person
from tests.support.pddl.problems import fleet, rooms
from tests.support.tasks.node import USUAL, simulated
from tests.support.tasks.simulation import TaskSimulation

CLOSED = rooms(init="(at r1 a)", goal="(and)", ways="ab")
"""There is no way to c."""
OPEN = {("way", "b", "c"): True}


def words(question) -> str:
    return str(json.loads(question.meta))


@pytest.fixture
def person() -> Person:
    return Person(words)


def change(simulation: TaskSimulation, facts: Mapping[Fluent, Value]) -> None:
    """Have facts change by themselves, and be known."""
    simulation.backend.robots.world.change(facts)
    simulation.knowledge.update(facts)


async def question(person: Person) -> str:
    async with asyncio.timeout(1000.0):
        return await person.asked.get()


# --- no plan ---


@simulated(CLOSED)
async def test_a_person_is_asked_with_the_reason_and_the_task_goes_on_when_it_is_mended(simulation: TaskSimulation, person: Person) -> None:
    task = simulation.want("(at r1 c)")
    text = await question(person)
    assert text.startswith("This goal cannot be reached: no plan: proved unsolvable: (at r1 c) cannot be reached")
    assert text.endswith("Answer 'try again' when that is mended, or 'give up'.")
    assert simulation.state(task) is TaskState.QUEUED
    assert simulation.seen(task, "blocked", "asks for help: no plan")
    assert (person.askers[0].run, person.askers[0].plan) == (task, "(at r1 c)")
    change(simulation, OPEN)
    person.answer(text, "Try again!")
    await simulation.reaches(task)


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        ("give up", "a person was asked for help, and says to give up"),
        (MISSING, "a person was asked for help, and does not know any"),
        (SourceError("nobody has answered within 60 s"), "help was asked for in vain: nobody has answered within 60 s"),
    ],
)
@simulated(CLOSED)
async def test_without_help_the_task_ends_as_it_would_have_and_says_that_help_was_asked_for(
    simulation: TaskSimulation, person: Person, answer: object, why: str
) -> None:
    task = simulation.want("(at r1 c)")
    open_question = person.open[await question(person)]
    if isinstance(answer, SourceError):
        open_question.set_exception(answer)
    else:
        open_question.set_result(answer)
    assert await simulation.ended_with(task) == [Code.NO_PLAN]
    message = simulation.endings[task].message
    assert message.startswith("no plan: proved unsolvable")
    assert message.endswith(why)


@simulated(CLOSED)
async def test_an_answer_that_means_nothing_is_asked_for_once_more_but_not_for_ever(simulation: TaskSimulation, person: Person) -> None:
    task = simulation.want("(at r1 c)")
    first = await question(person)
    person.answer(first, 42)
    second = await question(person)
    assert second == f"Expected 'try again' or 'give up', found '42'. {first}"
    person.answer(second, "what?")
    person.answer(await question(person), "no")
    assert await simulation.ended_with(task) == [Code.NO_PLAN]
    assert simulation.endings[task].message.endswith("help was asked for in vain: no answer was 'try again' or 'give up'")
    assert len(person.history) == 3


@simulated(CLOSED)
async def test_a_question_is_withdrawn_when_facts_make_a_plan_possible_and_stays_open_when_they_do_not(
    simulation: TaskSimulation, person: Person
) -> None:
    task = simulation.want("(at r1 c)")
    await question(person)
    for room in "abd":
        change(simulation, {("clean", room): True})
        await asyncio.sleep(5.0)
    assert (len(person.history), simulation.state(task)) == (1, TaskState.QUEUED)
    change(simulation, OPEN)
    await person.withdrawn.get()
    await simulation.reaches(task)
    assert len(person.history) == 1


@simulated(CLOSED, chosen=replace(USUAL, limits=Limits(patience=30.0)))
async def test_patience_comes_first(simulation: TaskSimulation, person: Person) -> None:
    task = simulation.want("(at r1 c)")
    await simulation.sees(task, "blocked", "waits 30 s at most for facts to change")
    await asyncio.sleep(20.0)
    assert not person.history
    text = await question(person)
    change(simulation, {("clean", "d"): True})
    await asyncio.sleep(5.0)
    person.answer(text, "give up")  # which is heard at once, and not after another 30 s
    now = asyncio.get_running_loop().time()
    await simulation.ended_with(task)
    assert asyncio.get_running_loop().time() - now < 5.0


# --- what has failed ---


@simulated(fleet(robots=1), faults=Faults((Fault("pick", FaultKind.ABORT, times=4, message="the gripper is stuck"),)))
async def test_what_has_failed_too_often_is_named_and_tried_again_after_help(simulation: TaskSimulation, person: Person) -> None:
    task = simulation.want("(in p0 a2)")
    text = await question(person)
    assert "the gripper is stuck" in text
    assert "it would help if pick(r0, p0, a0) works again" in text
    person.answer(text, "try again")
    person.answer(await question(person), "try again")
    await simulation.reaches(task)


@simulated(
    fleet(robots=1),
    faults=Faults((Fault("pick", FaultKind.LOSE_SERVER),)),
    chosen=replace(USUAL, bindings=Bindings({"pick": Binding(server="/{r}/gripper", retries=0)})),
)
async def test_a_server_that_is_gone_is_named(simulation: TaskSimulation, person: Person) -> None:
    task = simulation.want("(in p0 a2)")
    text = await question(person)
    assert "it would help if the action server /r0/gripper is there again" in text
    person.answer(text, "give up")
    await simulation.ended_with(task)


@simulated(
    rooms(init="(at r1 a)", ways="ab bc"),
    faults=Faults((Fault("move(r1, a, b)", FaultKind.ABORT, times=2),)),
    chosen=replace(USUAL, limits=Limits(replans=1, forbid_after=9)),
)
async def test_when_all_replans_are_used_up_facts_that_change_are_not_enough(simulation: TaskSimulation, person: Person) -> None:
    task = simulation.want("(at r1 c)")
    text = await question(person)
    assert "the limit of 1 replans is reached" in text
    change(simulation, {("clean", "d"): True})
    await asyncio.sleep(10.0)
    assert len(person.history) == 1
    person.answer(text, "try again")
    await simulation.reaches(task)


@simulated(CLOSED)
async def test_a_task_that_only_waits_for_help_keeps_no_other_from_going_on_and_is_cancelled_at_once(
    simulation: TaskSimulation, person: Person
) -> None:
    lower = simulation.want("(at r1 b)")
    higher = simulation.want("(at r1 c)", priority=1)
    text = await question(person)
    await simulation.reaches(lower)
    await simulation.master.cancel(higher)
    assert await simulation.ended_with(higher) == [Code.CANCELLED]
    assert await person.withdrawn.get() == text


@simulated(fleet(robots=1), faults=Faults((Fault("move(r0, a0, a1)", FaultKind.HANG, ignores_cancel=True, times=1),)))
async def test_a_resource_that_is_kept_is_named(simulation: TaskSimulation, person: Person) -> None:
    hung = await simulation.begun("(at r0 a1)")
    await simulation.master.cancel(hung)
    task = simulation.want("(in p0 a2)")
    text = await question(person)
    assert "r0 is kept by move(r0, a0, a1)" in text
    assert "it would help if r0 is given back" in text
    person.answer(text, "give up")
    assert await simulation.ended_with(task) == [Code.SERVER_UNAVAILABLE]


# --- goals that are only proposed ---


@pytest.fixture
def approver() -> Person:
    return Person(words)


@simulated(rooms(init="(at r1 a)", ways="ab bc"))
async def test_a_proposed_goal_is_pursued_after_a_yes_and_nothing_moves_before(simulation: TaskSimulation, approver: Person) -> None:
    task = simulation.want("(at r1\n c)", server=PROPOSED)
    text = await question(approver)
    assert text == "A program proposes the goal (at r1 c). Is it to be pursued? Answer 'yes' or 'no'."
    assert (approver.askers[0].run, approver.askers[0].plan) == (task, "(at r1 c)")
    await simulation.reaches(simulation.want("(at r1 b)"))  # which waits for nobody
    assert (simulation.state(task), simulation.sent(task)) == (TaskState.QUEUED, [])
    approver.answer(text, "Yes.")
    await simulation.reaches(task)
    assert len(approver.history) == 1


@pytest.mark.parametrize(
    ("answer", "why"),
    [
        ("no", "a person was asked, and does not say yes"),
        (MISSING, "a person was asked, and does not say yes"),
        (SourceError("nobody has answered within 60 s"), "nobody says yes: nobody has answered within 60 s"),
    ],
)
@simulated(rooms(init="(at r1 a)", ways="ab"))
async def test_a_proposed_goal_ends_without_a_yes(simulation: TaskSimulation, approver: Person, answer: object, why: str) -> None:
    task = simulation.want("(at r1 b)", server=PROPOSED)
    open_question = approver.open[await question(approver)]
    if isinstance(answer, SourceError):
        open_question.set_exception(answer)
    else:
        open_question.set_result(answer)
    assert await simulation.ended_with(task) == [Code.CANCELLED]
    assert (simulation.endings[task].message, simulation.sent(task)) == (why, [])


@simulated(rooms(init="(at r1 a)", ways="ab"))
async def test_a_proposed_goal_can_be_cancelled_while_a_person_is_asked(simulation: TaskSimulation, approver: Person) -> None:
    task = simulation.want("(at r1 b)", server=PROPOSED)
    text = await question(approver)
    await simulation.master.cancel(task)
    assert await approver.withdrawn.get() == text
    assert simulation.endings[task].code is Code.CANCELLED


@simulated(rooms(init="(at r1 a)", ways="ab"))
async def test_where_nobody_can_be_asked_a_proposed_goal_ends(simulation: TaskSimulation) -> None:
    task = simulation.want("(at r1 b)", server=PROPOSED)
    assert await simulation.ended_with(task) == [Code.CANCELLED]
    assert simulation.endings[task].message == "nobody says yes: there is nobody to be asked"
