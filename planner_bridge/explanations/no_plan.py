"""Why there is no plan, or no way: a tree that ends where nothing can be done any more.

Most goals without a plan could not be reached even if nothing were ever undone; reachability shows that, and its lacks are the tree.
Otherwise a planner that has searched all states may have proved it, and goals that exclude each other are looked for. Whatever
neither shows is called not proved.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final

from planner_bridge.explanations.answer import Answer, Known, Solves, Unsolvable
from planner_bridge.model.determinization import determinization
from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.model.rates import NO_RATES, Rates
from planner_bridge.ordering.robot_time import ExpectedTimes
from planner_bridge.planning.policies.dead_ends import DeadStates
from planner_bridge.planning.policies.grounding import policy_task
from planner_bridge.planning.policies.task import Unsuitable
from planner_bridge.planning.reachability import Achiever, GoalLiteral, Reachability, TooLarge, literal_of
from planner_bridge.planning.solve import solve
from pnm.core.logic.conditions import All, Compare, Condition, conjunction, conjuncts, fluents, parts_of
from pnm.core.logic.expressions import NOTHING, fluent_text
from pnm.core.machine.bindings import NO_BINDINGS, Bindings
from pnm.errors import counted, listed

# --- time for an answer ---------------------------------------------------------------------------
# Searches for plans, and looks at what can be reached, that answer one question: they share a time limit.


SECONDS: Final = 0.8
"""For one question, if nothing else is said: it is answered within a second."""
_LEAST: Final = 0.02
"""Seconds for a search, at least."""


@dataclass(frozen=True)
class AnswerLimit:
    """The moment at which a question has to be answered, on the clock of this process, and what is known of the robots."""

    end: float
    bindings: Bindings | None = None
    learned: Rates | None = None
    _reached: dict[int, tuple[Problem, Reachability | None]] = field(default_factory=dict, repr=False)
    """The problems that were looked at, by identity: mutable state."""

    @staticmethod
    def of(seconds: float, bindings: Bindings | None = None, learned: Rates | None = None) -> AnswerLimit:
        """Return the limit that ends in so many seconds; plans are looked for as `solve` does with the bindings, and what was learned."""
        return AnswerLimit(time.monotonic() + seconds, bindings, learned)

    @property
    def left(self) -> float:
        """Seconds that are left."""
        return max(0.0, self.end - time.monotonic())

    @property
    def is_over(self) -> bool:
        """Whether no search is worth its beginning."""
        return self.left < _LEAST

    def solve(self, problem: Problem, *, share: float = 1.0, improve: float = 0.0) -> PlanningResult:
        """Search for a plan for this share of the time that is left, at most, and for a better one for so long."""
        if self.is_over:
            return PlanningResult(PlanningStatus.TIMED_OUT, message="there was no time left")
        told = partial(solve, bindings=self.bindings, learned=self.learned)
        return told(problem, timeout=max(_LEAST, self.left * share), improve=min(improve, self.left * share))

    def reached(self, problem: Problem) -> Reachability | None:
        """Return the reachable facts of a problem, and those that its goal lacks; None if there is not enough time."""
        if id(problem) not in self._reached:
            reachability = Reachability(problem, problem.unknown)
            try:
                reachability.settle(problem.goal, self.end)
                self._reached[id(problem)] = problem, reachability
            except TooLarge:
                self._reached[id(problem)] = problem, None
        return self._reached[id(problem)][1]

    def first_plan(self, problem: Problem, *, improve: float = 0.0) -> PlanningResult:
        """Search for the plan that is to be explained; what cannot be reached at all is not searched for, which might take long."""
        if (reachability := self.reached(problem)) and reachability.of(problem.goal):
            return PlanningResult(PlanningStatus.UNSOLVABLE, message="the goal cannot be reached")
        return self.solve(problem, share=0.5, improve=improve)


_WAYS: Final = 3
"""Actions that are looked at for each fact; others are counted."""
_KNOTS: Final = 2
"""Facts that only each other would bring about, on the way from the goal: of more there is no telling where to begin."""
_LONG: Final = 70
"""Characters of a condition."""
_DEPTH: Final = 12
"""Facts on the way from the goal to where it ends."""


def why_no_plan(problem: Problem, found: PlanningResult, limit: AnswerLimit) -> Answer:
    """Return why there is no plan."""
    if dead_ends := _unreachable(problem, limit):
        text = listed([str(part) for part, _ in dead_ends])
        reasons = tuple(answer for _, answer in dead_ends)
        return Answer(f"there is no plan: {text} cannot be reached", Known.RELAXATION, reasons, (Unsolvable(problem),))
    if problem.unknown and (blocked := _unreachable(replace(problem, unknown=frozenset()), limit)):
        facts = listed(sorted(map(fluent_text, problem.unknown)))
        text = f"no plan was found: {facts} {'are' if len(problem.unknown) > 1 else 'is'} unknown, and counted as false"
        return Answer(text, Known.NOT_PROVED, tuple(_as_known(answer) for _, answer in blocked))
    if found.status is PlanningStatus.UNSOLVABLE:
        return Answer("there is no plan", Known.SEARCH, tuple(_exclusions(problem, limit)), (Unsolvable(problem),))
    return Answer(f"no plan was found, and it is not proved that there is none: {found.reason}", Known.NOT_PROVED)


def _as_known(answer: Answer) -> Answer:
    """Return the answer without proofs: it rests on unknown facts being false."""
    return Answer(answer.statement, Known.NOT_PROVED, tuple(map(_as_known, answer.reasons)))


# --- what cannot be reached -----------------------------------------------------------------------


def _unreachable(problem: Problem, limit: AnswerLimit) -> list[tuple[Condition, Answer]]:
    """Return the parts of the goal that cannot be reached, with the reasons; none if that is not found out."""
    if (reachability := limit.reached(problem)) is None:
        return []
    tree = DeadEnds(problem, reachability)
    return [(part, tree.why(part)) for part in conjuncts(problem.goal) if reachability.of(part)]


def why_unreachable(problem: Problem, condition: Condition, limit: AnswerLimit) -> Answer | None:
    """Return why a condition can never come true; None if it can, as far as reachability shows."""
    dead_ends = _unreachable(replace(problem, goal=condition, constraints=()), limit)
    return Answer(f"{condition} can never be true", Known.RELAXATION, tuple(answer for _, answer in dead_ends)) if dead_ends else None


@dataclass
class DeadEnds:
    """The tree of what cannot be reached. The mutable state is which facts were explained already."""

    problem: Problem
    reachability: Reachability
    seen: set[Condition] = field(default_factory=set)

    def why(self, condition: Condition, path: tuple[Condition, ...] = ()) -> Answer:
        """Return why the condition can never be true."""
        literal = literal_of(condition)
        if literal is None:
            reasons, others = self._parts(condition, (*path, condition))
            return self._proved(condition, f"{_short(condition)} can never be true{_closed(others)}", reasons)
        if condition in path:
            return self._proved(condition, f"{condition} would be needed for itself", ())
        if end := self._end(literal):
            return self._proved(condition, end, ())
        # every way to a knot leads through itself, or through others of which that is so: no end is nearer than others
        knots = sum((one := literal_of(part)) is not None and self.reachability.way(one).by is None for part in path)
        if condition in self.seen or len(path) >= _DEPTH or knots >= _KNOTS:
            return self._proved(condition, f"{condition} can never be true{', as said above' if condition in self.seen else ''}", ())
        self.seen.add(condition)
        reasons, others = self._ways(literal, (*path, condition))
        return self._proved(condition, f"{condition} can never be true{_closed(others)}", reasons)

    def _proved(self, condition: Condition, text: str, reasons: tuple[Answer, ...]) -> Answer:
        asked = replace(self.problem, goal=condition, constraints=(), preferences=(), metric=None, network="")
        return Answer(text, Known.RELAXATION, reasons, (Unsolvable(asked),))

    def _end(self, literal: GoalLiteral) -> str:
        """Return the words for a fact that no action makes true; empty if there are such actions."""
        condition, mentioned = literal.condition, fluents(literal.condition, self.reachability.state)
        if guarded := [self.problem.guards[fluent] for fluent in mentioned & self.problem.guards.keys()]:
            return f"{listed(guarded)} must not be used any more"
        if isinstance(literal.subject, Compare) and (missing := self.reachability.without_value(literal.subject)):
            return f"{listed([fluent_text(fluent) for fluent in missing])} {'has' if len(missing) == 1 else 'have'} no value"
        if self.reachability.way(literal).achievers:
            return ""
        is_fact = not isinstance(literal.subject, Compare)
        now = "true" if is_fact and not literal.truth else "false"
        what = fluent_text(literal.subject) if isinstance(literal.subject, tuple) else str(condition)
        return f"{what} is {now}, and no action changes that"

    def _parts(self, condition: Condition, path: tuple[Condition, ...]) -> tuple[tuple[Answer, ...], int]:
        """Return why the parts of a condition can never be true; of alternatives the nearest, and how many others there are."""
        parts, is_every = parts_of(condition, self.reachability.state, NOTHING, True)
        if not is_every:
            costs = [self.reachability.cost(self.reachability.of(*part)) for part in parts]
            parts = [part for part, cost in zip(parts, costs, strict=True) if cost == min(costs)][:_WAYS]
            others = len(costs) - len(parts)
        whys = {
            why.statement: why
            for part in parts
            for lack in self.reachability.lacking(*part, together=True)
            for why in [self.why(lack, path)]
        }
        return tuple(whys.values()), 0 if is_every else others

    def _ways(self, literal: GoalLiteral, path: tuple[Condition, ...]) -> tuple[tuple[Answer, ...], int]:
        """Return why the action that would most likely bring the fact about can never do it; and how many others there are.

        Others are told of as well if nothing but a switch, such as a door, keeps them from it.
        """
        by_lack: dict[tuple[str, tuple[Condition, ...]], Achiever] = {}
        for achiever in sorted(self.reachability.way(literal).achievers, key=self.reachability.likelihood):
            by_lack.setdefault((achiever.name, self.reachability.lacking(achiever.condition, achiever.env, together=True)), achiever)
        fresh = [key for key in by_lack if not any(lack in path for lack in key[1])] or [*by_lack]
        least = self.reachability.likelihood(by_lack[fresh[0]])[0]
        near = (key for key in fresh[1:] if self.reachability.likelihood(by_lack[key])[0] == least)
        likeliest = [fresh[0], *(key for key in near if all(map(self.reachability.is_end, key[1])))][:_WAYS]
        reasons: dict[str, Answer] = {}
        for name, lacks in likeliest:
            closed = {why.statement: why for why in (self.why(lack, path) for lack in lacks)}
            if name:
                needs = listed([*dict.fromkeys(map(_short, lacks))])
                text = f"{name} would make it so, but needs {needs}"
                closed = {text: Answer(text, Known.GIVEN, tuple(closed.values()))}
            reasons |= closed  # of a rule, which needs no words of its own
        return tuple(reasons.values()), len(by_lack) - len(likeliest)


def _short(condition: Condition) -> str:
    match condition:
        case Compare("=", left, right) if left == right:
            text = f"a value of {left}"
        case _:
            text = str(condition)
    return text if len(text) <= _LONG else f"{text[: _LONG - 1]}…"


def _closed(others: int) -> str:
    """Return that there are other ways, none of which is open."""
    return f": {others} more {'way' if others == 1 else 'ways'} to it {'is' if others == 1 else 'are'} closed as well" if others else ""


# --- what excludes each other ---------------------------------------------------------------------


def _exclusions(problem: Problem, limit: AnswerLimit) -> Iterator[Answer]:
    """Yield which parts of the goal exclude each other: together proved impossible, and none of them can be left out of that."""
    if problem.has_tasks:
        return
    if problem.constraints or problem.domain.constraints:
        free = replace(problem, constraints=(), domain=replace(problem.domain, constraints=()))
        found = limit.solve(free)
        if found.plan:
            constraints = listed([str(one) for one in (*problem.domain.constraints, *problem.constraints)])
            yield Answer(f"there is a plan without these constraints: {constraints}", Known.PLAN, (), (Solves(free, found.plan),))
            return
    parts = conjuncts(problem.goal)
    needed, possible = list(parts), list[Answer]()
    for part in parts:
        rest = [other for other in needed if other is not part]
        if not rest:
            break
        asked = replace(problem, goal=conjunction(rest))
        found = limit.solve(asked)
        if found.status is PlanningStatus.UNSOLVABLE:
            needed = rest
        elif found.plan:
            text = f"without {part}, there is a plan with {counted(len(found.plan.steps), 'call')}"
            possible.append(Answer(text, Known.PLAN, (), (Solves(asked, found.plan),)))
        else:
            text = f"whether there is a plan without {part} was not found out: {found.reason}"
            possible.append(Answer(text, Known.NOT_PROVED))
    claim = Unsolvable(replace(problem, goal=conjunction(needed)))
    if len(needed) == 1:
        yield Answer(f"{needed[0]} alone is impossible: all states were searched", Known.SEARCH, (), (claim,))
        return
    reasons = [answer for answer in possible if len(needed) == len(parts) or answer.known is Known.NOT_PROVED]
    for part in needed if len(needed) < len(parts) else ():
        asked = replace(problem, goal=part)
        if plan := limit.solve(asked).plan:
            text = f"{part} alone has a plan with {counted(len(plan.steps), 'call')}"
            reasons.append(Answer(text, Known.PLAN, (), (Solves(asked, plan),)))
    is_minimal = all(reason.known is Known.PLAN for reason in reasons)
    text = f"{listed([str(part) for part in needed])} exclude each other" if is_minimal else f"{All(tuple(needed))} is impossible"
    yield Answer(text, Known.SEARCH, tuple(reasons), (claim,))


# --- traps ----------------------------------------------------------------------------------------
# Why a policy does not take a way: outcomes of actions on it may lead to states without a way out.


_SHARE: Final = 0.3
"""Of the time that is left, for each search."""


def why_trap(problem: Problem, avoiding: Plan, other: Plan, limit: AnswerLimit) -> Answer | None:
    """Return the first step that may lead to a state without a way out, and why there is none; None if no such is found.

    Args:
        problem: in whose initial state the plans begin.
        avoiding: the plan that is to be explained: its own steps are no reason.
        other: the plan whose steps are looked at, with the outcomes that it hopes for.
        limit: for searches, where it does not follow from what can be reached.
    """
    try:
        rates = ExpectedTimes(limit.bindings or NO_BINDINGS, limit.learned or NO_RATES, problem.init)
        task = policy_task(problem, chances=rates.outcomes, is_over=lambda: limit.is_over)
    except Unsuitable:
        return None
    dead, state, actions = DeadStates(task), task.initial, {(action.name, action.arguments): action for action in task.actions}
    own = {(step.action, step.arguments) for step in avoiding.steps}
    for step in other.steps:
        action = actions.get((step.action, step.arguments))
        if action is None or action.condition_in(state) is None:
            return None
        hoped = next((one for one in action.outcomes if one.name == step.outcome), action.outcomes[0])
        chance, known, reason, claims = 0.0, Known.SEARCH, "", list[Unsolvable]()
        for outcome in action.outcomes:
            after = outcome.after(state)
            if outcome is hoped or task.goal_in(after) or (step.action, step.arguments) in own:
                continue
            same = {fluent: value for fluent, value in problem.init.items() if fluent not in task.facts}
            there = replace(problem, init=same | task.values(after))
            if part := dead.explained(after):
                named = {"true": task.texts(part.true), "false": task.texts(part.false)}
                facts = [f"{listed(those)} {'are' if len(those) > 1 else 'is'} {how}" for how, those in named.items() if those]
                known, reason = Known.RELAXATION, reason or f": {', and '.join(facts)}"
            elif limit.solve(there, share=_SHARE).status is not PlanningStatus.UNSOLVABLE:
                continue
            chance += outcome.chance
            claims.append(Unsolvable(there))
        if chance:
            reasons = filter(None, (why_unreachable(claims[0].problem, problem.goal, limit),))
            return Answer(f"{action} leads with {chance:.0%} to a state without a way out{reason}", known, tuple(reasons), tuple(claims))
        state = hoped.after(state)
    return None


def why_not_short(problem: Problem, plan: Plan, limit: AnswerLimit) -> Answer | None:
    """Return why a policy does not take the way that would be shorter with luck; None if there is none, or no trap on it is found."""
    each = determinization(problem)
    found = limit.solve(each.problem, share=_SHARE).plan
    short = each.plan(found) if found else plan
    if len(short.steps) >= len(plan.steps) or (trap := why_trap(problem, plan, short, limit)) is None:
        return None
    return replace(trap, reasons=(), statement=f"there is a way with {counted(len(short.steps), 'call')}, but {trap.statement}")
