"""Preferences of tasks are counted and never enforced; what is left of both for a planner, and how it is reported."""

from __future__ import annotations

import io
from dataclasses import replace

from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.run_console import ConsoleObserver, print_result
from planner_bridge.model.problem import Problem
from planner_bridge.model.world import simulated_backend
from planner_bridge.pipeline.achieve import achieve_at
from planner_bridge.tasks.settings import Settings
from pnm.clock import run_async
from pnm.core.logic.conditions import Exists, Holds, Not
from pnm.core.logic.domain import ActionSchema, Preference
from pnm.core.logic.expressions import Variable
from pnm.core.logic.trajectory import IMPOSSIBLE, Constraint
from pnm.core.machine.bindings import Bindings
from tests.support.logic.trajectories import always, sometime
from tests.support.tasks.constraints import TO_C, changes, monitor, monitored, within

A, B, C, D = (Holds(("clean", room)) for room in "abcd")
ROOM = Variable("?a", ("room",))


def wished(*preferences: Preference, problem: Problem = TO_C) -> Problem:
    return replace(problem, preferences=preferences)


# --- preferences ---


def test_preferences_are_counted_and_never_enforced() -> None:
    problem = wished(
        Preference("tidy", Holds(("clean", "?a")), (ROOM,)),
        Preference("there", Holds(("at", "r1", "c"))),
        Preference("quiet", (always(Not(Holds(("clean", "?a")))),), (ROOM,)),
        Preference("all-quiet", (always(Not(Holds(("clean", "?a"))), ROOM),)),
        Preference("soon", (within(0.5, C), within(0.7, C))),
        Preference("soon", (within(1.5, B),)),
        Preference("", (sometime(Holds(("at", "r1", "b"))),)),
        Preference("still", (Constraint("hold-during", (Not(D),), (0.5, 0.9)),)),
    )
    done = monitored(problem, changes((0.5, "a"), (1.0, "b"), (0.3, "d"), (0.95, "not d")))
    assert done.result.goal_reached
    assert done.result.constraints == ()
    assert [(one.name, one.status, one.violated) for one in done.result.preferences] == [
        ("tidy", "violated", 2),
        ("there", "fulfilled", 0),
        ("quiet", "violated", 3),
        ("all-quiet", "violated", 1),
        ("soon", "violated", 1),
        ("", "fulfilled", 0),
        ("still", "violated", 1),
    ]
    assert done.log.told == []


def test_preferences_of_actions_are_said_not_to_be_monitored() -> None:
    move: ActionSchema = replace(TO_C.domain.actions["move"], preferences=(Preference("lit", Exists((ROOM,), Holds(("clean", "?a")))),))
    problem = replace(TO_C, domain=replace(TO_C.domain, actions={**TO_C.domain.actions, "move": move}))
    assert [(one.name, one.status, one.violated) for one in monitored(problem).result.preferences] == [("lit", "not monitored", None)]


# --- what is left for a planner ---


def test_as_long_as_nothing_has_happened_everything_is_left_as_it_was_written() -> None:
    lifted = Constraint("at-most-once", (Holds(("clean", "?a")),), (), (ROOM,))
    problem = replace(wished(Preference("p", (sometime(A),), (ROOM,)), Preference("q", B)), constraints=(lifted, within(9.0, B)))
    _, left = monitor(problem, (0.0, {"d": True}))
    assert left.constraints == problem.constraints
    assert left.preferences == problem.preferences
    _, left = monitor(problem, (0.0, {"d": True}), (1.0, {"d": False}))
    assert [str(one) for one in left.constraints[2:]] == ["(at-most-once (clean c))", "(always (not (clean d)))", "(within 8 (clean b))"]


def test_what_is_left_is_handed_to_the_planner_with_times_from_now_on() -> None:
    domain = replace(TO_C.domain, constraints=(sometime(A), sometime(D)), preferences=(Preference("p", B),))
    problem = replace(
        TO_C, domain=domain, constraints=(within(9.0, C), Constraint("sometime-after", (A, D)), Constraint("at-most-once", (A,)))
    )
    _, left = monitor(problem, (0.0, {}), (3.0, {"a": True}), (4.0, {"a": False}))
    assert [str(one) for one in left.constraints] == [
        "(sometime (clean d))",
        "(within 5 (clean c))",
        "(sometime-after (clean a) (clean d))",
        "(sometime (clean d))",
        "(always (not (clean a)))",
    ]
    assert (left.domain.constraints, left.domain.preferences, left.preferences) == ((), (), (Preference("p", B),))


def test_of_preferences_every_instance_is_left_as_the_metric_names_them() -> None:
    problem = wished(
        Preference("p", (sometime(Holds(("clean", "?a"))),), (ROOM,)),
        Preference("q", (always(Not(A)), sometime(D))),
        Preference("r", (Constraint("sometime-after", (A, D)), within(9.0, B))),
        Preference("s", (sometime(B),)),
    )
    _, left = monitor(problem, (0.0, {}), (3.0, {"a": True}))
    assert left.preferences == (
        Preference("p", ()),
        *(Preference("p", (sometime(room),)) for room in (B, C, D)),
        Preference("q", (IMPOSSIBLE, sometime(D))),
        Preference("r", (Constraint("sometime-after", (A, D)), sometime(D), within(6.0, B))),
        Preference("s", (sometime(B),)),
    )


# --- told ---


def test_a_person_reads_what_is_violated_as_it_happens_and_at_the_end() -> None:
    problem = replace(wished(Preference("p", A), Preference("q", B)), constraints=(always(Not(Holds(("clean", "?a"))), ROOM),))
    text = io.StringIO()
    console = SafeConsole(file=text)
    backend = simulated_backend(problem, Bindings(), changes((0.3, "b"), (0.3, "c")))
    print_result(console, run_async(achieve_at(backend, problem, Settings(), ConsoleObserver(console, 30.0)), virtual=True))
    lines = text.getvalue().splitlines()
    assert "      0.31 s  broken (always (not (clean b))); observed (clean b) is true" in lines
    assert "goal     not reached: (always (not (clean b))) is violated after 0.30 s: (clean b) is true" in lines
    assert lines[-3:] == [
        "         constraint (always (not (clean b))) is violated after 0.30 s: (clean b) is true, and for 1 more choices of objects",
        "         preference p is violated 1 time",
        "         preference q is fulfilled",
    ]
    assert not any("constraint" in line or "preference" in line for line in result_lines(TO_C))


def result_lines(problem: Problem) -> list[str]:
    text = io.StringIO()
    print_result(SafeConsole(file=text), monitored(problem).result)
    return text.getvalue().splitlines()
