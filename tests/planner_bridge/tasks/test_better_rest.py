"""The rest of a plan is improved while robots carry it out, and exchanged if that saves more of their time than it costs."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from random import Random
from uuid import UUID

import pytest

from planner_bridge.explanations.history import JournalHistory
from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus, PlanStep
from planner_bridge.model.problem import Metric, Problem
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.ordering.robot_time import ExpectedTimes
from planner_bridge.planning.kairos import REHEARSAL
from planner_bridge.planning.solve import EXCHANGE, WORTH_IT, Improvement, improvement, solve, steps_of
from planner_bridge.tasks import plan_search
from planner_bridge.tasks.replanning import BetterRest, PlanAgain, ResumePlan, decision_words
from planner_bridge.tasks.result import TaskResult
from planner_bridge.tasks.settings import Memory, Settings
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults, HiddenChange
from pnm.core.logic.conditions import TRUE
from pnm.core.logic.domain import Preference
from pnm.core.logic.expressions import ValueOf
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import ActionCall
from pnm.tasks import Code, Wanted
from tests.support.pddl.problems import rooms
from tests.support.runs.simulation.disk import DEATHS, DiskPlan
from tests.support.tasks.replanning import decisions, pursued
from tests.support.tasks.scenarios.crash import survive
from tests.support.tasks.scenarios.random_deaths import run_deaths

BINDINGS = Bindings({"move": Binding(seconds=5.0), "sweep": Binding(seconds=4.0)})
IN_A_SECOND = Bindings({"move": Binding(seconds=1.0), "sweep": Binding(seconds=1.0)})
"""As simulated robots do."""
WAYS = "ab ba bc cb ad da dc cd"
HOUSE = rooms("(at r1 a)", "(and (clean b) (clean c) (clean d) (at r1 a))", WAYS)
ONE_BY_ONE = "move a b, sweep b, move b a, move a d, sweep d, move d a, move a b, move b c, sweep c, move c b, move b a"
"""Back to the first room after each of them; the round takes 7 calls."""


def plan_of(calls: str, robot: str = "r1") -> Plan:
    words = [call.split() for call in calls.split(", ")]
    return Plan(tuple(PlanStep(name, (robot, *places)) for name, *places in words))


@dataclass
class FirstPlan(Memory):
    """The plan that a task begins with."""

    first: Plan | None

    def plan(self, problem: Problem, timeout: float, search: Callable[[float], PlanningResult]) -> PlanningResult:
        plan, self.first = self.first, None
        return search(timeout) if plan is None else PlanningResult(PlanningStatus.SOLVED, plan)


def carried_out(
    problem: Problem = HOUSE, plan: Plan = plan_of(ONE_BY_ONE), *, improve: float | None = 0.2, faults: Faults = NO_FAULTS, **chosen: object
) -> TaskResult:
    settings = Settings(improve=improve, bindings=BINDINGS, memory=FirstPlan(plan))
    result, _ = pursued(problem, faults, replace(settings, **chosen))  # type: ignore[arg-type]
    assert result.goal_reached
    return result


def done(result: TaskResult) -> list[str]:
    return [str(call.call.action) for call in result.calls if call.outcome == "succeeded"]


def lasted(result: TaskResult) -> float:
    return max(call.ended or 0.0 for call in result.calls) - result.began


def test_a_better_rest_is_taken_while_calls_are_under_way_and_nothing_is_done_twice() -> None:
    result = carried_out(improve=1.0)
    assert decisions(result) == [BetterRest]
    assert result.episodes[0].decision == BetterRest("it takes 20 s less")
    assert len(done(result)) == len({*done(result)}) == 7
    assert (result.plans, result.replans, len(result.failures)) == (2, 0, 0)
    assert result.as_json()["decisions"] == [{"decision": "better rest", "why": "it takes 20 s less"}]
    assert lasted(result) == lasted(carried_out(improve=0.0)) - 4.0, "a call takes a second in simulation, and none waits for the exchange"


@pytest.mark.parametrize("improve", [0.0, None], ids=["switched off", "virtual time stands still for the search"])
def test_nothing_is_improved_unless_it_is_asked_for(improve: float | None) -> None:
    result = carried_out(improve=improve)
    assert (len(done(result)), decisions(result), result.plans) == (11, [], 1)


@pytest.mark.parametrize(
    ("problem", "seconds"),
    [(HOUSE, REHEARSAL), (replace(HOUSE, preferences=(Preference("p", TRUE),)), None)],
    ids=["no robot saves time by it", "first plans often fulfil no preference"],
)
def test_a_plan_for_simulated_robots_is_found_soon(problem: Problem, seconds: float | None, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[object]()

    def first(problem: Problem, **chosen: object) -> PlanningResult:
        asked.append(chosen["improve"])
        return PlanningResult(PlanningStatus.SOLVED, plan_of(ONE_BY_ONE))

    monkeypatch.setattr(plan_search, "solve", first)
    assert pursued(problem, NO_FAULTS, Settings(bindings=BINDINGS))[0].goal_reached
    assert asked == [seconds]


def test_the_same_is_done_without_known_seconds_and_by_a_metric() -> None:
    unknown = carried_out(improve=1.0, bindings=Bindings())
    assert unknown.episodes[0].decision == BetterRest("it has 4 calls less")
    costly = replace(HOUSE, metric=Metric("minimize", ValueOf(("total-cost",))))
    assert carried_out(costly, improve=1.0).episodes[0].decision == BetterRest("it costs 4 in place of 8")


def test_what_begins_during_the_search_stays_and_what_has_begun_is_not_replaced() -> None:
    graph = plan_graph(HOUSE, plan_of(ONE_BY_ONE))

    def search(later: Problem, **chosen: object) -> PlanningResult:
        return solve(later, improve=0.2, known=chosen["known"])  # type: ignore[arg-type]

    seconds, found = improvement(HOUSE, {}, graph.calls, graph.calls, ExpectedTimes(BINDINGS), 10.0, search)
    assert seconds == 52.0
    assert found is not None
    assert found.replaced == frozenset(range(4, 11)), "the first four begin within 15 s"
    assert found.rest(graph.calls[2:]).steps[:2] == plan_of(ONE_BY_ONE).steps[2:4]


def test_a_rest_that_is_short_or_saves_less_than_the_exchange_costs_is_left_as_it_is() -> None:
    assert decisions(carried_out(bindings=Bindings({name: Binding(seconds=WORTH_IT / 12.0) for name in ("move", "sweep")}))) == []
    hardly = Bindings({name: Binding(seconds=EXCHANGE / 4.5) for name in ("move", "sweep")})
    long = plan_of(", ".join([ONE_BY_ONE, *["move a b, move b a"] * 20]))
    assert hardly.of("move").seconds is not None
    assert decisions(carried_out(plan=long, bindings=hardly)) != []
    assert decisions(carried_out(plan=plan_of(ONE_BY_ONE), bindings=hardly)) == []


def test_facts_that_change_meanwhile_end_the_search_for_a_better_rest() -> None:
    swept = HiddenChange({("clean", "c"): True}, at=0.5)
    result = carried_out(faults=Faults(changes=(swept,)))
    assert "sweep(r1, c)" not in done(result)
    assert set(decisions(result)) <= {BetterRest, ResumePlan, PlanAgain}


# --- laws over random plans with detours -----------------------------------------------------------


def tour(random: Random, robots: tuple[str, ...]) -> tuple[Problem, Plan]:
    """Rooms to be swept, and a plan that goes back to the first one after each, the robots taking turns as they come."""
    names = "bcdefg"[: random.randint(3, 6)]
    ring = f"a{names}a"
    ways = " ".join(f"{one}{other} {other}{one}" for one, other in pairwise(ring))
    steps: list[str] = []
    for room in random.sample(names, len(names)):
        robot, place = random.choice(robots), ring.index(room)
        way = ring[: place + 1] if random.random() < 0.5 else ring[: place - 1 : -1]
        there = [f"move {robot} {one} {other}" for one, other in pairwise(way)]
        back = [f"move {robot} {other} {one}" for one, other in reversed([*pairwise(way)])]
        steps += [*there, f"sweep {robot} {room}", *back]
    words = [step.split() for step in steps]
    init = " ".join(f"(at {robot} a)" for robot in robots)
    goal = f"(and {' '.join(f'(clean {room})' for room in names)} {init})"
    return rooms(init, goal, ways), Plan(tuple(PlanStep(name, tuple(arguments)) for name, *arguments in words))


@pytest.mark.parametrize("seed", range(8))
def test_no_run_takes_longer_than_without_and_nothing_is_done_twice(seed: int) -> None:
    random = Random(seed)
    problem, plan = tour(random, ("r1", "r2")[: 1 + seed % 2])
    once = {name: Binding(seconds=1.0, resources=("{r}",)) for name in ("move", "sweep")}
    chosen = {"bindings": Bindings(once), "on_failure": OnFailure.CONTINUE_OTHERS}
    better, plain = (carried_out(problem, plan, improve=improve, **chosen) for improve in (0.1, 0.0))
    assert lasted(better) <= lasted(plain), "the exchange takes no time in simulation"
    assert {*decisions(better)} <= {BetterRest}
    assert better.replans == 0
    swept = Counter(call for call in done(better) if call.startswith("sweep"))
    assert sorted(call[-2] for call in swept) == sorted({step.arguments[1] for step in plan.steps if step.action == "sweep"})
    assert {*swept.values()} == {1}


@pytest.mark.parametrize("seed", range(6))
def test_goals_are_reached_with_a_better_rest_whatever_fails(seed: int) -> None:
    random = Random(seed)
    problem, plan = tour(random, ("r1", "r2"))
    kinds = FaultKind.ABORT, FaultKind.SLOW, FaultKind.NO_EFFECT
    faults = tuple(Fault(random.choice(("move", "sweep")), random.choice(kinds), times=random.randint(1, 3)) for _ in range(2))
    result = carried_out(problem, plan, faults=Faults(faults), bindings=IN_A_SECOND, on_failure=OnFailure.CONTINUE_OTHERS)
    assert result.replans == sum(kind is not BetterRest for kind in decisions(result))


@pytest.mark.parametrize("seed", range(8))
def test_another_process_goes_on_with_a_better_rest_and_all_readers_tell_why_it_followed(seed: int, tmp_path: Path) -> None:
    random, goal = Random(seed), "(and (clean b) (clean c) (clean d) (at r1 a))"
    settings = Settings(improve=0.5, bindings=BINDINGS, memory=FirstPlan(plan_of(ONE_BY_ONE)))
    deaths = [DiskPlan(random.randrange(1, 40), random.choice(DEATHS), torn=random.random()) for _ in range(random.randrange(3))]
    survival = survive(HOUSE, [Wanted(UUID(int=1), goal)], settings, tmp_path / "journal", deaths)
    assert [ending.code for ending in survival.endings.values()] == [Code.GOAL_REACHED]
    assert not survival.wrong
    assert not [call for call in survival.doubled if call.startswith("sweep")]
    history = JournalHistory.read(tmp_path / "journal")
    told = [run.replan.why for run in history.tasks[UUID(int=1)].own_runs if run.replan]
    assert told == ([decision_words(BetterRest("it takes 20 s less"))] if not deaths else told)
    assert all("a better rest of the plan was found at work" in why or "another plan was found" in why for why in told)


@pytest.mark.parametrize("seed", range(10))
def test_plans_may_be_exchanged_at_any_time_among_other_tasks_and_deaths(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    random = Random(seed)

    def other_rest(
        _now: Problem, _under_way: object, _calls: object, waiting: Sequence[ActionCall], *_: object
    ) -> tuple[float, Improvement | None]:
        if not waiting or random.random() < 0.3:
            return 0.0, None
        replaced = waiting[random.randrange(len(waiting)) :]
        return WORTH_IT, Improvement(frozenset(call.index for call in replaced), steps_of(replaced), "it is another one")

    monkeypatch.setattr(plan_search, "improvement", other_rest)
    run_deaths(seed, tmp_path, improve=1.0)
