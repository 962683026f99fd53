"""Reachability: which facts actions can bring about if nothing is ever undone, and how far away the others are.

Times are left out, a number may have any value once something can change it, and so may the objects that fluents have; what was
true once counts as true for ever. Whatever cannot be reached this way cannot be reached at all, by whatever arithmetic. Every fact
that the goal may need gets the cheapest *lack*: conditions that are never true, and that are all it would take. What lacks nothing
can be reached.
"""

from __future__ import annotations

import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from math import inf
from typing import Final, NamedTuple, TypeAlias, cast

from planner_bridge.model.grounding import dynamic_names, initial_knowledge
from planner_bridge.model.problem import TOTAL_COST, Problem
from planner_bridge.planning.normal_form import Assignment, schema_assignments
from pnm.core.logic.conditions import All, Compare, Condition, Holds, Not, conjuncts, evaluate, fluents, ground, parts_of
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.expressions import (
    DURATION,
    NOTHING,
    Constant,
    Environment,
    Expression,
    Fluent,
    ValueOf,
    Variable,
    bind,
    choices,
    expression_fluents,
    fluent_text,
    ground_expression,
    is_number,
    value_of,
)
from pnm.errors import listed

MOST_ACTIONS: Final = 20_000
"""Ground actions that are looked at."""
_STEPS: Final = 500_000
"""Parts of conditions, and what they lack, that are looked at: some seconds, whatever the problem is like."""
_FAR: Final = range(1000, 500, -1)
"""The weights of what actions are there for, if none can bring it about: the farther from the goal, the lighter."""


class TooLarge(Exception):
    """There are more ground actions than can be looked at, or more ways to them, or it would take too long."""


Lack: TypeAlias = frozenset[Condition]


class GoalLiteral(NamedTuple):
    """A fact that is to be true or false, or a comparison that is to be so or not."""

    subject: Fluent | Compare
    truth: bool

    @property
    def condition(self) -> Condition:
        """The literal as a condition."""
        subject = self.subject if isinstance(self.subject, Compare) else Holds(self.subject)
        return subject if self.truth else Not(subject)


class Achiever(NamedTuple):
    """A ground action, or a rule without a name, that may make a literal true if its condition holds."""

    name: str
    condition: Condition
    env: Environment


@dataclass
class Way:
    """A way for a literal to become true: its missing conditions, and its cause; None if that is the literal itself."""

    weight: int
    lack: Lack
    achievers: list[Achiever]
    by: Achiever | None = None
    needed_by: dict[_Use, None] = field(default_factory=dict)
    """The ways to look at again when it lacks less."""


@dataclass(eq=False, slots=True)
class _Use:
    """An achiever of a literal that is looked at for it, and whether it waits for that: mutable state."""

    way: Way
    achiever: Achiever
    is_waiting: bool = True


class Reachability:
    """The literals that the goal may need, each with its lack; what is `possible` may have any value. All of it is mutable state."""

    def __init__(self, problem: Problem, possible: frozenset[Fluent]) -> None:
        self._problem = problem
        self.state = initial_knowledge(problem)
        self._changing = dynamic_names(problem)
        self._possible = possible
        timed = [pair for change in problem.timed for pair in change.changes.items()]
        self._timed = {(fluent, truth) for fluent, value in timed for truth in ({value} if isinstance(value, bool) else (True, False))}
        self._in_tables = {fluent[0] for fluent in problem.init}
        self._changes = defaultdict[str, list[_Change]](list)
        """The effects of actions, by the name of the fluent."""
        for change in _changes(problem):
            self._changes[change.effect.fluent[0]].append(change)
        self._ways: dict[GoalLiteral, Way] = {}
        self._waiting = deque[_Use]()
        self._use: _Use | None = None
        """The ways to look at."""
        self.count = 0
        self._steps = 0

    def settle(self, goal: Condition, until: float = inf) -> None:
        """Work the lacks out: each only gets cheaper, and then so may what needs it; raise `TooLarge` at this time (monotonic clock)."""
        self.of(goal)
        while self._waiting:
            self._use = use = self._waiting.popleft()
            use.is_waiting, way = False, use.way
            if way.lack:
                lack = self.of(use.achiever.condition, use.achiever.env)
                if self._steps > _STEPS or time.monotonic() > until:
                    raise TooLarge
                if self.cost(lack) < self.cost(way.lack):
                    way.lack, way.by = lack, use.achiever
                    again = [other for other in way.needed_by if not other.is_waiting and other.way.lack]
                    for other in again:
                        other.is_waiting = True
                    self._waiting += again
        self._use = None

    def of(self, condition: Condition, env: Environment = NOTHING, truth: bool = True) -> Lack:
        """Return the cheapest lack of the condition, or of its opposite; empty if it can be reached."""
        if literal := literal_of(condition, env, truth):
            way = self.way(literal)
            if self._use and way.lack:
                way.needed_by[self._use] = None
            return way.lack
        parts, is_every = parts_of(condition, self.state, env, truth)
        lacks = [self.of(*part) for part in parts]
        self._steps += 1 + sum(map(len, lacks))
        return frozenset().union(*lacks) if is_every else min(lacks, key=self.cost, default=frozenset({condition}))

    def cost(self, lack: Lack) -> int:
        """Return the cost of making the conditions true."""
        return sum(self.way(literal).weight if (literal := literal_of(condition)) else 2 for condition in lack)

    def likelihood(self, achiever: Achiever) -> tuple[int, int, str]:
        """Return the place of an action among those that people think of: the fewer conditions are missing and the nearer, the earlier."""
        lack = self.of(achiever.condition, achiever.env)
        return self.cost(lack), len(lack), achiever.name

    def lacking(
        self, condition: Condition, env: Environment = NOTHING, truth: bool = True, *, together: bool = False
    ) -> tuple[Condition, ...]:
        """Return the unreachable parts of the condition, or of its opposite; of alternatives the cheapest, or all of them `together`."""
        if not self.of(condition, env, truth):
            return ()
        if literal := literal_of(condition, env, truth):
            return (literal.condition,)
        parts, is_every = parts_of(condition, self.state, env, truth)
        if together and not is_every:
            whole = ground(condition, env)
            return (whole if truth else Not(whole),)
        if not is_every:  # of those that cost the same, one where the way ends
            parts.sort(
                key=lambda part: (self.cost(self.of(*part)), (one := literal_of(*part)) is not None and not self.is_end(one.condition))
            )
        chosen = parts if is_every else parts[:1]
        lacks = dict.fromkeys(lack for part in chosen for lack in self.lacking(*part, together=together))
        return tuple(lacks) or (condition if truth else Not(condition),)

    def way(self, literal: GoalLiteral) -> Way:
        """Return a way for the literal to become true."""
        if literal not in self._ways:
            self._ways[literal] = way = Way(0, frozenset(), [])
            if not self.may_be(literal):
                way.achievers += self.achievers(literal)
                way.weight = self.weight(literal)
                way.lack = frozenset({literal.condition})
                self._waiting += [_Use(way, achiever) for achiever in way.achievers]
        return self._ways[literal]

    def weight(self, literal: GoalLiteral) -> int:
        """Return the cost of making a literal true: highest for what actions are there for, then maps and tables, lowest for a switch.

        A switch without objects, such as a door that is open, is nearer than a fact about one.
        """
        subject, truth = literal
        if isinstance(subject, Compare):
            return 2 * max((len(fluent) for fluent in self.without_value(subject)), default=1)
        if not self.is_end(literal.condition):
            return _FAR[min(len(self._ways), len(_FAR)) - 1]
        if truth and subject[0] in self._in_tables:
            return 2 * len(subject)
        return 2 if subject[1:] else 1

    def may_be(self, literal: GoalLiteral) -> bool:
        """Return whether the literal is true at first, or may become so by itself."""
        subject, truth = literal
        mentioned = fluents(literal.condition, self.state)
        if mentioned & self._possible or any((fluent, truth) in self._timed for fluent in mentioned):
            return True
        if isinstance(subject, Compare):
            is_known = {fluent[0] for fluent in mentioned} <= self._problem.domain.functions.keys()
            return not is_known or (not self.without_value(subject) and evaluate(subject, self.state) is truth)
        return bool(self.state.value(subject)) is truth or (not truth and subject[0] in self.state.rules.derived)

    def without_value(self, comparison: Compare) -> list[Fluent]:
        """Return the fluents of the comparison that have no value at first and never get one."""
        mentioned = sorted(fluents(comparison, self.state))
        return [fluent for fluent in mentioned if fluent[0] not in self._changing and self.state.value(fluent) is None]

    def achievers(self, literal: GoalLiteral) -> Iterator[Achiever]:
        """Yield the ways to make the literal true."""
        subject, truth = literal
        if isinstance(subject, tuple) and subject[0] in self.state.rules.derived:
            for rule in self.state.rules.rules:
                if rule.name == subject[0]:
                    env = dict(zip((variable.name for variable in rule.variables), subject[1:], strict=True))
                    yield Achiever("", rule.condition, env)
        elif isinstance(subject, tuple):
            yield from self.actions(subject, lambda effect, _: effect.value == Constant(truth))
        elif not self.without_value(subject):
            for fluent in sorted(fluents(subject, self.state)):
                yield from self.actions(fluent, partial(self.may_help, subject, truth, fluent))

    def actions(self, fluent: Fluent, helps: Callable[[Assignment, Environment], bool]) -> Iterator[Achiever]:
        """Yield the ground actions with an effect on the fluent that helps."""
        for schema, effect, condition in self._changes[fluent[0]]:
            for env in self.matches(effect.fluent, fluent, (*schema.parameters, *effect.variables)):
                self.count += 1
                if self.count > MOST_ACTIONS:
                    raise TooLarge
                if helps(effect, env):
                    yield Achiever(f"{schema.name}({', '.join(str(env[variable.name]) for variable in schema.parameters)})", condition, env)

    def matches(self, pattern: Fluent, fluent: Fluent, variables: tuple[Variable, ...]) -> Iterator[Environment]:
        """Yield the choices of objects for the variables with which the pattern is the fluent."""
        types = {variable.name: variable.types for variable in variables}
        env: dict[str, object] = {}
        for term, name in zip(pattern, fluent, strict=True):
            if (env.setdefault(term, name) if term in types else term) != name:
                return
        if all(name in self.state.objects(types[term]) for term, name in env.items()):
            yield from choices(tuple(variable for variable in variables if variable.name not in env), self.state, env)

    def may_help(self, comparison: Compare, truth: bool, fluent: Fluent, effect: Assignment, env: Environment) -> bool:
        """Return whether an effect on a number may make a comparison true, or false; not if it moves the number the other way."""
        left, right = comparison.left, comparison.right
        sides = ((left, right, 1), (right, left, -1))
        alone = [(other, sign) for side, other, sign in sides if side == ValueOf(fluent) and fluent not in expression_fluents(other)]
        if comparison.operation == "=" or not alone or not self.is_static(effect.value):
            return True
        amount = value_of(effect.value, self.state, env)
        if not is_number(amount):
            return False
        other, sign = alone[0]
        if effect.operation == "assign":
            numbers = (Constant(amount), other) if sign > 0 else (other, Constant(amount))
            return not self.is_static(other) or evaluate(Compare(comparison.operation, *numbers), self.state) is truth
        wanted = sign if comparison.operation.startswith(">") is truth else -sign
        return (amount if effect.operation == "increase" else -amount) * wanted > 0

    def is_static(self, expression: Expression) -> bool:
        """Return whether the expression always has the same value."""
        return not any(fluent == DURATION or fluent[0] in self._changing for fluent in expression_fluents(expression))

    def is_end(self, lack: Condition) -> bool:
        """Return whether nothing brings the condition about, or nobody knows whether it holds."""
        literal = literal_of(lack)
        return literal is None or not self.way(literal).achievers or bool(self._problem.unknown & fluents(lack, self.state))


class _Change(NamedTuple):
    """An effect of an action, a process or an event, and what it takes."""

    schema: ActionSchema
    effect: Assignment
    condition: Condition


def _changes(problem: Problem) -> Iterator[_Change]:
    for schema in problem.domain.schemas:
        at_start, at_end = schema_assignments(schema)
        values = [change.value for change in (*at_start, *at_end) if change.is_plain and change.fluent[0].lower() != TOTAL_COST]
        numbers = [*(constraint.bound for constraint in schema.duration or ()), *values]  # which need a value
        defined = [Compare("=", number, number) for number in dict.fromkeys(numbers) if any(expression_fluents(number))]
        whole = All((schema.precondition, schema.invariant, schema.end_condition))
        for effects, needed in ((at_start, schema.precondition), (at_end, whole)):
            for effect in effects:
                yield _Change(schema, effect, All((needed, effect.condition, *defined)))


def literal_of(condition: Condition, env: Environment = NOTHING, truth: bool = True) -> GoalLiteral | None:
    """Return the literal that the condition, or its opposite, is; None if it has several parts."""
    match condition:
        case Holds(fluent):
            return GoalLiteral(bind(fluent, env), truth)
        case Compare(operation, left, right):
            return GoalLiteral(Compare(operation, ground_expression(left, env), ground_expression(right, env)), truth)
        case Not(operand):
            return literal_of(operand, env, not truth)
        case _:
            return None


# --- why there is no plan -------------------------------------------------------------------------
# Why there is no plan: the parts of the goal that no action can bring about, what would, and which condition is never true.


_LENGTH: Final = 400
"""Characters after which no further reason is given."""


class _Ending(Enum):
    """The ends of a way to the goal: the words for one condition or call, and for several."""

    NEVER = "is never true", "are never true"
    UNKNOWN = "is unknown", "are unknown"
    NO_VALUE = "has no value", "have no value"
    FORBIDDEN = "must not be used", "must not be used"


_Said: TypeAlias = tuple[_Ending, str]


def why_unreachable(problem: Problem) -> str:
    """Return which parts of the goal cannot be reached, and why, whatever unknown facts are; empty if all can, or it is too large."""
    return _why(problem, problem.unknown, "cannot be reached")


def why_unknown(problem: Problem) -> str:
    """Return which parts of the goal cannot be reached if unknown facts are false, and why; empty as for `why_unreachable`."""
    return _why(problem, frozenset(), "cannot be reached with what is known")


def _why(problem: Problem, possible: frozenset[Fluent], verdict: str) -> str:
    reachability = Reachability(problem, possible)
    try:
        reachability.settle(problem.goal)
    except TooLarge:
        return ""
    reasons: dict[tuple[_Said, ...], list[tuple[str, list[str]]]] = {}
    for part in conjuncts(problem.goal):
        if reachability.of(part):
            endings, actions = _reason(reachability, problem, part)
            reasons.setdefault(endings, []).append((str(part), actions))
    text, left = "", len(reasons)
    for endings, parts in reasons.items():
        actions = parts[0][1]
        would = f"{actions[0]} would {'do it' if len(parts) == 1 else 'do the first'}, but " if actions else ""
        why = _clauses(endings, actions[-1] if actions[1:] else "")
        if not actions and len(endings) == 1 and endings[0][0] is _Ending.NEVER and endings[0][1].startswith(parts[0][0]):
            why = f"no action brings it about{endings[0][1].removeprefix(parts[0][0])}"
        reason = f"{'; ' if text else ''}{listed([part for part, _ in parts])} {verdict}: {would}{why}"
        if text and len(text) + len(reason) > _LENGTH:
            return f"{text}; and {left} more"
        text, left = text + reason, left - 1
    return text


def _reason(reachability: Reachability, problem: Problem, part: Condition) -> tuple[tuple[_Said, ...], list[str]]:
    """Return why a part of the goal cannot be reached, and the actions on the way there: the cheapest way is followed to where it ends."""
    lacks, way = reachability.lacking(part), list[Achiever]()
    while not (ends := tuple(filter(reachability.is_end, lacks))):
        ways = [reachability.way(literal) for lack in lacks if (literal := literal_of(lack))]
        open = next((found for found in ways if found.by), None)
        if way and not open:
            break  # what actions are there for, but none can bring about
        if open:  # the action that people think of first, of those that only need what nothing brings about; else one on the cheapest way
            cheapest, near = reachability.cost(open.lack), list[Achiever]()
            for one in open.achievers:
                its = reachability.lacking(one.condition, one.env)
                if reachability.cost(reachability.of(one.condition, one.env)) == cheapest and all(map(reachability.is_end, its)):
                    near.append(one)
            achiever = min(near, key=reachability.likelihood) if near else cast("Achiever", open.by)
        else:
            achiever = min((achiever for found in ways for achiever in found.achievers), key=reachability.likelihood)
        if achiever in way:
            break  # what it needs is what it is needed for
        way.append(achiever)
        lacks = reachability.lacking(achiever.condition, achiever.env)
    endings = (ending for lack in ends or lacks for ending in _endings(reachability, problem, lack))
    names = [one.name for one in way]
    return tuple(endings), list(filter(None, names if names and names[-1] else names[:1]))


def _endings(reachability: Reachability, problem: Problem, lack: Condition) -> Iterator[_Said]:
    literal, mentioned = literal_of(lack), fluents(lack, reachability.state)
    if guarded := [problem.guards[fluent] for fluent in mentioned & problem.guards.keys()]:
        yield from ((_Ending.FORBIDDEN, call) for call in guarded)
    elif problem.unknown & mentioned:
        yield _Ending.UNKNOWN, str(lack)
    elif literal and isinstance(literal.subject, Compare) and (missing := reachability.without_value(literal.subject)):
        yield from ((_Ending.NO_VALUE, fluent_text(fluent)) for fluent in missing)
    else:
        numbers = {fluent_text(fluent): value for fluent in sorted(mentioned) if is_number(value := reachability.state.value(fluent))}
        values = [f"{value:g}" if len(numbers) == 1 else f"{text} is {value:g}" for text, value in numbers.items()]
        yield _Ending.NEVER, f"{lack} [now {', '.join(values)}]" if values else str(lack)


def _clauses(endings: tuple[_Said, ...], action: str) -> str:
    """Return why the conditions do not hold, which the action needs if there is one."""
    kinds: dict[_Ending, dict[str, None]] = {}
    for ending, text in endings:
        kinds.setdefault(ending, {})[text] = None
    clauses, needs = list[str](), f"{action} needs "
    for ending, texts in kinds.items():
        what, verb = listed([*texts]), ending.value[len(texts) > 1]
        if action and ending is not _Ending.FORBIDDEN:
            what, verb, needs = f"{needs}{what}", f", which {verb}", ""
        clauses.append(what + (verb if verb.startswith(",") else f" {verb}"))
    return ", and ".join(clauses)
