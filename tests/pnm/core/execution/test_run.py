"""The sans-I/O contract of a run: events in, commands out, nothing else."""

from __future__ import annotations

from dataclasses import replace
from uuid import UUID

import pytest
from hypothesis import given, strategies as st

from pnm.core.execution.events import Begin, Cancel, Command, KnowledgeChanged, Send, Stop, Tick, Wake
from pnm.core.execution.guards import OPENS, Guards
from pnm.core.execution.machine_index import Firing, Site
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import Holds, Not
from pnm.core.logic.effects import Effect, Set, When
from pnm.core.logic.expressions import UNKNOWN, Constant, Unknown, Value
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.guards import After
from pnm.core.machine.plan_graph import GroundAction, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Postponed
from pnm.errors import RunError
from tests.support.runs.commands import RUN, accepted, begun, cancelled, sent
from tests.support.runs.mutation.changes import with_rule
from tests.support.runs.plan_graphs import plan, plan_of
from tests.support.runs.simulated import FiringLog

SUCCEEDED = Outcome(OutcomeKind.SUCCEEDED)


def ids_sent(commands: list[Command]) -> list[UUID]:
    return [command.request.id for command in commands if isinstance(command, Send)]


def test_a_run_begins_once_and_sends_what_waits_for_nothing() -> None:
    run, commands = begun(plan(3, "0e<2s"))
    assert sent(commands) == ["a0", "a1"]
    with pytest.raises(RunError, match="not over"):
        run.result()
    with pytest.raises(RunError, match="begun already"):
        run.handle(Begin(), 1.0)


def test_a_wait_at_the_place_that_is_marked_at_first_counts_from_the_beginning() -> None:
    machine = with_rule(generate(plan(1)), "begin", guard=After(2.0))
    run = Run(machine, Layered(KnowledgeBase()), id=RUN)
    assert sent(run.handle(Begin(), 1.0)) == []
    assert sent(run.handle(Tick(), 3.0)) == ["a0"]


def test_reports_about_unknown_or_finished_requests_change_nothing() -> None:
    log = FiringLog()
    run, commands = begun(plan(1), observer=log)
    request = ids_sent(commands)[0]
    before = run.marking
    assert run.handle(Ended(UUID(int=99), SUCCEEDED), 1.0) == []
    assert run.marking == before
    run.handle(Accepted(request), 1.0)
    run.handle(Ended(request, SUCCEEDED), 2.0)
    over = run.marking
    assert run.handle(Ended(request, SUCCEEDED), 3.0) == []
    assert run.marking == over
    assert len(log.orphans) == 2


def test_a_goal_that_nobody_answers_is_withdrawn_and_tried_again_once_that_is_confirmed() -> None:
    bindings = Bindings({"a0": Binding(accept=5.0, cancel=3.0, retries=1)})
    run, commands = begun(plan(1), bindings)
    assert commands[-1] == Wake(5.0)
    first = ids_sent(commands)[0]
    assert run.handle(Tick(), 5.0) == [Cancel(first), Wake(8.0)]
    run.handle(Accepted(first), 6.0)
    commands = run.handle(Ended(first, Outcome(OutcomeKind.CANCELED)), 6.0)
    assert len(ids_sent(commands)) == 1
    assert ids_sent(commands)[0] != first


def test_a_goal_that_is_neither_answered_nor_confirmed_as_withdrawn_is_not_tried_again() -> None:
    log = FiringLog()
    run, commands = begun(plan(1), Bindings({"a0": Binding(accept=5.0, cancel=3.0, retries=5)}), observer=log)
    run.handle(Tick(), 5.0)
    assert ids_sent(run.handle(Tick(), 8.0)) == []
    run.handle(Accepted(ids_sent(commands)[0]), 9.0)
    failure = run.result().failures[0]
    assert (failure.cause, failure.unconfirmed) == ("unavailable", True)
    assert log.orphans == [Accepted(ids_sent(commands)[0])]


def test_what_is_aborted_for_good_is_not_tried_again() -> None:
    run, commands = begun(plan(1), Bindings({"a0": Binding(retries=5)}))
    (request,) = ids_sent(commands)
    run.handle(Accepted(request), 0.0)
    assert ids_sent(run.handle(Ended(request, Outcome(OutcomeKind.ABORTED_FOR_GOOD, message="it is locked")), 1.0)) == []
    (failure,) = run.result().failures
    assert (failure.cause, failure.observed, run.result().calls[0].attempts) == ("aborted", "it is locked", 1)


def test_results_are_stored_by_name_and_fill_later_goals() -> None:
    bindings = Bindings({"a0": Binding(store={"time": "wait"}), "a1": Binding(goal={"time": "$wait", "word": "$spam"})})
    run, commands = begun(plan(2, "0e<1s"), bindings)
    run.handle(Accepted(ids_sent(commands)[0]), 0.0)
    commands = run.handle(Ended(ids_sent(commands)[0], Outcome(OutcomeKind.SUCCEEDED, {"time": 4, "spam": "eggs"})), 1.0)
    goals = [command.request.goal for command in commands if isinstance(command, Send)]
    assert [(goal["time"], goal["word"]) for goal in goals] == [(4, "eggs")]
    assert run.knowledge.world.variables() == {}


def test_a_fact_that_comes_in_time_opens_a_waiting_check_and_one_that_does_not_is_a_failure() -> None:
    graph = plan_of(GroundAction("act", precondition=Holds(("ok",))))
    for comes in (True, False):
        run, commands = begun(graph, world=KnowledgeBase(sensed={"ok": 2.0}))
        assert commands == [Wake(2.0)]
        run.knowledge.world.update({("ok",): comes})
        assert len(ids_sent(run.handle(KnowledgeChanged(), 1.0))) == comes
        run.handle(Tick(), 2.0)
        assert [failure.cause for failure in run._results.failures] == ([] if comes else ["precondition_false"])


def test_being_told_to_cancel_is_stronger_than_being_told_to_end() -> None:
    run, commands = begun(plan(1))
    run.handle(Accepted(ids_sent(commands)[0]), 0.0)
    assert run.handle(Stop(cancel=False), 1.0) == []
    assert run.handle(Stop(cancel=True), 2.0)[0] == Cancel(ids_sent(commands)[0])


def test_releases_count_from_the_moment_that_was_planned_from() -> None:
    released = PlanGraph((replace(plan(1).calls[0], release=10.0),))
    run = Run(generate(released), Layered(KnowledgeBase()), id=RUN, origin=100.0)
    assert run.handle(Begin(), 105.0) == [Wake(110.0)]


def acting(*effects: Effect, **options: object) -> tuple[Run, list[Command]]:
    """A run of one instantaneous action with these effects, in knowledge with these facts."""
    return begun(plan_of(GroundAction("act", end_effects=effects)), world=KnowledgeBase(**options))  # type: ignore[arg-type]


def test_assumed_effects_do_not_depend_on_what_the_sensors_show_meanwhile() -> None:
    held = Holds(("held",))
    effects = When(held, (Set(("held",), Constant(False)), Set(("delivered",), Constant(True))))
    run, commands = acting(effects, facts={("held",): True}, sensed={"held": 0.0})
    run.handle(Accepted(ids_sent(commands)[0]), 0.0)
    run.knowledge.world.update({("held",): False})
    run.handle(KnowledgeChanged(), 1.0)
    run.handle(Ended(ids_sent(commands)[0], SUCCEEDED), 1.0)
    assert run.result().goal
    assert run.knowledge.value(("delivered",)) is True


def test_a_toggle_that_the_sensors_show_early_is_not_taken_for_a_missing_effect() -> None:
    on = ("on",)
    effects = (When(Holds(on), (Set(on, Constant(False)),)), When(Not(Holds(on)), (Set(on, Constant(True)),)))
    run, commands = acting(*effects, sensed={"on": 0.0})
    run.knowledge.world.update({on: True})
    run.handle(Accepted(ids_sent(commands)[0]), 0.5)
    run.handle(Ended(ids_sent(commands)[0], SUCCEEDED), 1.0)
    assert run.result().goal
    assert run.result().calls[0].attempts == 1


@pytest.mark.parametrize("before", [0.0, 3.0, UNKNOWN, None])
def test_a_number_changed_at_the_start_is_what_it_was_after_a_failure(before: Value | Unknown | None) -> None:
    action = GroundAction("act", start_effects=(Set(("fuel",), Constant(1.0), "increase"),), duration=1.0)
    facts = {} if before is None else {("fuel",): before}
    run = accepted(plan_of(action), world=KnowledgeBase(facts))
    run.handle(Ended(run.open_requests[0], Outcome(OutcomeKind.ABORTED)), 1.0)
    assert run.knowledge.value(("fuel",)) == (UNKNOWN if before is None else before)


def test_a_fact_that_is_unknown_is_not_already_true() -> None:
    _, commands = acting(Set(("p",), Constant(True)), facts={("p",): UNKNOWN}, sensed={"p": 0.0})
    assert len(ids_sent(commands)) == 1


@given(st.data())
def test_what_guards_answer_does_not_depend_on_the_order_in_which_they_are_asked(data: st.DataObject) -> None:
    done = (Set(("done", "a0"), Constant(True)), Set(("seen", "a0"), Constant(True)))
    action = GroundAction("a0", precondition=Holds(("ok",)), invariant=Holds(("ok",)), end_effects=done)
    known = {("ok",): data.draw(st.booleans()), ("done", "a0"): data.draw(st.booleans())}
    run, _ = begun(plan_of(action), world=KnowledgeBase(known, sensed={"ok": 1.0, "done": 1.0, "seen": 2.0}))
    for request in run.open_requests:
        outcome = data.draw(st.sampled_from([None, OutcomeKind.SUCCEEDED, OutcomeKind.ABORTED]))
        run.handle(Accepted(request) if outcome is None else Ended(request, Outcome(outcome)), 1.0)
    index, marked = run._index, [place for place, tokens in enumerate(run._engine.tokens) if tokens]
    asked = [(index.sites[place], one, place) for place in marked for one in index.decision(place).firings if not one.counts]

    def answers(order: list[tuple[Site, Firing, int]]) -> dict[tuple[int, int], float]:
        guards = Guards(run._state, run._calls, run._claims, run._questions)
        return {(one[1].number, one[2]): OPENS[one[1].guarded](guards, *one) for one in order}

    assert answers(data.draw(st.permutations(asked))) == answers(asked)


def test_the_limit_for_the_acceptance_of_a_request_begins_anew_when_it_is_postponed() -> None:
    run, _ = begun(plan(2, "0e<1s"), Bindings({"a0": Binding(accept=15.0)}))
    (request,) = run.open_requests
    for now in (10.0, 20.0, 30.0):
        assert not cancelled(run.handle(Postponed(request), now))
        assert not cancelled(run.handle(Tick(), now + 5.0))
    assert cancelled(run.handle(Tick(), 45.0)) == [request], "15 s after it was postponed last"
    assert not run.handle(Postponed(request), 46.0), "it is given up"
    assert not run.handle(Postponed(UUID(int=7)), 46.0), "of a request that is not there"


def test_a_request_that_is_under_way_is_not_postponed() -> None:
    run, _ = begun(plan(1), Bindings({"a0": Binding(timeout=20.0)}))
    (request,) = run.open_requests
    run.handle(Accepted(request), 1.0)
    assert not cancelled(run.handle(Postponed(request), 15.0))
    assert cancelled(run.handle(Tick(), 21.0)) == [request]
