"""Words of a PDDL file: numbers, names that are being declared, typed lists; and what to say of a word nobody knows."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from decimal import Decimal
from difflib import get_close_matches
from typing import Final, Literal, TypeAlias, get_args

from planner_bridge.pddl.syntax.expressions import Atom, Group, Node, tolerate, wrong
from pnm.core.logic.effects import OPERATIONS
from pnm.errors import InputError

Types = tuple[str, ...]

CONNECTIVES: Final = frozenset(("and", "or", "not", "imply", "forall", "exists", "when", *OPERATIONS))
"""Words that begin a condition or an effect, so that no predicate or function can be called so."""

CONTINGENT: Final = "a contingent planner, of which unified-planning brings none,"
"""What would be needed where a robot has to find out what is the case."""

NAME: Final = re.compile(r"[A-Za-z0-9_@.][A-Za-z0-9_@.-]*")
NUMBER: Final = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
_SHOWN: Final = 8
"""So many names at most are listed in an error."""


# --- errors --------------------------------------------------------------------------------


def unsupported(node: Node, what: str, needed: str) -> InputError:
    """Return the error for a construct of PDDL that is not read."""
    return wrong(node, f"{what} are not supported yet; {needed} would be needed")


def nearest(atom: Atom, known: Collection[str]) -> str | None:
    """Return the name that may have been meant, if there is one alike."""
    spelled = {name.lower(): name for name in known}
    near = get_close_matches(atom.key, spelled, 1)
    return spelled[near[0]] if near else None


def unknown(kind: str, atom: Atom, known: Collection[str]) -> InputError:
    """Return the error for a name that nobody declared, with the nearest that somebody did."""
    near = nearest(atom, known)
    if near:
        hint = f"did you mean {near!r}?"
    elif known:
        hint = f"expected one of {', '.join(list(known)[:_SHOWN])}{', ...' if len(known) > _SHOWN else ''}"
    else:
        hint = "none is declared"
    return wrong(atom, f"unknown {kind} {atom}; {hint}")


# --- words ---------------------------------------------------------------------------------


def is_number(node: Node) -> bool:
    """Tell whether the part is written as a number."""
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


# --- typed lists ---------------------------------------------------------------------------


def typed_runs(items: Sequence[Node]) -> Iterator[tuple[list[Node], Node | None]]:
    """Split ``a b - t c`` into ``([a, b], t)`` and ``([c], None)``; ``-t`` without a space is read too."""
    names: list[Node] = []
    rest = iter(items)
    for item in rest:
        match item:
            case Atom("-"):
                kind = next(rest, None)
                if kind is None:
                    raise wrong(item, "expected a type after '-', found nothing")
            case Atom(text, offset, source) if text[0] == "-":
                kind = Atom(text[1:], offset + 1, source)
            case _:
                names.append(item)
                continue
        if names:
            yield names, kind
        else:
            tolerate(item, f"there is no name before the type {kind}; it is ignored")
        names = []
    if names:
        yield names, None


def type_words(node: Node) -> tuple[Atom, ...]:
    """Return the words of ``t`` or ``(either t u)``."""
    words = node.rest if isinstance(node, Group) and node.head == "either" and node.rest else (node,)
    found = tuple(word for word in words if isinstance(word, Atom))
    if len(found) < len(words):
        raise wrong(node, f"expected a type or (either TYPE ...), found {node}")
    return found


def show_types(types: Types) -> str:
    """Write the types of a term for a person."""
    return " or ".join(types)


# --- lists ---------------------------------------------------------------------------------


def operands(node: Group, count: int) -> tuple[Node, ...]:
    """Return what follows the first word, which must be so many parts."""
    if len(node.rest) != count:
        raise wrong(node, f"'{node.head}' takes {counted(count, 'operand')}, found {len(node.rest)}")
    return node.rest


def counted(count: int, noun: str) -> str:
    """Write a number with what is counted.

    >>> counted(1, "operand"), counted(2, "operand")
    ('1 operand', '2 operands')
    """
    return f"{count} {noun}{'' if count == 1 else 's'}"


def number_text(value: float) -> str:
    """Write a number exactly and without an exponent.

    >>> number_text(1e-7), number_text(3.0), number_text(0.1)
    ('0.0000001', '3', '0.1')
    """
    text = f"{Decimal(repr(value)):f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


TimeSpecifier: TypeAlias = Literal["at start", "over all", "at end"]
TIME_SPECIFIERS: Final[tuple[TimeSpecifier, ...]] = get_args(TimeSpecifier)
