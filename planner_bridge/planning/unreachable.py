"""Why there is no plan: facts of the goal that no action can bring about, even if nothing were ever undone.

Times, changing numbers and objects that fluents have are left out, and what was true once counts as true for ever: whatever
cannot be reached this way cannot be reached at all, by whatever arithmetic. From the goal backwards every fact gets the
cheapest *lack*: conditions that are never true, and that are all it would take. A fact without a lack can be reached.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Final, NamedTuple, TypeAlias

from planner_bridge.model.grounding import dynamic_names, initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.planning.normal_form import assignments
from pnm.core.logic.conditions import (
    All,
    Any,
    Compare,
    Computed,
    Condition,
    Exists,
    ForAll,
    Holds,
    Implies,
    Not,
    conjuncts,
    names,
)
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.expressions import (
    NOTHING,
    UNKNOWN,
    Constant,
    Environment,
    Fluent,
    Variable,
    bind,
    choices,
)

_LIMIT: Final = 20_000
"""Ground actions that are looked at; when there are more, no reason is given."""
_LISTED: Final = 3
"""Facts and conditions that a reason names; others are counted."""

Lack: TypeAlias = frozenset[Condition]


class _TooLarge(Exception):
    """There are more ground actions than can be looked at."""


class _Literal(NamedTuple):
    fluent: Fluent
    truth: bool

    @property
    def condition(self) -> Condition:
        return Holds(self.fluent) if self.truth else Not(Holds(self.fluent))


class _Achiever(NamedTuple):
    """A ground action, or a rule, that makes a literal true if its condition holds."""

    name: str
    condition: Condition
    env: Environment


@dataclass
class _Way:
    """How a literal may become true: what is still lacking, and what makes it true then, if anything does."""

    lack: Lack
    achievers: list[_Achiever] = field(default_factory=list)
    by: _Achiever | None = None


class _Lacks:
    """The literals that the goal may need, each with its lack. The mutable state is these, and the number of ground actions."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._state = initial_knowledge(problem)
        self._changing = dynamic_names(problem)
        self._timed = {_Literal(fluent, value is not False) for change in problem.timed for fluent, value in change.changes.items()}
        self._listed_names = {fluent[0] for fluent in problem.init}
        self._ways: dict[_Literal, _Way] = {}
        self._count = 0

    def settle(self, goal: Condition) -> None:
        """Work the lacks out: each only ever gets cheaper."""
        self.of(goal)
        is_settled = False
        while not is_settled:
            known, is_settled = [*self._ways.values()], True
            for way in known:
                for achiever in way.achievers:
                    lack = self.of(achiever.condition, achiever.env)
                    if self._cost(lack) < self._cost(way.lack):
                        way.lack, way.by, is_settled = lack, achiever, False
            is_settled = is_settled and len(known) == len(self._ways)

    def of(self, condition: Condition, env: Environment = NOTHING, truth: bool = True) -> Lack:
        """Return the cheapest lack of the condition, or of its opposite."""
        match condition:
            case Holds(fluent):
                return self._way(_Literal(bind(fluent, env), truth)).lack
            case Not(operand):
                return self.of(operand, env, not truth)
            case All(operands) | Any(operands):
                every = (self.of(operand, env, truth) for operand in operands)
                return self._joined(condition, every, isinstance(condition, All) is truth)
            case Implies(left, right):
                return self._joined(condition, (self.of(left, env, not truth), self.of(right, env, truth)), not truth)
            case ForAll(variables, body) | Exists(variables, body):
                every = (self.of(body, inner, truth) for inner in choices(variables, self._state, env))
                return self._joined(condition, every, isinstance(condition, ForAll) is truth)
            case Computed():
                return frozenset()
            case Compare():
                if names(condition) - self._problem.domain.functions.keys() or names(condition) & self._changing:
                    return frozenset()
                is_so = evaluate(condition, self._state, env) is truth
                return frozenset() if is_so else frozenset({condition if truth else Not(condition)})

    def _joined(self, whole: Condition, lacks: Iterable[Lack], all_of_them: bool) -> Lack:
        return frozenset().union(*lacks) if all_of_them else min(lacks, key=self._cost, default=frozenset({whole}))

    def _cost(self, lack: Lack) -> int:
        """Return how far the conditions are from true: most what actions are there for, then maps and tables, least a single switch."""
        return sum(map(self._weight, lack))

    def _weight(self, condition: Condition) -> int:
        literal = _literal(condition, NOTHING)
        if literal is None:
            return 1
        if literal in self._ways and self._ways[literal].achievers:
            return 100
        return len(literal.fluent) if literal.truth and literal.fluent[0] in self._listed_names else 1

    def _way(self, literal: _Literal) -> _Way:
        if literal not in self._ways:
            value, derived = self._state.value(literal.fluent), literal.fluent[0] in self._state.rules.derived
            is_so = value is UNKNOWN or bool(value) is literal.truth or literal in self._timed or (derived and not literal.truth)
            self._ways[literal] = way = _Way(frozenset() if is_so else frozenset({literal.condition}))
            if not is_so:
                way.achievers += self.rules(literal) if derived else self.actions(literal)
        return self._ways[literal]

    def rules(self, literal: _Literal) -> Iterator[_Achiever]:
        for rule in self._state.rules.rules:
            if rule.name == literal.fluent[0]:
                env = dict(zip((variable.name for variable in rule.variables), literal.fluent[1:], strict=True))
                yield _Achiever("", rule.condition, env)

    def actions(self, literal: _Literal) -> Iterator[_Achiever]:
        for schema in self._problem.domain.actions.values():
            at_end = All((schema.precondition, schema.invariant, schema.end_condition))
            for effects, needed in ((schema.start_effects, schema.precondition), (schema.end_effects, at_end)):
                for effect in assignments(effects, schema.parameters):
                    if effect.value != Constant(literal.truth) or effect.fluent[0] != literal.fluent[0]:
                        continue
                    for env in self.matches(effect.fluent, literal.fluent, (*schema.parameters, *effect.variables)):
                        self._count += 1
                        if self._count > _LIMIT:
                            raise _TooLarge
                        name = f"{schema.name}({', '.join(str(env[variable.name]) for variable in schema.parameters)})"
                        yield _Achiever(name, All((needed, effect.condition)), env)

    def matches(self, pattern: Fluent, fluent: Fluent, variables: tuple[Variable, ...]) -> Iterator[Environment]:
        """Yield the choices of objects for the variables with which the pattern is the fluent."""
        types = {variable.name: variable.types for variable in variables}
        env: dict[str, object] = {}
        for term, name in zip(pattern, fluent, strict=True):
            if (env.setdefault(term, name) if term in types else term) != name:
                return
        if all(name in self._state.objects(types[term]) for term, name in env.items()):
            yield from choices(tuple(variable for variable in variables if variable.name not in env), self._state, env)

    def reason(self, part: Condition) -> str:
        """Return what would make a part of the goal true, and why it does not."""
        lack = self.of(part)
        conditions = _listed([str(condition) for condition in sorted(lack, key=str)])
        never = f"{'is' if len(lack) == 1 else 'are'} never true"
        literal = _literal(part, NOTHING)
        by = None if literal is None else self._way(literal).by
        if by is None:
            return "no action brings it about" if lack == {part} else f"{conditions} {never}"
        last = by
        while inner := next(self.blocked(last), None):
            last = inner
        would = f"{by.name} would do it, but " if by.name else ""
        return would + (f"{conditions} {never}" if last.name in ("", by.name) else f"{last.name} needs {conditions}, which {never}")

    def blocked(self, achiever: _Achiever) -> Iterator[_Achiever]:
        """Yield what would make conditions of the achiever true that are not."""
        for part in conjuncts(achiever.condition):
            literal = _literal(part, achiever.env)
            if literal is not None and (way := self._way(literal)).lack and way.by is not None:
                yield way.by


def _literal(condition: Condition, env: Environment) -> _Literal | None:
    match condition:
        case Holds(fluent):
            return _Literal(bind(fluent, env), True)
        case Not(Holds(fluent)):
            return _Literal(bind(fluent, env), False)
        case _:
            return None


def why_unreachable(problem: Problem) -> str:
    """Return which parts of the goal cannot be reached, and why; empty when all can as far as this shows, or the problem is too large."""
    lacks = _Lacks(problem)
    try:
        lacks.settle(problem.goal)
    except _TooLarge:
        return ""
    parts: dict[Lack, list[Condition]] = {}
    for part in conjuncts(problem.goal):
        if lack := lacks.of(part):
            parts.setdefault(lack, []).append(part)
    reasons = [f"{_listed([*map(str, alike)])} cannot be reached: {lacks.reason(alike[0])}" for alike in parts.values()]
    more = f"; and {len(reasons) - _LISTED} more" if len(reasons) > _LISTED else ""
    return "; ".join(reasons[:_LISTED]) + more


def _listed(texts: list[str]) -> str:
    more = [f"{len(texts) - _LISTED} more"] if len(texts) > _LISTED else []
    shown = [*texts[:_LISTED], *more]
    return " and ".join(filter(None, (", ".join(shown[:-1]), shown[-1])))
