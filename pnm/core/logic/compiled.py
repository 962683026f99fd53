"""Conditions as functions of a state: the same truth, without walking through the condition, nor through all objects again."""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import prod
from typing import NamedTuple, TypeAlias
from weakref import WeakKeyDictionary

from pnm.core.logic.conditions import (
    All,
    Condition,
    Exists,
    ForAll,
    Holds,
    Not,
    conjuncts,
    data_in,
    evaluate,
    every_part,
    fluents_of,
    negate,
)
from pnm.core.logic.expressions import UNKNOWN, Fluent, State, Truth

TruthIn: TypeAlias = Callable[[State], Truth]


class CompiledCondition(NamedTuple):
    """A condition without free variables as a function."""

    truth: TruthIn
    reads_variables: bool
    """Whether it reads anything but facts and numbers."""

    def holds_by_facts(self, state: State) -> bool:
        """Return whether facts and numbers alone decide that it holds."""
        return not self.reads_variables and self.truth(state) is True


def compiled(condition: Condition) -> CompiledCondition:
    """Return a function for the truth of a condition without free variables in a state; raises what `evaluate` raises."""
    parts = conjuncts(condition)
    facts = tuple(part.fluent for part in parts if isinstance(part, Holds))
    if len(facts) == len(parts):
        return CompiledCondition(_all_facts(facts), reads_variables=False)
    truth = _truth_of(parts[0]) if len(parts) == 1 else _all_parts(tuple(map(_truth_of, parts)))
    return CompiledCondition(truth, any(True for _ in data_in(condition)))


def _truth_of(condition: Condition) -> TruthIn:
    match condition:
        case Holds(fluent):
            return lambda state: value if (value := state.value(fluent)) is UNKNOWN else bool(value)
        case Not(operand):
            truth = _truth_of(operand)
            return lambda state: negate(truth(state))
        case All():
            return compiled(condition).truth
        case ForAll() | Exists() if _is_countable(condition):
            return _Counted(condition).truth
        case _:
            return lambda state: evaluate(condition, state)


def _all_facts(fluents: tuple[Fluent, ...]) -> TruthIn:
    def hold(state: State) -> Truth:
        result: Truth = True
        for fluent in fluents:
            value = state.value(fluent)
            if value is UNKNOWN:
                result = UNKNOWN
            elif not value:
                return False
        return result

    return hold


def _all_parts(parts: tuple[TruthIn, ...]) -> TruthIn:
    def hold(state: State) -> Truth:
        result: Truth = True
        for part in parts:
            truth = part(state)
            if truth is False:
                return False
            if truth is UNKNOWN:
                result = UNKNOWN
        return result

    return hold


# --- of choices of objects, those that a change is about --------------------------------------


class RecordedState(State):
    """A state that remembers which of its fluents have changed."""

    derived: frozenset[str]
    """The names of fluents that change without being recorded."""

    @property
    def changes(self) -> int:
        """The number of changes so far."""
        raise NotImplementedError

    def changed_since(self, changes: int) -> Sequence[Fluent] | None:
        """Return the fluents that have changed since there were so many changes; None if anything may have."""
        raise NotImplementedError


def _is_countable(condition: ForAll | Exists) -> bool:
    own = {variable.name for variable in condition.variables}
    inner = (part.variables for part in every_part(condition.body) if isinstance(part, ForAll | Exists))
    return not any(True for _ in data_in(condition)) and all(variable.name not in own for variables in inner for variable in variables)


@dataclass(slots=True)
class _Choices:
    """The choices of objects for which the body of a condition does not have the truth that leaves it to the others."""

    changes: int
    """The number of changes of the state when it was looked at last."""
    members: tuple[dict[str, None], ...]
    """The objects for each variable."""
    decisive: set[tuple[str, ...]] = field(default_factory=set)
    unknown: set[tuple[str, ...]] = field(default_factory=set)
    complete: bool = False
    """Whether these are all of them: otherwise the first one that was decisive is enough."""


class _Counted:
    """A condition over all objects: once it has been judged, only those choices are judged again that a change is about.

    The mutable state is what is known of the choices in states that remember their changes.
    """

    def __init__(self, condition: ForAll | Exists) -> None:
        self._condition, self._body = condition, condition.body
        self._decisive = isinstance(condition, Exists)
        self._variables = tuple(variable.name for variable in condition.variables)
        self._read = tuple(dict.fromkeys(fluents_of(condition.body)))
        self._known: WeakKeyDictionary[State, _Choices] = WeakKeyDictionary()

    def truth(self, state: State) -> Truth:
        """Return the truth of the condition."""
        if not isinstance(state, RecordedState) or any(fluent[0] in state.derived for fluent in self._read):
            return evaluate(self._condition, state)
        known = self._known.get(state)
        changed = None if known is None else state.changed_since(known.changes)
        if known is None or changed is None or len(changed) > prod(map(len, known.members)):
            members = tuple(dict.fromkeys(state.objects(variable.types)) for variable in self._condition.variables)
            known = self._known[state] = _Choices(state.changes, members)
        else:
            known.changes = state.changes
            for chosen in dict.fromkeys(chosen for fluent in changed for chosen in self._about(fluent, known.members)):
                self._judge(chosen, known, state)
        if not known.decisive and not known.complete:
            known.unknown.clear()
            known.complete = not any(self._judge(chosen, known, state) is self._decisive for chosen in product(*known.members))
        return self._decisive if known.decisive else UNKNOWN if known.unknown else not self._decisive

    def _judge(self, chosen: tuple[str, ...], known: _Choices, state: State) -> Truth:
        truth = evaluate(self._body, state, dict(zip(self._variables, chosen, strict=True)))
        for some, member in ((known.decisive, truth is self._decisive), (known.unknown, truth is UNKNOWN)):
            some.add(chosen) if member else some.discard(chosen)
        return truth

    def _about(self, fluent: Fluent, members: tuple[dict[str, None], ...]) -> Iterator[tuple[str, ...]]:
        """Yield the choices with which the body reads the fluent."""
        for read in self._read:
            if len(read) == len(fluent) and all(term == name or term[0] == "?" for term, name in zip(read, fluent, strict=True)):
                bound = dict(zip(read, fluent, strict=True))
                if all(bound[term] == name for term, name in zip(read, fluent, strict=True)):
                    own = ((bound[one],) if one in bound else some for one, some in zip(self._variables, members, strict=True))
                    yield from (chosen for chosen in product(*own) if all(map(operator.contains, members, chosen)))
