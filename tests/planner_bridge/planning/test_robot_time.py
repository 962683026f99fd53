"""Plans that take robots little time: what calls are expected to take counts, and parts of plans are replaced by better ones."""

from __future__ import annotations

from dataclasses import replace

import pytest

from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.model.rates import NO_RATES, Call, Counts, End, Rates
from planner_bridge.ordering.robot_time import ExpectedTimes, priced, robot_time
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.solve import solve
from planner_bridge.planning.validate import why_invalid
from pnm.core.logic.domain import Declaration
from pnm.core.logic.expressions import Fluent, Value
from pnm.core.machine.bindings import Binding, Bindings
from pnm.errors import InputError
from tests.support.pddl.problems import rooms

SLOW_SWEEP = Bindings({"move": Binding(seconds=2.0), "sweep": Binding(seconds=10.0)})


def plan_of(*calls: str) -> Plan:
    """A sequential plan of calls such as ``move r1 a b``."""
    words = [call.split() for call in calls]
    return Plan(tuple(PlanStep(name, tuple(arguments)) for name, *arguments in words))


def ways(direct: str = "") -> Problem:
    """A place that is reached by two short drives or a flight, and by foot."""
    domain = parse_domain("""
    (define (domain ways)
      (:requirements :strips)
      (:predicates (begun) (halfway) (there))
      (:action drive_out :parameters () :effect (halfway))
      (:action drive_in :parameters () :precondition (halfway) :effect (there))
      (:action walk :parameters () :effect (there)))
    """)
    return parse_problem(f"(define (problem p) (:domain ways) (:init (begun)) (:goal (there)) {direct})", domain)


def test_the_plan_with_the_least_seconds_is_found_and_not_that_with_the_fewest_calls() -> None:
    walk_is_slow = Bindings({"walk": Binding(seconds=60.0), "drive_out": Binding(seconds=5.0)})
    fast, short = solve(ways(), bindings=walk_is_slow).plan, solve(ways()).plan
    assert fast is not None
    assert short is not None
    assert [step.action for step in fast.steps] == ["drive_out", "drive_in"]
    assert fast.seconds == pytest.approx(6.0)
    assert str(fast).startswith("2 calls, 6 s expected")
    assert [step.action for step in short.steps] == ["walk"]
    assert short.seconds is None


def test_calls_that_go_on_at_the_same_time_count_once_unless_they_need_the_same_resource() -> None:
    problem = rooms(goal="(and (clean a) (clean b))", init="(at r1 a) (at r2 b)")
    plan = plan_of("sweep r1 a", "sweep r2 b")
    one_broom = Bindings({"sweep": Binding(seconds=10.0, resources=("broom",))})
    assert robot_time(problem, plan, ExpectedTimes(SLOW_SWEEP)) == 10.0
    assert robot_time(problem, plan, ExpectedTimes(one_broom)) == 20.0
    assert robot_time(problem, plan_of("move r1 a b", "move r1 b c", "sweep r2 b"), ExpectedTimes(SLOW_SWEEP)) == 10.0


@pytest.mark.parametrize(("robots", "seconds"), [(1, 80.0), (2, 40.0)])
def test_robots_share_the_work(robots: int, seconds: float) -> None:
    ways, names = "ab ba ac ca ad da ae ea", "bcde"
    at = " ".join(f"(at r{number + 1} a)" for number in range(robots))
    problem = rooms(at, f"(and {' '.join(f'(clean {room})' for room in names)} {at})", ways)
    of_one = {name: Binding(seconds=lasts, resources=("{r}",)) for name, lasts in (("move", 5.0), ("sweep", 10.0))}
    plan = solve(problem, bindings=Bindings(of_one), improve=2.0).plan
    assert plan is not None
    assert plan.seconds == seconds
    assert not why_invalid(problem, plan)


def test_nothing_is_called_best_where_calls_can_go_on_at_the_same_time() -> None:
    problem = rooms(goal="(clean a)")
    together = solve(problem, bindings=SLOW_SWEEP).plan
    in_turn = Bindings({name: Binding(seconds=2.0, resources=("floor",)) for name in ("move", "sweep")})
    one_by_one = solve(problem, bindings=in_turn).plan
    assert together is not None
    assert one_by_one is not None
    assert (together.is_best, one_by_one.is_best) == (False, True)


def test_a_metric_of_the_problem_counts_and_not_the_seconds() -> None:
    problem = ways("(:metric minimize (total-time))")
    assert priced(problem, ExpectedTimes(Bindings({"walk": Binding(seconds=60.0)}))) is problem
    plan = solve(problem, bindings=Bindings({"walk": Binding(seconds=60.0)})).plan
    assert plan is not None
    assert [step.action for step in plan.steps] == ["walk"]


def learned_of(**attempts: tuple[float, int, int]) -> Rates:
    """ExpectedTimes of actions without arguments: the seconds of an attempt, how many have succeeded, how many have not."""
    counted = [
        (Call(name, name), Counts.of(end, seconds))
        for name, (seconds, *times) in attempts.items()
        for end, many in zip((End.SUCCEEDED, End.ABORTED), times, strict=True)
        for _ in range(many)
    ]
    return NO_RATES.grown("journal", 1, counted)


@pytest.mark.parametrize(
    ("walk", "drives", "chosen"),
    [
        ((60.0, 30, 0), (5.0, 30, 0), ["drive_out", "drive_in"]),
        ((6.0, 30, 0), (5.0, 30, 0), ["walk"]),
        ((6.0, 10, 30), (5.0, 30, 0), ["drive_out", "drive_in"]),  # a walk takes four attempts
    ],
)
def test_plans_are_measured_by_what_was_learned(walk: tuple[float, int, int], drives: tuple[float, int, int], chosen: list[str]) -> None:
    plan = solve(ways(), learned=learned_of(walk=walk, drive_out=drives, drive_in=drives)).plan
    assert plan is not None
    assert [step.action for step in plan.steps] == chosen
    if chosen != ["walk"]:
        assert plan.seconds == pytest.approx(10.0, rel=0.01), "all but the assumption that one of ten attempts fails is learned"


def test_each_call_takes_as_long_as_it_took() -> None:
    problem, move = rooms(goal="(at r1 c)", init="(at r1 a)"), Call("move", "move")
    counted = [
        (move._replace(arguments=("r1", here, there)), Counts.of(End.SUCCEEDED, seconds))
        for here, there, seconds in (("a", "b", 3.0), ("b", "c", 8.0))
        for _ in range(1000)
    ]
    rates = ExpectedTimes(learned=NO_RATES.grown("journal", 1, counted))
    assert robot_time(problem, plan_of("move r1 a b", "move r1 b c"), rates) == pytest.approx(11.0, rel=0.001)
    never = problem.domain.actions["move"]
    assert rates.of(never, ("r1", "a", "d")) == pytest.approx(8.0, rel=0.02), "what was never done takes as long as most of it"
    assert rates.of(never, ()) == pytest.approx(5.5, rel=0.02)


def test_ways_between_places_are_told_apart() -> None:
    problem = rooms(goal="(at r1 c)", init="(at r1 a)", ways="ab bc ac")
    counted = [
        (Call("move", "move", ("r1", here, there)), Counts.of(End.SUCCEEDED, seconds))
        for here, there, seconds in (("a", "b", 2.0), ("b", "c", 3.0), ("a", "c", 9.0))
        for _ in range(30)
    ]
    rates = ExpectedTimes(learned=NO_RATES.grown("journal", 1, counted))
    plan = solve(priced(problem, rates, by_call=True)).plan
    assert plan is not None
    assert [step.arguments for step in plan.steps] == [("r1", "a", "b"), ("r1", "b", "c")]
    assert plan.cost == pytest.approx(5.3, abs=0.2)
    whole = solve(priced(problem, rates)).plan
    assert whole is not None
    assert len(whole.steps) == 1, "all moves cost as much there"


def test_the_problem_may_say_how_long_each_call_takes() -> None:
    moves, places = Binding(seconds=("lasts", "?a", "?b")), {("a", "b"): 2.0, ("b", "c"): 3.0, ("a", "c"): 9.0}
    known: dict[Fluent, Value] = {("lasts", *way): seconds for way, seconds in places.items()}
    bindings = Bindings({"move": moves})
    rates = ExpectedTimes(bindings, known=known)
    problem = rooms(goal="(at r1 c)", init="(at r1 a)", ways="ab bc ac")
    move = problem.domain.actions["move"]
    assert [rates.of(move, arguments) for arguments in (("r1", "a", "b"), ("r2", "b", "c"), ("r1", "c", "a"))] == [2.0, 3.0, 9.0]
    assert rates.of(move, ("r1", "a")) == 5.5, "the mean of those that begin so"
    assert rates.of(move, ()) == pytest.approx(14 / 3)
    learned = NO_RATES.grown("journal", 1, [(Call("move", "move", ("r1", "a", "b")), Counts.of(End.SUCCEEDED, 8.0))] * 2)
    both = ExpectedTimes(bindings, learned, known)
    assert both.of(move, ("r1", "b", "c")) == pytest.approx(3.0, rel=0.1), "what was learned of another call does not count"
    assert both.of(move, ("r1", "a", "b")) == pytest.approx(5.0, rel=0.1)
    declared = replace(problem.domain, functions={**problem.domain.functions, "lasts": Declaration("lasts", move.parameters[1:])})
    plan = solve(replace(problem, domain=declared, init={**problem.init, **known}), bindings=bindings).plan
    assert plan is not None
    assert [step.arguments for step in plan.steps] == [("r1", "a", "b"), ("r1", "b", "c")]
    assert plan.seconds == 5.0


def test_seconds_are_not_negative() -> None:
    with pytest.raises(InputError):
        Binding(seconds=-1.0)
