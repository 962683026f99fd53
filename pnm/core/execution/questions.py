"""Evaluation context of guards and requests: knowledge, arguments of the call, answers from outside; and operations on knowledge.

A question is asked once per decision, however often its answer is looked at: `Questions` keeps the answers until the
token leaves the place at which it is being decided.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, Generic, NamedTuple, TypeVar
from uuid import UUID

from pnm.core.execution.events import Ask, Command, Performed, Store, Withdraw
from pnm.core.kept_state import KeptState
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import (
    CHANGING,
    MISSING,
    Data,
    KnowledgeOperation,
    Layer,
    Operation,
    Query,
    Question,
    Unanswered,
    Uncomputable,
    Update,
    compute,
    question_of,
    variable_name,
)
from pnm.core.logic.expressions import NOTHING, Environment, Fluent, Unknown, Value
from pnm.core.machine.bindings import DEFAULT, Binding, open_parameters
from pnm.core.machine.plan_graph import GroundAction, PlanGraph
from pnm.core.machine.requests import Ended, Outcome, OutcomeKind

Place = TypeVar("Place", bound=Hashable)
_NO_ACTION = GroundAction("")
_NO_ANSWERS: Final[Mapping[Question, object]] = {}


@dataclass(frozen=True)
class EvaluationContext:
    """Context in which conditions, goal fields and operations are evaluated.

    Asking for what is not known here raises `Unanswered` as long as the question is not among the answers.
    """

    knowledge: Layered
    action: GroundAction = _NO_ACTION
    """The one that the decision is about."""
    binding: Binding = DEFAULT
    answers: Mapping[Question, object] = field(default_factory=dict)
    asks: bool = False
    """Whether questions can be asked outside."""

    @property
    def world(self) -> KnowledgeBase:
        """Knowledge that all runs share."""
        return self.knowledge.world

    _known: list[tuple[tuple[int, int], Environment]] = field(default_factory=list, init=False, repr=False, compare=False)
    """The environment of before, and the version of the knowledge that it is of."""

    ready: list[tuple[GroundAction, Environment, GroundAction]] = field(default_factory=list, init=False, repr=False, compare=False)
    """An action, the environment, and the action as it was made ready last."""

    @cached_property
    def _open(self) -> tuple[str, ...]:
        return open_parameters(self.action)

    @cached_property
    def _given(self) -> Mapping[str, Data]:
        return dict(self.action.given)

    @cached_property
    def _arguments(self) -> Mapping[str, str]:
        return dict(zip(self.action.parameters, self.action.arguments, strict=True))

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return the value of the fluent in the world."""
        return self.knowledge.value(fluent)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        """Return the objects of any of the types."""
        return self.knowledge.objects(types)

    def because(self, fluent: Fluent, /) -> str:
        """Return why a derived fact holds or does not, as text."""
        return self.knowledge.because(fluent)

    def local_variable(self, name: str, /) -> object:
        """Return a variable of the run, or `MISSING`."""
        return self.knowledge.local.variable(name)

    def variable(self, name: str, /) -> object:
        """Return a variable of the run or, if it has none, of what all runs share in memory; or `MISSING`."""
        return self.knowledge.variable(name)

    def answer(self, question: Question, /) -> object:
        """Return the source of the answer: the shared knowledge in memory, or the outside."""
        # All layers but people have the same answer outside, so one question serves local and global lookups alike.
        if question.layer is not Layer.PERSON:
            question = Question(question.name, Layer.GLOBAL, question.meta)
            if (known := self.world.variable(question.name)) is not MISSING:
                return known
        if not self.asks:  # not the same as an answer that is still to come: with nobody to ask, the variable is missing for good
            return MISSING
        if question not in self.answers:
            raise Unanswered(question)
        return self.answers[question]

    def find(self, name: str, /) -> object:
        """Return a variable that is needed: local, global, or asked for if the binding has a question for it; or `MISSING`."""
        known = self.variable(name)
        if known is MISSING:
            known = self.answer(Question(name, Layer.GLOBAL, "null"))
        if known is MISSING and name in self.binding.ask:
            words = self.binding.ask[name]
            for parameter, value in self._arguments.items():
                words = words.replace(f"{{{parameter}}}", value)
            known = self.answer(Question(name, Layer.PERSON, json.dumps(words)))
        return known

    def parameter(self, name: str, /) -> object:
        """Return the value that the call gives a parameter of its action, named with ``?``; or `MISSING`."""
        bare = name.removeprefix("?")
        if bare in self._given:
            return compute(self._given[bare], self)
        argument = self._arguments.get(bare, name)
        return self.find(bare) if argument.startswith("?") else argument

    def given(self) -> dict[str, object]:
        """Return the values that the plan gives to goal fields, or leaves open for knowledge to fill, as far as there are any."""
        values: dict[str, object] = {name.removeprefix("?"): value for name, value in self.environment().items()}
        values |= {name: value for name in self._given if (value := self._parameter(name)) is not MISSING}
        return values

    def environment(self) -> Environment:
        """Return the knowledge for the parameters that the plan leaves open: the same one until knowledge changes."""
        if not self._open:
            return NOTHING
        version = self.knowledge.version
        if not self._known or self._known[0][0] != version:
            values = {f"?{name}": self._parameter(name) for name in self._open}
            self._known[:] = [(version, {name: value for name, value in values.items() if value is not MISSING})]
        return self._known[0][1]

    def uncomputable(self, names: Iterable[str], /) -> Iterator[str]:
        """Yield why the value that the plan gives one of these parameters, named without ``?``, cannot be computed."""
        for name in self._given.keys() & {*names}:
            try:
                compute(self._given[name], self)
            except Uncomputable as error:
                yield str(error)

    def _parameter(self, name: str) -> object:
        """Return the value of a parameter, without ``?``; what cannot be computed is missing."""
        try:
            return self.parameter(f"?{name}")
        except Uncomputable:
            return MISSING


LIMITS: Final = {layer: 3600.0 if layer is Layer.PERSON else 600.0 for layer in Layer}
"""Seconds that a run waits for an answer, whatever its source does; sources have shorter limits of their own."""


def subject_of(plan: PlanGraph, call: int | None) -> str:
    """Return for whose sake a question is asked: the action as the plan has it."""
    return "" if call is None or call >= len(plan.calls) else str(plan.calls[call].action)


class Need(NamedTuple):
    """The treatment of a question: commands, and the limit of its answer, or the present when that is over."""

    commands: tuple[Command, ...] = ()
    until: float | None = None


class Questions(KeptState, Generic[Place]):
    """The questions that a run has asked outside, and their answers.

    Answers of people to a run are known to the one that succeeds it, once for every call of the same action that asks the
    same; knowledge bases are asked again, for what they know may have changed, and no person is troubled by that.

    Places are known by number or by name. The mutable state is what the constructor sets.
    """

    KEPT = ("_subjects", "noted", "_answers", "_silence", "asked", "_closed", "count", "_inherited", "_open")

    def __init__(self) -> None:
        self._subjects: dict[Place, str] = {}
        """By place, what questions are asked for there."""
        self.noted: set[Place] = set()
        """The places about which something is remembered; what guards remember of them is noted here as well."""
        self._answers: dict[Place, dict[Question, object]] = {}
        self._silence: dict[Place, list[str]] = {}
        self.asked: dict[UUID, tuple[Place, Question, float]] = {}
        """Questions that are open: the place and the question, and until when an answer is waited for."""
        self._closed = ""
        """Why no question is asked any more."""
        self.count = 0
        """The number of questions that the run has asked itself."""
        self._inherited: list[tuple[str, Question, object]] = []
        """Answers that the run before had and has not used."""
        self._open: dict[UUID, tuple[str, Question]] = {}
        """Questions that the run before has asked, and this one has not come to yet."""

    def answers_at(self, place: Place | None) -> Mapping[Question, object] | None:
        """Return the knowledge for the decision at a place; None without a place."""
        return None if place is None else self._answers.get(place, _NO_ANSWERS)

    @property
    def wait_for_people(self) -> bool:
        """Whether a person has been asked and has not answered yet."""
        return any(question.layer is Layer.PERSON for _, question, _ in self.asked.values())

    def need(self, place: Place, subject: str, question: Question, now: float, identity: Callable[[str], UUID]) -> Need:
        """Return the treatment of a question that the decision at a place depends on, for the sake of the subject.

        It is asked once. When its limit has passed it counts as answered with nothing, whatever its source does; and at once if the run
        asks no more.
        """
        for known, (where, asked, until) in self.asked.items():
            if (where, asked) == (place, question):
                if now < until:
                    return Need((), until)
                self.answered(known, MISSING, f"{question} was not answered within {LIMITS[question.layer]:g} s")
                return Need((Withdraw(known),))
        self._subjects[place] = subject
        self.noted.add(place)
        # The run before may have asked the same person the same: that answer, or the open question, is used instead.
        if self._take_up(place, subject, question, now):
            return Need()
        self.count += 1
        new, until = identity(f"question {self.count}"), now + LIMITS[question.layer]
        self.asked[new] = (place, question, until)
        if self._closed:
            self.answered(new, MISSING, self._closed)
            return Need()
        return Need((Ask(new, question),), until)

    def again(self) -> tuple[Ask, ...]:
        """Return the open questions, to be asked in another process."""
        asked = {identity: question for identity, (_, question, _) in self.asked.items()}
        inherited = {identity: question for identity, (_, question) in self._open.items()}
        return tuple(Ask(identity, question) for identity, question in (asked | inherited).items())

    def close(self, why: str) -> tuple[Withdraw, ...]:
        """Ask nothing any more, for that reason; what is asked counts as answered with nothing, and is withdrawn."""
        self._closed = why
        asked = tuple(self.asked)
        for identity in asked:
            self.answered(identity, MISSING, why)
        return tuple(map(Withdraw, asked))

    def silence_at(self, place: Place | None) -> Sequence[str]:
        """Return why questions for the decision at a place have no answers."""
        return () if place is None else self._silence.get(place, ())

    def answered(self, identity: UUID, value: object, message: str) -> Place | None:
        """Record an answer, or why there is none; return the place that waits for it, if any still does."""
        if identity in self._open:  # the run before has asked; this run may come to the same question later, so the answer is kept for it
            self._keep(*self._open.pop(identity), value)
        place, question, _ = self.asked.pop(identity, (None, None, 0.0))
        if place is not None and question is not None:
            self._answers.setdefault(place, {})[question] = value
            if message:
                self._silence.setdefault(place, []).append(message)
        return place

    def left(self, place: Place) -> Iterator[UUID]:
        """Forget all that concerns the place; yield the questions whose answers are no longer needed."""
        self._answers.pop(place, None)
        self._silence.pop(place, None)
        if not self.asked:
            return
        # Answers that come later find no place, and are ignored.
        for identity in [question for question, (where, *_) in self.asked.items() if where == place]:
            del self.asked[identity]
            yield identity

    # --- from one run to the next ---------------------------------------------------------------

    def inherit(self, old: Questions[Place], subjects: frozenset[str]) -> frozenset[UUID]:
        """Take over the answers of people for the sake of these subjects; return the questions that they are still being asked."""
        given = [(old._subjects[place], *answer) for place, answers in old._answers.items() for answer in answers.items()]
        for subject, question, value in (*given, *old._inherited):
            if subject in subjects:
                self._keep(subject, question, value)
        asked = {identity: (old._subjects[place], question) for identity, (place, question, _) in old.asked.items()}
        for identity, (subject, question) in {**old._open, **asked}.items():
            if subject in subjects and question.layer is Layer.PERSON:
                self._open[identity] = subject, question
        return frozenset(self._open)

    def _take_up(self, place: Place, subject: str, question: Question, now: float) -> bool:
        """Return whether the run before has asked the question; if so, its answer, or the open question, is taken over for the place."""
        # Each inherited answer is used once: the second call of an action asks again, as it would have without the change of runs.
        for number, (its, known, value) in enumerate(self._inherited):
            if (its, known) == (subject, question):
                del self._inherited[number]
                self._answers.setdefault(place, {})[question] = value
                return True
        for identity, asked in self._open.items():
            if asked == (subject, question):
                del self._open[identity]
                self.asked[identity] = (place, question, now + LIMITS[question.layer])
                return True
        return False

    def _keep(self, subject: str, question: Question, value: object) -> None:
        if question.layer is Layer.PERSON and value is not MISSING:
            self._inherited.append((subject, question, value))


# --- operations on knowledge ---


def unknown_values(operation: KnowledgeOperation, context: EvaluationContext) -> tuple[str, ...]:
    """Return the variables without a value that an update copies; raises `Unanswered` if the operation depends on a question."""
    try:
        match operation:
            case Update(name, data, _, meta):
                variable_name(name, context)
                compute(meta, context)
                if compute(data, context) is not MISSING:
                    return ()
                return (question_of(data, context).name,) if isinstance(data, Query) else (str(data).removeprefix("?"),)
            case _:
                compute(operation, context)
                return ()
    except Uncomputable:
        return ()  # the operation itself will report that


def carry_out(identity: UUID, operation: KnowledgeOperation, context: EvaluationContext) -> Performed:
    """Carry out an operation on knowledge; what is stored outside is a command, everything else is over at once."""
    try:
        match operation:
            case Update(name, data, layer, meta):
                value = compute(data, context)
                return _store(identity, question_of(Query(name, layer, meta), context), None if value is MISSING else value, context)
            case Operation(name, (Query() as changed, *_)) if name in CHANGING:
                return _store(identity, question_of(changed, context), compute(operation, context), context)
            case _:
                compute(operation, context)
                return _ended(identity)
    except Uncomputable as error:
        return Performed(reports=(Ended(identity, Outcome(OutcomeKind.ABORTED, message=str(error))),))


def _store(identity: UUID, question: Question, value: object, context: EvaluationContext) -> Performed:
    knowledge = context.knowledge
    if question.layer in (Layer.LOCAL, Layer.ALL):  # before anything outside is stored, so that the run itself can rely on it at once
        knowledge.local.store({question.name: value})
    if question.layer is Layer.LOCAL:
        return _ended(identity, changes_knowledge=True)
    if context.asks:
        outside = replace(question, layer=Layer.GLOBAL if question.layer is Layer.ALL else question.layer)
        return Performed((Store(identity, outside, value),), changes_knowledge=True)
    if question.layer is Layer.PERSON:
        raise Uncomputable(f"there is nobody to be told {value!r}")
    knowledge.world.store({question.name: value})
    return _ended(identity, changes_knowledge=True)


def _ended(identity: UUID, *, changes_knowledge: bool = False) -> Performed:
    return Performed((), (Ended(identity, Outcome(OutcomeKind.SUCCEEDED)),), changes_knowledge)
