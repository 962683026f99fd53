"""What follows from recorded facts by rules: found when asked for, remembered until its grounds change.

A fact is derived from the question backwards. It is taken to be false and attempts are made to derive
it, one for every body and every choice of objects for the body's own variables, step by step. A step
that asks about a fact of the same stratum opens that question too; the attempt goes on from there
whenever the answer turns out to be more than was thought. When no attempt can go on, every fact that
was asked about has its value in the least fixpoint. Facts of lower strata are settled first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, assert_never

from pnm.core.logic.conditions import Condition, Holds, fluents, ground, names
from pnm.core.logic.evaluation import evaluate
from pnm.core.logic.expressions import UNKNOWN, Environment, Fluent, State, Truth, Unknown, Value, bind, fluent_text
from pnm.core.logic.rules import Body, CheckCondition, ChooseObject, FindFact, Rules

LISTED: Final = 4
"""How many reasons are named; the others are counted."""


@dataclass(frozen=True, slots=True, eq=False)
class _Attempt:
    """A body being followed to derive a fact: so many of its steps have succeeded, for these objects."""

    fact: Fluent
    body: Body
    chosen: Environment
    position: int = 0
    truth: Truth = True
    """Unknown as soon as one step is."""

    @property
    def succeeded(self) -> bool:
        """Whether all steps have succeeded, as far as is known."""
        return self.position == len(self.body.steps)

    def on(self, chosen: Environment, truth: Truth = True) -> _Attempt:
        """Return the attempt after one more step."""
        return _Attempt(self.fact, self.body, chosen, self.position + 1, self.truth if truth is True else truth)


class DerivedFacts:
    """The facts that follow from recorded ones: a state that answers for both.

    The mutable state is what is remembered: for every derived name the truth of its facts, the attempt that
    showed a fact to be true, and what a fact waits for that is unknown; for every recorded name its facts by
    some of their terms.

    Args:
        rules: what derives facts.
        recorded: the recorded facts; whoever changes them calls `forget`.
        objects: gives the objects of any of some types; these do not change.
    """

    def __init__(
        self, rules: Rules, recorded: Mapping[Fluent, Value | Unknown], objects: Callable[[tuple[str, ...]], tuple[str, ...]]
    ) -> None:
        self.rules = rules
        self.objects = objects
        self._recorded = recorded
        self._members: dict[tuple[str, ...], frozenset[str]] = {}
        self._truth: dict[str, dict[Fluent, Truth]] = {name: {} for name in rules.derived}
        self._proofs: dict[str, dict[Fluent, _Attempt]] = {name: {} for name in rules.derived}
        self._undecided: dict[str, dict[Fluent, frozenset[Fluent]]] = {name: {} for name in rules.derived}
        self._tables: dict[str, dict[tuple[int, tuple[int, ...]], dict[Fluent, list[Fluent]]]] = {}

    def forget(self, names: Iterable[str]) -> None:
        """Note that recorded facts of these names have changed."""
        for name in names:
            self._tables.pop(name, None)
            for one in self.rules.above.get(name, ()):
                self._truth[one].clear()
                self._proofs[one].clear()
                self._undecided[one].clear()

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return the truth of a derived fact, or what is recorded for any other fluent."""
        known = self._truth.get(fluent[0])
        if known is None:
            return self._recorded.get(fluent)
        if fluent not in known:
            _Fixpoint(self, self.rules.strata[fluent[0]]).settle(fluent)
        return known[fluent]

    def remembered(self, fluent: Fluent) -> Truth | None:
        """Return the truth of a derived fact if it is settled."""
        return self._truth[fluent[0]].get(fluent)

    def remember(self, fluent: Fluent, truth: Truth, proof: _Attempt | None) -> None:
        """Note the truth of a derived fact, and what showed it if it is true."""
        self._truth[fluent[0]][fluent] = truth
        if proof:
            self._proofs[fluent[0]][fluent] = proof

    # --- why --------------------------------------------------------------------------------------

    def rests_on(self, fluent: Fluent) -> frozenset[Fluent]:
        """Return the unknown recorded fluents that decide whether a derived fact holds; none when that is known."""
        found: set[Fluent] = set()
        waiting = {fluent} if self.value(fluent) is UNKNOWN else set()
        while waiting:
            asked = waiting.pop()
            found.add(asked)
            if asked[0] in self.rules.derived:
                waiting |= self._waits_for(asked) - found
        return frozenset(one for one in found if one[0] not in self.rules.derived)

    def _waits_for(self, fluent: Fluent) -> frozenset[Fluent]:
        """Return the unknown fluents in what may still turn out to derive the fact."""
        remembered = self._undecided[fluent[0]]
        if fluent not in remembered:
            open_ = (one for one in self._ended(fluent) if one.succeeded and one.truth is UNKNOWN)
            parts = ((part, one.chosen) for one in open_ for part in one.body.parts if evaluate(part, self, one.chosen) is UNKNOWN)
            asked = (one for part, chosen in parts for one in fluents(part, self, chosen))
            remembered[fluent] = frozenset(one for one in asked if self.value(one) is UNKNOWN)
        return remembered[fluent]

    def because(self, fluent: Fluent) -> str:
        """Say why a derived fact has its truth, by what is recorded: "because of …", or "for want of …" if it is false."""
        truth = self.value(fluent)
        if truth is UNKNOWN:
            return _listed("because of", sorted(map(fluent_text, self.rests_on(fluent))))
        derived, seen, reasons = [fluent], {fluent}, dict[str, None]()
        for fact in derived:  # grows
            for part, chosen in self._grounds(fact):
                one = bind(part.fluent, chosen) if isinstance(part, Holds) else ()
                if one[:1] and one[0] in self.rules.derived:
                    derived += {one} - seen
                    seen.add(one)
                elif names(part):
                    reasons[str(ground(part, chosen))] = None
        # where the last possibility ended tells more than where the first did
        return _listed("because of", list(reasons)) if truth else _listed("for want of", list(reversed(reasons)))

    def _grounds(self, fluent: Fluent) -> Iterator[tuple[Condition, Environment]]:
        """Yield what shows the fact to be true, or what stopped every attempt to."""
        if fluent in self._proofs[fluent[0]]:
            proof = self._proofs[fluent[0]][fluent]
            yield from ((part, proof.chosen) for part in proof.body.parts)
            return
        for attempt in self._ended(fluent):
            step = attempt.body.steps[attempt.position]
            if not isinstance(step, ChooseObject):
                yield step.condition, attempt.chosen

    def _ended(self, fluent: Fluent) -> Iterator[_Attempt]:
        """Yield all attempts to derive the fact, as far as they go now that all is settled."""
        waiting = list(reversed(self.attempts(fluent)))
        while waiting:
            attempt = waiting.pop()
            further = [] if attempt.succeeded else self.further(attempt, self)
            if further:
                waiting += reversed(further)
            else:
                yield attempt

    # --- following bodies -------------------------------------------------------------------------

    def attempts(self, fluent: Fluent) -> list[_Attempt]:
        """Return an attempt to derive the fact for every body that is about it."""
        return [
            _Attempt(fluent, body, dict(zip((one.name for one in body.head), fluent[1:], strict=True)))
            for body in self.rules.bodies[fluent[0]]
            if len(body.head) == len(fluent) - 1 and all(map(self._is_one, fluent[1:], (one.types for one in body.head)))
        ]

    def further(self, attempt: _Attempt, state: State) -> list[_Attempt]:
        """Return the attempt after its next step, as often as there are ways to take it; none when it fails."""
        match attempt.body.steps[attempt.position]:
            case CheckCondition(condition):
                truth = evaluate(condition, state, attempt.chosen)
                return [] if truth is False else [attempt.on(attempt.chosen, truth)]
            case ChooseObject(variable):
                return [attempt.on({**attempt.chosen, variable.name: name}) for name in self.objects(variable.types)]
            case FindFact() as find:
                return [attempt.on(chosen, truth) for chosen, truth in self._found(find, attempt.chosen)]
            case other:
                assert_never(other)

    def _found(self, find: FindFact, env: Environment) -> Iterator[tuple[Environment, Truth]]:
        """Yield what each recorded fact like the one looked for makes of the new variables, and whether it is true."""
        pattern = bind(find.condition.fluent, env)
        for fact in self._table(pattern[0], len(pattern), find.known).get(tuple(pattern[one] for one in find.known), ()):
            inner = dict(env)
            if all(self._is_one(fact[at], new.types) and inner.setdefault(new.name, fact[at]) == fact[at] for at, new in find.new):
                yield inner, UNKNOWN if self._recorded[fact] is UNKNOWN else True

    def _table(self, name: str, length: int, known: tuple[int, ...]) -> dict[Fluent, list[Fluent]]:
        """Return the recorded facts of a name that are not false, by the terms at some positions."""
        tables = self._tables.setdefault(name, {})
        if (length, known) not in tables:
            table = tables[length, known] = {}
            for fact, value in self._recorded.items():
                if fact[0] == name and len(fact) == length and (value is UNKNOWN or value):
                    table.setdefault(tuple(fact[one] for one in known), []).append(fact)
        return tables[length, known]

    def _is_one(self, name: str, types: tuple[str, ...]) -> bool:
        if types not in self._members:
            self._members[types] = frozenset(self.objects(types))
        return name in self._members[types]


class _Fixpoint:
    """The facts of one stratum that bear on a question: false until shown to be more.

    The mutable state is what the constructor sets besides `objects`.
    """

    def __init__(self, all: DerivedFacts, stratum: int) -> None:
        self.objects = all.objects
        self._all = all
        self._stratum = stratum
        self._truth: dict[Fluent, Truth] = {}
        self._proofs: dict[Fluent, _Attempt] = {}
        self._agenda: list[_Attempt] = []
        self._askers: dict[Fluent, dict[_Attempt, None]] = {}
        """For every fact the attempts to be made again when it becomes more than it is."""
        self._passed: dict[_Attempt, Truth] = {}
        """How the next step of an attempt went, if it went on."""
        self._asking: _Attempt

    def settle(self, question: Fluent) -> None:
        """Answer the question and all that it depends on."""
        self._open(question)
        while self._agenda:
            attempt = self._agenda.pop()
            if self._truth[attempt.fact] is True:
                continue
            if attempt.succeeded:
                self._show(attempt)
                continue
            self._asking = attempt
            further = self._all.further(attempt, self)
            if further and further[0].truth is not self._passed.get(attempt):
                self._passed[attempt] = further[0].truth
                self._agenda += further
        for fact, truth in self._truth.items():
            self._all.remember(fact, truth, self._proofs.get(fact))

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return what the fact is so far taken for, if it is of this stratum, and note who asked."""
        if self._all.rules.strata.get(fluent[0]) != self._stratum:
            return self._all.value(fluent)
        settled = self._all.remembered(fluent)
        if settled is not None:
            return settled
        if fluent not in self._truth:
            self._open(fluent)
        if self._truth[fluent] is not True:
            self._askers[fluent][self._asking] = None
        return self._truth[fluent]

    def _open(self, fluent: Fluent) -> None:
        self._truth[fluent] = False
        self._askers[fluent] = {}
        self._agenda += self._all.attempts(fluent)

    def _show(self, attempt: _Attempt) -> None:
        fact = attempt.fact
        if attempt.truth is not self._truth[fact]:
            self._truth[fact] = attempt.truth
            self._agenda += self._askers[fact]
            self._askers[fact] = {}
            if attempt.truth is True:
                self._proofs[fact] = attempt


def _listed(how: str, reasons: list[str]) -> str:
    if not reasons:
        return ""
    more = f" and {len(reasons) - LISTED} more" if len(reasons) > LISTED else ""
    return f"{how} {', '.join(reasons[:LISTED])}{more}"
