"""What a PDDL file says it needs, and what is used in it without being said (PDDL 3.1, HDDL)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Final

from planner_bridge.pddl.syntax.expressions import Atom, Node, tolerate, wrong
from planner_bridge.pddl.syntax.words import new_name

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
        *(":time", ":contingent", ":non-deterministic", ":probabilistic-effects", ":rewards", ":multi-agent"),
        *(":hierarchy", ":method-preconditions", ":htn", ":htn-method-prec"),
    )
)


class Requirements:
    """What may be used in a file; the mutable state is what has been used without permission, which is told once."""

    def __init__(self, words: Iterable[str]) -> None:
        self._allowed = {needed for word in words for needed in (word, *_IMPLIED.get(word, ()))}

    def need(self, node: Node, word: str, *others: str) -> None:
        """Note that this part needs the requirement; one of the others would do as well."""
        if word not in self._allowed and self._allowed.isdisjoint(others):
            self._allowed.add(word)
            tolerate(node, f"{word} is needed here but not among the :requirements")


def requirements(parts: Iterable[Node]) -> tuple[str, ...]:
    """Read requirements, each with its colon and in lower case; unknown ones are kept."""
    found: list[str] = []
    for part in parts:
        if not isinstance(part, Atom):
            raise wrong(part, f"expected a requirement such as :typing, found {part}")
        word = ":" + new_name(Atom(part.key.lstrip(":") or ":", part.offset, part.source), "requirement")
        if part.text[0] != ":":
            tolerate(part, f"{part} is read as '{word}'")
        if word not in _KNOWN:
            tolerate(part, f"unknown requirement '{word}'")
        found.append(word)
    return tuple(dict.fromkeys(found))
