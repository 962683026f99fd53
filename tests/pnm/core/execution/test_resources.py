"""Resources that runs share: who gets them and when, and that nobody has them while waiting for something else."""

from __future__ import annotations

import asyncio
import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from dataclasses import replace as changed
from io import StringIO
from pathlib import Path
from random import Random
from uuid import UUID

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planner_bridge.node.simulate import LoggedRobots
from planner_bridge.simulation import simulated_backend
from pnm.actions.simulated_robots import SimulatedRobots
from pnm.actions.simulated_world import SimulatedWorld
from pnm.clock import run_async
from pnm.core.execution.events import Answered, Ask, Begin, Command, KnowledgeChanged, Pause, ResourcesChanged, Resume, Send, Stop, Tick
from pnm.core.execution.resources import Claim, Resources
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import Layer, Literal, Operation, Query
from pnm.core.logic.conditions import Computed, Holds
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, Cause, Flow, GroundAction, PlanGraph, Recovery, Then
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.errors import InputError, RunError
from pnm.executor import Executor
from pnm.language.plan import merge_bindings, read_plans
from pnm.language.runner import Performer, Program
from tests.support.runs.plan_graphs import ordering

SUCCEEDED = Outcome(OutcomeKind.SUCCEEDED)


def claim(number: int, *names: str, priority: int = 0, task: int | None = None) -> Claim:
    return Claim(UUID(int=number if task is None else task), UUID(int=number), priority, names)


# --- the pool ------------------------------------------------------------------------------


def test_a_claim_gets_all_or_nothing() -> None:
    pool = Resources()
    assert pool.take(claim(1, "arm"))
    assert not pool.take(claim(2, "leg", "arm"))
    assert pool.held == (claim(1, "arm"),)
    pool.give(UUID(int=1))
    assert pool.take(claim(2, "leg", "arm"))
    assert pool.line == ()


def test_what_one_ahead_waits_for_is_not_taken_by_one_behind() -> None:
    pool = Resources()
    pool.take(claim(1, "arm"))
    pool.take(claim(2, "arm", "leg"))
    assert not pool.take(claim(3, "leg"))
    assert pool.take(claim(4, "eye"))
    assert pool.take(claim(5, "leg", priority=1)), "but a higher priority is ahead"


def test_a_claim_stands_in_line_once_and_where_it_came_first() -> None:
    pool = Resources()
    pool.take(claim(1, "arm"))
    for number in (2, 3, 2):
        assert not pool.take(claim(number, "arm"))
    assert [one.request.int for one in pool.line] == [2, 3]
    assert not pool.take(claim(2, "arm", "leg")), "another claim comes anew"
    assert [one.request.int for one in pool.line] == [3, 2]


def test_whoever_waits_is_told_when_it_would_be_served() -> None:
    pool, told = Resources(), list[str]()
    stop = pool.listen(lambda: told.append("served"))
    pool.take(claim(1, "arm"))
    pool.take(claim(2, "leg"))
    pool.take(claim(3, "arm", "leg"))
    pool.give(UUID(int=1))
    assert told == []
    pool.take(claim(4, "arm"))
    pool.withdraw(UUID(int=3))
    assert told == ["served"]
    assert pool.servable() == {UUID(int=4)}
    stop()
    pool.give(UUID(int=2))
    assert told == ["served"]


def test_tasks_are_outranked_by_claims_of_higher_priority_alone() -> None:
    pool = Resources({"leg": 2})
    for one in (claim(1, "arm", task=7), claim(2, "leg", task=8), claim(3, "eye", task=9, priority=2)):
        assert pool.take(one)
    pool.take(claim(4, "arm", "leg", "eye", priority=1))
    assert pool.outranked() == {UUID(int=7)}
    pool.withdraw(UUID(int=4))
    pool.take(claim(5, "arm"))
    assert pool.outranked() == frozenset()


def test_a_resource_is_in_use_as_often_as_it_may_be() -> None:
    pool = Resources({"arm": 2})
    assert [pool.take(claim(number, "arm")) for number in range(3)] == [True, True, False]
    assert repr(pool) == "<Resources, in use: arm; 1 in line>"


def test_what_is_withheld_is_free_when_its_end_is_confirmed() -> None:
    pool, told = Resources({"leg": 2}), list[str]()
    pool.listen(lambda: told.append("called"))
    pool.take(claim(1, "arm", "leg"))
    pool.take(claim(2, "arm"))
    pool.withhold(UUID(int=1), "wave()")
    assert told == ["called"], "who waits is told that it may do so in vain"
    assert pool.withheld_from(["leg", "arm"]) == {"arm": "wave()"}, "there is another leg"
    assert [one.request.int for one in pool.held] == [1]
    pool.withhold(UUID(int=2), "nothing")
    pool.confirm(UUID(int=2))
    assert (len(pool.held), len(pool.line)) == (1, 1)
    pool.confirm(UUID(int=1))
    assert pool.held == ()
    assert told == ["called"] * 2
    assert pool.withheld_from(["arm"]) == {}


def test_nobody_is_outranked_for_what_it_cannot_give_back() -> None:
    pool = Resources()
    pool.take(claim(1, "arm", task=7))
    pool.withhold(UUID(int=1), "wave()")
    pool.take(claim(2, "arm", priority=1))
    assert pool.outranked() == frozenset()


LIMITS = Bindings({"act": Binding(timeout=10.0, cancel=5.0, retries=0), "next": Binding(accept=4.0)})


def given_up(pool: Resources) -> UUID:
    """A request that has been given up at 15 s, and keeps the arm."""
    run = resourceful("act", pool, 1)
    (request,) = run.open_requests
    run.handle(Accepted(request), 0.0)
    run.handle(Tick(), 10.0)
    run.handle(Tick(), 15.0)
    assert run.result().failures[0].unconfirmed
    return request


def resourceful(name: str, pool: Resources, number: int, **options: object) -> Run:
    graph = PlanGraph((ActionCall(0, GroundAction(name, resources=("arm",)), **options),))  # type: ignore[arg-type]
    run = Run(generate(graph, LIMITS), Layered(KnowledgeBase()), id=UUID(int=number), bindings=LIMITS, resources=pool)
    run.handle(Begin(), 0.0)
    return run


def test_a_request_that_was_given_up_keeps_what_it_has_and_who_waits_for_it_says_who_that_is() -> None:
    pool = Resources()
    given_up(pool)
    waiting = resourceful("next", pool, 2)
    assert not waiting.open_requests
    waiting.handle(Tick(), 3.9)
    assert not waiting.over
    waiting.handle(Tick(), 4.0)
    (failure,) = waiting.result().failures
    assert (failure.cause, failure.expected, failure.lacking) == ("withheld", "arm within 4 s", ("arm",))
    assert failure.observed == "arm is kept by act() of task 00000000, which has not confirmed that it is over"
    assert (len(pool.held), pool.line) == (1, ())


def test_a_request_that_was_given_up_gives_back_what_it_has_when_its_server_reports_late() -> None:
    pool = Resources()
    request = given_up(pool)
    waiting = resourceful("next", pool, 2)
    pool.confirm(request)
    assert [command.request.action.name for command in waiting.handle(ResourcesChanged(), 3.0) if isinstance(command, Send)] == ["next"]


def test_the_time_for_what_is_withheld_does_not_pass_during_a_pause() -> None:
    pool = Resources()
    given_up(pool)
    waiting = resourceful("next", pool, 2)
    waiting.handle(Pause(), 1.0)
    waiting.handle(Tick(), 100.0)
    assert not waiting.over
    waiting.handle(Resume(), 101.0)
    waiting.handle(Tick(), 104.0)
    assert not waiting.over
    waiting.handle(Tick(), 105.0)
    assert waiting.over


def test_what_is_given_up_while_others_wait_is_noticed() -> None:
    pool = Resources()
    run = resourceful("act", pool, 1)
    waiting = resourceful("next", pool, 2)
    pool.withhold(run.open_requests[0], "act()")
    waiting.handle(ResourcesChanged(), 20.0)
    waiting.handle(Tick(), 23.0)
    assert not waiting.over
    waiting.handle(Tick(), 24.0)
    assert [one.cause for one in waiting.result().failures] == ["withheld"]


def test_a_plan_says_what_to_do_about_what_is_withheld_as_about_a_server_that_is_not_there() -> None:
    pool = Resources()
    given_up(pool)
    instead = Recovery(frozenset({Cause.UNAVAILABLE}), Then.SKIP, Flow((ActionCall(1, GroundAction("other")),)))
    waiting = resourceful("next", pool, 2, recoveries=(instead,))
    commands = waiting.handle(Tick(), 4.0)
    assert [command.request.action.name for command in commands if isinstance(command, Send)] == ["other"]


def test_a_call_that_goes_on_after_a_recovery_waits_with_a_limit_for_what_it_was_sent_with() -> None:
    pool = Resources()
    bindings = Bindings({"move": Binding(accept=4.0, retries=0, resources=("{robot}",))})
    mending = Recovery(frozenset({Cause.ABORTED}), Then.CONTINUE, Flow((ActionCall(1, GroundAction("mend")),)))
    graph = PlanGraph((ActionCall(0, GroundAction("move", ("?robot",), ("robot",)), recoveries=(mending,)),))
    knowledge = Layered(KnowledgeBase(), KnowledgeBase(variables={"robot": "r1"}))
    run = Run(generate(graph, bindings), knowledge, id=UUID(int=1), bindings=bindings, resources=pool)
    (sent,) = (one for one in run.handle(Begin(), 0.0) if isinstance(one, Send))
    run.handle(Ended(sent.request.id, Outcome(OutcomeKind.ABORTED)), 1.0)
    pool.take(claim(9, "r1"))
    pool.withhold(UUID(int=9), "lift()")
    (mend,) = run.open_requests
    run.handle(Ended(mend, Outcome(OutcomeKind.SUCCEEDED, {"robot": "r2"})), 2.0)
    assert [one.names for one in pool.line] == [("r1",)]
    run.handle(Tick(), 6.0)
    (failure,) = run.result().failures
    assert (failure.cause, failure.lacking) == ("withheld", ("r1",))


def test_a_report_that_comes_after_the_end_of_a_run_frees_what_was_kept() -> None:
    pool = Resources()
    graph = PlanGraph((ActionCall(0, GroundAction("act", resources=("arm",))),))
    run = Run(generate(graph, LIMITS), Layered(KnowledgeBase()), id=UUID(int=1), bindings=LIMITS, resources=pool)
    reporters: list[tuple[UUID, Reporter]] = []

    class Deaf:
        """Accepts, and ends nothing by itself."""

        def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
            return ()

        def send(self, request: Request, report: Reporter, /) -> None:
            reporters.append((request.id, report))
            report(Accepted(request.id))

        def cancel(self, request: UUID, /) -> None: ...

    async def main() -> None:
        result = await Executor(run, Deaf()).execute()
        assert result.failures[0].unconfirmed
        assert [one.names for one in pool.held] == [("arm",)]
        ((request, report),) = reporters
        report(Ended(request, SUCCEEDED))
        assert pool.held == ()

    run_async(main(), virtual=True)


@dataclass
class Worker:
    """Wants something so many times, one after the other. The mutable state is what has a default."""

    number: int
    priority: int
    names: tuple[str, ...]
    times: int
    has: bool = False
    waits: bool = False

    @property
    def claim(self) -> Claim:
        return claim(self.number * 100 + self.times, *self.names, priority=self.priority)


@dataclass
class Fair:
    """What the pool does, said in other words: everybody in line, in the order in which they came."""

    capacities: dict[str, int]
    having: dict[int, tuple[str, ...]] = field(default_factory=dict)
    came: list[Worker] = field(default_factory=list)

    def may(self, worker: Worker) -> bool:
        everybody = self.came if worker in self.came else [*self.came, worker]
        served = sorted(everybody, key=lambda one: -one.priority)
        before = served[: served.index(worker)]
        used = Counter(name for names in (*self.having.values(), *(one.names for one in before)) for name in names)
        return all(used[name] + 1 <= self.capacities.get(name, 1) for name in worker.names)


NAMES = st.lists(st.sampled_from(["arm", "leg", "eye"]), min_size=1, unique=True).map(tuple)
WORKERS = st.lists(st.tuples(st.integers(0, 2), NAMES, st.integers(1, 3)), min_size=1, max_size=6)


@settings(deadline=None)
@given(WORKERS, st.dictionaries(st.sampled_from(["arm", "leg"]), st.integers(1, 2)), st.integers(0, 2**32))
def test_nobody_has_too_much_everybody_is_served_and_equals_in_order(
    wanted: list[tuple[int, tuple[str, ...], int]], capacities: dict[str, int], seed: int
) -> None:
    pool, fair, random = Resources(capacities), Fair(capacities), Random(seed)
    workers = [Worker(number, *one) for number, one in enumerate(wanted)]
    for _ in range(1000):
        going_on = [one for one in workers if one.times]
        if not going_on:
            break
        worker = random.choice(going_on)
        if worker.has:
            pool.give(worker.claim.request)
            fair.having.pop(worker.number)
            worker.has, worker.times = False, worker.times - 1
        elif worker.waits and random.random() < 0.1:
            pool.withdraw(worker.claim.request)
            fair.came.remove(worker)
            worker.waits = False
        else:
            may = fair.may(worker)
            assert pool.is_free(worker.claim) is may
            assert pool.take(worker.claim) is may
            if worker in fair.came:
                fair.came.remove(worker) if may else None
            elif not may:
                fair.came.append(worker)
            worker.has, worker.waits = may, not may
            if may:
                fair.having[worker.number] = worker.names
        used = Counter(name for one in pool.held for name in one.names)
        assert all(count <= capacities.get(name, 1) for name, count in used.items())
        assert [one.request for one in pool.line] == [one.claim.request for one in sorted(fair.came, key=lambda one: -one.priority)]
        assert pool.held or not pool.line or pool.servable()
    else:
        raise AssertionError(f"somebody is never served: {pool}")


# --- runs ----------------------------------------------------------------------------------


def calls(*actions: GroundAction, orders: tuple[str, ...] = ()) -> PlanGraph:
    return PlanGraph(tuple(ActionCall(index, action) for index, action in enumerate(actions)), tuple(map(ordering, orders)))


def arm(name: str, **options: object) -> GroundAction:
    return GroundAction(name, resources=("arm",), **options)  # type: ignore[arg-type]


def names(commands: list[Command]) -> list[str]:
    return [command.request.action.name for command in commands if isinstance(command, Send)]


def begun(graph: PlanGraph, number: int = 1, **options: object) -> tuple[Run, list[Command]]:
    bindings = options.pop("bindings", None)
    knowledge = Layered(options.pop("world", None) or KnowledgeBase())  # type: ignore[arg-type]
    run = Run(generate(graph, bindings), knowledge, id=UUID(int=number), bindings=bindings, **options)  # type: ignore[arg-type]
    return run, run.handle(Begin(), 0.0)


def finish(run: Run) -> list[Command]:
    """Have the first open request succeed."""
    return run.handle(Ended(run.open_requests[0], SUCCEEDED), 1.0)


def test_a_call_that_waits_for_an_answer_has_nothing() -> None:
    asking = Bindings({"asks": Binding(goal={"word": "$word"})})
    run, commands = begun(calls(arm("asks"), arm("acts")), bindings=asking, asks=True)
    assert names(commands) == ["acts"]
    (question,) = [command for command in commands if isinstance(command, Ask)]
    assert run.handle(Answered(question.id, "hello"), 1.0) == []
    assert names(finish(run)) == ["asks"]


def test_a_call_that_waits_for_a_fact_has_nothing_and_stands_in_nobody_s_way() -> None:
    world = KnowledgeBase(sensed={"ready": 5.0})
    run, commands = begun(calls(arm("waits", precondition=Holds(("ready",))), arm("first"), arm("second")), world=world)
    assert names(commands) == ["first"]
    assert names(finish(run)) == ["second"], "the fact that it needs is not there when the arm is"
    world.update({("ready",): True})
    assert names(run.handle(KnowledgeChanged(), 2.0)) == []
    assert names(finish(run)) == ["waits"]


def test_whoever_cannot_use_it_yet_leaves_the_line() -> None:
    world = KnowledgeBase(sensed={"ready": 5.0})
    asked = Computed(Operation("eq", (Query(Literal.of("word"), Layer.GLOBAL), Literal.of(1))))
    for condition in (Holds(("ready",)), asked):
        waits = arm("waits", precondition=condition)
        run, commands = begun(calls(arm("first"), waits, arm("behind")), world=world, asks=True)
        assert names(commands) == ["first"]
        assert len(run.resources.line) == 2
        assert names(finish(run)) == ["behind"]


def test_what_need_not_be_done_is_not_waited_for() -> None:
    world = KnowledgeBase()
    run, _ = begun(calls(arm("first"), arm("second", expected=Holds(("done",)))), world=world)
    world.update({("done",): True})
    run.handle(KnowledgeChanged(), 0.5)
    assert run.resources.line == ()
    finish(run)
    assert [call.outcome for call in run.result().calls] == ["succeeded", "already true"]


def test_a_precondition_is_looked_at_when_the_call_can_start() -> None:
    world = KnowledgeBase(facts={("ready",): False})
    run, commands = begun(calls(arm("first"), arm("second", precondition=Holds(("ready",)))), world=world)
    assert names(commands) == ["first"]
    assert not run.ending
    world.update({("ready",): True})
    assert names(finish(run)) == ["second"]


def test_a_deadline_counts_while_a_call_waits_for_resources() -> None:
    graph = calls(arm("first"), arm("second"))
    late = changed(graph, steps=(graph.calls[0], changed(graph.calls[1], deadline=9.0)))
    run, _ = begun(late)
    run.handle(Tick(), 9.0)
    assert run.resources.line == ()
    finish(run)
    assert [failure.cause for failure in run.result().failures] == ["too_late"]


def test_the_steps_of_a_recovery_take_their_own() -> None:
    mending = ActionCall(1, GroundAction("b", resources=("arm", "leg")))
    recovery = Recovery(frozenset({Cause.ABORTED}), Then.RETRY, Flow((mending,)))
    run, commands = begun(PlanGraph((ActionCall(0, arm("a"), recoveries=(recovery,)),)))
    assert names(commands) == ["a"]
    commands = run.handle(Ended(run.open_requests[0], Outcome(OutcomeKind.ABORTED)), 1.0)
    assert names(commands) == ["b"]
    assert [one.names for one in run.resources.held] == [("arm", "leg")]
    assert names(finish(run)) == ["a"]


def test_runs_with_one_pool_take_turns_by_priority_then_in_order() -> None:
    pool = Resources()
    low, commands = begun(calls(arm("low")), 1, resources=pool)
    assert names(commands) == ["low"]
    waiting = [begun(calls(arm(name)), number, resources=pool, priority=rank)[0] for number, (name, rank) in enumerate(LINE, 2)]
    assert pool.outranked() == {low.task}
    finish(low)
    order = []
    for _ in LINE:
        for run in waiting:
            order += names(run.handle(ResourcesChanged(), 2.0))
        finish(next(run for run in waiting if run.open_requests))
    assert order == ["high", "second", "third"]
    assert (pool.held, pool.line) == ((), ())


LINE = (("second", 0), ("third", 0), ("high", 1))


def test_a_claim_is_withdrawn_when_the_call_is_skipped() -> None:
    pool = Resources()
    begun(calls(arm("first")), 1, resources=pool)
    run, _ = begun(calls(arm("second")), 2, resources=pool)
    assert len(pool.line) == 1
    run.handle(Stop(), 1.0)
    assert run.over
    assert pool.line == ()


def test_resources_are_named_after_robots_also_when_the_robot_is_known_late() -> None:
    bindings = Bindings({"move": Binding(resources=("{robot}/base",))})
    known, late = GroundAction("move", ("r1",), ("robot",)), GroundAction("move", ("?robot",), ("robot",))
    assert bindings.resources(known) == ("r1/base",)
    run, _ = begun(calls(late, known, GroundAction("move", ("r2",), ("robot",))), bindings=bindings)
    assert [failure.cause for failure in run._results.failures] == ["data_missing"]
    graph, knowledge = calls(late, known), Layered(KnowledgeBase(), KnowledgeBase(variables={"robot": "r1"}))
    run = Run(generate(graph, bindings), knowledge, id=UUID(int=1), bindings=bindings)
    assert len(run.handle(Begin(), 0.0)) == 2
    assert [one.names for one in run.resources.held] == [("r1/base",)]
    with pytest.raises(InputError, match=r"the resource '\{who\}/base' of move names \{who\}, which is not a parameter"):
        Bindings({"move": Binding(resources=("{who}/base",))}).resources(known)


# --- robots --------------------------------------------------------------------------------


def clashes(bindings: Bindings, shared: Callable[[], Resources | None]) -> list[str]:
    """Two runs of one action each with the same robots: what the robots notice."""
    robots = SimulatedRobots(SimulatedWorld(KnowledgeBase(), frozenset()), bindings=bindings)
    machine = generate(calls(GroundAction("move", ("r1",), ("robot",), duration=5.0)), bindings)

    async def main() -> None:
        runs = [
            Run(machine, Layered(KnowledgeBase()), id=UUID(int=number), bindings=bindings, resources=shared()) for number in range(1, 4)
        ]
        results = await asyncio.gather(*(Executor(run, robots).execute() for run in runs))
        assert all(result.goal for result in results)

    run_async(main(), virtual=True)
    return robots.clashes


def test_robots_notice_when_a_resource_is_used_twice_at_once() -> None:
    bindings = Bindings({"move": Binding(resources=("{robot}/base",))})
    assert clashes(bindings, lambda: None) == [
        "r1/base is used by move(r1) and move(r1) at once",
        "r1/base is used by move(r1) and move(r1) and move(r1) at once",
    ]
    pool = Resources()
    assert clashes(bindings, lambda: pool) == []
    assert clashes(Bindings(), lambda: None) == []


def test_a_clash_is_written_down_by_simulated_servers() -> None:
    bindings = Bindings({"move": Binding(resources=("{robot}/base",))})
    log = StringIO()

    async def main() -> None:
        robots = LoggedRobots(SimulatedRobots(SimulatedWorld(KnowledgeBase(), frozenset()), bindings=bindings), log)
        for number in range(2):
            robots.send(Request(UUID(int=number), GroundAction("move", ("r1",), ("robot",), duration=5.0), {}, 1), lambda _: None)
        await asyncio.sleep(10)

    run_async(main(), virtual=True)
    lines = [json.loads(line) for line in log.getvalue().splitlines()]
    assert [line["event"] for line in lines] == ["start", "start", "clash", "end", "end"]
    assert lines[2]["text"] == "r1/base is used by move(r1) and move(r1) at once"


NESTED = """
actions: {lift: {params: [what], duration: 2, resources: [arm]}}
outer: {params: [what], plan: [{lift: {what: cup}}, {inner: {what: {LocalQuery: what}}}]}
inner: {params: [what], plan: [{lift: }, {lift: }]}
"""


def test_all_plans_of_a_performer_share_resources(tmp_path: Path) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text(NESTED, encoding="utf-8")
    plans = read_plans(file)
    backend = simulated_backend(plans["inner"], merge_bindings(plans.values()))
    performer = Performer({name: Program.of(plan) for name, plan in plans.items()}, backend, KnowledgeBase())

    async def main() -> None:
        await backend.open(performer.world)
        performances = [performer.perform("outer", {"what": what}) for what in ("plate", "spoon", "fork")]
        results = await asyncio.gather(*map(performer.execute, performances))
        assert all(result.goal for result in results)
        assert asyncio.get_running_loop().time() == pytest.approx(18.0, abs=0.1)
        await backend.close()

    run_async(main(), virtual=True)
    assert backend.robots.clashes == []


def test_a_machine_made_for_other_capacities_is_refused() -> None:
    graph = PlanGraph((ActionCall(0, GroundAction("act", resources=("arm",))),))
    shared = Resources({"arm": 2})
    with pytest.raises(RunError, match="generated for 1 calls with arm; 2 may have it"):
        Run(generate(graph), Layered(KnowledgeBase()), id=UUID(int=1), resources=shared)
    machine = generate(graph, capacities=shared.capacities)
    assert Run(machine, Layered(KnowledgeBase()), id=UUID(int=1), resources=shared).machine.capacities == {"arm": 2}


def test_calls_with_open_parameters_need_different_resources_at_the_same_time() -> None:
    bindings = Bindings({"move": Binding(resources=("{robot}/base",))})
    calls = tuple(ActionCall(number, GroundAction("move", (f"?{name}",), ("robot",))) for number, name in enumerate(("robot", "robot")))
    knowledge = Layered(KnowledgeBase(), KnowledgeBase(variables={"robot": "r1"}))
    run = Run(generate(PlanGraph(calls), bindings), knowledge, id=UUID(int=1), bindings=bindings)
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


def test_every_plan_of_a_performer_shares_what_one_of_them_says_of_a_resource(tmp_path: Path) -> None:
    file = tmp_path / "plan.yaml"
    text = "actions: {lift: {params: [what], duration: 2, resources: [arm]}}\n"
    branches = "plan: [{concurrent_actions: [{lift: {what: plate}}, {lift: {what: spoon}}]}]"
    file.write_text(f"{text}one: {{resources: {{arm: 2}}, {branches}}}\nother: {{{branches}}}\n", encoding="utf-8")
    plans = read_plans(file)
    backend = simulated_backend(plans["one"], merge_bindings(plans.values()))
    performer = Performer({name: Program.of(plan) for name, plan in plans.items()}, backend, KnowledgeBase())

    async def main() -> None:
        await backend.open(performer.world)
        assert (await performer.execute(performer.perform("other"))).goal
        assert asyncio.get_running_loop().time() == pytest.approx(2.0, abs=0.1)
        await backend.close()

    run_async(main(), virtual=True)
    assert backend.robots.clashes == []
