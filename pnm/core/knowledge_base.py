"""The knowledge base: facts, numbers and variables, local to a run or shared by all.

A *fact* or number is a fluent with a value; a *variable* is a name with any value, such as a
field of an action's result. A base is *closed*: a fluent without a record is absent, which
conditions read as false. A fluent may also be recorded as `UNKNOWN`.

Facts that `pnm.core.logic.rules` derive are computed when queried and maintained from then on, never recorded, written
or reported. Reports about them are ignored.

A fluent is *sensed* when state reports include it (its name is then listed with their lag),
and *assumed* otherwise: then an action's effect is written when the action succeeds.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from operator import itemgetter
from typing import Final, Generic, TypeVar

from pnm.core.logic.compiled import RecordedState
from pnm.core.logic.computed_values import MISSING
from pnm.core.logic.derived_facts import DerivedFacts
from pnm.core.logic.effects import Changes
from pnm.core.logic.expressions import EXISTS, UNKNOWN, Constant, Fluent, Unknown, Value, absent_value, fluent_text, same_value
from pnm.core.logic.rules import NO_RULES, Reads, Rules
from pnm.errors import InputError, check_seconds

_REMEMBERED: Final = 20_000
"""Changes that are remembered at most."""

_NAME_OF: Final = itemgetter(0)

Listener = Callable[[Mapping[Fluent, Value | Unknown]], None]


def _of_types(objects: Mapping[str, tuple[str, ...]], types: tuple[str, ...]) -> tuple[str, ...]:
    if len(types) == 1:
        return objects.get(types[0], ())
    return tuple(dict.fromkeys(name for kind in types for name in objects.get(kind, ())))


class KnowledgeBase(RecordedState):
    """One store of facts, numbers and variables that notifies its listeners of changes.

    The mutable state is the dictionaries set in the constructor, the list of listeners, the last changes, and the
    cache of derived facts. Given facts that rules derive raise `InputError`.
    """

    def __init__(
        self,
        facts: Mapping[Fluent, Value | Unknown] | None = None,
        *,
        variables: Mapping[str, object] | None = None,
        objects: Mapping[str, tuple[str, ...]] | None = None,
        sensed: Mapping[str, float] | None = None,
        rules: Rules = NO_RULES,
    ) -> None:
        self.rules = rules
        self.derived = rules.derived
        if self.derived:
            self._refuse_derived(facts or {})
        self._facts: dict[Fluent, Value | Unknown] = dict(facts or {})
        self._present: dict[str, dict[Fluent, None]] | None = None
        """Of each name, the fluents with a known value that is not absent, from the first report on: it costs what it is about."""
        self._variables: dict[str, object] = dict(variables or {})
        self._objects: dict[str, tuple[str, ...]] = dict(objects or {})
        self._sensed: dict[str, float] = dict(sensed or {})
        self._why_unknown: dict[Fluent, str] = {}
        """Why fluents are unknown, where that was said; nothing of those that are not."""
        self.told_why: Mapping[str, tuple[Fluent, ...]] = {}
        """What is news, with the changes that listeners are told of, of why fluents are unknown: for each reason, those."""
        self._listeners: list[Listener] = []
        self._listeners_of: dict[str, list[Listener]] = {}
        """By name, those that hear of changes of fluents of this name alone."""
        self._changed: list[Fluent] = []
        """The fluents that have changed last, in order."""
        self._forgotten = 0
        """The number of changes before these."""
        self._derived_facts = self._derived_anew()

    def __repr__(self) -> str:
        return f"<KnowledgeBase {len(self._facts)} facts, {len(self._variables)} variables, {len(self._sensed)} sensed names>"

    # as a state (`pnm.core.logic.expressions.State`)

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return the recorded value of the fluent, None when there is none; or the truth of a derived fact."""
        value = self._facts.get(fluent)
        if value is None and fluent[0] in self.derived:
            return self._derived_facts.value(fluent)
        return value

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        """Return the objects of any of the types: in the order in which they were declared, then those that were found, by name."""
        return _of_types(self._objects, types)

    def _derived_anew(self) -> DerivedFacts:
        # without a reference to this world: worlds are copied for every plan, and go as soon as nobody has them
        return DerivedFacts(self.rules, self._facts, partial(_of_types, self._objects))

    def objects_by_type(self) -> dict[str, tuple[str, ...]]:
        """Return a copy of the objects of every type."""
        return dict(self._objects)

    def found(self) -> dict[str, tuple[str, ...]]:
        """Return the objects that were found, with their types and the supertypes of these."""
        found: dict[str, tuple[str, ...]] = {}
        for _, name, kind in (fluent for fluent, value in self._facts.items() if _is_found(fluent) and value is not False):
            found[name] = (*found.get(name, ()), kind)
        return found

    def _note_objects(self, changes: Iterable[Fluent]) -> None:
        """Note which objects are there, now that some were found, or turned out not to be there."""
        if about := [fluent for fluent in changes if _is_found(fluent)]:
            found, names = self.found(), {name for _, name, _ in about}
            for kind in {"object", *(kind for _, _, kind in about)}:
                others = (name for name in self._objects.get(kind, ()) if name not in names and name not in found)
                self._objects[kind] = (*others, *sorted(name for name, kinds in found.items() if kind in ("object", *kinds)))
            self._derived_facts = self._derived_anew()
            self._forget_changes()

    # derived facts

    def because(self, fluent: Fluent, /) -> str:
        """Return why a derived fact holds or does not, in recorded facts, or why any other is unknown; empty if nothing is to be said."""
        if fluent[0] in self.derived:
            return self._derived_facts.because(fluent)
        why = self._why_unknown.get(fluent)
        return f"({why})" if why else ""

    def why_unknown(self) -> dict[Fluent, str]:
        """Return the fluents that are unknown for a reason that was given, with that."""
        return dict(self._why_unknown)

    def rests_on(self, fluents: frozenset[Fluent]) -> frozenset[Fluent]:
        """Return the fluents with each derived one replaced by the unknown fluents that decide whether it holds."""
        if not self.derived:
            return fluents
        derived = frozenset(fluent for fluent in fluents if fluent[0] in self.derived)
        return (fluents - derived).union(*map(self._derived_facts.rests_on, derived))

    # facts

    def facts(self) -> dict[Fluent, Value | Unknown]:
        """Return a copy of everything recorded that is not false."""
        return {fluent: value for fluent, value in self._facts.items() if value is not False}

    def update(self, changes: Mapping[Fluent, Value | Unknown], why: str = "") -> Changes:
        """Record the changes; return those that changed something. Malformed or derived fluents raise `InputError`: nothing is recorded."""
        for fluent in changes:
            if not isinstance(fluent, tuple) or not fluent or not all(isinstance(name, str) for name in fluent):
                raise InputError(f"not a fluent: {fluent!r}; expected a tuple of names such as ('at', 'r1', 'kitchen')")
        return self.record(changes, why)

    def record(self, changes: Mapping[Fluent, Value | Unknown], why: str = "") -> Changes:
        """Record changes of fluents that are known to be well-formed, such as effects; otherwise as `update`."""
        if self.derived:
            self._refuse_derived(changes)
        facts = self._facts
        real = {fluent: value for fluent, value in changes.items() if not same_value(facts.get(fluent), value)}
        news = self._explain(changes, real, why) if why or self._why_unknown else ()
        if real:
            if self._present is not None:
                self._note_present(real, self._present)
            facts.update(real)
            self._changed += real
            if len(self._changed) > _REMEMBERED:
                self._forget_changes(_REMEMBERED // 2)
            if self.derived:
                self._derived_facts.changed(real)
            if EXISTS in map(_NAME_OF, real):
                self._note_objects(real)
        if real or news:
            self._tell(real, {why: news} if news else {})
        return real

    def _explain(self, changes: Iterable[Fluent], real: Iterable[Fluent], why: str) -> tuple[Fluent, ...]:
        """Note why fluents are unknown from now on, or forget why those that have changed were; return those of which there is news."""
        if not why:
            for fluent in real:
                self._why_unknown.pop(fluent, None)
            return ()
        news = tuple([fluent for fluent in changes if self._why_unknown.get(fluent) != why])
        self._why_unknown.update(dict.fromkeys(news, why))
        return news

    def _tell(self, changes: Changes, why: Mapping[str, tuple[Fluent, ...]] | None = None) -> None:
        of_names = (
            (self._listeners_of.get(name, ()) for name in dict.fromkeys(fluent[0] for fluent in changes)) if self._listeners_of else ()
        )
        for listener in (*self._listeners, *chain.from_iterable(of_names)):
            self.told_why = why or {}
            listener(changes)

    def forget(self, fluents: Iterable[Fluent], why: str) -> Changes:
        """Record that the fluents are unknown, and why; return those that have become so. Derived ones raise `InputError`."""
        return self.update(dict.fromkeys(fluents, UNKNOWN), why)

    def replace(self, names: Iterable[str], facts: Mapping[Fluent, Value | Unknown]) -> Changes:
        """Record a complete report about the named predicates and functions.

        A fact that it omits is false, an object fluent that it omits has no object, and a number that it omits is
        unknown. Derived facts in it are ignored.
        """
        names = frozenset(names) - self.derived
        if self.derived:
            facts = {fluent: value for fluent, value in facts.items() if not self._derives(fluent)}
        if self._present is None:
            self._present = {}
            self._note_present(self._facts, self._present)
        omitted = (fluent for name in sorted(names) for fluent in self._present.get(name, ()) if fluent not in facts)
        return self.update({**{fluent: absent_value(self._facts[fluent]) for fluent in omitted}, **facts})

    @staticmethod
    def _note_present(changes: Mapping[Fluent, Value | Unknown], present: dict[str, dict[Fluent, None]]) -> None:
        for fluent, value in changes.items():
            if value is UNKNOWN or same_value(None, value):
                present.get(fluent[0], {}).pop(fluent, None)
            else:
                present.setdefault(fluent[0], {})[fluent] = None

    def begin_anew(self, facts: Mapping[Fluent, Value | Unknown], objects: Mapping[str, tuple[str, ...]], rules: Rules) -> None:
        """Replace the facts, objects and rules of one world by those of another; variables and the sensed names stay.

        Sensed fluents keep their last report: sensors do not report again because of a new world. Given facts that
        rules derive raise `InputError`, and nothing changes.
        """
        old_rules, self.rules, self.derived = self.rules, rules, rules.derived
        try:
            self._refuse_derived(facts)
        except InputError:
            self.rules, self.derived = old_rules, old_rules.derived
            raise
        reported = {fluent: value for fluent, value in self._facts.items() if self.is_sensed(fluent) and not self._derives(fluent)}
        facts = {**{fluent: value for fluent, value in facts.items() if not self.is_sensed(fluent)}, **reported}
        changes = {fluent: absent_value(value) for fluent, value in self._facts.items() if fluent not in facts and value is not UNKNOWN}
        changes |= {fluent: value for fluent, value in facts.items() if not same_value(self._facts.get(fluent), value)}
        self._facts.clear()
        self._facts.update(facts)
        self._why_unknown = {fluent: why for fluent, why in self._why_unknown.items() if facts.get(fluent) is UNKNOWN}
        self._present = None
        self._objects = dict(objects)
        self._derived_facts = self._derived_anew()
        self._note_objects(facts)
        self._forget_changes()
        self._tell(changes)

    def _refuse_derived(self, changes: Mapping[Fluent, Value | Unknown]) -> None:
        for fluent in filter(self._derives, changes):
            raise InputError(f"{fluent_text(fluent)} follows from rules; it is neither set nor reported")

    def _derives(self, fluent: object) -> bool:
        return isinstance(fluent, tuple) and fluent[:1] != () and fluent[0] in self.derived

    def listen(self, listener: Listener, name: str | None = None) -> Callable[[], None]:
        """Call the listener with every batch of changes, or those of fluents of this name; return what unsubscribes it.

        One for variables, for what is sensed, or for why something is unknown is empty.
        """
        listeners = self._listeners if name is None else self._listeners_of.setdefault(name, [])
        listeners.append(listener)
        return lambda: listeners.remove(listener)

    # changes

    @property
    def changes(self) -> int:
        """The number of changes so far."""
        return self._forgotten + len(self._changed)

    def changed_since(self, changes: int) -> Sequence[Fluent] | None:
        """Return the fluents that have changed since there were so many changes; None if anything may have, also variables."""
        known = changes - self._forgotten
        return None if known < 0 else self._changed[known:]

    def go_on_from(self, changes: int, last: Sequence[Fluent]) -> None:
        """Count changes from there on, and remember which were the last: nothing has changed here yet."""
        self._changed, self._forgotten = list(last), changes - len(last)

    def _forget_changes(self, count: int | None = None) -> None:
        """Forget the oldest changes; or all, with one more that may be of anything."""
        self._forgotten += len(self._changed) + 1 if count is None else count
        del self._changed[:count]

    # sensing

    def sense(self, names: Iterable[str], *, lag: float = 0.0) -> None:
        """Mark predicates and functions as sensed: reported, at most `lag` seconds late; raise `InputError` if that is not finite."""
        check_seconds("a report", lag)
        news = {name: lag for name in names if name not in self.derived and self._sensed.get(name) != lag}
        self._sensed.update(news)
        if news:
            self._forget_changes()
            self._tell({})

    def sensed_names(self) -> dict[str, float]:
        """Return the sensed predicates and functions, and how many seconds late their reports may be."""
        return dict(self._sensed)

    def is_sensed(self, fluent: Fluent) -> bool:
        """Return whether the fluent is sensed; a derived one, whether all fluents below it are."""
        name = fluent[0]
        return all(below in self._sensed for below in self.rules.base((name,))) if name in self.derived else name in self._sensed

    def reported(self, values: Mapping[Fluent, Value]) -> dict[Fluent, Value]:
        """Return those of the values that sensors report."""
        return {fluent: value for fluent, value in values.items() if self.is_sensed(fluent)} if self._sensed else {}

    def assumed(self, changes: Changes) -> Changes:
        """Return those of the changes that no sensor reports, or that are about an object which no sensor has known."""
        if not self._sensed:
            return changes
        unseen = {fluent: value for fluent, value in changes.items() if not self.is_sensed(fluent)}
        if EXISTS in map(_NAME_OF, changes):
            new = {fluent[1] for fluent in changes if _is_found(fluent) and self._facts.get(fluent) in (None, False)}
            unseen |= {fluent: value for fluent, value in changes.items() if not new.isdisjoint(fluent)}
        return unseen

    def senses(self, names: frozenset[str]) -> bool:
        """Return whether all fluents of these names are sensed."""
        if not self._sensed:
            return not names
        return (self.rules.base(names) if self.derived else names) <= self._sensed.keys()

    def lag(self, names: Iterable[str]) -> float:
        """Return the lag in seconds of the slowest report about the names, or the base names below them."""
        return max((self._sensed.get(name, 0.0) for name in self.rules.base(names)), default=0.0)

    @property
    def longest_lag(self) -> float:
        """Seconds until every change is reported."""
        return max(self._sensed.values(), default=0.0)

    # variables

    def variable(self, name: str) -> object:
        """Return the value of the variable, or `MISSING`."""
        return self._variables.get(name, MISSING)

    def store(self, variables: Mapping[str, object]) -> None:
        """Record the variables, replacing older values; one that is set to None is forgotten."""
        self._variables.update(variables)
        for name in [name for name, value in variables.items() if value is None]:
            del self._variables[name]
        self._forget_changes()
        self._tell({})

    def variables(self) -> dict[str, object]:
        """Return a copy of all variables."""
        return dict(self._variables)


@dataclass(frozen=True)
class Layered:
    """The knowledge of one run: its local knowledge base in front of the global one.

    Facts describe the one world that all runs share: they are read from the global layer and written to it.
    Variables belong to the run that stored them; reading asks the local layer first.
    """

    world: KnowledgeBase
    local: KnowledgeBase = field(default_factory=KnowledgeBase)

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return the value of the fluent in the world."""
        return self.world.value(fluent)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        """Return the objects of any of the types."""
        return self.world.objects(types)

    def because(self, fluent: Fluent, /) -> str:
        """Return why a derived fact holds or does not."""
        return self.world.because(fluent)

    @property
    def version(self) -> tuple[int, int]:
        """The changes of both layers so far: as long as they are as many, everything has the value that it had."""
        return self.world.changes, self.local.changes

    def variable(self, name: str) -> object:
        """Return the variable from the first layer that has it, or `MISSING`."""
        value = self.local.variable(name)
        return self.world.variable(name) if value is MISSING else value


def _is_found(fluent: Fluent) -> bool:
    """Return whether the fluent says that an object of a type is there."""
    return fluent[0] == EXISTS and len(fluent) == 3


def statement_text(fluent: Fluent, value: Value | Unknown) -> str:
    """Return the text that `parse_statement` reads."""
    if isinstance(value, bool):
        return fluent_text(fluent) if value else f"(not {fluent_text(fluent)})"
    return f"(= {fluent_text(fluent)} {Constant(value) if not isinstance(value, Unknown) else value.value})"


_FLUENT = re.compile(r"\(\s*([^\s()]+(?:\s+[^\s()]+)*)\s*\)\Z")
_NOT = re.compile(r"\(\s*not\s+(\(.*\))\s*\)\Z", re.DOTALL)
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?\Z", re.IGNORECASE)
_EQUAL = re.compile(r"\(\s*=\s+(\(.*\))\s+([^\s()]+)\s*\)\Z", re.DOTALL)


def parse_fluent(text: str) -> Fluent:
    """Read ``(at r1 kitchen)``; raise `InputError` for anything else."""
    match = _FLUENT.match(text.strip())
    if not match:
        raise InputError(f"not a fact: {text!r}; expected something like (at r1 kitchen)")
    return tuple(match[1].split())


def parse_statement(text: str) -> tuple[Fluent, Value]:
    """Read ``(at r1 kitchen)``, ``(not (at r1 kitchen))``, ``(= (battery r1) 80)`` or ``(= (location r1) kitchen)``."""
    text = text.strip()
    if match := _NOT.match(text):
        return parse_fluent(match[1]), False
    if match := _EQUAL.match(text):
        return parse_fluent(match[1]), float(match[2]) if _NUMBER.match(match[2]) else match[2]
    return parse_fluent(text), True


# --- who reads which fluents, so that a change concerns only those who read what has changed ---


Reader = TypeVar("Reader", bound=Hashable)


class Readers(Generic[Reader]):
    """An index from fluents, and names of fluents, to those who read them. The mutable state is what the constructor sets."""

    def __init__(self) -> None:
        self.reads: dict[Reader, Reads] = {}
        """The fluents that each of them reads."""
        self._of: dict[Fluent | str, set[Reader]] = {}
        self._of_all: set[Reader] = set()

    def __len__(self) -> int:
        return len(self.reads)

    def add(self, reader: Reader, reads: Reads) -> None:
        """Have changes of what it reads concern a reader; of everything, if it is not known what that is. Only the first time counts."""
        if reader in self.reads:
            return
        self.reads[reader] = reads
        if reads is None:
            self._of_all.add(reader)
        else:
            for read in reads:
                self._of.setdefault(read, set()).add(reader)

    def remove(self, reader: Reader) -> None:
        """Have no change concern a reader."""
        self._of_all.discard(reader)
        for read in self.reads.pop(reader, None) or ():
            readers = self._of[read]
            readers.discard(reader)
            if not readers:
                del self._of[read]

    def concerned(self, changed: Iterable[Fluent]) -> set[Reader]:
        """Return whom changes of these fluents concern."""
        found = self._of_all.copy()
        for fluent in changed:
            found.update(self._of.get(fluent, ()), self._of.get(fluent[0], ()))
        return found
