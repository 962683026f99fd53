"""Goals that cannot be read, have no plan, or hold already."""

from __future__ import annotations

from planner_bridge.tasks.task_manager import TaskLimits
from planner_bridge.tasks.task_start import MAX_CALLS
from pnm.tasks import Code, TaskListener, TaskState, Wanted
from tests.support.tasks.node import simulated
from tests.support.tasks.simulation import TaskSimulation


@simulated()
async def test_a_goal_that_cannot_be_read_ends_at_once_with_the_reason(simulation: TaskSimulation):
    task = simulation.want("nonsense")
    assert await simulation.ended_with(task) == [Code.INVALID_GOAL]
    assert "nonsense" in simulation.endings[task].message


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
