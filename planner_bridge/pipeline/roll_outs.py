"""The odds of a goal, or of a hand-written plan: exact where nothing is planned anew, else by roll-outs.

Roll-outs are runs of the machine itself, with its recovery and its new plans, on simulated robots under virtual time.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from random import Random
from typing import Final

from planner_bridge.model.grounding import dynamic_names, initial_knowledge
from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus, Policy
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import stretch
from planner_bridge.model.rates import Basis, Chance, as_may_be
from planner_bridge.model.world import simulated_backend
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pipeline.achieve import carry_out
from planner_bridge.pipeline.goal_handle import GoalHandle
from planner_bridge.pipeline.odds import AttemptOdds, Attempts, GoalOdds, KnownRobots, Leads, Odds, exact, odds_of_calls
from planner_bridge.pipeline.policy_odds import PolicyChain
from planner_bridge.planning.validate import why_invalid
from planner_bridge.tasks.result import Stopwatch, TaskResult
from planner_bridge.tasks.settings import Memory, ProvedMachine, Settings, TaskObserver
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Arithmetic, Constant, Fluent, ValueOf, is_number
from pnm.core.machine.plan_graph import GroundAction, PlanGraph
from pnm.language.plan import chosen_plan, read_plans
from pnm.tasks import Code

SECONDS: Final = 2.0
"""Seconds of processor time for all roll-outs together."""
IMPROVE: Final = 0.05
"""The share of them for which a better plan is looked for once there is one, at most `MOST_IMPROVE` seconds: runs take good plans."""
MOST_IMPROVE: Final = 1.0
MOST: Final = 2000
"""Roll-outs, at most: the interval is 4 % wide then at worst."""


def odds_of_goal(
    problem: Problem,
    plan: Plan,
    settings: Settings,
    faults: Faults,
    *,
    policy: Policy | None = None,
    seconds: float = SECONDS,
    most: int = MOST,
) -> GoalOdds:
    """Return the odds of a goal with this plan; what follows a failure is planned in a small share of the seconds.

    What follows the outcomes of actions that have several is as their policy says.

    Args:
        faults: of simulated robots, which declare the chances of attempts; without any, these are learned, as the settings say, or assumed.
        seconds: of the processor for roll-outs; 0 for none.
    """
    bindings, graph = settings.bindings, plan_graph(problem, plan)
    known = KnownRobots(settings.learned, faults)
    attempts = known.attempts(bindings, problem.init, is_timed=problem.is_timed)
    calls = odds_of_calls(graph, bindings, attempts)
    alone = None if calls is None else exact(graph, calls, initial_knowledge(problem))
    if policy and plan.steps and (chain := PolicyChain.of(problem, policy, bindings, attempts)):
        alone, calls = chain.odds(), chain.calls
    if not seconds or (alone and (alone.chance == 1.0 or not settings.limits.replans)):
        return GoalOdds(alone, None, calls or ())
    first, spent = (
        PlanningResult(PlanningStatus.SOLVED, stretch(problem, plan), policy=policy),
        used_up(problem) if faults == NO_FAULTS else frozenset(),
    )
    memory = RememberedPlans(problem, first, time.process_time() + seconds, spent)
    improve = 0.0 if problem.domain.uncertain or problem.has_preferences else min(MOST_IMPROVE, IMPROVE * seconds)
    chosen = replace(settings, improve=improve, memory=memory, ask_for_help=False)

    def run(number: int) -> tuple[TaskResult, KnowledgeBase] | None:
        backend = simulated_backend(problem, bindings, world_of(known, attempts, number, spent))
        result = run_async(GoalHandle(backend, problem, chosen, TaskObserver(), Stopwatch()).run(), virtual=True)
        return None if memory.is_late else (result, backend.robots.world.truth)

    sure = None if spent else alone  # attempts that fail may use up too much
    return GoalOdds(alone, _rolled(run, initial_knowledge(problem), seconds, most, sure), calls or ())


def used_up(problem: Problem) -> frozenset[str]:
    """Return the functions that some action decreases, and another sets to a constant again, such as what is left in a battery.

    What is decreased by a function that is zero in this problem is none of them.
    """
    effects = [effect for schema in problem.domain.actions.values() for effect in schema.end_effects if isinstance(effect, Set)]
    some = {fluent[0] for fluent, value in problem.init.items() if value} | dynamic_names(problem)
    decreased = [effect for effect in effects if effect.operation == "decrease"]
    spent = {one.fluent[0] for one in decreased if not isinstance(one.value, ValueOf) or one.value.fluent[0] in some}
    return frozenset(spent & {one.fluent[0] for one in effects if one.operation == "assign" and isinstance(one.value, Constant)})


def odds_of_plan(
    file: Path, name: str | None, parameters: Mapping[str, object], settings: Settings, faults: Faults, *, seconds: float = SECONDS
) -> GoalOdds:
    """Return the odds of a hand-written plan; people who are asked something do not answer. The rest is as in `odds_of_goal`."""
    plans = read_plans(file)
    plan = plans[chosen_plan(plans, name)]
    bindings, known = settings.bindings.before(plan.bindings), KnownRobots(settings.learned, faults)
    attempts = known.attempts(bindings, plan.facts, is_timed=False)
    calls = odds_of_calls(plan.graph, bindings, attempts)
    alone = None if calls is None else exact(plan.graph, calls, initial_knowledge(plan))
    if alone or not seconds:  # without recoveries of its own nothing is planned anew
        return GoalOdds(alone, None, calls or ())
    chosen = replace(settings, ask_for_help=False)

    def run(number: int) -> tuple[TaskResult, None]:
        return carry_out(file, name, parameters, faults=world_of(known, attempts, number), settings=chosen), None

    return GoalOdds(None, _rolled(run, KnowledgeBase(), seconds, MOST))


def _rolled(
    run: Callable[[int], tuple[TaskResult, KnowledgeBase | None] | None],
    before: KnowledgeBase,
    seconds: float,
    most: int,
    sure: Odds | None = None,
) -> Odds | None:
    """Return the odds by as many runs as there is time for; None if there is none for a single one.

    Args:
        run: carries a run out, given its seed, and returns its result and the world after it; None if its time was not enough.
        before: the world before each.
        sure: the odds if no new plan is needed, if they hold for such runs.
    """
    until, reached, number, easy = time.process_time() + seconds, list[float](), 0, 0
    numbers: dict[Fluent, list[float]] = {}
    while number < most and time.process_time() < until and (ended := run(number)) is not None:
        number += 1
        result, after = ended
        if result.code is Code.CANCELLED:
            raise KeyboardInterrupt
        if result.goal_reached:
            if sure and not result.replans:
                easy += 1
            else:
                reached.append(max((call.ended - result.began for call in result.calls if call.ended is not None), default=0.0))
            for fluent, value in after.facts().items() if after else ():
                if is_number(value) and (fluent in numbers or value != before.value(fluent)):
                    numbers.setdefault(fluent, []).append(float(value))
    return Odds.estimated(number - easy, reached, numbers, number, sure) if number else None


def world_of(known: KnownRobots, attempts: Attempts, number: int, spent: frozenset[str] = frozenset()) -> Faults:
    """Return the faults of simulated robots in one of the worlds where attempts may have these odds; spent is as in `played`."""
    faults = known.faults if known.faults != NO_FAULTS else played(in_one_world(attempts, Random(f"world {number}")), spent)
    return replace(faults, seed=number)


def in_one_world(attempts: Attempts, random: Random) -> Attempts:
    """Return attempts with the chances that they may have in one world: all that rest on the same estimate have the same there."""
    chances, outcomes = dict[object, list[float]](), dict[object, Chance]()

    def there(action: GroundAction) -> AttemptOdds | None:
        if (attempt := attempts(action)) is None:
            return None
        if (estimate := attempt.estimate) not in chances:
            total = attempt.total if attempt.rests != Basis.ASSUMED.value else 0.0
            (chances[estimate],) = as_may_be([ending.chance for ending in attempt.endings], total, random)
        endings = tuple([replace(ending, chance=chance) for ending, chance in zip(attempt.endings, chances[estimate], strict=True)])
        if (ways := attempt.outcomes) is not None:
            ways = outcomes.setdefault(ways.estimate, ways.drawn(random)[0])
        return replace(attempt, endings=endings, outcomes=ways)

    return there


def played(attempts: Attempts, spent: frozenset[str] = frozenset()) -> Faults:
    """Return the faults of simulated robots whose attempts end so.

    Args:
        spent: functions that calls of an action decrease by what it says, on average: every attempt as its seconds are.
    """

    def drawn(action: GroundAction, random: Random) -> Fault | None:
        if (attempt := attempts(action)) is None:
            return None
        (ending,) = random.choices(attempt.endings, [one.chance for one in attempt.endings])
        seconds, weights = zip(*ending.seconds, strict=True)
        kind = FaultKind.SLOW if ending.leads is Leads.DONE else FaultKind.ABORT
        lasts = random.choices(seconds, weights)[0]
        of_all = attempts(replace(action, arguments=(), parameters=())) if spent else None
        mean = of_all.expected if of_all else 0.0
        share = Constant(lasts / mean if mean else attempt.chance(Leads.DONE))
        uses = {
            effect: replace(effect, value=Arithmetic("*", (share, effect.value)))
            for effect in action.end_effects
            if isinstance(effect, Set) and effect.operation == "decrease" and effect.fluent[0] in spent and not action.outcomes
        }
        whole = tuple([uses.get(effect, effect) if isinstance(effect, Set) else effect for effect in action.end_effects]) if uses else None
        for_good, outcome = ending.leads is Leads.FAILED, ""
        if attempt.outcomes:
            (outcome,) = random.choices([*attempt.outcomes.weights], [*attempt.outcomes.weights.values()])
        return Fault(action.name, kind, seconds=lasts, for_good=for_good, outcome=outcome, succeeded=whole, failed=tuple(uses.values()))

    return Faults(drawn=drawn)


class RememberedPlans(Memory):
    """The memory of what was found for a problem, and after it. The mutable state is all that was found.

    Args:
        until: when there is no time for searches any more, on the clock of the processor.
        spent: functions that need not be just as much for a plan to be followed again: it has to be valid.
    """

    improves = False

    def __init__(self, problem: Problem, first: PlanningResult, until: float, spent: frozenset[str] = frozenset()) -> None:
        self._until, self._spent = until, spent
        self._plans: dict[frozenset[object], list[tuple[Problem, PlanningResult]]] = {self._key(problem): [(problem, first)]}
        self._machines: dict[int, list[tuple[PlanGraph, ProvedMachine]]] = {}
        self.is_late = False
        """Whether a search was ended because there was no time left."""

    def plan(self, problem: Problem, timeout: float, search: Callable[[float], PlanningResult]) -> PlanningResult:
        """Return the plan that was found for the same problem, or what the search finds in the time that is left.

        Where only what is used up differs, the plan is that of the problem which differs least, of those that are valid.
        """

        def distance(other: Problem) -> float:
            levels = [(value, other.init.get(fluent)) for fluent, value in problem.init.items() if fluent[0] in self._spent]
            return sum(abs(one - two) if is_number(one) and is_number(two) else float(one != two) for one, two in levels)

        alike = self._plans.setdefault(self._key(problem), [])
        for far, other, known in sorted(((distance(other), other, known) for other, known in alike), key=itemgetter(0)):
            if replace(other, init=problem.init) != problem or other.unknown != problem.unknown:
                continue
            if not far or (known.plan and not known.policy and not why_invalid(problem, known.plan)):
                return known
        left = self._until - time.process_time()
        result = search(max(0.01, min(timeout, left)))
        self.is_late = left < timeout and result.status is PlanningStatus.TIMED_OUT
        alike.append((problem, result))
        return result

    def _key(self, problem: Problem) -> frozenset[object]:
        return frozenset(item for item in problem.init.items() if item[0][0] not in self._spent)

    def machine(self, graph: PlanGraph, prove: Callable[[], ProvedMachine]) -> ProvedMachine:
        """Return the machine of a plan that was proved before, or is now."""
        alike = self._machines.setdefault(len(graph.calls), [])
        for other, known in alike:
            if other == graph:
                return known
        alike.append((graph, prove()))
        return alike[-1][1]


class VettedPlan(Memory):
    """Looks at the odds of the first plan of a task, before anything of it has begun. The mutable state is these odds.

    Args:
        least: the least chance with which it begins; None for any, and then there are no roll-outs.
    """

    def __init__(self, settings: Settings, faults: Faults, least: float | None) -> None:
        self._settings = settings
        self._faults = faults
        self._least = least
        self.odds: GoalOdds | None = None

    def plan(self, problem: Problem, timeout: float, search: Callable[[float], PlanningResult]) -> PlanningResult:
        """Return what the search finds; no plan, and why, if the odds of the first one are too low."""
        result = search(timeout)
        if result.plan is None or self.odds is not None:
            return result
        seconds = 0.0 if self._least is None else SECONDS
        odds = odds_of_goal(problem, result.plan, self._settings, self._faults, policy=result.policy, seconds=seconds)
        if self._least is not None and (refusal := odds.refusal(self._least)):
            message = f"one was found, and is not begun: {refusal}"
            return PlanningResult(PlanningStatus.NO_PLAN, message=message, planner=result.planner)
        self.odds = odds
        return result
