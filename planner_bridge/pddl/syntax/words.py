"""Words of a PDDL file: names and numbers, and the errors about them."""

from __future__ import annotations

import re
from collections.abc import Collection
from decimal import Decimal
from difflib import get_close_matches
from typing import Final, Literal, TypeAlias, get_args

from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, wrong
from pnm.core.logic.effects import OPERATIONS
from pnm.errors import InputError, counted

Types = tuple[str, ...]

CONNECTIVES: Final = frozenset(("and", "or", "not", "imply", "forall", "exists", "when", *OPERATIONS))
"""Words that begin a condition or an effect: no predicate or function can have their names."""

TimeSpecifier: TypeAlias = Literal["at start", "over all", "at end"]
"""To which moment of a durative action a condition or effect belongs."""
TIME_SPECIFIERS: Final[tuple[TimeSpecifier, ...]] = get_args(TimeSpecifier)

NAME: Final = re.compile(r"[A-Za-z0-9_@.][A-Za-z0-9_@.-]*")
NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_SHOWN: Final = 8
"""Names listed in an error, at most."""


def nearest(atom: Atom, known: Collection[str]) -> str | None:
    """Return the known name most like this one, if one is alike."""
    spelled = {name.lower(): name for name in known}
    near = get_close_matches(atom.key, spelled, 1)
    return spelled[near[0]] if near else None


def unknown(kind: str, atom: Atom, known: Collection[str]) -> InputError:
    """Return the error for a name that is not declared, with the nearest that is."""
    near = nearest(atom, known)
    if near:
        hint = f"did you mean {near!r}?"
    elif known:
        hint = f"expected one of {', '.join(list(known)[:_SHOWN])}{', ...' if len(known) > _SHOWN else ''}"
    else:
        hint = "none is declared"
    return wrong(atom, f"unknown {kind} {atom}; {hint}")


def is_number(node: Node) -> bool:
    """Whether the part is written as a number."""
    return isinstance(node, Atom) and NUMBER.fullmatch(node.text) is not None


def number(node: Node) -> float:
    """Return the number, which must be finite."""
    if not isinstance(node, Atom) or not is_number(node):
        raise wrong(node, f"expected a number, found {node}")
    value = float(node.text)
    if value in (float("inf"), float("-inf")):
        raise wrong(node, f"the number {node.text} is too large")
    return value


def time(node: Node) -> float:
    """Return a number of seconds, which must not be negative."""
    seconds = number(node)
    if seconds < 0:
        raise wrong(node, f"expected a time of at least 0, found {node}")
    return seconds


def new_name(node: Node, kind: str, forbidden: Collection[str] = ()) -> str:
    """Return a name that is being declared, spelled as it stands."""
    match node:
        case Atom() if node.key in forbidden:
            raise wrong(node, f"{node} is a word of PDDL and cannot name {with_article(kind)}")
        case Atom(text) if NAME.fullmatch(text) and not is_number(node):
            return text
        case Atom(text) if text[0] != "?" and text[0] != ":" and not is_number(node):
            raise wrong(node, f"{node} cannot name {with_article(kind)}; expected letters, digits and _ - . @")
        case _:
            raise wrong(node, f"expected the name of {with_article(kind)}, found {node}")


def with_article(kind: str) -> str:
    """Put the article before a noun.

    >>> with_article("action"), with_article("type")
    ('an action', 'a type')
    """
    return f"an {kind}" if kind[0] in "aeiou" else f"a {kind}"


def show_types(types: Types) -> str:
    """Return the types of a term as text for an error."""
    return " or ".join(types)


def operands(node: Group, count: int) -> tuple[Node, ...]:
    """Return the parts behind the first word; there must be `count`."""
    if len(node.rest) != count:
        raise wrong(node, f"'{node.head}' takes {counted(count, 'operand')}, found {len(node.rest)}")
    return node.rest


def number_text(value: float) -> str:
    """Return a number as text, exactly and without an exponent.

    >>> number_text(1e-7), number_text(3.0), number_text(0.1)
    ('0.0000001', '3', '0.1')
    """
    text = f"{Decimal(repr(value)):f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
