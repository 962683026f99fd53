"""The PDDL that is read, and its structure before anything in it is interpreted: sections, keyed lists and typed lists."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final, Literal

from planner_bridge.pddl.expressions import Atom, Group, Node, new_name, normalized, parse, tolerate, where, wrong
from pnm.errors import InputError, Position, suggestion

# --- requirements ---------------------------------------------------------------------------------
# The PDDL that the reader accepts (PDDL 3.1, HDDL): requirements, refused constructs, and tolerated mistakes.
# Everything that is refused as a construct is a member of `Refused`, everything that is read with a warning one of
# `Leniency`, each with its text. To accept a new construct, read it where `Refused.….at` is raised, and delete it here.
# (The two slips of parentheses and spaces that the parser tolerates are in `planner_bridge.pddl.expressions`.)


_CONTINGENT: Final = "a contingent planner, which unified-planning lacks,"


class Refused(Enum):
    """A construct of PDDL that is not supported: its name, and what would be needed to support it."""

    CONTINUOUS_EFFECT = "continuous effects (#t) outside a process", "a process (:process) in their place"
    DURATION_AT_END = "durations that are decided at the end", "a bound that is only known when the action ends"
    CONDITIONAL_OVER_ALL = "conditional effects on a condition 'over all'", "a watch over what is not required"
    SENSING_ACTION = "sensing actions (:observe)", _CONTINGENT
    UNKNOWN = "uncertain facts (unknown)", _CONTINGENT
    OUTCOMES_AT_START = "outcomes at the start of a durative action", "a request whose robot says how it has begun"
    OR_IN_INIT = "uncertain initial states (or in :init)", _CONTINGENT
    ONEOF_IN_INIT = "uncertain initial states (oneof in :init)", _CONTINGENT
    UNKNOWN_IN_INIT = "uncertain initial states (unknown in :init)", _CONTINGENT

    def at(self, node: Node) -> InputError:
        """Return the error for this construct where the node stands."""
        construct, needed = self.value
        return wrong(node, f"{construct} are not supported yet; {needed} would be needed")


REFUSED_SECTIONS: Final[Mapping[str, Refused]] = {":observe": Refused.SENSING_ACTION}
REFUSED_HEADS: Final[Mapping[str, Refused]] = {"unknown": Refused.UNKNOWN}
"""In the place of a predicate or function."""
REFUSED_IN_INIT: Final[Mapping[str, Refused]] = {
    "or": Refused.OR_IN_INIT,
    "oneof": Refused.ONEOF_IN_INIT,
    "unknown": Refused.UNKNOWN_IN_INIT,
}
"""In the initial state, where no predicate has that name."""


class Leniency(Enum):
    """Something that is not as it should be but can be understood: the text of its warning, with places for details."""

    # requirements and sections
    MISSING_REQUIREMENT = "{} is needed here but not among the :requirements"
    REQUIREMENT_WITHOUT_COLON = "{} is read as '{}'"
    UNKNOWN_REQUIREMENT = "unknown requirement '{}'"
    SECOND_SECTION = "a second {} section, read as part of the first in line {}"
    OTHER_DOMAIN = "the problem is for a domain {}; this one is {!r}"
    NO_DOMAIN = "the problem does not name its domain; expected (:domain {})"
    LENGTH = "':length' is ignored"
    NO_GOAL = "there is no :goal; any state will do"
    SEVERAL_CONSTRAINTS = "several constraints without 'and' around them; all of them count"

    # declarations
    TYPE_WITHOUT_NAMES = "there is no name before the type {}; it is ignored"
    TYPE_TWICE = "the type {} is declared twice; it is of all the kinds given"
    OBJECT_TWICE = "the object {!r} is declared twice{}"
    SYMBOL_TWICE = "the {} {!r} is declared twice, the first time in line {}; it takes the types of both"
    VARIABLE_TWICE = "the variable {} is there twice"
    DERIVED_UNDECLARED = "the predicate {!r} is derived here but not among the :predicates"

    # actions and what they change
    ACTION_TWICE = "the action {!r} is declared twice, the first time in line {}; this one is called {!r}"
    ADDED_AND_DELETED = "the outcome {} of {} both deletes and adds {}, so it is true after it"

    # rewards
    GOAL_REWARD = "':goal-reward' is ignored: every plan reaches the goal"
    REWARD = "rewards are ignored: {}"

    # names
    OBJECT_OF_PROBLEMS = "the object {} is not among the :constants; every problem has to declare it"
    OTHER_SPELLING = "the {} {} is read as {!r}"
    TOTAL_COST_UNDECLARED = "the function {} is not declared; it is read as (total-cost) - number"
    PREDICATE_UNDECLARED = "the predicate {} is not declared; it is read as false"

    # actions
    MOMENT_INSIDE = "{} is expected inside ({} ...)"
    DURATION_SECOND = "?duration is expected first"
    VARS = "the variables of :vars are read as further parameters"

    # initial state
    FACT_UNDECLARED = "the predicate {} is not declared; the fact is ignored"
    FACT_ARITY = "{} takes {}, found {}; the fact is ignored"
    ASSIGN_IN_INIT = "'{}' is read as '='"
    VALUE_UNDECLARED = "the function {} is not declared; its value is ignored"
    VALUE_TWICE = "{} has another value before; this one is used"
    NUMBER_MISSING = "{} has no value at first; actions that need it cannot be applied"
    FACT_TWICE = "{} is there twice"

    def note(self, node: Node, *details: object) -> None:
        """Add the warning about the node to those of its file."""
        tolerate(node, self.value.format(*details))


_QUANTIFIED: Final = (":existential-preconditions", ":universal-preconditions")
_FLUENTS: Final = (":numeric-fluents", ":object-fluents")
_IMPLIED: Final[Mapping[str, tuple[str, ...]]] = {
    ":quantified-preconditions": _QUANTIFIED,
    ":fluents": _FLUENTS,
    ":timed-initial-literals": (":durative-actions",),
    ":domain-axioms": (":derived-predicates",),
    ":adl": (
        *(":strips", ":typing", ":negative-preconditions", ":disjunctive-preconditions", ":equality"),
        *(":quantified-preconditions", ":conditional-effects", *_QUANTIFIED),
    ),
}
_KNOWN: Final = frozenset(
    (
        *(*_IMPLIED, *_FLUENTS, *_IMPLIED[":adl"], ":durative-actions", ":duration-inequalities", ":continuous-effects"),
        *(":derived-predicates", ":timed-initial-fluents", ":preferences", ":constraints", ":action-costs", ":goal-utilities"),
        *(":time", ":processes", ":events", ":contingent", ":non-deterministic", ":probabilistic-effects", ":rewards", ":multi-agent"),
        *(":hierarchy", ":method-preconditions", ":htn", ":htn-method-prec"),
    )
)


class Requirements:
    """The requirements of a file. The mutable state is those that are missing, each of which is reported once."""

    def __init__(self, words: Iterable[str]) -> None:
        self._allowed = {needed for word in words for needed in (word, *_IMPLIED.get(word, ()))}

    def need(self, node: Node, word: str, *others: str) -> None:
        """Note that this part needs the requirement; one of the others would do as well."""
        if word not in self._allowed and self._allowed.isdisjoint(others):
            self._allowed.add(word)
            Leniency.MISSING_REQUIREMENT.note(node, word)


def requirements(parts: Iterable[Node]) -> tuple[str, ...]:
    """Read requirements, each with its colon and in lower case; unknown ones are kept."""
    words: list[str] = []
    for part in parts:
        if not isinstance(part, Atom):
            raise wrong(part, f"expected a requirement such as :typing, found {part}")
        word = ":" + new_name(Atom(part.key.lstrip(":") or ":", part.offset, part.source), "requirement")
        if part.text[0] != ":":
            Leniency.REQUIREMENT_WITHOUT_COLON.note(part, part, word)
        if word not in _KNOWN:
            Leniency.UNKNOWN_REQUIREMENT.note(part, word)
        words.append(word)
    return tuple(dict.fromkeys(words))


# --- sections -------------------------------------------------------------------------------------


_REPEATABLE: Final = (":action", ":durative-action", ":process", ":event", ":derived", ":task", ":method")
"""Sections that a file may have several times."""
_YAML: Final = re.compile(r"(?:\s|#.*\n|---\s*\n)*[\w-]+:(?:\s|$)")


@dataclass(frozen=True, slots=True)
class Definition:
    """``(define (domain NAME) SECTION ...)``, or a problem, cut into its sections."""

    name: str
    whole: Group
    sections: tuple[Group, ...]

    def every(self, *keys: str) -> list[Group]:
        """Return the sections of these names in the order of the file."""
        return [section for section in self.sections if section.head in keys]

    def lists(self, key: str) -> list[tuple[Node, ...]]:
        """Return the contents of each section of the name."""
        return [section.rest for section in self.every(key)]

    def parts(self, key: str) -> tuple[Node, ...]:
        """Return the contents of the sections of the name, joined."""
        return tuple([part for parts in self.lists(key) for part in parts])

    def one(self, key: str) -> Group | None:
        """Return the section, if there is one; a second one is refused unless it has the same words."""
        sections = self.every(key)
        for other in sections[1:]:
            if normalized(other) != normalized(sections[0]):
                raise wrong(other, f"a second {key} section; the first is in line {where(sections[0]).line}")
        return sections[0] if sections else None


def define(text: str, file: str, kind: Literal["domain", "problem"], known: tuple[str, ...]) -> Definition:
    """Read a definition; all its sections must be known ones."""
    form = f"(define ({kind} NAME) ...)"
    match parse(text, file):
        case ():
            raise InputError(f"the file is empty; expected {form}", Position(file, 1, 1))
        case (Group() as whole,) if whole.head == "define":
            pass
        case (Group() as whole, extra, *_) if whole.head == "define":
            raise wrong(extra, f"expected the end of the file after {form}, found {extra}")
        case (Group(items=(Atom() as word, *_)), *_):
            raise wrong(word, f"expected 'define', found {word}")
        case (first, *_):
            hint = "; this is YAML: `pnm import` writes a domain in YAML as PDDL" if _YAML.match(text) else ""
            raise wrong(first, f"expected {form}, found {first}{hint}")
    match whole.rest:
        case (Group(items=(_, name)) as head, *sections) if head.head == kind:
            return Definition(new_name(name, kind), whole, _sections(sections, known))
        case (other, *_):
            misplaced = isinstance(other, Group) and other.head in {"domain", "problem"} - {kind}
            hint = f"; this file is not a {kind}: the domain comes first, then the problem" if misplaced else ""
            raise wrong(other, f"expected ({kind} NAME), found {other}{hint}")
        case _:
            raise wrong(whole, f"expected {form}, found {whole}")


def _sections(nodes: list[Node], known: tuple[str, ...]) -> tuple[Group, ...]:
    sections: list[Group] = []
    for node in nodes:
        if not isinstance(node, Group) or not node.head.startswith(":"):
            raise wrong(node, f"expected a section such as ({known[1]} ...), found {node}")
        if node.head not in known:
            raise _unknown(node.items[0], "section", known)
        sections.append(node)
    first: dict[str, Group] = {}
    for section in sections:
        if first.setdefault(section.head, section) is not section and section.head not in _REPEATABLE:
            Leniency.SECOND_SECTION.note(section, section.head, where(first[section.head]).line)
    return tuple(sections)


def keyed(items: tuple[Node, ...], place: str, known: tuple[str, ...]) -> dict[str, Node]:
    """Read ``:key value :key value``, each key a known one and there once."""
    values: dict[str, Node] = {}
    rest = iter(items)
    for key in rest:
        if not isinstance(key, Atom) or key.text[0] != ":":
            raise wrong(key, f"expected one of {', '.join(known)}; found {key}")
        if key.key not in known:
            raise _unknown(key, "key", known, f" in {place}")
        if key.key in values:
            raise wrong(key, f"a second {key.key}; expected one")
        value = next(rest, None)
        if value is None or (isinstance(value, Atom) and value.text[0] == ":"):
            raise wrong(key, f"expected a value after {key}, found {value or 'nothing'}")
        values[key.key] = value
    return values


def _unknown(key: Node, kind: str, known: Collection[str], place: str = "") -> InputError:
    word = key.key if isinstance(key, Atom) else ""
    if word in REFUSED_SECTIONS:
        return REFUSED_SECTIONS[word].at(key)
    hint = suggestion(word, known) or f"expected one of {', '.join(known)}"
    return wrong(key, f"unknown {kind} {key}{place}; {hint}")


def typed_runs(items: Sequence[Node]) -> Iterator[tuple[list[Node], Node | None]]:
    """Split ``a b - t c`` into ``([a, b], t)`` and ``([c], None)``; ``-t`` without a space is read too."""
    names: list[Node] = []
    rest = iter(items)
    for item in rest:
        match item:
            case Atom("-"):
                types = next(rest, None)
                if types is None:
                    raise wrong(item, "expected a type after '-', found nothing")
            case Atom(text, offset, source) if text[0] == "-":
                types = Atom(text[1:], offset + 1, source)
            case _:
                names.append(item)
                continue
        if names:
            yield names, types
        else:
            Leniency.TYPE_WITHOUT_NAMES.note(item, types)
        names = []
    if names:
        yield names, None


def type_words(node: Node) -> tuple[Atom, ...]:
    """Return the words of ``t`` or ``(either t u)``."""
    nodes = node.rest if isinstance(node, Group) and node.head == "either" and node.rest else (node,)
    words = tuple(word for word in nodes if isinstance(word, Atom))
    if len(words) < len(nodes):
        raise wrong(node, f"expected a type or (either TYPE ...), found {node}")
    return words
