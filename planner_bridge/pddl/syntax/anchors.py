"""Anchors: the names by which comments refer to conditions, effects, facts and rules of a PDDL definition.

A form is named by its own words, in lower case and as the reader understands it: ``and`` and the time specifiers
of a durative action are looked through, so that a condition has the same name wherever a writer puts it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final

from planner_bridge.pddl.syntax.expressions import Atom, Node
from planner_bridge.pddl.syntax.pretty_print import Form, flat
from planner_bridge.pddl.syntax.words import NUMBER, TIME_SPECIFIERS, number_text

ACTION: Final = "action"
PARTS: Final = {
    ":precondition": "condition",
    ":condition": "condition",
    ":effect": "effect",
    ":parameters": "parameters",
    ":vars": "parameters",
    ":duration": "duration",
}
"""The keys of the parts of an action, the same for instantaneous and durative ones."""
COMPOUND: Final = frozenset(("or", "imply", "when", "forall", "exists", "not", "preference"))
"""Heads of forms that have forms with names inside them."""
_HIERARCHY: Final = re.compile(r"\(\s*([^\s()]*)\s*([^\s()]*)")


def form_anchor(form: Form) -> str:
    """Return the name of a condition, an effect or a fact.

    >>> form_anchor(["and", ["at", "start", ["p", "?X"]]]) == form_anchor(["p", "?x"]) == "(p ?x)"
    True
    """
    if not isinstance(form, list):
        word = flat(form)
        return number_text(float(word)) if NUMBER.fullmatch(word) else word.lower()
    head = _head(form)
    if head == "and":
        parts = [form_anchor(part) for part in _conjuncts(form)]
        return parts[0] if len(parts) == 1 else f"({' '.join(('and', *parts))})"
    if is_timed(form):
        return form_anchor(form[2])
    if head.startswith("?"):  # variables, of which only some have types, though they need not
        return f"({' '.join(part.lower() for part in form if isinstance(part, str) and part.startswith('?'))})"
    return f"({' '.join(map(form_anchor, form))})"


def fact_anchor(form: Form) -> str:
    """Return the name of a fact or an assignment in an initial state, which is the same whatever the value."""
    return form_anchor(form[:2]) if isinstance(form, list) and _head(form) in ("=", "assign") else form_anchor(form)


def rule_anchor(form: Form) -> str:
    """Return the name of a rule: that of its head, and its body."""
    match form:
        case [_, [head, *_], body]:
            return f"{form_anchor(head)} {form_anchor(body)}"
        case _:
            return form_anchor(form)


def hierarchy_anchor(text: str) -> tuple[str, str]:
    """Return the keyword and the name of a task, a method or a network, given its text.

    >>> hierarchy_anchor("(:task Clean :parameters ())")
    (':task', 'clean')
    """
    match = _HIERARCHY.match(text)
    return (match[1].lower(), match[2].lower()) if match else ("", "")


def form_of(node: Node) -> Form:
    """Return a part of a text as nested lists of words."""
    return node.text if isinstance(node, Atom) else [form_of(item) for item in node.items]


def is_timed(form: Form) -> bool:
    """Whether the form is ``(at start X)``, ``(over all X)`` or ``(at end X)``."""
    match form:
        case [str() as first, str() as second, list()]:
            return f"{first} {second}".lower() in TIME_SPECIFIERS
        case _:
            return False


def _conjuncts(form: list[Form]) -> Iterator[Form]:
    for part in form[1:]:
        inner = part[2] if isinstance(part, list) and is_timed(part) else part
        if isinstance(inner, list) and _head(inner) == "and":
            yield from _conjuncts(inner)
        else:
            yield inner


def _head(form: list[Form]) -> str:
    return form[0].lower() if form and isinstance(form[0], str) else ""
