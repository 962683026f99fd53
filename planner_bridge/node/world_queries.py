"""Queries and updates of facts as PDDL texts; goals, and the domain and the problem of the current state.

A text that is wrong is refused with the line and column in it, and the nearest word.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Final

from planner_bridge.model.grounding import problem_now, with_found
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import write_domain, write_problem
from planner_bridge.pddl.expressions import Group, Node, number_text, operands, parse, where, wrong
from planner_bridge.pddl.formulas import TermScope, condition
from planner_bridge.pddl.sections import Requirements
from planner_bridge.pddl.symbols import SymbolTable
from pnm.core.knowledge_base import KnowledgeBase, statement_text
from pnm.core.logic.conditions import Condition, choices_in, evaluate
from pnm.core.logic.domain import MAX_CHOICES, check_choices
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, Fluent, State, Unknown, Value, fluent_text, same_value
from pnm.errors import InputError, Position, suggestion
from pnm.files.yaml_nodes import load_yaml

# --- a limit for answers --------------------------------------------------------------------------
# A limit for the time that the answers to questions about a state may take.


MAX_SECONDS: Final = 5.0
"""For the answers to all questions at once."""


@dataclass(frozen=True, slots=True)
class TimedState:
    """A state that can be asked until a time, on the monotonic clock."""

    state: State
    until: float

    @staticmethod
    def begin(state: State) -> TimedState:
        """Return a state that can be asked for `MAX_SECONDS` from now."""
        return TimedState(state, monotonic() + MAX_SECONDS)

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return the value of a fluent; raise an `InputError` if the time is over."""
        self.check()
        return self.state.value(fluent)

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        """Return the objects of any of the types."""
        return self.state.objects(types)

    def check(self) -> None:
        """Raise an `InputError` if the time is over."""
        if monotonic() > self.until:
            raise InputError(f"the answers have taken {MAX_SECONDS:g} s; expected fewer or simpler questions")


# --- queries and updates --------------------------------------------------------------------------


MAX_TEXTS: Final = 10_000
"""Questions or changes at once."""
MAX_LENGTH: Final = 100_000
"""Characters of a question, a change or a goal."""
MAX_CHARACTERS: Final = 1_000_000
"""Of all questions or changes at once."""
MAX_GOAL_CHOICES: Final = 10_000
"""Choices of objects that the quantifiers of a goal may range over: it is looked at whenever anything changes."""


@dataclass(frozen=True, slots=True)
class WantedChange:
    """A change of a fact as a client wants it."""

    node: Node
    """The position of this statement."""
    fluent: Fluent
    value: Value | Unknown
    is_removed: bool


class SharedWorld:
    """The facts of a problem's world, read and written as PDDL.

    The mutable state is the object values of functions that `changes` has seen last, and the names that objects had then.

    Args:
        elapsed: returns the seconds since the problem's initial state, by which timed facts of `problem_text` are earlier.
    """

    def __init__(
        self, problem: Problem, knowledge: KnowledgeBase, goals: Mapping[str, str] | None = None, elapsed: Callable[[], float] = lambda: 0.0
    ) -> None:
        self.problem = problem
        self._knowledge = knowledge
        self._elapsed = elapsed
        self._named: tuple[tuple[str, ...], TermScope] | None = None
        self._goals = {name: self._condition(text, f"goal {name}") for name, text in (goals or {}).items()}
        self._objects: dict[Fluent, str] = {}
        self.attend()

    def __repr__(self) -> str:
        return f"<SharedWorld {self.problem.name}: {self._knowledge!r}>"

    # --- questions and changes -------------------------------------------------------------------

    def query(self, questions: Sequence[str]) -> list[tuple[str, str]]:
        """Return each question with its answer: ``true``, ``false``, ``unknown``, a number or an object.

        A question is a condition or a function; ``undefined`` is the value of a function that has no object. Without
        questions, all recorded facts are returned.
        """
        _bounded(questions, "questions")
        if not questions:
            return [(fluent_text(fluent), _value_text(value)) for fluent, value in self._knowledge.facts().items()]
        state, answers = TimedState.begin(self._knowledge), []
        for index, text in enumerate(questions):
            node = _single(text, f"questions[{index}]")
            if (function := self._scope.symbols.find_function(node)) is None:
                value: Value | Unknown = evaluate(self._checked(node), state)
            else:
                known = state.value(self._scope.function(node))
                value = (UNDEFINED if function.values else UNKNOWN) if known is None else known
            answers.append((text, _value_text(value)))
            state.check()
        return answers

    def read_changes(self, add: Sequence[str] = (), remove: Sequence[str] = (), forget: Sequence[str] = ()) -> list[WantedChange]:
        """Read the facts to record: as true, as false, and as unknown.

        Functions are written with their value: ``(= (battery r1) 0.8)``; to remove ``(= (location r1) hall)`` changes
        nothing while the location is another one.

        Raises:
            InputError: a text is malformed, or a fact is derived.
        """
        _bounded((*add, *remove, *forget), "changes")
        wanted: list[WantedChange] = []
        for kind, texts, read in (("add", add, self._added), ("forget", forget, self._forgotten), ("remove", remove, self._removed)):
            for index, text in enumerate(texts):
                node = _single(text, f"{kind}[{index}]")
                fluent, value = read(node)
                wanted.append(WantedChange(node, fluent, value, kind == "remove"))
        return wanted

    def record(self, wanted: Iterable[WantedChange]) -> int:
        """Record changes; return how many facts changed. If they contradict each other or a sensor, record none, raise an `InputError`."""
        changes: dict[Fluent, Value | Unknown] = {}
        for change in wanted:
            fluent, value = change.fluent, change.value
            known = self._knowledge.value(fluent)
            if change.is_removed and isinstance(value, str):  # the object that the function no longer has
                if changes.get(fluent, known) != value:
                    continue
                value = UNDEFINED
            if self._knowledge.is_sensed(fluent) and known is not UNKNOWN and not same_value(known, value):
                what = statement_text(fluent, False if known is None else known)
                raise wrong(change.node, f"a sensor reports {what}; only facts without a sensor, and unknown ones, can be updated")
            if changes.setdefault(fluent, value) != value:
                raise wrong(change.node, f"another change contradicts this one about {fluent_text(fluent)}")
        return len(self._knowledge.update(changes))

    def over(self, knowledge: KnowledgeBase) -> SharedWorld:
        """Return the same world with other knowledge of it, such as a snapshot for another thread."""
        world = copy(self)
        world._knowledge = knowledge
        return world

    def attend(self) -> None:
        """Note the object values of all functions, which the next batch of `changes` is compared with."""
        self._objects = {
            fluent: value for fluent, value in self._knowledge.facts().items() if isinstance(value, str) and value != UNDEFINED
        }

    def changes(self, batch: Mapping[Fluent, Value | Unknown]) -> dict[str, object]:
        """Return a batch of changes as fields of a ``KnowledgeChange`` message; to be called with every batch, in order."""
        added: list[str] = []
        removed: list[str] = []
        unknown: list[str] = []
        numbers: dict[str, float] = {}
        for fluent, value in batch.items():
            before = self._objects.pop(fluent, UNDEFINED)
            if before not in (UNDEFINED, value) and value is not UNKNOWN:
                removed.append(statement_text(fluent, before))
            match value:
                case Unknown():
                    unknown.append(fluent_text(fluent))
                case bool():
                    (added if value else removed).append(fluent_text(fluent))
                case str():
                    if value != UNDEFINED:
                        self._objects[fluent] = value
                    if value != UNDEFINED or before == UNDEFINED:  # its value was unknown; now it is known to have none
                        added.append(statement_text(fluent, value))
                case _:
                    numbers[fluent_text(fluent)] = float(value)
        return {"added": added, "removed": removed, "unknown": unknown, "fluents": [*numbers], "values": [*numbers.values()]}

    # --- domain, problem and goals ---------------------------------------------------------------

    def domain_text(self) -> str:
        """Return the domain as PDDL."""
        return write_domain(self.problem.domain)

    def problem_text(self) -> str:
        """Return the problem with the current state as its initial state, as PDDL."""
        return write_problem(self.current_problem())

    def current_problem(self) -> Problem:
        """Return the problem with the current state as its initial state."""
        return problem_now(self.problem, self._knowledge, self._elapsed())

    def read_goal(self, text: str) -> Condition:
        """Return the goal of a text: a condition, the name of a goal, or nothing for the problem's; raise an `InputError` for another."""
        text = text.strip()
        if not text:
            return self.problem.goal
        if text in self._goals:
            return self._goals[text]
        if text[0] not in "(;":
            known = f"expected one of {', '.join(self._goals)}, or a condition" if self._goals else ""
            hint = suggestion(text, self._goals) or known or "expected a condition such as (at r1 kitchen)"
            raise InputError(f"there is no goal {text[:80]!r}; {hint}", Position("goal", 1, 1))
        return self._condition(text, "goal")

    # --- reading ---------------------------------------------------------------------------------

    @property
    def _scope(self) -> TermScope:
        """The names that texts may have: objects that were found have theirs."""
        there = self._knowledge.objects(("object",))
        if self._named is None or self._named[0] != there:
            domain, objects = self.problem.domain, with_found(self.problem, self._knowledge).objects
            symbols = SymbolTable(domain, objects, Requirements(domain.requirements), derived=domain.rules.derived)
            self._named = there, TermScope(symbols)
        return self._named[1]

    def _condition(self, text: str, origin: str) -> Condition:
        return self._checked(_single(text, origin), MAX_GOAL_CHOICES)

    def _checked(self, node: Node, limit: int = MAX_CHOICES) -> Condition:
        checked = condition(node, self._scope)
        check_choices(choices_in(checked, self.problem.count), where(node), limit=limit)
        return checked

    def _added(self, node: Node) -> tuple[Fluent, Value]:
        if not isinstance(node, Group) or node.head != "=":
            return self._fact(node), True
        target, value = operands(node, 2)
        return self._scope.assigned(target, value)

    def _removed(self, node: Node) -> tuple[Fluent, Value]:
        if not isinstance(node, Group) or node.head != "=":
            return self._fact(node), False
        fluent, value = self._added(node)
        if not isinstance(value, str):
            raise wrong(node, f"{fluent_text(fluent)} always has a number; expected it among the added or forgotten facts")
        return fluent, value

    def _forgotten(self, node: Node) -> tuple[Fluent, Unknown]:
        is_function = self._scope.symbols.find_function(node) is not None
        return self._scope.function(node) if is_function else self._fact(node), UNKNOWN

    def _fact(self, node: Node) -> Fluent:
        if self._scope.symbols.find_function(node) is not None:
            raise wrong(node, f"{node} is a function; expected it with its value, such as (= (battery r1) 0.8)")
        fluent = self._scope.fact(node)
        if fluent[0] in self._scope.symbols.derived:
            raise wrong(node, f"{fluent[0]!r} is a derived predicate; it follows from others and cannot be set")
        return fluent


def read_goals(path: Path) -> dict[str, str]:
    """Read a YAML file with the texts of goals by name, under ``goals``; raise an `InputError` if it is something else."""
    top = load_yaml(path)
    top.only("goals")
    node = top.node("goals")
    goals: dict[str, str] = {}
    for name, at, value in node.mapped().entries() if node is not None and not node.is_null else ():
        if not name or name[0] in "(;" or name != name.strip():
            raise InputError(f"{name!r} cannot name a goal; expected a word", at)
        if value.text is None:
            raise value.wrong(f"expected a condition as a text for {name}")
        goals[name] = value.text
    return goals


def _bounded(texts: Sequence[str], what: str) -> None:
    if len(texts) > MAX_TEXTS:
        raise InputError(f"{len(texts)} {what} at once; expected {MAX_TEXTS} at most")
    if (characters := sum(map(len, texts))) > MAX_CHARACTERS:
        raise InputError(f"{characters} characters at once; expected {MAX_CHARACTERS} at most")


def _single(text: str, origin: str) -> Node:
    start = Position(origin, 1, 1)
    if len(text) > MAX_LENGTH:
        raise InputError(f"{len(text)} characters; expected {MAX_LENGTH} at most", start)
    match parse(text, origin):
        case (Group() as node,):
            return node
        case (Group(), extra, *_):
            raise wrong(extra, f"expected the end of the text, found {extra}")
        case (word, *_):
            raise wrong(word, f"expected something in parentheses, such as (at r1 kitchen), found {word}")
        case _:
            raise InputError("the text is empty; expected something such as (at r1 kitchen)", start)


def _value_text(value: Value | Unknown) -> str:
    match value:
        case Unknown():
            return value.value
        case bool():
            return str(value).lower()
        case str():
            return value
        case _:
            return number_text(value)
