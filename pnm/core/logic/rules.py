"""Derived facts: rules for when a fact holds that no action and no sensor sets (PDDL 2.2, derived predicates).

A derived fact holds if the condition of one of its rules does, and not otherwise: the derived facts are
the least fixpoint of the rules. Negation must be *stratified*:
no name may depend on its own negation. Then the names fall into strata; a rule negates only names
of lower ones, and each stratum has a least fixpoint once those below it are settled. With the truth
values ordered false < unknown < true that is so for three values as for two.

Names that no rule derives are *base* names. A rule is split into *bodies*:
conjunctions with variables of their own, whose steps are ordered as a join: objects are looked up
among the recorded facts before all objects of a type are tried.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, TypeAlias

from pnm.core.logic.conditions import (
    All,
    Any,
    Compare,
    Computed,
    Condition,
    Exists,
    ForAll,
    Holds,
    every_part,
    free_variables,
    ground,
    names,
    polarities,
)
from pnm.core.logic.expressions import EXISTS, Fluent, Variable, expression_fluents, variables_in
from pnm.errors import PnmError


class UnstratifiedError(PnmError):
    """A derived fact would depend on its own negation, so the rules have no unique least fixpoint.

    Args:
        rule: the one with the negation.
        path: the names from the negated one to that of the rule, each of which depends on the next.
    """

    def __init__(self, rule: DerivationRule, path: tuple[str, ...]) -> None:
        super().__init__(f"whether ({rule.name} …) holds would depend on its own negation")
        self.rule = rule
        self.path = path


@dataclass(frozen=True, slots=True)
class DerivationRule:
    """The facts of this name hold for every choice of objects for which the condition does.

    Several rules may derive facts of one name: one that holds is enough.
    """

    name: str
    variables: tuple[Variable, ...]
    condition: Condition


@dataclass(frozen=True, slots=True)
class CheckCondition:
    """A step: the condition must hold; all of its variables are bound by now."""

    condition: Condition


@dataclass(frozen=True, slots=True)
class FindFact:
    """A step: some recorded fact must match this one, which binds its other variables."""

    condition: Holds
    known: tuple[int, ...]
    """Positions of the terms that are bound by now."""
    new: tuple[tuple[int, Variable], ...]
    """Positions of the variables that the fact binds, with these."""


@dataclass(frozen=True, slots=True)
class ChooseObject:
    """A step: bind the variable to any object of its types."""

    variable: Variable


BodyStep: TypeAlias = CheckCondition | FindFact | ChooseObject


@dataclass(frozen=True, slots=True)
class Body:
    """One way to derive a fact: all steps succeed for some binding of the body's own variables."""

    head: tuple[Variable, ...]
    steps: tuple[BodyStep, ...]

    @property
    def parts(self) -> tuple[Condition, ...]:
        """The conditions that must all hold."""
        return tuple(step.condition for step in self.steps if not isinstance(step, ChooseObject))


@dataclass(frozen=True, slots=True)
class Chain:
    """Another way to derive facts of a name, from their other end, for rules such as "there is a way to where one begins next door".

    Some rules ask for one more fact of their name, and keep some of its terms as they are. So a fact holds if one with other terms at
    the positions `moved` holds without these rules, and these terms are reached by steps of them. To ask for all facts with the same
    terms at `moved`, these steps are enough; the rules themselves would ask for all facts that there are.
    """

    name: str
    """That of the facts about what is reached: the terms at which steps begin, and those at which they end."""
    moved: tuple[int, ...]
    """Positions among the terms of a fact of those that the steps change."""
    steps: tuple[Body, ...]
    """The ways to derive facts about what is reached."""
    bodies: tuple[Body, ...]
    """The ways to derive facts from these."""

    def ends(self, fact: Fluent) -> tuple[Fluent, Fluent]:
        """Return the terms of a fact that steps change, and those that they keep."""
        terms = fact[1:]
        kept = [term for position, term in enumerate(terms) if position not in self.moved]
        return (">", fact[0], *[terms[position] for position in self.moved]), ("=", fact[0], *kept)


@dataclass(frozen=True)
class Rules:
    """The rules of a domain; raises `UnstratifiedError` if a derived name depends on its own negation."""

    rules: tuple[DerivationRule, ...] = ()

    def __post_init__(self) -> None:
        for rule in self.rules:
            for name, is_positive in polarities(rule.condition):
                if not is_positive and name in self.derived and (path := self._below(name).get(rule.name)):
                    raise UnstratifiedError(rule, path)

    def __iter__(self) -> Iterator[DerivationRule]:
        """Iterate over the rules, in their order."""
        return iter(self.rules)

    def __len__(self) -> int:
        return len(self.rules)

    @cached_property
    def derived(self) -> frozenset[str]:
        """The names that the rules derive."""
        return frozenset(rule.name for rule in self.rules)

    @cached_property
    def strata(self) -> dict[str, int]:
        """For every derived name its stratum: a rule negates only names of lower strata, and mentions none of higher ones."""
        levels = dict.fromkeys(self.derived, 0)
        for _ in self.derived:  # the longest chain of names settles in as many rounds
            for name, mentioned in self._mentioned.items():
                levels[name] = max((levels[other] + negated for other, negated in mentioned), default=0)
        return levels

    @cached_property
    def bodies(self) -> dict[str, tuple[Body, ...]]:
        """For every derived name, the ways to derive a fact of it."""
        return {name: tuple([_body(way, self.derived) for way in ways]) for name, ways in self._ways.items()}

    @cached_property
    def chains(self) -> dict[str, Chain]:
        """For derived names whose rules lead from one fact to the next, what has been passed on the way."""
        return {name: chain for name, ways in self._ways.items() if (chain := _chain(name, ways, self.derived))}

    @cached_property
    def _ways(self) -> dict[str, list[_Way]]:
        ways: dict[str, list[_Way]] = {}
        for rule in self.rules:
            head = frozenset(variable.name for variable in rule.variables)
            ways.setdefault(rule.name, []).extend((rule.variables, *way) for way in _split(rule.condition, head))
        return ways

    def base(self, mentioned: Iterable[str]) -> frozenset[str]:
        """Return the base names on which facts of these names depend, each derived name replaced by those below it."""
        return frozenset().union(*(self._base.get(name, (name,)) for name in mentioned))

    @cached_property
    def below(self) -> frozenset[str]:
        """The base names on which derived facts depend."""
        return frozenset().union(*self._base.values())

    @cached_property
    def _base(self) -> dict[str, frozenset[str]]:
        own = {name: frozenset[str]().union(*(names(rule.condition) for rule in self.rules if rule.name == name)) for name in self.derived}
        return {name: frozenset().union(*(own[below] for below in self._below(name))) - self.derived for name in self.derived}

    @cached_property
    def _mentioned(self) -> dict[str, frozenset[tuple[str, bool]]]:
        """For every derived name, the derived names in its rules, and whether they are negated there."""
        mentioned = {name: frozenset[tuple[str, bool]]() for name in self.derived}
        for rule in self.rules:
            mentioned[rule.name] |= {(name, not positive) for name, positive in polarities(rule.condition) if name in self.derived}
        return mentioned

    def _below(self, name: str) -> dict[str, tuple[str, ...]]:
        """Return the derived name and all those it depends on, each with the names from the one to the other."""
        below: dict[str, tuple[str, ...]] = {name: (name,)}
        waiting = deque(below)
        while waiting:
            here = waiting.popleft()
            for other, _ in sorted(self._mentioned[here]):
                if other not in below:
                    below[other] = (*below[here], other)
                    waiting.append(other)
        return below


NO_RULES: Final = Rules()

Reads: TypeAlias = frozenset[Fluent | str] | None
"""Recorded fluents, and names that stand for all fluents of that name; None for anything, also variables."""


def read_by(condition: Condition, rules: Rules) -> Reads:
    """Return the fluents that decide whether a condition holds: only if they change, or rules do, the truth may change."""
    found: set[Fluent | str] = set()
    for part in every_part(condition):
        if isinstance(part, Computed):
            return None
        if isinstance(part, Exists | ForAll):
            found.add(EXISTS)
        elif isinstance(part, Holds):
            found |= reads_of(part.fluent, rules)
        elif isinstance(part, Compare):
            for fluent in (*expression_fluents(part.left), *expression_fluents(part.right)):
                found |= reads_of(fluent, rules)
    return frozenset(found)


def reads_of(fluent: Fluent, rules: Rules) -> frozenset[Fluent | str]:
    """Return the fluents that decide about the value of a fluent: itself, if it is ground and recorded."""
    if fluent[0] in rules.derived:
        return rules.base((fluent[0],))
    return frozenset((fluent[0],) if variables_in(fluent) else (fluent,))


# --- bodies --------------------------------------------------------------------------------

_Way: TypeAlias = tuple[tuple[Variable, ...], tuple[Variable, ...], tuple[Condition, ...]]
"""An alternative of a rule: its variables, those of its own, and what must hold for some binding of these."""


def _split(condition: Condition, taken: frozenset[str]) -> Iterator[tuple[tuple[Variable, ...], tuple[Condition, ...]]]:
    """Split a condition into alternatives: existential variables, and conjuncts that must hold for some binding of them.

    A conjunction with a disjunction in it is not multiplied out. Variables are renamed apart from those in `taken`.
    """
    match condition:
        case Any(operands):
            for operand in operands:
                yield from _split(operand, taken)
        case Exists(variables, body):
            new = tuple(Variable(_unused(variable.name, taken), variable.types) for variable in variables)
            renamed = ground(body, {old.name: fresh.name for old, fresh in zip(variables, new, strict=True)})
            for own, parts in _split(renamed, taken | {variable.name for variable in new}):
                yield (*new, *own), parts
        case All(operands):
            mine: tuple[Variable, ...] = ()
            conjuncts: tuple[Condition, ...] = ()
            for operand in operands:
                ways = list(_split(operand, taken | {variable.name for variable in mine}))
                own, parts = ways[0] if len(ways) == 1 else ((), (operand,))
                mine, conjuncts = (*mine, *own), (*conjuncts, *parts)
            yield mine, conjuncts
        case _:
            yield (), (condition,)


def _unused(name: str, taken: frozenset[str]) -> str:
    while name in taken:
        name += "'"
    return name


def _body(way: _Way, derived: frozenset[str]) -> Body:
    """Order the conjuncts: those without unbound variables first, base before derived; then the base fact with most terms bound."""
    head, own, parts = way
    open_ = {variable.name: variable for variable in own}
    left, steps = list(parts), list[BodyStep]()
    while left or open_:
        ready = [part for part in left if not free_variables(part) & open_.keys()]
        steps += map(CheckCondition, sorted(ready, key=lambda part: not names(part).isdisjoint(derived)))
        left = [part for part in left if part not in ready]
        if not open_:
            continue
        finds = [part for part in left if isinstance(part, Holds) and part.fluent[0] not in derived]
        if finds:
            # the most selective lookup first, as in a database join
            best = max((_find(part, open_) for part in finds), key=lambda find: len(find.known))
            steps.append(best)
            left.remove(best.condition)
            for _, variable in best.new:
                open_.pop(variable.name, None)
        else:
            steps.append(ChooseObject(open_.pop(next(iter(open_)))))
    return Body(head, tuple(steps))


def _find(condition: Holds, unknown: dict[str, Variable]) -> FindFact:
    terms = tuple(enumerate(condition.fluent))
    known = tuple(position for position, term in terms if term not in unknown)
    return FindFact(condition, known, tuple((position, unknown[term]) for position, term in terms if term in unknown))


def _chain(name: str, ways: list[_Way], derived: frozenset[str]) -> Chain | None:
    """Return the chain of a name; None if no rule leads from one fact to the next, or several keep different terms."""
    steps = [(way, again, moved) for way in ways if (again := _again(name, way)) and (moved := _moved(way, again))]
    moves, types = {moved for *_, moved in steps}, {tuple(variable.types for variable in head) for head, *_ in ways}
    if len(moves) != 1 or len(types) != 1:
        return None
    (moved,), reached = moves, f"{name}>"
    derived |= {reached}

    def before(head: tuple[Variable, ...]) -> tuple[dict[str, object], tuple[Variable, ...], Holds]:
        """Return other variables for those that steps change, and that steps from the one to the other are possible."""
        begin = [head[position] for position in moved]
        other = [Variable(f"{variable.name}>", variable.types) for variable in begin]
        asked = Holds((reached, *(variable.name for variable in (*begin, *other))))
        return {one.name: another.name for one, another in zip(begin, other, strict=True)}, tuple(other), asked

    first, further = list[_Way](), list[_Way]()
    for (head, own, parts), again, _ in steps:
        ends = {again.fluent[1 + position] for position in moved}
        end = tuple([replace(head[position], name=again.fluent[1 + position]) for position in moved])
        rest, left = tuple([part for part in parts if part != again]), tuple([one for one in own if one.name not in ends])
        ends_at = (*(head[position] for position in moved), *end)
        renamed, others, asked = before(head)
        first.append((ends_at, left, rest))
        further.append((ends_at, (*left, *others), (*(ground(part, renamed) for part in rest), asked)))
    bodies = [way for way in ways if all(way is not step for step, *_ in steps)]
    for head, own, parts in bodies.copy():
        renamed, others, asked = before(head)
        bodies.append((head, (*own, *others), (*(ground(part, renamed) for part in parts), asked)))
    return Chain(reached, moved, *(tuple([_body(way, derived) for way in some]) for some in ((*first, *further), bodies)))


def _again(name: str, way: _Way) -> Holds | None:
    """Return the one fact of this name that an alternative of its rules asks for, if it asks for one only."""
    asked = [part for part in way[2] if name in names(part)]
    return asked[0] if len(asked) == 1 and isinstance(asked[0], Holds) and len(asked[0].fluent) == 1 + len(way[0]) else None


def _moved(way: _Way, again: Holds) -> tuple[int, ...]:
    """Return the positions of the fact asked for whose terms are others, if all else of the alternative is only about these."""
    head, own, parts = way
    terms, elsewhere = again.fluent[1:], frozenset().union(*(free_variables(part) for part in parts if part != again))
    moved = tuple([position for position, variable in enumerate(head) if terms[position] != variable.name or variable.name in elsewhere])
    types = {variable.name: variable.types for variable in own}
    new = [terms[position] for position in moved if types.get(terms[position]) == head[position].types]
    return moved if len(set(new)) == len(moved) < len(head) else ()
