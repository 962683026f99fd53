"""The search with one planner; and Kairos, the default one, in this process: its parser, its anytime search and its plan validator."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import inf
from operator import attrgetter
from typing import TYPE_CHECKING, Final

import kairos

from planner_bridge.model.plan import (
    ASSUMED_SECONDS,
    GAP,
    CancelToken,
    Plan,
    PlanningResult,
    PlanningStatus,
    PlanStep,
    SpelledNames,
    plan_text,
)
from planner_bridge.model.problem import TOTAL_TIME, Domain, Problem, once_per_domain
from planner_bridge.pddl.writer import write_domain, write_problem
from planner_bridge.planning.normal_form import in_whole_numbers, with_durations
from pnm.core.logic.conditions import TOLERANCE
from pnm.core.logic.expressions import ValueOf
from pnm.core.machine.plan_graph import GroundAction
from pnm.errors import InputError

if TYPE_CHECKING:
    from planner_bridge.ordering.robot_time import ExpectedTimes

DEFAULT_PLANNER: Final = "kairos"
_SHARE: Final = 0.05
"""Share of the time that a plan is expected to take for which a better one is looked for."""
AT_WORK: Final = 2.5
"""How much longer that is while robots carry the plan out: they do not wait, but the processor is theirs as well."""
_IN_VAIN: Final = 0.4
"""Part of that time after which the search ends because nothing better was found, and all parts of the plan were tried."""
LONGEST: Final = 5.0
"""Seconds for which a better plan is looked for at most, if nothing else is said: robots wait."""
GLANCE: Final = 0.04
"""Seconds for that where people look at a plan, and no robot moves."""
REHEARSAL: Final = 0.1
"""Seconds for that where robots are simulated in virtual time, which stands still for the search: a better plan saves nobody any."""
_POLL: Final = 0.05
"""Seconds between two looks at the cancel token."""
_ADVICE: Final = re.compile(r"\s[^.()]*\(SolveOptions::\w+\)\.|\s\(see the note before\)")
"""The statements of Kairos about its options and its output."""
_LEAST: Final = 0.05
"""Seconds for which a better plan is looked for in any case, if nothing else is said; where preferences are weighed, `_WEIGHED`."""
_WEIGHED: Final = 1.0
"""The first plans often fulfil no preference."""
_PART: Final = 0.1
"""Seconds of processor time of this process for a better part of a plan."""
_ALONE: Final = 0.3
"""Part of the time for improvement, in processor time, for which the search has the processor alone after each plan that it finds: where
cores are shared, it comes to a good one in half of the time that it takes beside the search for parts."""
_BESIDE: Final = {"ehc": 0.2, "goals": 0.2, "novelty": 0.6}
"""Other ways of searching in Kairos, which it has beside its own one. Once there is a plan: one after the other, each for this share
of the time for improvement. While there is none: one more whenever so much time has passed again. Each finds plans for some problems."""
_NARROW: Final = 0.4
"""Share of the time for improvement for plans of calls like those of the best plan, of which there are few; all of it for those that are
weighed by the seconds of each call, which get better for as long."""
_SETTLED: Final = 0.1
"""Seconds of processor time of this process, without a better plan, after which they are looked for like those of the best one by then."""
_TRIED: Final = 0.3
"""The same after which, where calls of one action take differently long, the seconds of each are counted instead of the calls."""
_TOGETHER: Final = 0.3
"""Share of the time for improvement for plans in which calls go on side by side, where these take less time."""
_PATIENCE: Final = 0.5
"""Seconds of processor time of this process, without a plan, after which the first of the other ways of searching joins."""
_STATUS: Final[Mapping[kairos.Status, PlanningStatus]] = {
    kairos.Status.SOLVED: PlanningStatus.NO_PLAN,  # without a plan, that is none
    kairos.Status.UNSOLVABLE: PlanningStatus.UNSOLVABLE,
    kairos.Status.NO_PLAN_FOUND: PlanningStatus.NO_PLAN,
    kairos.Status.TIMEOUT: PlanningStatus.TIMED_OUT,
    kairos.Status.OUT_OF_MEMORY: PlanningStatus.OUT_OF_MEMORY,
    kairos.Status.GROUNDING_TOO_LARGE: PlanningStatus.OUT_OF_MEMORY,
    kairos.Status.UNSUPPORTED: PlanningStatus.UNSUPPORTED,
    kairos.Status.INVALID_INPUT: PlanningStatus.INVALID,
    kairos.Status.CANCELLED: PlanningStatus.CANCELLED,
    kairos.Status.INTERNAL_ERROR: PlanningStatus.CRASHED,
}
"""The ends of a search that has found no plan."""


def worth(seconds: float) -> float:
    """Return the seconds for which something better is looked for than what takes so many."""
    return min(LONGEST, seconds * _SHARE)


def parse_for_kairos(problem: Problem) -> kairos.Problem:
    """Return the problem as Kairos reads it: without its task network, in whole numbers. It may refuse what our reader accepted."""
    try:
        return _parsed(problem)
    except kairos.PddlError as error:
        raise InputError(f"the planner refuses the problem: {error}") from error


def validate(problem: Problem, plan: Plan, parsed: kairos.Problem | None = None) -> str:
    """Return why the plan does not solve the problem by Kairos' validator; empty when it does.

    Which tasks of a hierarchical problem the steps carry out is not looked at.
    """
    try:
        report = kairos.validate(parsed or _parsed(problem), kairos.parse_plan(plan_text(plan)))
    except kairos.PddlError as error:
        return str(error)
    return "" if report.valid else _joined(report.diagnostics) or str(report.status)


def _parsed(problem: Problem) -> kairos.Problem:
    problem = in_whole_numbers(problem)
    return kairos.parse_problem(write_problem(replace(problem, network="")), _parsed_domain(problem.domain), f"{problem.name}.pddl")


@once_per_domain
def _parsed_domain(domain: Domain) -> kairos.Domain:
    """Return the domain as Kairos reads it, without tasks and methods."""
    return kairos.parse_domain(write_domain(replace(domain, hierarchy=())), f"{domain.name}.pddl")


def search(
    problem: Problem,
    planner: str,
    timeout: float,
    cancel: CancelToken,
    *,
    improve: float | None = 0.0,
    parsed: kairos.Problem | None = None,
    rates: ExpectedTimes | None = None,
    known: Plan | None = None,
    least: float = -inf,
) -> PlanningResult:
    """Search with one planner, at most `timeout` seconds besides the time to load it; the plan is not validated yet.

    Args:
        improve: seconds for which Kairos looks for a better plan once there is one, None for what that is worth; other planners return
            what they find.
        parsed: the problem as Kairos reads it, if that is there already.
        rates: what calls are expected to take; None where nothing is known.
        known: a plan that robots carry out meanwhile: only a better one is looked for.
        least: what no plan is better than; there is no need to look for a better one than that.
    """
    if planner != DEFAULT_PLANNER:
        from planner_bridge.planning.engines import search_with_engine  # here, because Kairos needs no other process

        return replace(search_with_engine(problem, planner, timeout, cancel), planner=planner)
    if problem.has_tasks:
        message = "task networks, which aries plans for (--planner aries)"
        return PlanningResult(PlanningStatus.UNSUPPORTED, message=message, planner=planner)
    return search_with_kairos(problem, parsed or parse_for_kairos(problem), timeout, improve, cancel, rates, known, least)


def search_with_kairos(
    problem: Problem,
    parsed: kairos.Problem,
    timeout: float,
    improve: float | None,
    cancel: CancelToken,
    rates: ExpectedTimes | None = None,
    known: Plan | None = None,
    least: float = -inf,
) -> PlanningResult:
    """Search for a plan until the timeout, or until the search is cancelled.

    The search has one thread, so the same problem gets the same first plan. If that takes long, other ways of searching join it one by
    one, and the plan may be another one the next time; not with `improve` at 0, which asks for that first plan.

    Once there is a plan, a better one is looked for: `improve` seconds, or a share of the time that the plan is expected to take, for
    robots wait. The searches go on; when they bring nothing better for a while, parts of the best plan are replaced by better ones. Where
    robots can work side by side, one more looks for plans with times, of which only the order of the calls is kept.

    Beside the first search, one looks among calls like those of the best plan, of which there are few: where a house has many places, it
    finds in a tenth of the time what takes the first one seconds. It looks for few calls as well, and then, where calls of one action take
    differently long, for little time by the seconds of each call: the first search ends there.

    Where actions take differently long, the first search is for few calls all the same, which it finds much sooner; those that come
    beside it, or after it if it ends, are for little time.
    """
    begin = partial(kairos.Planner().start, anytime=improve != 0.0, threads=1)  # type: ignore[no-untyped-call]
    start, weighed = partial(begin, parsed), parsed
    if rates is not None:
        from planner_bridge.ordering.robot_time import priced  # here, because most problems are about no robot that is known

        weighed = parsed if (dear := priced(problem, rates)) is problem else parse_for_kairos(dear)
    search: kairos.Search = start(timeout=timeout)
    searches, others, best, alike = [search], iter(_BESIDE.items()), _Best(problem, parsed, rates), _Alike(problem, rates, begin)
    together: kairos.Search | None = None
    until, began, patience = time.monotonic() + timeout, time.process_time(), inf if improve == 0.0 else _PATIENCE
    helpers = iter(sorted(_BESIDE, key=_BESIDE.__getitem__, reverse=True))
    first = news = deadline = inf
    alone = allowed = 0.0
    parts: Iterator[bool] = iter(())
    if known is not None and not best.take(known):
        search.stop()
        return PlanningResult(PlanningStatus.INVALID_PLAN, message="the known plan does not solve the problem", planner=DEFAULT_PLANNER)
    while not (cancel.is_set() or best.is_at(least)) and (now := time.monotonic()) < deadline:
        is_alone = (search.running() or alike.is_pricing) and time.process_time() < alone
        if not is_alone and next(parts, False):
            news = now
        else:
            search.next_plan(min(_POLL, deadline - now))
            news = now if is_alone else news
        if best.plan is None and time.process_time() > began + patience and (way := next(helpers, None)):
            searches.append(start(timeout=max(_POLL, until - now), search=way, memory_limit_mb=_memory_of_others()))
            patience *= 2
        is_over = not search.running()
        if best.of(searches) or (known is not None and first == inf):
            first, news = min(first, now), now
            if best.plan is not None and (improve is None or improve >= _PART):
                from planner_bridge.planning.parts import better_parts, can_have_parts  # short searches look for none

                came, allowed = time.process_time(), best.worth if improve is None else improve
                alone = came + _ALONE * allowed if known is None else alone
                if can_have_parts(problem):
                    parts, alike.since = better_parts(problem, best.plan, best.of_part, best.take), came
        if best.plan and not is_over and (narrow := alike.begun(best.plan, allowed)):
            searches.append(narrow)
            if alike.is_priced:
                searches[0].stop()  # for few calls in the whole problem, where it is known by now that these seconds count
                alone = time.process_time() + _ALONE * allowed
        if best.plan is not None:
            allowed = best.worth * (1.0 if known is None else AT_WORK) if improve is None else improve
            deadline = first + allowed if improve is not None else min(first + allowed, news + allowed * _IN_VAIN)
            if together is None and improve != 0.0 and (course := best.together()):
                together = begin(course, timeout=allowed * _TOGETHER)
                searches.append(together)
            if news < now and not any(beside.running() for beside in searches[1:]) and (other := next(others, None)):
                searches.append(begin(weighed, timeout=allowed * other[1], search=other[0]))
        if is_over and not alike.is_priced and best.plan is not None and (alike.by_call or weighed is not parsed) and search is searches[0]:
            weighed = parse_for_kairos(priced(problem, rates, by_call=True)) if rates and alike.by_call else weighed
            searches.append(search := begin(weighed, timeout=max(_POLL, until - now)))
        elif is_over and not (alike.is_pricing or (together and together.running()) or (alike.by_call and next(parts, False))):
            break
    is_best = not search.running() and search.stop_reason is kairos.StopReason.PROVEN_OPTIMAL
    is_best &= weighed is parsed or search is not searches[0]
    if rates is not None and rates.are_measure(problem):  # proved is that no plan has less work, if every call of an action takes as long
        is_best &= rates.have_turns(problem) and not rates.tell_apart
    for started in searches:
        started.stop()
    best.of(searches)  # the searches end some milliseconds later
    if best.plan is not None:
        return PlanningResult(PlanningStatus.SOLVED, replace(best.plan, is_best=is_best), planner=DEFAULT_PLANNER)
    return _without_plan(problem, search)


def _without_plan(problem: Problem, search: kairos.Search) -> PlanningResult:
    """Return the end of a search that has found no plan."""
    result = search.wait()
    status = _STATUS[result.status]
    if status is PlanningStatus.UNSOLVABLE and any(function.values for function in problem.domain.functions.values()):
        status = PlanningStatus.NO_PLAN  # Kairos 1.0.6 calls some such problems unsolvable although its validator accepts a plan
    message = "" if status is PlanningStatus.CANCELLED else _joined(result.diagnostics)
    if status is PlanningStatus.TIMED_OUT:
        message = f"{message.removesuffix('.')}; a longer limit (--planner-timeout) or another planner (--planner race) may find one"
    return PlanningResult(status, message=message, planner=DEFAULT_PLANNER)


def _memory_of_others() -> int:
    """Return the megabytes for each of the other ways: together as many as for the first, which takes half of what is available."""
    domain = kairos.parse_domain("(define (domain d))")
    solved = kairos.solve(domain, kairos.parse_problem("(define (problem p) (:domain d) (:goal (and)))", domain))
    return int(solved.stats.memory_limit_bytes) // 2**20 // len(_BESIDE)  # the limit is not told otherwise


class _Best:
    """The best plan that was found. The mutable state is that plan, its value, and which plans of which searches were looked at."""

    def __init__(self, problem: Problem, parsed: kairos.Problem, rates: ExpectedTimes | None) -> None:
        self._problem, self._parsed, self._rates = problem, parsed, rates
        self._start = kairos.Planner().start  # type: ignore[no-untyped-call]
        self._counts = rates is not None and rates.are_measure(problem)
        self._value: tuple[float, ...] = (inf,)
        self._seen: dict[int, float] = {}
        self.plan: Plan | None = None

    def of(self, searches: Iterable[kairos.Search]) -> bool:
        """Take the best of the plans that the searches have found, of equal ones that of the first; return whether it is a better one."""
        is_better = False
        for number, search in enumerate(searches):
            found = search.best()  # an empty plan is false, and a plan
            if found is not None and self._seen.get(number) != found.cost:
                self._seen[number] = found.cost
                plan = _plan(found, self._problem)
                if found.temporal and not self._problem.is_timed:
                    steps = enumerate(sorted(plan.steps, key=attrgetter("start")))
                    is_better |= self.take(replace(plan, steps=tuple(replace(step, start=float(at), duration=0.0) for at, step in steps)))
                else:
                    is_better |= self._keep(plan)
        return is_better

    def together(self) -> kairos.Problem | None:
        """Return the problem with the seconds of calls as durations, as Kairos reads it; None if that makes no difference."""
        if self._rates is None or not self._counts or self._rates.have_turns(self._problem):
            return None
        from planner_bridge.model.guards import with_turns

        seconds = {name: self._rates.expected(GroundAction(name)) for name in self._problem.domain.actions}
        try:
            return parse_for_kairos(with_turns(with_durations(self._problem, seconds), self._rates.bindings))
        except InputError:
            return None

    def take(self, plan: Plan) -> bool:
        """Take a plan that no search has found, if it is better and Kairos' validator accepts it; return whether it was taken."""
        report = kairos.validate(self._parsed, kairos.parse_plan(plan_text(plan)))
        return report.valid and self._keep(replace(plan, cost=report.metric) if _has_cost(self._problem) else plan)

    def _keep(self, plan: Plan) -> bool:
        if self._counts:
            from planner_bridge.ordering.robot_time import robot_time

            assert self._rates is not None
            time = robot_time(self._problem, plan, self._rates)
            value: tuple[float, ...] = (time, self._work(plan.steps))
            plan = replace(plan, seconds=time)
        elif plan.cost is not None:
            value = (self._problem.sign * plan.cost,)
        else:
            value = (plan.makespan if plan.temporal else float(len(plan.steps)),)
        if value < self._value:
            self.plan, self._value = plan, value
        return self.plan is plan

    def is_at(self, least: float) -> bool:
        """Return whether there is a plan that is as good as this."""
        return self.plan is not None and self.plan.value <= least + TOLERANCE

    @property
    def worth(self) -> float:
        """The seconds for which a better plan is looked for, because robots save as much."""
        plan = self.plan
        assert plan is not None
        least = _WEIGHED if self._problem.has_preferences else _LEAST
        taken = plan.makespan if plan.temporal else len(plan.steps) * ASSUMED_SECONDS if plan.seconds is None else plan.seconds
        return max(least, worth(taken))

    def of_part(self, part: Problem, old: Sequence[PlanStep], reached: float | None) -> Plan | None:
        """Find a better plan for a part of a plan in a short time.

        Args:
            old: the steps of the part so far.
            reached: the metric's value after them; None without one.
        """
        limit = self._work(old) if reached is None else part.sign * reached
        if self._counts:
            from planner_bridge.ordering.robot_time import priced

            assert self._rates is not None
            part = priced(part, self._rates, by_call=True)
        try:
            search: kairos.Search = self._start(parse_for_kairos(part), anytime=True, threads=1)
        except InputError:
            return None
        until, going_on = time.process_time() + _PART, True
        while going_on and time.process_time() < until:
            going_on = search.running()
            found = search.next_plan(_PART / 10.0)
            if found is not None:
                better = _plan(found, part)
                if (self._work(better.steps) if reached is None else part.sign * found.cost) < limit:
                    search.stop()
                    return better
        search.stop()
        return None

    def _work(self, steps: Iterable[PlanStep]) -> float:
        """Return the seconds of all calls, one after the other."""
        if self._rates is None:
            return sum(ASSUMED_SECONDS for _ in steps)
        return sum(self._rates.of(self._problem.domain.actions[step.action], step.arguments) for step in steps)


class _Alike:
    """The searches among calls like those of the best plan, one after the other.

    The mutable state is what is set below "state".
    """

    def __init__(self, problem: Problem, rates: ExpectedTimes | None, begin: Callable[..., kairos.Search]) -> None:
        self._problem, self._rates, self._begin = problem, rates, begin
        self.by_call = rates is not None and rates.are_measure(problem) and rates.tell_apart
        """Whether calls of one action take differently long, which counts."""
        # state
        self._search: kairos.Search | None = None
        self._plan: Plan | None = None
        """The plan that it was begun with."""
        self._tried: tuple[PlanStep, ...] = ()
        self.is_priced = False
        """Whether they are for little time by the seconds of each call, and no more for few calls."""
        self.since = inf
        """The processor time when the best plan was found, or the last search begun; infinite where the calls of plans are no choice."""

    @property
    def is_pricing(self) -> bool:
        """Whether one goes on that is for little time."""
        return self.is_priced and self._search is not None and self._search.running()

    def begun(self, best: Plan, allowed: float) -> kairos.Search | None:
        """Return one more search, which has begun and may take `allowed` seconds at most, if it is time for one; the one before ends."""
        is_same = best is self._plan
        is_early = time.process_time() < self.since + (_TRIED if is_same else _SETTLED)
        if is_early or self.is_pricing or (is_same and (self.is_priced or not self.by_call)):
            return None
        from planner_bridge.planning.parts import narrowed  # here, because short searches look for none

        self.is_priced |= is_same
        self._plan, self.since = best, time.process_time()
        if self._search is not None:
            self._search.stop()
        self._tried += best.steps  # by the seconds of calls, what plans with more of them have may be the better choice
        small = narrowed(self._problem, self._tried if self.is_priced else best.steps)
        if self.is_priced and self._rates is not None:
            from planner_bridge.ordering.robot_time import priced

            small = priced(small, self._rates, by_call=True)
        self._search = self._begin(parse_for_kairos(small), timeout=allowed * (1.0 if self.is_priced else _NARROW))
        return self._search


def _joined(diagnostics: Iterable[kairos.Diagnostic]) -> str:
    """Return the messages of the diagnostics on one line, without advice about options of Kairos that are not ours."""
    lines = (
        " ".join(_ADVICE.sub("", line).split()).removeprefix("no plan: ")
        for diagnostic in diagnostics
        for line in diagnostic.message.splitlines()
    )
    return "; ".join(filter(None, lines))


def _plan(plan: kairos.Plan, problem: Problem) -> Plan:
    """Return a plan of Kairos with the names of actions and objects spelled as in the problem."""
    names = SpelledNames(problem)
    steps = [names.step(step.name, step.args, step.time, step.duration) for step in plan.steps]
    taken: list[float] = []
    for number, step in enumerate(steps if problem.domain.nature else ()):  # then Kairos takes what is at one time one after the other
        while any(abs(step.start - time) < GAP / 2.0 for time in taken):
            steps[number] = step = replace(step, start=step.start + GAP)
        taken += (step.start, step.start + step.duration)
    found = Plan(tuple(steps), temporal=problem.is_timed, cost=plan.cost if _has_cost(problem) else None)
    return replace(found, until=plan.end) if plan.end and plan.end > found.makespan else found


def _has_cost(problem: Problem) -> bool:
    return problem.metric is not None and problem.metric.expression != ValueOf(TOTAL_TIME)
