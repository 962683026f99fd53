"""Derived facts: computed when asked for, and maintained from what changes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Final, NamedTuple, TypeAlias, assert_never

from pnm.core.logic.conditions import Condition, Holds, evaluate, fluents, ground, names
from pnm.core.logic.expressions import UNKNOWN, Environment, Fluent, Truth, Unknown, Value, bind, fluent_text
from pnm.core.logic.rules import Body, CheckCondition, ChooseObject, FindFact, Rules

LISTED: Final = 4
"""Reasons that an explanation names; the others are counted."""
KEPT: Final = 50_000
"""Derived facts that are maintained at most; if there are more at a change, all are forgotten."""
_Read: TypeAlias = tuple[object, ...]
"""A fluent that a rule asks for, or a pattern of recorded facts: name, length, known positions and the terms there."""


class _Attempt(NamedTuple):
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
        self._strata = {**rules.strata, **{chain.name: rules.strata[name] for name, chain in rules.chains.items()}}
        self._bodies = {**rules.bodies, **{chain.name: chain.steps for chain in rules.chains.values()}}
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
        self._asked = Counter[Fluent]()
        """How many facts with a chain have been asked for, by each of their ends."""
        self._by_chain: set[Fluent] = set()
        """Facts that are derived by chains."""
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
        stratum = self._strata.get(fluent[0])
        if stratum is None:
            return self._recorded.get(fluent)
        if self._changed:
            self._follow()
        if fluent not in self._truth:
            if chain := self.rules.chains.get(fluent[0]):
                begin, end = chain.ends(fluent)
                if self._asked[begin] > self._asked[end]:  # more is asked about where it begins than about where it ends
                    self._by_chain.add(fluent)
                self._asked.update((begin, end))
            self._settle(stratum, (fluent,))
        return self._truth[fluent]

    def is_open(self, fluent: Fluent, stratum: int) -> bool:
        """Return whether the fluent is a derived fact of this stratum that has not been judged."""
        return fluent not in self._truth and self._strata.get(fluent[0]) == stratum

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
                for attempt in self._ended(fact, judge, by_chain=fact in self._by_chain):
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
        return [fact for fact in self._readers.get(read, ()) if self._strata[fact[0]] == stratum]

    def _follow(self) -> None:
        """Judge again what has read something that has changed."""
        reads: list[_Read] = [*self._changed]
        for fluent in self._changed:
            tables = (known for length, known in self._tables.get(fluent[0], {}) if length == len(fluent))
            reads += ((fluent[0], len(fluent), known, tuple([fluent[position] for position in known])) for known in tables)
        gone, self._changed = set(self._changed), {}
        self._undecided.clear()
        if len(self._truth) > KEPT:
            for cache in (self._truth, self._proofs, self._reads, self._readers, self._asked, self._by_chain):
                cache.clear()
        for stratum in range(max(self._strata.values()) + 1):
            judged = dict.fromkeys(fact for read in reads for fact in self._readers_of(read, stratum))
            fallen, falling = dict[Fluent, Truth](), list(judged)
            for fact in falling:  # grows
                proof = None if self._truth[fact] is False else self._proofs[fact]
                if proof and any(not gone.isdisjoint(fluents(part, self, proof.env)) for part in proof.body.parts):
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

    # --- why --------------------------------------------------------------------------------------

    def rests_on(self, fluent: Fluent) -> frozenset[Fluent]:
        """Return the unknown recorded fluents that decide whether a derived fact holds; none when that is known."""
        unknown: set[Fluent] = set()
        waiting = {fluent} if self.value(fluent) is UNKNOWN else set()
        while waiting:
            undecided = waiting.pop()
            unknown.add(undecided)
            if undecided[0] in self._strata:
                waiting |= self._waits_for(undecided) - unknown
        return frozenset(fluent for fluent in unknown if fluent[0] not in self._strata)

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
                if below[:1] and below[0] in self._strata:
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

    def _ended(self, fluent: Fluent, judge: _Judge, *, by_chain: bool = False) -> Iterator[_Attempt]:
        """Yield all attempts to derive the fact, each at its last step, as far as is known."""
        bodies = self.rules.chains[fluent[0]].bodies if by_chain else self._bodies[fluent[0]]
        waiting = [
            _Attempt(fluent, body, dict(zip((variable.name for variable in body.head), fluent[1:], strict=True)))
            for body in reversed(bodies)
            if len(body.head) == len(fluent) - 1 and all(map(self._is_of, fluent[1:], (variable.types for variable in body.head)))
        ]
        while waiting:
            attempt = waiting.pop()
            further = [] if attempt.succeeded else self._further(attempt, judge)
            if further:
                waiting += reversed(further)
            else:
                yield attempt

    # --- following bodies -------------------------------------------------------------------------

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

    def __init__(self, facts: DerivedFacts, stratum: int = -1) -> None:
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
        if facts.is_open(fluent, self._stratum):
            self.opened[fluent] = None
            return False
        return facts.value(fluent)


def _listed(how: str, reasons: list[str]) -> str:
    if not reasons:
        return ""
    more = f" and {len(reasons) - LISTED} more" if len(reasons) > LISTED else ""
    return f"{how} {', '.join(reasons[:LISTED])}{more}"
