"""Runs that are succeeded by others: what is under way is taken over, and nothing is lost."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from uuid import UUID

import pytest

from pnm.clock import run_async
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.events import Begin, Cancel, Command, Pause, Send, Stop, Tick, Wake
from pnm.core.execution.handover import UnderWay
from pnm.core.execution.resources import Resources
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import MISSING, Layer, Question
from pnm.core.logic.conditions import Holds
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph, PlanGraphError
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.core.machine.verification.verify import explore, verify
from pnm.errors import RunError
from pnm.executor import Executor
from pnm.knowledge.sources.person_text import question_text
from pnm.knowledge.sources.source import Asker, Source
from tests.support.runs.mutants import check_proof_of_mutants
from tests.support.runs.plan_graphs import ordering
from tests.support.runs.simulated import Log, move

CANCELED, SUCCEEDED, ABORTED = (Outcome(kind) for kind in (OutcomeKind.CANCELED, OutcomeKind.SUCCEEDED, OutcomeKind.ABORTED))
ACT = GroundAction("act", resources=("arm",), duration=5.0)
LAST = GroundAction("last", resources=("arm",))


def plan(*calls: ActionCall, orders: tuple[str, ...] = ()) -> PlanGraph:
    return PlanGraph(calls, tuple(map(ordering, orders)))


def going(*actions: GroundAction, bindings: Bindings | None = None, world: KnowledgeBase | None = None, **options: object) -> Run:
    """A run whose calls were all accepted at 1 s."""
    graph = plan(*(ActionCall(index, action) for index, action in enumerate(actions)))
    machine = generate(graph, bindings)
    run = Run(machine, Layered(world or KnowledgeBase()), id=UUID(int=1), bindings=bindings, **options)  # type: ignore[arg-type]
    run.handle(Begin(), 0.0)
    for request in run.open_requests:
        run.handle(Accepted(request), 1.0)
    return run


def successor(
    old: Run,
    *more: GroundAction,
    taken: int | None = None,
    orders: tuple[str, ...] = (),
    bindings: Bindings | None = None,
    **options: object,
) -> Run:
    """A run that takes over what is under way, and does more."""
    there = old.under_way()[:taken]
    calls = [ActionCall(number, one.call.action, under_way=True) for number, one in enumerate(there)]
    calls += [ActionCall(number, action) for number, action in enumerate(more, len(there))]
    machine = generate(plan(*calls, orders=orders), bindings)
    verify(machine)
    adopted = dict(enumerate(there))
    options = {"resources": old.resources, "id": UUID(int=2), **options}
    return Run(machine, old.knowledge, bindings=bindings, adopted=adopted, **options)  # type: ignore[arg-type]


def sent(commands: list[Command]) -> list[str]:
    return [command.request.action.name for command in commands if isinstance(command, Send)]


def cancelled(commands: list[Command]) -> list[UUID]:
    return [command.request for command in commands if isinstance(command, Cancel)]


# --- runs ----------------------------------------------------------------------------------


def test_a_request_is_taken_over_and_what_waits_for_it_goes_on_after_its_end() -> None:
    old = going(ACT)
    (request,) = old.open_requests
    new = successor(old, LAST)
    assert new.open_requests == (request,)
    assert sent(new.handle(Begin(), 2.0)) == [], "the arm is still in use"
    assert [claim.request for claim in new.resources.held] == [request]
    assert sent(new.handle(Ended(request, SUCCEEDED), 3.0)) == ["last"]
    new.handle(Ended(new.open_requests[0], SUCCEEDED), 4.0)
    result = new.result()
    assert result.goal
    assert [(call.outcome, call.attempts, call.started) for call in result.calls] == [("succeeded", 1, 0.0), ("succeeded", 1, 3.0)]
    assert (new.resources.held, new.resources.line) == ((), ())


def test_what_is_not_accepted_or_being_cancelled_is_not_under_way() -> None:
    old = going(GroundAction("one"), GroundAction("two"))
    assert [str(one.call) for one in old.under_way()] == ["one()#0", "two()#1"]
    old.handle(Pause(at_once=True), 2.0)
    assert old.under_way() == ()
    fresh = Run(old.machine, old.knowledge, id=UUID(int=3))
    fresh.handle(Begin(), 0.0)
    assert fresh.under_way() == ()
    old.handle(Ended(old.open_requests[0], CANCELED), 3.0)
    assert old.under_way() == ()


def test_how_far_a_run_has_come_is_told() -> None:
    old = going(GroundAction("one"), GroundAction("two"))
    old.handle(Ended(old.open_requests[0], SUCCEEDED), 2.0)
    told = old.interim_result()
    assert [call.outcome for call in told.calls] == ["succeeded", "handed over"]
    assert (told.goal, told.failures, told.stopped) == (False, (), False)


def test_time_outs_count_from_the_first_acceptance() -> None:
    limits = Bindings({"act": Binding(timeout=10.0)})
    old = going(ACT, bindings=limits)
    new = successor(old, bindings=limits)
    assert new.handle(Begin(), 4.0) == [Wake(11.0)]
    assert cancelled(new.handle(Tick(), 11.0)) == [*old.open_requests]
    late = successor(old, bindings=limits)
    assert cancelled(late.handle(Begin(), 12.0)) == [*old.open_requests]


def test_a_call_taken_over_that_fails_is_tried_again_as_any_other() -> None:
    world = KnowledgeBase({("at", "r1", "hall"): True})
    old = going(move("r1", "hall", "lab"), world=world)
    new = successor(old)
    new.handle(Begin(), 2.0)
    assert world.value(("at", "r1", "hall")) is False
    commands = new.handle(Ended(old.open_requests[0], ABORTED), 3.0)
    assert sent(commands) == ["move"]
    assert world.value(("at", "r1", "hall")) is True, "what was assumed at its start is taken back"
    assert new.open_requests != old.open_requests
    new.handle(Accepted(new.open_requests[0]), 3.0)
    new.handle(Ended(new.open_requests[0], SUCCEEDED), 4.0)
    assert new.result().calls[0].attempts == 2
    assert world.value(("at", "r1", "lab")) is True


def test_an_end_that_comes_before_the_beginning_is_not_lost() -> None:
    old = going(ACT)
    new = successor(old, LAST)
    assert new.handle(Ended(old.open_requests[0], SUCCEEDED), 2.0) == []
    assert sent(new.handle(Begin(), 2.0)) == ["last"]


def test_an_over_all_condition_counts_from_the_beginning() -> None:
    world = KnowledgeBase({("ok",): True})
    old = going(replace(ACT, invariant=Holds(("ok",))), world=world)
    world.update({("ok",): False})
    new = successor(old)
    assert cancelled(new.handle(Begin(), 2.0)) == [*old.open_requests]
    new.handle(Ended(old.open_requests[0], CANCELED), 3.0)
    assert [failure.cause for failure in new.result().failures] == ["invariant_false"]


def test_what_waits_for_the_start_of_a_call_taken_over_goes_on() -> None:
    old = going(GroundAction("act", duration=5.0))
    new = successor(old, GroundAction("next"), orders=("0s<1s",))
    explore(new.machine)
    assert sent(new.handle(Begin(), 2.0)) == ["next"]
    delayed = PlanGraph(
        (ActionCall(0, GroundAction("act", duration=5.0), under_way=True), ActionCall(1, GroundAction("next"))),
        (Ordering(PlanEvent(0, Moment.START), PlanEvent(1, Moment.START), delay=4.0),),
    )
    later = Run(generate(delayed), old.knowledge, id=UUID(int=3), adopted=dict(enumerate(old.under_way())))
    assert later.handle(Begin(), 2.0)[-1] == Wake(5.0), "4 s after its acceptance"


def test_stopping_a_successor_cancels_what_it_has_taken_over() -> None:
    old = going(ACT)
    new = successor(old)
    new.handle(Stop(), 2.0)
    assert cancelled(new.handle(Begin(), 2.0)) == [*old.open_requests]
    new.handle(Ended(old.open_requests[0], CANCELED), 3.0)
    assert [call.outcome for call in new.result().calls] == ["canceled"]


def test_a_pause_suspends_what_was_taken_over_and_it_begins_anew() -> None:
    old = going(ACT)
    new = successor(old)
    new.handle(Begin(), 2.0)
    assert cancelled(new.handle(Pause(at_once=True), 3.0)) == [*old.open_requests]
    new.handle(Ended(old.open_requests[0], CANCELED), 4.0)
    assert new.paused
    assert new.resources.held == ()


def test_a_run_without_others_keeps_what_its_predecessor_had() -> None:
    old = going(ACT, resources=Resources())
    new = successor(old, LAST, resources=None)
    assert sent(new.handle(Begin(), 2.0)) == []
    assert [claim.names for claim in new.resources.held] == [("arm",)]


def test_what_contradicts_the_plan_is_refused() -> None:
    old = going(ACT)
    (there,) = old.under_way()
    machine = generate(plan(ActionCall(0, ACT, under_way=True)))

    def refused(adopted: Mapping[int, UnderWay], match: str) -> None:
        with pytest.raises(RunError, match=match):
            Run(machine, old.knowledge, id=UUID(int=2), adopted=adopted)

    refused({}, r"the calls \[0\] of the plan are under way; requests are taken over for \[\]")
    refused({0: there, 1: there}, r"taken over for \[0, 1\]")
    refused({0: replace(there, resources=("leg",))}, "has leg for itself; the plan says otherwise")
    twice = generate(plan(ActionCall(0, ACT, under_way=True), ActionCall(1, ACT, under_way=True)))
    with pytest.raises(RunError, match="2 requests that are taken over have arm"):
        Run(twice, old.knowledge, id=UUID(int=2), adopted={0: there, 1: there})
    with pytest.raises(PlanGraphError, match="is under way: it cannot wait for others"):
        plan(ActionCall(0, LAST), ActionCall(1, ACT, under_way=True), orders=("0e<1s",))


def test_the_block_proof_accepts_no_machine_that_the_state_space_refutes() -> None:
    check_proof_of_mutants(generate(plan(ActionCall(0, ACT, under_way=True)), Bindings({"act": Binding(retries=0)})))


# --- executors -----------------------------------------------------------------------------


class Server:
    """Accepts everything at once; ends what it is told to. The mutable state is what it was asked for."""

    def __init__(self) -> None:
        self.reporters: dict[str, tuple[Request, Reporter]] = {}
        self.cancelled: list[str] = []

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return ()

    def send(self, request: Request, report: Reporter, /) -> None:
        self.reporters[request.action.name] = request, report
        report(Accepted(request.id))

    def cancel(self, request: UUID, /) -> None:
        self.cancelled += [name for name, (one, _) in self.reporters.items() if one.id == request]

    def end(self, name: str, outcome: Outcome = SUCCEEDED) -> None:
        request, report = self.reporters[name]
        report(Ended(request.id, outcome))


def carried(
    scenario: Callable[[Executor, Server], object], *actions: GroundAction, bindings: Bindings | None = None, source: Source | None = None
) -> RunResult:
    """Have a run of these actions carried out, and something done to it after a second."""
    graph = plan(*(ActionCall(index, action) for index, action in enumerate(actions)))
    server = Server()
    world = KnowledgeBase(sensed={"seen": 2.0})
    run = Run(generate(graph, bindings), Layered(world), id=UUID(int=1), bindings=bindings, observer=Log(), asks=source is not None)
    executor = Executor(run, server, source)

    async def main() -> RunResult:
        task = asyncio.ensure_future(executor.execute())
        await asyncio.sleep(1)
        scenario(executor, server)
        result = await asyncio.wait_for(task, 1000)
        assert asyncio.get_running_loop().time() < 500, "it ends by itself"
        return result

    return run_async(main(), virtual=True)


def test_the_result_is_that_of_the_last_run() -> None:
    def scenario(executor: Executor, server: Server) -> None:
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
    def scenario(executor: Executor, server: Server) -> None:
        server.end("act")
        executor.succeed(successor(executor.run))

    assert carried(scenario, ACT).goal


def test_a_successor_with_nothing_to_do_ends_at_once() -> None:
    def scenario(executor: Executor, _: Server) -> None:
        executor.succeed(successor(executor.run))

    assert carried(scenario, GroundAction("blocked", precondition=Holds(("seen",)))).goal


def test_nobody_stands_in_line_for_a_run_that_is_succeeded() -> None:
    def scenario(executor: Executor, server: Server) -> None:
        pool = executor.run.resources
        assert len(pool.line) == 1
        executor.succeed(successor(executor.run))
        assert ([claim.names for claim in pool.held], pool.line) == ([("arm",)], ())
        server.end("act")

    assert carried(scenario, ACT, LAST).goal


def test_a_pause_goes_on_in_the_successor() -> None:
    def scenario(executor: Executor, server: Server) -> None:
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


# --- questions -----------------------------------------------------------------------------

ASKING = Bindings({"greet": Binding(goal={"word": "$word"}, ask={"word": "What shall I say to {whom}?"})})


def greet(whom: str) -> GroundAction:
    return GroundAction("greet", (whom,), parameters=("whom",))


@dataclass
class Person:
    """Is asked, and answers when told to. The mutable state is what was asked and is not answered."""

    asked: list[str] = field(default_factory=list)
    open: dict[str, asyncio.Future[object]] = field(default_factory=dict)

    async def query(self, question: Question, asker: Asker, /) -> object:
        if question.layer is not Layer.PERSON:
            return MISSING
        words = question_text(question)
        self.asked.append(words)
        answer = self.open[words] = asyncio.get_running_loop().create_future()
        try:
            return await answer
        finally:
            del self.open[words]

    async def update(self, question: Question, value: object, asker: Asker, /) -> None: ...

    async def close(self) -> None: ...

    def answer(self, whom: str, word: str) -> None:
        self.open[f"What shall I say to {whom}?"].set_result(word)


async def settle() -> None:
    for _ in range(10):
        await asyncio.sleep(0)


@pytest.mark.parametrize("moment", ["handled", "in the inbox", "later, while it is paused", "later"])
def test_what_a_person_is_asked_is_asked_once_whichever_run_goes_on(moment: str) -> None:
    person, loops = Person(), list[asyncio.Task[None]]()

    def scenario(executor: Executor, server: Server) -> None:
        loops.append(asyncio.ensure_future(tell(executor, server)))

    async def tell(executor: Executor, server: Server) -> None:
        def succeed() -> None:
            executor.succeed(successor(executor.run, GroundAction("first"), greet("ann"), orders=("1e<2s",), bindings=ASKING, asks=True))

        executor.pause()
        await settle()
        if moment == "handled":
            person.answer("ann", "hello")
            await settle()
        elif moment == "in the inbox":
            person.answer("ann", "hello")
            await asyncio.sleep(0)
        succeed()
        await settle()
        if moment == "later, while it is paused":
            person.answer("ann", "hello")
            await settle()
        executor.succeed(successor_of_successor(executor.run))
        executor.resume()
        await settle()
        server.end("act")
        server.end("first")
        await settle()
        if moment == "later":
            person.answer("ann", "hello")
            await settle()
        assert server.reporters["greet"][0].goal["word"] == "hello"
        server.end("greet")

    def successor_of_successor(run: Run) -> Run:
        return successor(run, GroundAction("first"), greet("ann"), orders=("1e<2s",), bindings=ASKING, asks=True, id=UUID(int=3))

    assert carried(scenario, ACT, greet("ann"), bindings=ASKING, source=person).goal
    assert person.asked == ["What shall I say to ann?"]
    assert not person.open
    loops[0].result()


def test_a_question_that_the_successor_does_not_ask_is_withdrawn() -> None:
    person = Person()

    def scenario(executor: Executor, server: Server) -> None:
        executor.succeed(successor(executor.run, greet("bob"), bindings=ASKING, asks=True))
        asyncio.get_running_loop().call_later(1, lambda: open_then.extend(person.open))
        asyncio.get_running_loop().call_later(2, person.answer, "bob", "good day")
        asyncio.get_running_loop().call_later(3, server.end, "act")
        asyncio.get_running_loop().call_later(3, server.end, "greet")

    open_then: list[str] = []
    assert carried(scenario, ACT, greet("ann"), bindings=ASKING, source=person).goal
    assert open_then == ["What shall I say to bob?"]
    assert person.asked == ["What shall I say to ann?", "What shall I say to bob?"]


def test_an_answer_does_for_one_call() -> None:
    person = Person()

    def scenario(executor: Executor, server: Server) -> None:
        executor.pause()
        loop = asyncio.get_running_loop()
        loop.call_later(1, person.answer, "ann", "hello")
        loop.call_later(2, lambda: executor.succeed(two(executor.run)))
        loop.call_later(3, executor.resume)
        loop.call_later(4, lambda: server.end("greet"))
        loop.call_later(5, person.answer, "ann", "hello again")
        loop.call_later(6, lambda: words.append(server.reporters["greet"][0].goal["word"]))
        loop.call_later(7, lambda: server.end("greet"))
        loop.call_later(8, lambda: server.end("act"))

    def two(run: Run) -> Run:
        return successor(run, greet("ann"), greet("ann"), orders=("1e<2s",), bindings=ASKING, asks=True)

    words: list[object] = []
    assert carried(scenario, ACT, greet("ann"), bindings=ASKING, source=person).goal
    assert person.asked == ["What shall I say to ann?"] * 2
    assert words == ["hello again"]


# --- what is refused -----------------------------------------------------------------------


def refusing(match: str, change: Callable[[Executor, Server], Run]) -> Callable[[Executor, Server], None]:
    """Try to go on with another run; then end all that is open."""

    def scenario(executor: Executor, server: Server) -> None:
        old, new = executor.run, change(executor, server)
        with pytest.raises(RunError, match=match):
            executor.succeed(new)
        assert executor.run is old
        for name in server.reporters:
            server.end(name)

    return scenario


def stopped(executor: Executor) -> Run:
    new = successor(executor.run)
    executor.run.handle(Stop(), 1.0)
    return new


def ended(executor: Executor) -> Run:
    new = successor(executor.run)
    executor.run.handle(Pause(at_once=True), 1.0)
    executor.resume()
    return new


def test_nothing_that_is_under_way_is_lost() -> None:
    act, two = GroundAction("act"), GroundAction("two")
    carried(refusing(r"does not take over two\(\)", lambda executor, _: successor(executor.run, taken=1)), act, two)
    carried(refusing("was told to stop", lambda executor, _: stopped(executor)), act)
    carried(refusing(r"act\(\)#0 cannot be taken over", lambda executor, _: ended(executor)), act)
    carried(refusing("an id of its own", lambda executor, _: executor.run), act)


def test_a_call_whose_effects_are_looked_for_is_waited_for() -> None:
    effects = (Set(("seen",), Constant(True)),)

    def scenario(executor: Executor, server: Server) -> None:
        executor.run.handle(Ended(executor.run.open_requests[0], SUCCEEDED), 1.0)
        new = successor(executor.run)
        with pytest.raises(RunError, match=r"the effects of act\(\)#0 are still to be looked for"):
            executor.succeed(new)
        executor.run.knowledge.world.update({("seen",): True})

    assert carried(scenario, GroundAction("act", end_effects=effects)).goal


def test_what_is_not_being_carried_out_is_not_succeeded() -> None:
    machine, knowledge = generate(plan(ActionCall(0, LAST))), Layered(KnowledgeBase())
    server = Server()
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
    waiting = Run(generate(plan(ActionCall(0, LAST))), Layered(KnowledgeBase()), id=UUID(int=9), resources=pool)
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
    def scenario(executor: Executor, server: Server) -> None:
        old = executor.run
        executor.succeed(successor(old, GroundAction("sees", precondition=Holds(("seen",)))))
        old.knowledge.world.update({("seen",): True})
        server.end("act")
        asyncio.get_running_loop().call_later(1, server.end, "sees")

    assert carried(scenario, ACT).goal
