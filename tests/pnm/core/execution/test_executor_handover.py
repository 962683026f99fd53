"""Executors that hand over to another run while requests are open."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from uuid import UUID

import pytest

from pnm.clock import run_async
from pnm.core.execution.events import Begin, Pause, Stop
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import Holds
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction
from pnm.core.machine.requests import Ended
from pnm.core.resources import Resources
from pnm.errors import RunError
from pnm.executor import Executor
from tests.support.runs.handover import SUCCEEDED, ManualClient, carried, going, successor
from tests.support.runs.plan_graphs import plan_of_steps

ACT = GroundAction("act", resources=("arm",), duration=5.0)
LAST = GroundAction("last", resources=("arm",))


# --- executors ---


def test_the_result_is_that_of_the_last_run() -> None:
    def scenario(executor: Executor, server: ManualClient) -> None:
        executor.succeed(successor(executor.run, LAST))
        asyncio.get_running_loop().call_later(3, server.end, "act")
        asyncio.get_running_loop().call_later(5, server.end, "last")

    result = carried(scenario, ACT)
    assert result.goal
    assert [(call.call.action.name, call.outcome, call.ended) for call in result.calls] == [
        ("act", "succeeded", pytest.approx(4.0)),
        ("last", "succeeded", pytest.approx(6.0)),
    ]


def test_a_report_that_waits_in_the_inbox_reaches_the_successor() -> None:
    def scenario(executor: Executor, server: ManualClient) -> None:
        server.end("act")
        executor.succeed(successor(executor.run))

    assert carried(scenario, ACT).goal


def test_a_successor_with_nothing_to_do_ends_at_once() -> None:
    def scenario(executor: Executor, _: ManualClient) -> None:
        executor.succeed(successor(executor.run))

    assert carried(scenario, GroundAction("blocked", precondition=Holds(("seen",)))).goal


def test_nobody_stands_in_line_for_a_run_that_is_succeeded() -> None:
    def scenario(executor: Executor, server: ManualClient) -> None:
        pool = executor.run.resources
        assert len(pool.line) == 1
        executor.succeed(successor(executor.run))
        assert ([claim.names for claim in pool.held], pool.line) == ([("arm",)], ())
        server.end("act")

    assert carried(scenario, ACT, LAST).goal


def test_a_pause_goes_on_in_the_successor() -> None:
    def scenario(executor: Executor, server: ManualClient) -> None:
        executor.run.handle(Pause(), 1.0)
        executor.succeed(successor(executor.run, LAST))
        server.end("act")
        loop = asyncio.get_running_loop()
        loop.call_later(5, lambda: states.append((executor.run.paused, [*server.reporters])))
        loop.call_later(6, executor.resume)
        loop.call_later(7, server.end, "last")

    states: list[object] = []
    assert carried(scenario, ACT).goal
    assert states == [(True, ["act"])]


def refusing(match: str, change: Callable[[Executor, ManualClient], Run]) -> Callable[[Executor, ManualClient], None]:
    """Try to go on with another run; then end all that is open."""

    def scenario(executor: Executor, server: ManualClient) -> None:
        old, new = executor.run, change(executor, server)
        with pytest.raises(RunError, match=match):
            executor.succeed(new)
        assert executor.run is old
        for name in server.reporters:
            server.end(name)

    return scenario


def then(executor: Executor, event: Stop | Pause) -> Run:
    """A successor that was made before the run was told something."""
    new = successor(executor.run)
    executor.run.handle(event, 1.0)
    executor.resume()
    return new


def test_nothing_that_is_under_way_is_lost() -> None:
    act, two = GroundAction("act"), GroundAction("two")
    carried(refusing(r"does not take over two\(\)", lambda executor, _: successor(executor.run, taken=1)), act, two)
    carried(refusing("was told to stop", lambda executor, _: then(executor, Stop())), act)
    carried(refusing(r"act\(\)#0 cannot be taken over", lambda executor, _: then(executor, Pause(at_once=True))), act)
    carried(refusing("an id of its own", lambda executor, _: executor.run), act)


def test_a_call_whose_effects_are_looked_for_is_waited_for() -> None:
    effects = (Set(("seen",), Constant(True)),)

    def scenario(executor: Executor, server: ManualClient) -> None:
        executor.run.handle(Ended(executor.run.open_requests[0], SUCCEEDED), 1.0)
        new = successor(executor.run)
        with pytest.raises(RunError, match=r"the effects of act\(\)#0 are still to be looked for"):
            executor.succeed(new)
        executor.run.knowledge.world.update({("seen",): True})

    assert carried(scenario, GroundAction("act", end_effects=effects)).goal


def test_what_is_not_being_carried_out_is_not_succeeded() -> None:
    machine, knowledge = generate(plan_of_steps(ActionCall(0, LAST))), Layered(KnowledgeBase())
    server = ManualClient()
    executor = Executor(Run(machine, knowledge, id=UUID(int=1)), server)

    def refused() -> None:
        with pytest.raises(RunError, match="is not being carried out"):
            executor.succeed(Run(machine, knowledge, id=UUID(int=2)))

    async def main() -> None:
        refused()
        task = asyncio.ensure_future(executor.execute())
        asyncio.get_running_loop().call_soon(refused)  # it listens, but has not begun
        await asyncio.sleep(1)
        server.end("last")
        await task
        refused()

    run_async(main(), virtual=True)


def test_the_resources_of_a_run_that_is_succeeded_are_given_back_but_for_what_goes_on() -> None:
    pool = Resources()
    old = going(ACT, GroundAction("wheel", resources=("base",)), resources=pool)
    waiting = Run(generate(plan_of_steps(ActionCall(0, LAST))), Layered(KnowledgeBase()), id=UUID(int=9), resources=pool)
    waiting.handle(Begin(), 1.0)
    kept, left = old.open_requests
    old.retire([kept])
    assert [claim.names for claim in pool.held if pool.gives(claim)] == [("arm",)]
    assert dict(pool.withheld_from(["arm", "base"])) == {"base": "wheel() of task 00000000"}, "its server is still at work"
    pool.confirm(left)
    assert [claim.names for claim in pool.held] == [("arm",)]
    waiting.retire()
    assert pool.line == ()


def test_changes_of_knowledge_reach_the_successor_alone() -> None:
    def scenario(executor: Executor, server: ManualClient) -> None:
        old = executor.run
        executor.succeed(successor(old, GroundAction("sees", precondition=Holds(("seen",)))))
        old.knowledge.world.update({("seen",): True})
        server.end("act")
        asyncio.get_running_loop().call_later(1, server.end, "sees")

    assert carried(scenario, ACT).goal
