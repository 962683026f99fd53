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
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, TypeAlias, assert_never

from pnm.core.logic.conditions import (
    All,
    Any,
    Compare,
    Computed,
    Condition,
    Exists,
    Holds,
    evaluate,
    every_part,
    fluents,
    free_variables,
    ground,
    names,
    polarities,
)
from pnm.core.logic.expressions import (
    UNKNOWN,
    Environment,
    Fluent,
    Truth,
    Unknown,
    Value,
    Variable,
    bind,
    expression_fluents,
    fluent_text,
    variables_in,
)
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
        bodies: dict[str, tuple[Body, ...]] = {}
        for rule in self.rules:
            head = frozenset(variable.name for variable in rule.variables)
            split = (_body(rule.variables, own, parts, self.derived) for own, parts in _split(rule.condition, head))
            bodies[rule.name] = (*bodies.get(rule.name, ()), *split)
        return bodies

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
    """Return the fluents that decide whether a condition holds: only if they change, or objects or rules do, the truth may change."""
    found: set[Fluent | str] = set()
    for part in every_part(condition):
        if isinstance(part, Computed):
            return None
        if isinstance(part, Holds):
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


def _body(head: tuple[Variable, ...], own: tuple[Variable, ...], parts: tuple[Condition, ...], derived: frozenset[str]) -> Body:
    """Order the conjuncts: those without unbound variables first, base before derived; then the base fact with most terms bound."""
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


# --- derived facts, computed when asked for, and maintained from what changes --------------


LISTED: Final = 4
"""Reasons that an explanation names; the others are counted."""
_KEPT: Final = 100_000
"""Derived facts that are maintained at most; if there are more at a change, all are forgotten."""
_Read: TypeAlias = tuple[object, ...]
"""A fluent that a rule asks for, or a pattern of recorded facts: name, length, known positions and the terms there."""


@dataclass(frozen=True, slots=True, eq=False)
class _Attempt:
    """A partial derivation of a fact: the first steps of a body have succeeded for a binding of its variables."""

    fact: Fluent
    body: Body
    env: Environment
    position: int = 0
    """Number of steps that have succeeded."""
    truth: Truth = True
    """Unknown as soon as one step is."""

    @property
    def succeeded(self) -> bool:
        """Whether all steps have succeeded, as far as is known."""
        return self.position == len(self.body.steps)

    def advanced(self, env: Environment, truth: Truth = True) -> _Attempt:
        """Return the attempt after one more step."""
        return _Attempt(self.fact, self.body, env, self.position + 1, self.truth if truth is True else truth)


class DerivedFacts:
    """A state with the recorded facts and those that rules derive from them when asked, which are maintained from then on.

    A derived fact is taken to be false, and so is every fact of its stratum that it asks about; whenever one of them turns out to be
    more, those that have read it are judged again, until all have their value in the least fixpoint. Facts of lower strata are settled
    first. When recorded facts change, those that have read them are judged again, stratum by stratum. Before that, all whose proof rests
    on something that has changed are taken to be false, and so are those whose proof rests on these: none keeps itself alive.

    The mutable state is what the constructor sets besides `rules` and `objects`. `changed` must be called after recorded facts change;
    the objects of a type never do.
    """

    def __init__(
        self, rules: Rules, recorded: Mapping[Fluent, Value | Unknown], objects: Callable[[tuple[str, ...]], tuple[str, ...]]
    ) -> None:
        self.rules = rules
        self.objects = objects
        self._recorded = recorded
        self._members: dict[tuple[str, ...], frozenset[str]] = {}
        self._tables: dict[str, dict[tuple[int, tuple[int, ...]], dict[Fluent, dict[Fluent, None]]]] = {}
        """For every recorded name its facts that are not false, by their terms at some positions."""
        self._changed: dict[Fluent, None] = {}
        """The recorded fluents that have changed since derived facts were judged."""
        self._truth: dict[Fluent, Truth] = {}
        self._proofs: dict[Fluent, _Attempt] = {}
        """For every derived fact that is not false, the attempt that has proved it."""
        self._reads: dict[Fluent, dict[_Read, None]] = {}
        self._readers: dict[_Read, dict[Fluent, None]] = {}
        self._undecided: dict[Fluent, frozenset[Fluent]] = {}
        """For facts that are unknown, the unknown fluents that they depend on."""

    def changed(self, changes: Iterable[Fluent]) -> None:
        """Note that recorded fluents have changed."""
        for fluent in changes:
            if fluent[0] in self.rules.below:
                self._changed[fluent] = None
                for (length, known), table in self._tables.get(fluent[0], {}).items():
                    if length == len(fluent):
                        self._enter(fluent, table.setdefault(tuple([fluent[position] for position in known]), {}))

    def _enter(self, fact: Fluent, facts: dict[Fluent, None]) -> None:
        value = self._recorded[fact]
        if value is UNKNOWN or value:
            facts[fact] = None
        else:
            facts.pop(fact, None)

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return the truth of a derived fact, or what is recorded for any other fluent."""
        if fluent[0] not in self.rules.derived:
            return self._recorded.get(fluent)
        if self._changed:
            self._follow()
        if fluent not in self._truth:
            self._settle(self.rules.strata[fluent[0]], (fluent,))
        return self._truth[fluent]

    def knows(self, fluent: Fluent) -> bool:
        """Return whether the derived fact has been judged."""
        return fluent in self._truth

    # --- the least fixpoint ----------------------------------------------------------------------

    def _settle(self, stratum: int, facts: Iterable[Fluent]) -> dict[Fluent, Truth]:
        """Judge facts of a stratum and all of it that depends on them; return those that have risen, with their truth before."""
        judge, risen, waiting = _Judge(self, stratum), dict[Fluent, Truth](), dict.fromkeys(facts)
        while waiting:
            judging, waiting = waiting, {}
            for fact in judging:
                before = self._truth.setdefault(fact, False)
                if before is True:
                    continue
                judge.reads = {}
                best: _Attempt | None = None
                for attempt in self._ended(fact, judge):
                    if attempt.succeeded and (best is None or attempt.truth is True):
                        best = attempt
                        if best.truth is True:
                            break
                self._note(fact, judge.reads)
                waiting |= judge.opened
                judge.opened = {}
                if best is not None and best.truth is not before:
                    risen.setdefault(fact, before)
                    self._truth[fact], self._proofs[fact] = best.truth, best
                    waiting |= dict.fromkeys(self._readers_of(fact, stratum))
        return risen

    def _note(self, fact: Fluent, reads: dict[_Read, None]) -> None:
        before = self._reads.get(fact, {})
        self._reads[fact] = reads
        for read in before.keys() - reads.keys():
            del self._readers[read][fact]
            if not self._readers[read]:
                del self._readers[read]
        for read in reads.keys() - before.keys():
            self._readers.setdefault(read, {})[fact] = None

    def _readers_of(self, read: _Read, stratum: int) -> list[Fluent]:
        return [fact for fact in self._readers.get(read, ()) if self.rules.strata[fact[0]] == stratum]

    def _follow(self) -> None:
        """Judge again what has read something that has changed."""
        reads = [read for fluent in self._changed for read in (fluent, *self._patterns(fluent))]
        gone, self._changed = set(self._changed), {}
        self._undecided.clear()
        if len(self._truth) > _KEPT:
            for cache in (self._truth, self._proofs, self._reads, self._readers):
                cache.clear()
        for stratum in range(max(self.rules.strata.values()) + 1):
            judged = dict.fromkeys(fact for read in reads for fact in self._readers_of(read, stratum))
            fallen, falling = dict[Fluent, Truth](), list(judged)
            for fact in falling:  # grows
                if self._truth[fact] is not False and self._rests_on_any(fact, gone):
                    fallen[fact], self._truth[fact] = self._truth[fact], False
                    gone.add(fact)
                    falling += self._readers_of(fact, stratum)
            for fact in fallen:
                del self._proofs[fact]
            for fact, before in {**self._settle(stratum, {**judged, **fallen}), **fallen}.items():
                if self._truth[fact] is before:
                    gone.discard(fact)
                else:
                    gone.add(fact)
                    reads.append(fact)

    def _patterns(self, fluent: Fluent) -> Iterator[_Read]:
        for length, known in self._tables.get(fluent[0], {}):
            if length == len(fluent):
                yield fluent[0], length, known, tuple([fluent[position] for position in known])

    def _rests_on_any(self, fact: Fluent, gone: set[Fluent]) -> bool:
        proof = self._proofs[fact]
        return any(not gone.isdisjoint(fluents(part, self, proof.env)) for part in proof.body.parts)

    # --- why --------------------------------------------------------------------------------------

    def rests_on(self, fluent: Fluent) -> frozenset[Fluent]:
        """Return the unknown recorded fluents that decide whether a derived fact holds; none when that is known."""
        unknown: set[Fluent] = set()
        waiting = {fluent} if self.value(fluent) is UNKNOWN else set()
        while waiting:
            undecided = waiting.pop()
            unknown.add(undecided)
            if undecided[0] in self.rules.derived:
                waiting |= self._waits_for(undecided) - unknown
        return frozenset(fluent for fluent in unknown if fluent[0] not in self.rules.derived)

    def _waits_for(self, fluent: Fluent) -> frozenset[Fluent]:
        """Return the unknown fluents in the bodies that may still turn out to derive the fact."""
        if fluent not in self._undecided:
            attempts = [attempt for attempt in self._ended(fluent, _Judge(self)) if attempt.succeeded and attempt.truth is UNKNOWN]
            parts = ((part, attempt.env) for attempt in attempts for part in attempt.body.parts)
            asked = (below for part, env in parts if evaluate(part, self, env) is UNKNOWN for below in fluents(part, self, env))
            self._undecided[fluent] = frozenset(below for below in asked if self.value(below) is UNKNOWN)
        return self._undecided[fluent]

    def because(self, fluent: Fluent) -> str:
        """Return why a derived fact has its truth, in recorded facts: "because of …", or "for want of …" if it is false."""
        truth = self.value(fluent)
        if truth is UNKNOWN:
            return _listed("because of", sorted(map(fluent_text, self.rests_on(fluent))))
        derived, seen, reasons = [fluent], {fluent}, dict[str, None]()
        for fact in derived:  # grows
            for part, env in self._grounds(fact):
                below = bind(part.fluent, env) if isinstance(part, Holds) else ()
                if below[:1] and below[0] in self.rules.derived:
                    derived += {below} - seen
                    seen.add(below)
                elif names(part):
                    reasons[str(ground(part, env))] = None
        # the last attempt explains more than the first: it usually got furthest
        return _listed("because of", list(reasons)) if truth else _listed("for want of", list(reversed(reasons)))

    def _grounds(self, fluent: Fluent) -> Iterator[tuple[Condition, Environment]]:
        """Yield the conditions that prove the fact, or those at which every attempt failed, with their bindings."""
        if self.value(fluent) is True:
            proof = self._proofs[fluent]
            yield from ((part, proof.env) for part in proof.body.parts)
            return
        for attempt in self._ended(fluent, _Judge(self)):
            step = attempt.body.steps[attempt.position]
            if not isinstance(step, ChooseObject):
                yield step.condition, attempt.env

    def _ended(self, fluent: Fluent, judge: _Judge) -> Iterator[_Attempt]:
        """Yield all attempts to derive the fact, each at its last step, as far as is known."""
        waiting = list(reversed(self._attempts(fluent)))
        while waiting:
            attempt = waiting.pop()
            further = [] if attempt.succeeded else self._further(attempt, judge)
            if further:
                waiting += reversed(further)
            else:
                yield attempt

    # --- following bodies -------------------------------------------------------------------------

    def _attempts(self, fluent: Fluent) -> list[_Attempt]:
        """Return an attempt to derive the fact for every body that is about it."""
        return [
            _Attempt(fluent, body, dict(zip((variable.name for variable in body.head), fluent[1:], strict=True)))
            for body in self.rules.bodies[fluent[0]]
            if len(body.head) == len(fluent) - 1 and all(map(self._is_of, fluent[1:], (variable.types for variable in body.head)))
        ]

    def _further(self, attempt: _Attempt, judge: _Judge) -> list[_Attempt]:
        """Return the attempt after its next step, once for every binding with which that succeeds."""
        match attempt.body.steps[attempt.position]:
            case CheckCondition(condition):
                truth = evaluate(condition, judge, attempt.env)
                return [] if truth is False else [attempt.advanced(attempt.env, truth)]
            case ChooseObject(variable):
                return [attempt.advanced({**attempt.env, variable.name: name}) for name in self.objects(variable.types)]
            case FindFact() as find:
                return [attempt.advanced(env, truth) for env, truth in self._matches(find, attempt.env, judge)]
            case other:
                assert_never(other)

    def _matches(self, find: FindFact, env: Environment, judge: _Judge) -> Iterator[tuple[Environment, Truth]]:
        """Yield the environment extended by each recorded fact that matches, and the truth of that fact."""
        pattern = bind(find.condition.fluent, env)
        name, length, terms = pattern[0], len(pattern), tuple([pattern[position] for position in find.known])
        judge.reads[name, length, find.known, terms] = None
        tables = self._tables.setdefault(name, {})
        if (length, find.known) not in tables:
            table = tables[length, find.known] = {}
            for fact in self._recorded:
                if fact[0] == name and len(fact) == length:
                    self._enter(fact, table.setdefault(tuple([fact[position] for position in find.known]), {}))
        for fact in tables[length, find.known].get(terms, ()):
            inner = dict(env)
            if all(self._is_of(fact[at], new.types) and inner.setdefault(new.name, fact[at]) == fact[at] for at, new in find.new):
                yield inner, UNKNOWN if self._recorded[fact] is UNKNOWN else True

    def _is_of(self, name: str, types: tuple[str, ...]) -> bool:
        if types not in self._members:
            self._members[types] = frozenset(self.objects(types))
        return name in self._members[types]


class _Judge:
    """The state as rules of a stratum see it: facts of that which nobody has asked about yet are false, and opened.

    The mutable state is what the constructor sets besides `objects`.
    """

    def __init__(self, facts: DerivedFacts, stratum: int | None = None) -> None:
        self.objects = facts.objects
        self._facts = facts
        self._stratum = stratum
        self.reads: dict[_Read, None] = {}
        """What has been asked for."""
        self.opened: dict[Fluent, None] = {}

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return the value of a fluent, as far as is known."""
        self.reads[fluent] = None
        facts = self._facts
        if facts.rules.strata.get(fluent[0], -1) != self._stratum or facts.knows(fluent):
            return facts.value(fluent)
        self.opened[fluent] = None
        return False


def _listed(how: str, reasons: list[str]) -> str:
    if not reasons:
        return ""
    more = f" and {len(reasons) - LISTED} more" if len(reasons) > LISTED else ""
    return f"{how} {', '.join(reasons[:LISTED])}{more}"
