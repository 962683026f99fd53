"""Why a plan has a call, and not another one.

Which later calls, or which part of the goal, need what a call does is found by simulating the plan without it. What would fail first
needs the call itself. So a call that nothing needs is superfluous, and that is proved: without it all that comes later goes on as
before. Numbers, derived facts and conditional effects are no special case.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, TypeAlias

from planner_bridge.explanations.answer import Answer, Best, Claim, Fails, Known, Solves, Unsolvable
from planner_bridge.explanations.no_plan import AnswerLimit, why_no_plan, why_trap, why_unreachable
from planner_bridge.model.grounding import ground_action, initial_knowledge
from planner_bridge.model.guards import unused_name
from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus, PlanStep
from planner_bridge.model.problem import TOTAL_TIME, Problem
from planner_bridge.model.progression import Happening, Progression, Stage, calls_of, happenings, snapshot
from planner_bridge.planning.validate import DURATION_TOLERANCE, why_invalid
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Condition, Holds, conjunction, ground, observed, unmet
from pnm.core.logic.domain import ActionSchema, Declaration
from pnm.core.logic.effects import Set, ground_effects
from pnm.core.logic.expressions import Constant, Fluent, ValueOf, ground_expression
from pnm.core.machine.plan_graph import ActionCall
from pnm.errors import counted, listed

Needs: TypeAlias = Mapping[int | None, tuple[Condition, ...]]
"""The conditions that an earlier call is needed for, by the later call whose they are; None for the goal."""
_SHOWN: Final = 6
"""Calls that are named on the way to the goal."""


@dataclass(frozen=True)
class Course:
    """Calls in an order in which they can be carried out, the state they begin in, and the goal.

    Args:
        calls: by number.
        happenings: in the order of time.
        state: before the first; it is not changed.
        goal: what holds at the end.
    """

    calls: Sequence[ActionCall]
    happenings: Sequence[Happening]
    state: KnowledgeBase
    goal: Condition
    under_way: frozenset[int] = frozenset()
    """The calls that have begun before."""
    _needs: dict[int, Needs] = field(default_factory=dict, repr=False)
    """Those that were looked for already: mutable state."""

    @staticmethod
    def of(problem: Problem, plan: Plan) -> Course:
        """Return the course of a plan."""
        return Course(calls_of(problem, plan), happenings(problem, plan), initial_knowledge(problem), problem.goal)

    @cached_property
    def as_it_is(self) -> frozenset[tuple[int | None, Condition]]:
        """Needs that are not fulfilled although nothing is left out: given up, or changed beside the plan."""
        return frozenset(self._unmet(None))

    def needs(self, call: int) -> Needs:
        """Return the needs for the call itself, in the order of time."""
        if call not in self._needs:
            found: dict[int | None, dict[Condition, None]] = {}
            for by, condition in self._unmet(call):
                if by != call and (by, condition) not in self.as_it_is:
                    found.setdefault(by, {})[condition] = None
            self._needs[call] = {by: tuple(conditions) for by, conditions in found.items()}
        return self._needs[call]

    def _unmet(self, without: int | None) -> Iterator[tuple[int | None, Condition]]:
        """Yield every condition that is not fulfilled when it is needed, and by which call; effects come all the same."""
        noted: list[tuple[int, Condition]] = []

        def note(call: int, stage: Stage, condition: Condition, state: KnowledgeBase) -> bool:
            noted.extend((call, part) for part in unmet(condition, state))
            return True

        running = {call: self.calls[call].action for call in self.under_way if call != without}
        progression = Progression(snapshot(self.state), running, note)
        for happening in self.happenings:
            events = [(event, self.calls[event.call].action) for event in happening.events if event.call != without]
            progression.advance(events, happening.changes)
        yield from noted
        yield from ((None, condition) for condition in unmet(self.goal, progression.state))

    def way_to_goal(self, call: int) -> tuple[int, ...] | None:
        """Return the calls from one to the goal, each of which needs the one before; the shortest way, None if there is none."""
        waiting, seen = deque[tuple[int, ...]]([(call,)]), {call}
        while waiting:
            way = waiting.popleft()
            for by in self.needs(way[-1]):
                if by is None:
                    return way
                if by not in seen:
                    seen.add(by)
                    waiting.append((*way, by))
        return None

    def name(self, call: int) -> str:
        """Return a call with its number, as everywhere."""
        return f"#{call} {self.calls[call].action}"


def why_call_of_plan(problem: Problem, plan: Plan, call: int) -> Answer:
    """Return why a plan has a call, by its number from 0; what a plan without it lacks is looked at by the validator as well."""
    course = Course.of(problem, plan)
    steps = (*plan.steps[:call], *plan.steps[call + 1 :])
    without = replace(plan, steps=steps, is_best=False)
    if course.needs(call):
        answer = why_call(course, call)
        return replace(answer, claims=(Fails(problem, without),)) if why_invalid(problem, without) else answer
    if problem.has_tasks:
        statement = f"no condition needs {course.name(call)}; whether the network of tasks asks for it was not looked at"
        return Answer(statement, Known.NOT_PROVED)
    if reason := why_invalid(problem, without):
        return Answer(f"{course.name(call)} is needed: without it, {reason}", Known.SIMULATION, (), (Fails(problem, without),))
    statement = f"nothing needs {course.name(call)}: the plan without it reaches the goal as well"
    wish = Answer(f"whether {course.calls[call].action} fulfils a preference was not looked at", Known.NOT_PROVED)
    return Answer(statement, Known.PLAN, (wish,) if problem.has_preferences else (), (Solves(problem, without),))


def why_call(course: Course, call: int) -> Answer:
    """Return why a call is there: what needs it, and from there the way to the goal."""
    needs = course.needs(call)
    if not needs:
        statement = f"nothing needs {course.name(call)}: without it, all that comes later goes on as it would"
        return Answer(statement, Known.NOT_PROVED if course.as_it_is else Known.SIMULATION)
    reasons = tuple(_need(course, by, conditions) for by, conditions in needs.items())
    return Answer(f"{course.name(call)} is needed: without it, the rest of the plan does not work", Known.SIMULATION, reasons)


def _need(course: Course, by: int | None, needed: tuple[Condition, ...]) -> Answer:
    conditions = listed([str(condition) for condition in needed])
    if by is None:
        return Answer(f"the goal needs it: {conditions}", Known.SIMULATION)
    way = course.way_to_goal(by)
    if way is None:
        further = Answer(f"nothing needs {course.name(by)}", Known.SIMULATION)
    else:
        *between, last = way[1:] or way
        named = [course.name(number) for number in between]
        named = [*named[: _SHOWN - 2], f"{len(named) - _SHOWN + 2} more calls", *named[-1:]] if len(named) >= _SHOWN else named
        steps = ", then ".join([*named, course.name(last)])
        goals = listed([str(goal) for goal in course.needs(last)[None]])
        text = f"{steps}: for the goal {goals}" if way[1:] else f"it is for the goal {goals}"
        further = Answer(f"which is needed by {text}" if way[1:] else text, Known.SIMULATION)
    return Answer(f"{course.name(by)} needs it: {conditions}", Known.SIMULATION, (further,))


# --- the plan as a whole --------------------------------------------------------------------------
# Why a problem has the plan that it has, or none: the first question, with one line for each call.


def why_plan(problem: Problem, plan: Plan) -> Answer:
    """Return the purpose of each call of a plan."""
    if not plan.steps:
        return Answer(
            "there is nothing to do: the goal is empty, holds already, or comes by itself", Known.PLAN, (), (Solves(problem, plan),)
        )
    course = Course.of(problem, plan)
    best = ", and it is proved that none is better" if plan.is_best else ""
    lines = []
    for call in range(len(plan.steps)):
        for_calls: dict[str, list[str]] = {}
        parts = []
        for by, needed in course.needs(call).items():
            conditions = listed([str(condition) for condition in needed])
            if by is None:
                parts.append(f"for the goal {conditions}")
            else:
                for_calls.setdefault(conditions, []).append(f"#{by}")
        for conditions, calls in for_calls.items():
            parts.append(f"for {listed(calls)}, which need{'s' if len(calls) == 1 else ''} {conditions}")
        lines.append(Answer(f"{course.name(call)}: {'; '.join(parts) or 'no later condition needs it'}", Known.SIMULATION))
    text = f"there is a plan with {counted(len(plan.steps), 'call')}{best}"
    return Answer(text, Known.PLAN, tuple(lines), (Solves(problem, plan),))


# --- why not another action -----------------------------------------------------------------------
# Why a plan does not have an action: it can never be carried out, no plan uses it, or plans that use it are no better.
#
# The action is *forced*: a copy of it, with these arguments, makes a fact true that the goal asks for besides.


_IMPROVE: Final = 0.3
"""Seconds for which a better plan is looked for, with the action and without it."""


@dataclass(frozen=True, slots=True)
class Forced:
    """A problem whose plans have to use an action once at least: a copy of it, with these arguments, makes a fact of the goal true."""

    problem: Problem
    fact: Fluent
    copy: str
    action: PlanStep

    @staticmethod
    def of(problem: Problem, action: PlanStep) -> Forced:
        """Return the problem for an action, with objects of the right types."""
        domain, schema = problem.domain, problem.domain.actions[action.action]
        fact, copy = (unused_name("used", domain),), f"{schema.name}-used"
        while copy in domain.actions:
            copy += "-"
        env = schema.environment(action.arguments)
        bounds = schema.duration and tuple(replace(bound, bound=ground_expression(bound.bound, env)) for bound in schema.duration)
        used = ActionSchema(
            copy,
            (),
            ground(schema.precondition, env),
            ground(schema.invariant, env),
            ground(schema.end_condition, env),
            ground_effects(schema.start_effects, env),
            (*ground_effects(schema.end_effects, env), Set(fact, Constant(True))),
            bounds,
        )
        named = {name: problem.objects[name] for name in action.arguments}
        domain = replace(
            domain,
            constants={**domain.constants, **named},
            predicates={**domain.predicates, fact[0]: Declaration(fact[0])},
            actions={**domain.actions, copy: used},
        )
        own = {name: types for name, types in problem.own_objects.items() if name not in named}
        goal = conjunction((problem.goal, Holds(fact)))
        return Forced(replace(problem, domain=domain, own_objects=own, goal=goal), fact, copy, action)

    def plan(self, plan: Plan) -> Plan:
        """Return a plan of this problem as one of the problem that it was made of."""
        steps = (
            replace(step, action=self.action.action, arguments=self.action.arguments) if step.action == self.copy else step
            for step in plan.steps
        )
        return replace(plan, steps=tuple(steps))


def why_not(problem: Problem, action: PlanStep, found: PlanningResult, limit: AnswerLimit) -> Answer:
    """Return why a plan does not use an action, whose arguments are objects of the right types."""
    same = (action.action, action.arguments)
    if found.plan and (numbers := [number for number, step in enumerate(found.plan.steps) if (step.action, step.arguments) == same]):
        return Answer(f"the plan does use {action}: it is call #{numbers[0]}", Known.PLAN, (), (Solves(problem, found.plan),))
    asked = Forced.of(problem, action)
    if never := why_unreachable(asked.problem, Holds(asked.fact), limit):
        closed = never.reasons[0].reasons  # of the fact, whose only way is the copy
        claim = Unsolvable(replace(asked.problem, goal=Holds(asked.fact), constraints=()))
        return Answer(f"{action} can never be carried out", Known.RELAXATION, closed[0].reasons if closed else (), (claim,))
    state = initial_knowledge(problem)
    missing = unmet(ground_action(problem.domain.actions[action.action], action.arguments).precondition, state)
    obstacles = (f"at first it cannot begin: it needs {part}; observed {observed(part, state)}" for part in missing)
    now = tuple(Answer(text, Known.GIVEN) for text in obstacles) or (Answer("at first it could begin", Known.GIVEN),)
    if problem.has_tasks or problem.domain.actions[action.action].preferences:
        what = "a network of tasks" if problem.has_tasks else "a preference of the action"
        return Answer(f"whether a plan can use {action} was not looked at: there is {what}", Known.NOT_PROVED, now)
    result = limit.solve(asked.problem, share=0.6, improve=_IMPROVE)
    if problem.domain.uncertain and found.plan and result.plan and (trap := why_trap(problem, found.plan, asked.plan(result.plan), limit)):
        return replace(trap, reasons=(*trap.reasons, *now))
    if result.plan and found.plan:
        better = limit.solve(problem, share=0.8, improve=_IMPROVE).plan or found.plan
        return _compared(problem, asked, better, result.plan, now)
    if result.plan:
        plan = asked.plan(result.plan)
        return Answer(f"a plan can use {action}: one with {counted(len(plan.steps), 'call')}", Known.PLAN, now, (Solves(problem, plan),))
    if result.status is not PlanningStatus.UNSOLVABLE:
        return Answer(f"whether a plan can use {action} was not found out: {result.reason}", Known.NOT_PROVED, now)
    if found.plan is None:
        now += (why_no_plan(problem, found, limit),)
    return Answer(f"no plan that reaches the goal uses {action}", Known.SEARCH, now, (Unsolvable(asked.problem),))


def _compared(problem: Problem, asked: Forced, plan: Plan, its: Plan, now: tuple[Answer, ...]) -> Answer:
    """Return a comparison of a plan that has to use the action with one that has not."""
    action, other = asked.action, asked.plan(its)
    claims: tuple[Claim, ...] = (Solves(problem, plan), Solves(problem, other))
    worth, its_worth = _worth(problem, plan), _worth(problem, its)
    if worth is None or its_worth is None:
        return Answer(f"a plan can use {action}, and nothing says how good it is", Known.PLAN, now, claims)
    unit = "s" if plan.temporal else "calls"
    if problem.metric and problem.metric.expression != ValueOf(TOTAL_TIME):
        unit = "of the metric"
    gap = problem.sign * (its_worth - worth)
    by, shown = f"{round(gap, 2):g} {unit}", f"{round(its_worth, 2):g} against {round(worth, 2):g} {unit}"
    if abs(gap) <= DURATION_TOLERANCE:
        return Answer(f"a plan that uses {action} is as good: {shown}", Known.PLAN, now, claims)
    if gap < 0.0:
        return Answer(f"a plan that uses {action} is even better: {shown}; the search ended before it was found", Known.PLAN, now, claims)
    if plan.is_best and its.is_best:
        claims = (*claims, Best(problem, plan), Best(asked.problem, its))
        return Answer(f"a plan that uses {action} is worse by {by} at least: {shown}", Known.SEARCH, now, claims)
    now += (Answer("that no plan with it is better is not proved: not all plans were looked at", Known.NOT_PROVED),)
    return Answer(f"the best plan found that uses {action} is worse by {by}: {shown}", Known.PLAN, now, claims)


def _worth(problem: Problem, plan: Plan) -> float | None:
    if problem.has_preferences or (problem.metric and problem.metric.expression != ValueOf(TOTAL_TIME)):
        return plan.cost
    return plan.makespan if plan.temporal else float(len(plan.steps))
