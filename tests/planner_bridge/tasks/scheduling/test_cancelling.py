"""How tasks end before they have begun much: goals that cannot be read, have no plan, or hold already; deadlines, and cancelling."""

from __future__ import annotations

import asyncio
from uuid import uuid4

import pytest

from planner_bridge.tasks.task_manager import TaskLimits
from planner_bridge.tasks.task_start import MAX_CALLS
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding
from pnm.tasks import Code, TaskListener, TaskRefused, TaskState, Wanted
from tests.support.tasks.node import everything_needs, robots_of, simulated
from tests.support.tasks.simulation import TaskSimulation


@pytest.mark.parametrize("deadline", [0.0, 0.5, 1.5])
@simulated()
async def test_a_goal_that_is_not_reached_in_time_is_given_up(simulation: TaskSimulation, deadline: float):
    task = simulation.want("(in p0 a2)", deadline=deadline)
    assert await simulation.ended_with(task) == [Code.DEADLINE_MISSED]
    await simulation.reaches(simulation.want("(in p0 a2)"))


@simulated()
async def test_a_goal_that_waits_can_be_cancelled_and_misses_its_deadline(simulation: TaskSimulation):
    one, two, three = simulation.want("(at r0 a2)"), simulation.want("(at r0 a1)"), simulation.want("(at r0 a3)", deadline=1.0)
    await simulation.sees(two, "state", "waits")
    await simulation.master.cancel(two)
    assert await simulation.ended_with(one, two, three) == [Code.GOAL_REACHED, Code.CANCELLED, Code.DEADLINE_MISSED]


@simulated()
async def test_a_task_is_cancelled_only_when_the_servers_have_confirmed_it(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    await simulation.master.cancel(task)
    assert simulation.endings[task].code is Code.CANCELLED
    assert len(simulation.seen(task, "ended")) == 1


@simulated(faults=Faults((Fault("move", FaultKind.HANG, ignores_cancel=True, times=1),)))
async def test_a_task_that_is_left_alone_when_the_process_ends_is_cancelled_and_no_error(simulation: TaskSimulation):
    task = await simulation.begun("(at r0 a2)")
    work, cancelling = simulation.master._work[task], asyncio.ensure_future(simulation.master.cancel(task, why="the node is shut down"))
    for _ in range(2):  # the second time is what the end of the loop does
        await asyncio.sleep(0.5)
        work.cancel()
    await cancelling
    assert await simulation.ended_with(task) == [Code.CANCELLED]
    assert simulation.endings[task].message == "the node is shut down; its calls are left alone"
    await asyncio.sleep(20.0)  # its executor gives the server up, here where the process goes on
    simulation.wrong.clear()


@simulated(faults=Faults((Fault("move(r0, a0, a1)", FaultKind.HANG, ignores_cancel=True),)))
async def test_what_a_request_has_that_was_given_up_is_not_used_by_others_and_they_find_another_way(simulation: TaskSimulation):
    first = await simulation.begun("(at r0 a1)")
    await simulation.master.cancel(first)
    assert simulation.seen(first, "withheld", "keeps r0 until its server reports the end")
    second = simulation.want("(in p0 a1)")
    assert await simulation.ended_with(second) == [Code.GOAL_REACHED]
    (failure,) = simulation.seen(second, "failed")
    assert f"r0 is kept by move(r0, a0, a1) of task {first.hex[:8]}, which has not confirmed that it is over" in failure.text
    assert {word.split("(")[1].split(",")[0] for word in simulation.sent(second)} == {"r1"}
    third = simulation.want("(has r0 p0)")
    assert await simulation.ended_with(third) == [Code.SERVER_UNAVAILABLE], "no other robot will do"
    assert "move(r0, ?, ?)" in simulation.endings[third].message
    assert simulation.endings[third].message.endswith(
        f"r0 is kept by move(r0, a0, a1) of task {first.hex[:8]}, which has not confirmed that it is over"
    )
    assert not simulation.sent(third)


@simulated(
    faults=Faults((Fault("move(r0, a0, a1)", FaultKind.SLOW, ignores_cancel=True, times=1),)),
    chosen=everything_needs("{r}", move=Binding(resources=("{r}",), retries=0, cancel=2.0)),
)
async def test_what_a_request_has_that_was_given_up_is_free_when_its_server_reports_late(simulation: TaskSimulation):
    first = await simulation.begun("(at r0 a1)")
    await simulation.master.cancel(first)
    second = simulation.want("(has r0 p0)")
    assert await simulation.ended_with(second) == [Code.GOAL_REACHED]
    assert simulation.seen(second, "sent")[0].time >= 10.0 - 0.1, "when the first one has ended indeed"


@simulated(
    faults=Faults(
        (
            Fault("move(r0, a0, a1)", FaultKind.SLOW, ignores_cancel=True, times=1),
            Fault("move(r1, a1, a0)", FaultKind.SLOW, times=1),
            Fault("pick(r1, p0, a0)", FaultKind.ABORT),
        )
    ),
    chosen=everything_needs(
        "{r}", move=Binding(resources=("{r}",), retries=0, cancel=2.0), pick=Binding(resources=("{r}",), retries=0, accept=3.0)
    ),
)
async def test_what_was_waited_for_in_vain_is_planned_with_again_when_it_is_free(simulation: TaskSimulation):
    first = await simulation.begun("(at r0 a1)")
    await simulation.master.cancel(first)
    second = simulation.want("(in p0 a1)")
    await simulation.sees(second, "failed", "r0 is kept")
    await simulation.reaches(second)
    assert robots_of(simulation, second) == {"r0", "r1"}


@simulated()
async def test_what_is_not_there_cannot_be_paused_resumed_or_cancelled(simulation: TaskSimulation):
    task = simulation.want("(at r0 a0)")
    await simulation.ended_with(task)
    for deed in (simulation.master.cancel, simulation.master.resume, lambda one: simulation.master.pause(one, at_once=True)):
        with pytest.raises(TaskRefused, match="is over"):
            await deed(task)
        with pytest.raises(TaskRefused, match="there is no task"):
            await deed(uuid4())


# --- goals that cannot be ---


@simulated()
async def test_the_goal_of_the_problem_is_told_in_pddl(simulation: TaskSimulation):
    simulation.master._read_goal = lambda _: simulation.read("(at r0 a1)")
    task = simulation.want("")
    assert simulation.master.status()[0].goal == "(at r0 a1)"
    await simulation.ended_with(task)


@simulated()
async def test_a_plan_as_a_text_that_has_parameters_or_too_many_calls_is_refused_and_one_that_is_not_there(simulation: TaskSimulation):
    with_parameters = simulation.want("(move r0 a0 a1)", is_plan=True, parameters={"speed": 1})
    unknown = simulation.want("tour", is_plan=True)
    long = simulation.want("(move r0 a0 a1)\n(move r0 a1 a0)\n" * (MAX_CALLS // 2 + 1), is_plan=True)
    assert await simulation.ended_with(with_parameters, unknown, long) == [Code.INVALID_GOAL] * 3
    assert simulation.endings[long].message == f"the plan has {MAX_CALLS + 2} calls; expected {MAX_CALLS} at most"
    assert simulation.endings[with_parameters].message == "a plan that is sent as a text has no parameters; found speed"
    assert "expected a call such as (move r1 hall kitchen), found 'tour'" in simulation.endings[unknown].message


@simulated()
async def test_a_goal_that_holds_is_reached_without_any_call(simulation: TaskSimulation):
    task = simulation.want("(at r0 a0)")
    await simulation.reaches(task)
    assert simulation.sent(task) == []


@simulated(limits=TaskLimits(active=1, queue=1))
async def test_a_full_queue_takes_no_more(simulation: TaskSimulation):
    first, second, third = (simulation.want(f"(in p{n} a{n + 1})") for n in range(3))
    assert await simulation.ended_with(third) == [Code.QUEUE_FULL]
    await simulation.reaches(first, second)
    await simulation.reaches(simulation.want("(in p2 a3)"))


@simulated()
async def test_a_task_of_the_same_id_is_refused_and_the_first_goes_on(simulation: TaskSimulation):
    first = simulation.want("(in p0 a1)")
    ended: list[Code] = []
    simulation.master.listen(type("Ears", (TaskListener,), {"ended": lambda self, task, ending: ended.append(ending.code)})())
    simulation.ended = lambda task, ending: None  # type: ignore[method-assign]
    simulation.master.begin(Wanted(first, "(in p1 a2)"))
    assert ended == [Code.ERROR]
    del simulation.ended
    assert [one.id for one in simulation.master.status() if one.state is not TaskState.OVER] == [first]
    await simulation.reaches(first)
