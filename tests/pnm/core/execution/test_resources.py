"""Resources that runs share: who gets them and when, and that nobody has them while waiting for something else."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.model.world import simulated_backend
from pnm.actions.simulated_robots import SimulatedRobots, SimulatedWorld
from pnm.clock import run_async
from pnm.core.execution.events import Answered, Ask, Begin, Command, KnowledgeChanged, Send, Tick
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import Layer, Literal, Operation, Query
from pnm.core.logic.conditions import Computed, Holds
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, Flow, GroundAction, Recovery, Then
from pnm.core.machine.requests import Ended, Outcome, OutcomeKind
from pnm.core.resources import Resources
from pnm.errors import InputError, RunError
from pnm.executor import Executor
from pnm.language.plan import merge_bindings, read_plans
from pnm.language.runner import PlanRunner, Program
from tests.support.runs.commands import begun, sent
from tests.support.runs.plan_graphs import plan_of, plan_of_steps

SUCCEEDED = Outcome(OutcomeKind.SUCCEEDED)


def arm(name: str, **options: object) -> GroundAction:
    return GroundAction(name, resources=("arm",), **options)  # type: ignore[arg-type]


def finish(run: Run) -> list[Command]:
    """Have the first open request succeed."""
    return run.handle(Ended(run.open_requests[0], SUCCEEDED), 1.0)


# --- runs ---


def test_a_call_that_waits_for_an_answer_has_nothing() -> None:
    asking = Bindings({"asks": Binding(goal={"word": "$word"})})
    run, commands = begun(plan_of(arm("asks"), arm("acts")), bindings=asking, asks=True)
    assert sent(commands) == ["acts"]
    (question,) = [command for command in commands if isinstance(command, Ask)]
    assert run.handle(Answered(question.id, "hello"), 1.0) == []
    assert sent(finish(run)) == ["asks"]


def test_whoever_cannot_use_it_yet_leaves_the_line() -> None:
    world = KnowledgeBase(sensed={"ready": 5.0})
    asked = Computed(Operation("eq", (Query(Literal.of("word"), Layer.GLOBAL), Literal.of(1))))
    for condition in (Holds(("ready",)), asked):
        waits = arm("waits", precondition=condition)
        run, commands = begun(plan_of(arm("first"), waits, arm("behind")), world=world, asks=True)
        assert sent(commands) == ["first"]
        assert len(run.resources.line) == 2
        assert sent(finish(run)) == ["behind"], "what the other needs is not known when the arm is free"


def test_what_need_not_be_done_is_not_waited_for() -> None:
    world = KnowledgeBase()
    run, _ = begun(plan_of(arm("first"), arm("second", expected=Holds(("done",)))), world=world)
    world.update({("done",): True})
    run.handle(KnowledgeChanged(), 0.5)
    assert run.resources.line == ()
    finish(run)
    assert [call.outcome for call in run.result().calls] == ["succeeded", "already true"]


def test_a_precondition_is_looked_at_when_the_call_can_start() -> None:
    world = KnowledgeBase(facts={("ready",): False})
    run, commands = begun(plan_of(arm("first"), arm("second", precondition=Holds(("ready",)))), world=world)
    assert sent(commands) == ["first"]
    assert not run.ending
    world.update({("ready",): True})
    assert sent(finish(run)) == ["second"]


def test_a_deadline_counts_while_a_call_waits_for_resources() -> None:
    run, _ = begun(plan_of_steps(ActionCall(0, arm("first")), ActionCall(1, arm("second"), deadline=9.0)))
    run.handle(Tick(), 9.0)
    assert run.resources.line == ()
    finish(run)
    assert [failure.cause for failure in run.result().failures] == ["too_late"]


def test_the_steps_of_a_recovery_take_their_own() -> None:
    mending = ActionCall(1, GroundAction("b", resources=("arm", "leg")))
    recovery = Recovery(frozenset({Cause.ABORTED}), Then.RETRY, Flow((mending,)))
    run, commands = begun(plan_of_steps(ActionCall(0, arm("a"), recoveries=(recovery,))))
    assert sent(commands) == ["a"]
    commands = run.handle(Ended(run.open_requests[0], Outcome(OutcomeKind.ABORTED)), 1.0)
    assert sent(commands) == ["b"]
    assert [one.names for one in run.resources.held] == [("arm", "leg")]
    assert sent(finish(run)) == ["a"]


def test_resources_are_named_after_robots_also_when_the_robot_is_known_late() -> None:
    bindings = Bindings({"move": Binding(resources=("{robot}/base",))})
    known, late = GroundAction("move", ("r1",), ("robot",)), GroundAction("move", ("?robot",), ("robot",))
    assert bindings.resources(known) == ("r1/base",)
    run, _ = begun(plan_of(late, known, GroundAction("move", ("r2",), ("robot",))), bindings=bindings)
    assert [failure.cause for failure in run._results.failures] == ["data_missing"]
    graph, knowledge = plan_of(late, known), Layered(KnowledgeBase(), KnowledgeBase(variables={"robot": "r1"}))
    run = Run(generate(graph, bindings), knowledge, id=UUID(int=1), bindings=bindings)
    assert len(run.handle(Begin(), 0.0)) == 2
    assert [one.names for one in run.resources.held] == [("r1/base",)]
    with pytest.raises(InputError, match=r"the resource '\{who\}/base' of move names \{who\}, which is not a parameter"):
        Bindings({"move": Binding(resources=("{who}/base",))}).resources(known)


def clashes(bindings: Bindings, shared: Callable[[], Resources | None]) -> list[str]:
    """Two runs of one action each with the same robots: what the robots notice."""
    robots = SimulatedRobots(SimulatedWorld(KnowledgeBase(), frozenset()), bindings=bindings)
    machine = generate(plan_of(GroundAction("move", ("r1",), ("robot",), duration=5.0)), bindings)

    async def main() -> None:
        runs = [
            Run(machine, Layered(KnowledgeBase()), id=UUID(int=number), bindings=bindings, resources=shared()) for number in range(1, 4)
        ]
        results = await asyncio.gather(*(Executor(run, robots).execute() for run in runs))
        assert all(result.goal for result in results)

    run_async(main(), virtual=True)
    return robots.clashes


# --- robots ---


def test_robots_notice_when_a_resource_is_used_twice_at_once() -> None:
    bindings = Bindings({"move": Binding(resources=("{robot}/base",))})
    assert clashes(bindings, lambda: None) == [
        "r1/base is used by move(r1) and move(r1) at once",
        "r1/base is used by move(r1) and move(r1) and move(r1) at once",
    ]
    pool = Resources()
    assert clashes(bindings, lambda: pool) == []
    assert clashes(Bindings(), lambda: None) == []


NESTED = """
actions: {lift: {params: [what], duration: 2, resources: [arm]}}
outer: {params: [what], plan: [{lift: {what: cup}}, {inner: {what: {LocalQuery: what}}}]}
inner: {params: [what], plan: [{lift: }, {lift: }]}
"""


TWO_ARMS = """
actions: {lift: {params: [what], duration: 2, resources: [arm]}}
one: {resources: {arm: 2}, plan: [{concurrent_actions: [{lift: {what: plate}}, {lift: {what: spoon}}]}]}
other: {plan: [{concurrent_actions: [{lift: {what: plate}}, {lift: {what: spoon}}]}]}
"""


@pytest.mark.parametrize(
    ("text", "runs", "seconds"),
    [(NESTED, [("outer", {"what": what}) for what in ("plate", "spoon", "fork")], 18.0), (TWO_ARMS, [("other", {})], 2.0)],
    ids=["they take turns", "what one of them says of a resource counts for all"],
)
def test_all_plans_of_a_runner_share_resources(
    text: str, runs: list[tuple[str, dict[str, object]]], seconds: float, tmp_path: Path
) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text(text, encoding="utf-8")
    plans = read_plans(file)
    backend = simulated_backend(next(iter(plans.values())), merge_bindings(plans.values()))
    runner = PlanRunner({name: Program.of(plan) for name, plan in plans.items()}, backend, KnowledgeBase())

    async def main() -> None:
        await backend.open(runner.world)
        results = await asyncio.gather(*(runner.execute(runner.prepare_run(*run)) for run in runs))
        assert all(result.goal for result in results)
        assert asyncio.get_running_loop().time() == pytest.approx(seconds, abs=0.1)
        await backend.close()

    run_async(main(), virtual=True)
    assert backend.robots.clashes == []


def test_a_machine_made_for_other_capacities_is_refused() -> None:
    graph, shared = plan_of(arm("act")), Resources({"arm": 2})
    with pytest.raises(RunError, match="generated for 1 call with arm; 2 may have it"):
        Run(generate(graph), Layered(KnowledgeBase()), id=UUID(int=1), resources=shared)
    machine = generate(graph, capacities=shared.capacities)
    assert Run(machine, Layered(KnowledgeBase()), id=UUID(int=1), resources=shared).machine.capacities == {"arm": 2}


def test_calls_with_open_parameters_need_different_resources_at_the_same_time() -> None:
    bindings = Bindings({"move": Binding(resources=("{robot}/base",))})
    knowledge = Layered(KnowledgeBase(), KnowledgeBase(variables={"robot": "r1"}))
    graph = plan_of(*[GroundAction("move", ("?robot",), ("robot",))] * 2)
    run = Run(generate(graph, bindings), knowledge, id=UUID(int=1), bindings=bindings)
    (first,) = (one for one in run.handle(Begin(), 0.0) if isinstance(one, Send))
    knowledge.local.store({"robot": "r2"})
    (second,) = (one for one in run.handle(KnowledgeChanged(), 1.0) if isinstance(one, Send))
    assert [one.names for one in run.resources.held] == [("r1/base",), ("r2/base",)]
    assert (first.request.action.arguments, second.request.action.arguments) == (("r1",), ("r2",))


def test_a_plan_that_is_called_has_no_resources_itself(tmp_path: Path) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text(NESTED.replace("{LocalQuery: what}}}]", "{LocalQuery: what}}, resources: [arm]}]"), encoding="utf-8")
    with pytest.raises(InputError, match=r"inner is a plan and has no resources \(arm\)"):
        Program.of(read_plans(file)["outer"])
