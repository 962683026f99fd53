"""Tasks with constraints and preferences, on simulated robots: what is violated ends a task, what is missing does not."""

from __future__ import annotations

import asyncio
import io
from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import pytest
from rich.console import Console

from planner_bridge.cli.console import ConsoleObserver, print_result
from planner_bridge.model.grounding import problem_now
from planner_bridge.model.problem import Problem
from planner_bridge.pipeline import achieve_at
from planner_bridge.simulation import robots_of, simulated_backend
from planner_bridge.tasks.constraint_monitor import ConstraintMonitor
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.result import TaskResult, Violation
from planner_bridge.tasks.settings import Settings, TaskObserver
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults, HiddenChange
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import Condition, Exists, Holds, Not
from pnm.core.logic.domain import ActionSchema, Preference
from pnm.core.logic.expressions import Variable
from pnm.core.logic.trajectory import IMPOSSIBLE, Constraint
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.plan_graph import GroundAction
from tests.support.problems import rooms
from tests.support.runs.simulated import LateBackend

TO_C = rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc")
"""Two moves of a second each, from a over b to c."""
A, B, C, D = (Holds(("clean", room)) for room in "abcd")
ROOM = Variable("?a", ("room",))


def always(condition: Condition, *variables: Variable) -> Constraint:
    return Constraint("always", (condition,), (), variables)


def sometime(condition: Condition) -> Constraint:
    return Constraint("sometime", (condition,))


def within(seconds: float, condition: Condition) -> Constraint:
    return Constraint("within", (condition,), (seconds,))


def constrained(*constraints: Constraint, problem: Problem = TO_C) -> Problem:
    return replace(problem, constraints=constraints)


def changes(*times: tuple[float, str], value: bool = True) -> Faults:
    """Rooms that become clean behind the robots' backs; or, with ``not``, dirty."""
    return Faults(changes=tuple(HiddenChange({("clean", room[-1]): "not" not in room}, at=time) for time, room in times))


@dataclass
class Log(TaskObserver):
    """Writes down which constraints are violated, when that is told, and how often a planner is asked."""

    told: list[tuple[float, Violation]] = field(default_factory=list)
    asked: int = 0

    def planning(self, planner: str) -> None:
        self.asked += 1

    def violated(self, violation: Violation, now: float) -> None:
        self.told.append((now, violation))


@dataclass
class Pursued:
    """A task that is over."""

    result: TaskResult
    log: Log
    truth: KnowledgeBase
    ended: float

    def outcomes(self) -> list[str]:
        return [call.outcome for call in self.result.calls]

    def statuses(self) -> list[str]:
        return [one.status for one in self.result.constraints]


def pursued(
    problem: Problem,
    faults: Faults = NO_FAULTS,
    *,
    limits: Limits = Limits(),
    bindings: Bindings = Bindings(),
    backend: SimulatedBackend | None = None,
) -> Pursued:
    backend, log = backend or simulated_backend(problem, bindings, faults), Log()

    async def main() -> tuple[TaskResult, float]:
        result = await achieve_at(backend, problem, Settings(limits=limits, bindings=bindings), log)
        return result, asyncio.get_running_loop().time()

    result, ended = run_async(main(), virtual=True)
    return Pursued(result, log, backend.robots.world.truth, ended)


# --- violated ----------------------------------------------------------------------------------------


def test_a_violated_constraint_stops_the_run_and_ends_the_task() -> None:
    done = pursued(constrained(always(Not(B))), changes((0.3, "b")))
    assert not done.result.goal_reached
    assert done.result.reason == "(always (not (clean b))) is violated after 0.30 s: (clean b) is true"
    assert done.outcomes() == ["canceled", "skipped"]
    assert not any(failure.unconfirmed for failure in done.result.failures)
    assert done.truth.value(("at", "r1", "a")) is True
    assert done.statuses() == ["violated"]
    assert [(round(now, 6), violation.time) for now, violation in done.log.told] == [(0.31, 0.3)]
    assert done.ended < 0.4


def test_a_violation_that_is_made_good_before_all_reports_are_in_does_not_count() -> None:
    done = pursued(constrained(always(Not(B))), changes((0.3, "b"), (0.305, "not b")))
    assert done.result.goal_reached
    assert done.statuses() == ["fulfilled"]


def test_a_violation_at_the_very_end_counts() -> None:
    done = pursued(constrained(always(Not(B))), changes((1.995, "b")))
    assert done.outcomes() == ["succeeded", "succeeded"]
    assert done.result.reason == "(always (not (clean b))) is violated after 2.00 s: (clean b) is true"
    assert not done.result.goal_reached
    assert done.result.as_json()["decisions"] == []


def test_a_violation_that_is_reported_after_the_end_counts() -> None:
    problem = constrained(always(Not(B)))
    done = pursued(problem, backend=LateBackend(problem, changes((2.65, "b")), delay=0.3, lag=1.0))
    assert done.outcomes() == ["succeeded", "succeeded"]
    assert done.result.reason == "(always (not (clean b))) is violated after 2.95 s: (clean b) is true"
    assert done.result.as_json()["decisions"] == []


class SlowBackend(SimulatedBackend):
    """Servers are looked for so long."""

    async def prepare(self, actions: Iterable[GroundAction]) -> None:
        await asyncio.sleep(5.0)


def test_nothing_is_started_when_a_constraint_is_violated_before() -> None:
    problem = constrained(always(Not(B)))
    done = pursued(problem, backend=SlowBackend(robots_of(problem, Bindings(), changes((2.0, "b")))))
    assert [call.attempts for call in done.result.calls] == [0, 0]
    assert done.result.reason.startswith("(always (not (clean b))) is violated after 2.00 s")


def test_a_constraint_that_the_initial_state_violates_leaves_nothing_to_plan() -> None:
    done = pursued(constrained(always(Not(Holds(("at", "r1", "a"))))))
    assert done.result.reason == "(always (not (at r1 a))) is violated after 0.00 s: (at r1 a) is true"
    assert (done.log.asked, done.result.calls) == (0, ())


def test_constraints_of_the_domain_count_for_every_object() -> None:
    nowhere = always(Not(Holds(("clean", "?a"))), ROOM)
    problem = replace(TO_C, domain=replace(TO_C.domain, constraints=(nowhere,)))
    done = pursued(problem, changes((0.5, "d"), (0.5, "c")))
    assert done.statuses() == ["violated"]
    assert [str(one.constraint) for one in done.result.constraints[0].violations] == [f"(always (not (clean {room})))" for room in "cd"]
    assert done.result.reason.startswith("(always (not (clean c))) is violated after 0.50 s")


@pytest.mark.parametrize("assumed", [frozenset[str](), frozenset({"at", "clean"})])
def test_a_deadline_that_passes_ends_the_task(assumed: frozenset[str]) -> None:
    slow = Faults((Fault("move", FaultKind.SLOW, after=1),))
    done = pursued(constrained(within(3.5, Holds(("at", "r1", "c")))), slow, bindings=Bindings(assumed=assumed))
    assert done.result.reason == "(within 3.5 (at r1 c)) is violated after 3.50 s: (at r1 c) is false"
    assert done.outcomes() == ["succeeded", "canceled"]
    assert [round(now, 6) for now, _ in done.log.told] == [3.51]


@pytest.mark.parametrize("assumed", [frozenset[str](), frozenset({"at"})])
def test_a_deadline_may_be_met_at_the_last_moment(assumed: frozenset[str]) -> None:
    done = pursued(constrained(within(1.0, Holds(("at", "r1", "b")))), bindings=Bindings(assumed=assumed))
    assert done.result.goal_reached, done.result.reason
    assert done.statuses() == ["fulfilled"]


def test_what_is_too_early_or_comes_twice_is_violated() -> None:
    for constraint, faults, time in (
        (Constraint("sometime-before", (B, A)), changes((0.3, "b")), 0.3),
        (Constraint("sometime-before", (B, A)), changes((0.3, "a"), (0.4, "b")), None),
        (Constraint("at-most-once", (B,)), changes((0.3, "b"), (0.4, "not b"), (0.5, "b")), 0.5),
        (Constraint("at-most-once", (B,)), changes((0.3, "b"), (0.4, "not b")), None),
        (Constraint("always-within", (B, A), (0.5,)), changes((0.3, "b"), (0.9, "a")), 0.8),
        (Constraint("always-within", (B, A), (0.5,)), changes((0.3, "b"), (0.7, "a")), None),
        (Constraint("hold-during", (Not(B),), (0.5, 0.9)), changes((0.3, "b")), 0.5),
        (Constraint("hold-during", (Not(B),), (0.5, 0.9)), changes((0.3, "b"), (0.4, "not b"), (0.9, "b")), None),
        (Constraint("hold-after", (Not(B),), (0.5,)), changes((0.3, "b"), (0.4, "not b"), (0.9, "b")), 0.9),
    ):
        done = pursued(constrained(constraint), faults)
        assert [round(violation.time, 6) for _, violation in done.log.told] == ([] if time is None else [time]), constraint
        assert done.result.goal_reached is (time is None), constraint


def test_a_violation_while_waiting_to_try_again_ends_the_task_at_once() -> None:
    aborts = Faults((Fault("move", FaultKind.ABORT),), changes((20.0, "b")).changes)
    done = pursued(constrained(always(Not(B))), aborts, limits=Limits(backoff=1000.0, longest_backoff=1000.0, forbid_after=100))
    assert done.result.reason.startswith("(always (not (clean b))) is violated after 20.00 s")
    assert done.ended < 21.0
    assert done.log.asked == done.result.plans == 1


def test_the_constraints_are_watched_in_every_episode() -> None:
    aborts = Faults((Fault("move(r1, b, c)", FaultKind.ABORT, times=2),), changes((0.5, "a"), (2.5, "b")).changes)
    done = pursued(constrained(Constraint("at-most-once", (A,)), always(Not(B))), aborts)
    assert done.result.replans == 1
    assert done.statuses() == ["fulfilled", "violated"]
    assert done.result.reason.startswith("(always (not (clean b))) is violated after 2.50 s")


# --- fulfilled ---------------------------------------------------------------------------------------


def test_what_was_so_for_one_moment_was_so_sometime() -> None:
    visits = sometime(Holds(("at", "r1", "b")))
    done = pursued(constrained(visits, sometime(A)), changes((0.5, "a"), (0.5, "not a")))
    assert done.result.goal_reached
    assert done.statuses() == ["fulfilled", "fulfilled"]


def test_a_goal_that_holds_is_not_reached_while_something_is_missing() -> None:
    in_vain = Faults((Fault("sweep", FaultKind.NO_EFFECT),))
    done = pursued(constrained(sometime(B)), in_vain, limits=Limits(replans=0))
    assert not done.result.goal_reached
    assert done.result.reason.startswith("the limit of 0 replans is reached")
    assert done.result.reason.endswith("; not fulfilled: (sometime (clean b))")
    assert done.statuses() == ["violated"]


def test_a_cancelled_task_tells_what_was_not_fulfilled() -> None:
    done = pursued(constrained(sometime(B), always(Not(D))), limits=Limits(seconds=0.5))
    assert done.result.reason == "the limit of 0.5 s is reached"
    assert done.statuses() == ["violated", "fulfilled"]


def test_a_violation_is_told_once() -> None:
    world = KnowledgeBase()
    watching = ConstraintMonitor(constrained(always(Not(B))), Layered(world))
    watching.look(0.0)
    world.update({("clean", "b"): True})
    assert [[violation.time for violation in watching.look(now)] for now in (1.0, 1.005, 1.02, 2.0, 3.0)] == [[], [], [1.0], [], []]


def test_a_task_that_never_began_has_monitored_nothing() -> None:
    monitor = ConstraintMonitor(constrained(always(B)), Layered(KnowledgeBase()))
    assert [one.status for one in monitor.constraint_results(0.0)] == ["not monitored"]


# --- preferences -------------------------------------------------------------------------------------


def wished(*preferences: Preference, problem: Problem = TO_C) -> Problem:
    return replace(problem, preferences=preferences)


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
    done = pursued(problem, changes((0.5, "a"), (1.0, "b"), (0.3, "d"), (0.95, "not d")))
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
    assert [(one.name, one.status, one.violated) for one in pursued(problem).result.preferences] == [("lit", "not monitored", None)]


# --- what is left for a planner ----------------------------------------------------------------------


def monitor(problem: Problem, *seen: tuple[float, dict[str, bool]]) -> tuple[ConstraintMonitor, Problem]:
    """Look at which rooms are clean at some times; return also the problem that is left then."""
    world = KnowledgeBase(problem.init, objects=problem.objects_by_type)
    watching = ConstraintMonitor(problem, Layered(world))
    for time, clean in seen:
        world.update({("clean", room): value for room, value in clean.items()})
        watching.look(time)
        watching.look(time + 0.02)
    last = seen[-1][0]
    return watching, watching.rest_of(problem_now(problem, world, last), last)


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


def test_a_problem_without_constraints_is_left_alone() -> None:
    watching, left = monitor(TO_C, (0.0, {}))
    assert watching.idle
    assert left.domain is TO_C.domain


# --- told --------------------------------------------------------------------------------------------


def test_the_result_as_json_tells_constraints_and_preferences() -> None:
    problem = replace(wished(Preference("p", B)), constraints=(always(Not(B)), sometime(Holds(("at", "r1", "a")))))
    told = pursued(problem, changes((0.3, "b"))).result.as_json()
    assert told["constraints"] == [
        {
            "constraint": "(always (not (clean b)))",
            "status": "violated",
            "violations": [{"constraint": "(always (not (clean b)))", "time": 0.3, "observed": "(clean b) is true"}],
        },
        {"constraint": "(sometime (at r1 a))", "status": "fulfilled", "violations": []},
    ]
    assert told["preferences"] == [{"name": "p", "status": "fulfilled", "violated": 0}]
    plain = pursued(TO_C).result.as_json()
    assert (plain["constraints"], plain["preferences"]) == ([], [])


def test_a_person_reads_what_is_violated_as_it_happens_and_at_the_end() -> None:
    problem = replace(wished(Preference("p", A), Preference("q", B)), constraints=(always(Not(Holds(("clean", "?a"))), ROOM),))
    text = io.StringIO()
    console = Console(file=text)
    backend = simulated_backend(problem, Bindings(), changes((0.3, "b"), (0.3, "c")))
    print_result(console, run_async(achieve_at(backend, problem, Settings(), ConsoleObserver(console)), virtual=True))
    lines = text.getvalue().splitlines()
    assert "      0.31 s  broken (always (not (clean b))); observed (clean b) is true" in lines
    assert "goal     not reached: (always (not (clean b))) is violated after 0.30 s: (clean b) is true" in lines
    assert lines[-3:] == [
        "         constraint (always (not (clean b))) is violated after 0.30 s: (clean b) is true, and for 1 more choices of objects",
        "         preference p is violated 1 time",
        "         preference q is fulfilled",
    ]
    assert not any("constraint" in line or "preference" in line for line in _read(TO_C))


def _read(problem: Problem) -> list[str]:
    text = io.StringIO()
    print_result(Console(file=text), pursued(problem).result)
    return text.getvalue().splitlines()
