"""Robots stop for a pause, and a step lets one request leave in the midst of one."""

from __future__ import annotations

import asyncio

from pnm.actions.simulated_robots import SimulatedRobots, SimulatedWorld, report_changes
from pnm.clock import run_async
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.events import Begin, KnowledgeChanged, Pause, Resume, SingleStep
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.executor import Executor
from tests.support.runs.commands import RUN, accepted, cancelled, sent
from tests.support.runs.plan_graphs import plan, plan_of
from tests.support.runs.simulated import FiringLog, move

SUCCEEDED = Outcome(OutcomeKind.SUCCEEDED)


def test_robots_stop_for_a_pause_and_do_the_rest_after_it() -> None:
    at = ("at", "r1", "hall")
    truth = KnowledgeBase({at: True})
    world, beliefs, log = SimulatedWorld(truth, {"at"}), KnowledgeBase({at: True}), FiringLog()
    robots = SimulatedRobots(world)
    graph = plan_of(move("r1", "hall", "door"), move("r1", "door", "lab"), orders=("0e<1s",))
    run = Run(generate(graph), Layered(beliefs), id=RUN, observer=log)

    async def main() -> RunResult:
        report_changes(world, beliefs)
        executor = Executor(run, robots)
        task = asyncio.ensure_future(executor.execute())
        await asyncio.sleep(2)
        executor.pause(at_once=True)
        await asyncio.sleep(10)
        assert run.paused
        assert truth.value(at) is True
        executor.resume()
        await asyncio.sleep(1)
        executor.pause()
        await asyncio.sleep(30)
        assert run.paused
        assert truth.value(("at", "r1", "door")) is True
        executor.resume()
        return await task

    result = run_async(main(), virtual=True)
    assert result.goal
    assert [call.attempts for call in result.calls] == [2, 1]
    assert truth.value(("at", "r1", "lab")) is True


def test_a_step_lets_one_request_leave_and_the_pause_goes_on() -> None:
    run = Run(generate(plan(3)), Layered(KnowledgeBase()), id=RUN)
    run.handle(Pause(at_once=True), 0.0)
    run.handle(Begin(), 0.0)
    for number in range(3):
        assert sent(run.handle(SingleStep(), 1.0)) == [f"a{number}"]
        assert not run.paused
        assert run.handle(KnowledgeChanged(), 2.0) == []
        (request,) = run.open_requests
        assert cancelled(run.handle(Accepted(request), 2.0)) == []
        assert sent(run.handle(Ended(request, SUCCEEDED), 3.0)) == []
        assert run.paused
    assert run.result().goal


def test_a_step_of_what_is_not_paused_changes_nothing() -> None:
    run = accepted(plan(2, "0e<1s"))
    before = run.marking
    assert run.handle(SingleStep(), 1.0) == []
    assert (run.marking, run.pausing) == (before, None)
    assert sent(run.handle(Ended(run.open_requests[0], SUCCEEDED), 2.0)) == ["a1"]


def test_a_step_with_which_nothing_can_begin_is_used_up() -> None:
    run = accepted(plan(2, "0e<1s"))
    run.handle(Pause(), 1.0)
    assert run.handle(SingleStep(), 2.0) == []
    assert sent(run.handle(Ended(run.open_requests[0], SUCCEEDED), 3.0)) == []
    assert run.paused
    assert sent(run.handle(Resume(), 4.0)) == ["a1"]


def test_a_step_takes_resources_for_its_call_alone_and_leaves_no_claim_in_line() -> None:
    bindings = Bindings({f"a{number}": Binding(resources=("arm",)) for number in range(3)})
    run = Run(generate(plan(3), bindings), Layered(KnowledgeBase()), id=RUN, bindings=bindings)
    run.handle(Pause(), 0.0)
    run.handle(Begin(), 0.0)
    assert sent(run.handle(SingleStep(), 1.0)) == ["a0"]
    assert [*run.resources.line] == []
    assert run.handle(SingleStep(), 2.0) == []
    assert [*run.resources.line] == []
    assert sent(run.handle(Ended(run.open_requests[0], SUCCEEDED), 3.0)) == []
    assert [*run.resources.held] == []
    assert sent(run.handle(SingleStep(), 4.0)) == ["a1"]
