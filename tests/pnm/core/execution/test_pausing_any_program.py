"""Pauses are proved and survived whatever the program, on simulated robots as well."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from random import Random
from uuid import UUID

import pytest
from hypothesis import given, settings, strategies as st

from pnm.actions.simulated_robots import SimulatedRobots, SimulatedWorld, report_changes
from pnm.clock import run_async
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.events import Begin, Event, KnowledgeChanged, Pause, Resume, SingleStep
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.guards import Always, CancelAsked, PauseAsked
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind
from pnm.core.machine.verification.part import Unsound
from pnm.core.machine.verification.verify import explore, verify
from pnm.executor import Executor
from tests.support.runs.commands import accepted, cancelled, sent
from tests.support.runs.plan_graphs import plan, plan_of
from tests.support.runs.simulated import FiringLog, move
from tests.support.yaml.chaos import Chaos, in_use
from tests.support.yaml.programs import only_plan, programs

RUN = UUID(int=1)
SUCCEEDED = Outcome(OutcomeKind.SUCCEEDED)


# --- the proof ---


@pytest.mark.parametrize("guard", [Always(), CancelAsked()])
def test_only_pauses_may_have_a_call_begin_anew_for_ever(guard: Always | CancelAsked) -> None:
    machine = generate(plan(1))
    explore(machine)
    (name,) = [name for name, rule in machine.rules.items() if isinstance(rule.guard, PauseAsked)]
    mutant = replace(machine, rules={**machine.rules, name: machine.rules[name]._replace(guard=guard)})
    for prove in (explore, verify):
        if isinstance(guard, CancelAsked):
            # behind `stop`, which is open whenever it is: it never fires
            prove(mutant)
            continue
        with pytest.raises(Unsound, match="round for ever"):
            prove(mutant)


def test_a_round_beside_that_of_a_pause_is_found() -> None:
    machine = generate(plan(1))
    mutant = replace(machine, net=replace(machine.net, outputs={**machine.net.outputs, "a0()#0 aborted": {"a0()#0 ready": 1}}))
    for prove in (explore, verify):
        with pytest.raises(Unsound, match="round for ever"):
            prove(mutant)


# --- runs on robots ---


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


class Pausing(Chaos):
    """Pauses, steps and resumes as well, up to some time."""

    pauses = 12
    has_stepped = False
    """Whether the last event was a step."""

    def _next(self) -> Event:
        self.has_stepped = bool(self.run.pausing) and self.random.random() < 0.1
        return SingleStep() if self.has_stepped else self._other()

    def _other(self) -> Event:
        if self.run.pausing and (self.random.random() < 0.2 or not (self.queues or self.wake)):
            return Resume()
        if not self.run.pausing and self.pauses and self.random.random() < 0.1:
            self.pauses -= 1
            return Pause(at_once=self.random.random() < 0.6)
        return super()._next()


# --- any program ---


@pytest.mark.timeout(600)
@settings(max_examples=30)
@given(programs(), st.integers(0, 2**32))
def test_any_program_that_is_paused_and_resumed_ends_and_loses_no_token(text: str, seed: int) -> None:
    found = only_plan(text)
    machine = generate(found.graph, found.bindings, on_failure=found.on_failure)
    random = Random(seed)
    world = KnowledgeBase(found.facts, objects=found.objects, rules=found.rules)
    knowledge = Layered(world, KnowledgeBase(variables=found.variables))
    run = Run(machine, knowledge, id=RUN, bindings=found.bindings, asks=random.random() < 0.7)
    chaos = Pausing(run, knowledge, random)
    open_before: set[UUID] = set()
    was_pausing = False
    for _ in chaos.drive():
        for place, tokens in run.marking.items():
            assert tokens == 1 or place in machine.record_places, f"{place} holds {tokens} tokens"
        for name, used in in_use(chaos.requests).items():
            assert used <= found.graph.capacities.get(name, 1), f"{name} is used by {used} calls"
        assert {one for claim in run.resources.held for one in claim.names} >= in_use(chaos.requests).keys()
        if was_pausing and run.pausing:
            begun = set(run.open_requests) - open_before
            assert len(begun) <= chaos.has_stepped, "nothing starts during a pause but what a step lets leave"
        if run.paused:
            assert (run.resources.line, run.open_requests) == ((), ())
            assert {claim.request for claim in run.resources.held} <= chaos.requests.keys()
        open_before, was_pausing = set(run.open_requests), run.pausing is not None
    assert run.resources.line == ()
    assert {claim.request for claim in run.resources.held} <= chaos.requests.keys(), "only servers that may be at work keep any"
    assert all(run.marking[place] == machine.initial[place] for place in machine.resource_places)
    ended = {place: tokens for place, tokens in run.marking.items() if place not in machine.record_places}
    assert ended == ({machine.goal_place: 1} if run.result().goal else {machine.failed_place: 1})


# --- steps -------------------------------------------------------------------------------------


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
