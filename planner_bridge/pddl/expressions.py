"""S-expressions: text to nested lists of words, as Lisp and PDDL write them, with positions; and the words in them.

The parser keeps its own stack, so depth is a number that is checked and never a RecursionError.
A part holds its offset in the text; line and column are computed when they are needed.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from decimal import Decimal
from functools import cached_property
from typing import Final, Literal, TypeAlias, get_args

from planner_bridge.pddl.comments import LineIndex
from pnm.core.logic.effects import OPERATIONS
from pnm.errors import InputError, Position, Tolerated, counted, suggestion

MAX_DEPTH: Final = 100
"""Lists inside lists; formulas are walked recursively later, by several calls a level."""

_TOKEN: Final = re.compile(r"[()]|;[^\r\n]*|\?[^\s()?;]*|[^\s()?;]+")
_LONELY: Final = re.compile(r"\?\s+[^\s()?;]")
"""A variable with a space behind its question mark."""
_CLOSING: Final = re.compile(r"(?:[)\s]|;[^\r\n]*)*")


@dataclass(frozen=True, eq=False)
class SourceText:
    """A text and the name of its file. The mutable state is the warnings about it so far."""

    file: str
    text: str = field(repr=False)
    warnings: dict[tuple[int, str], None] = field(default_factory=dict, repr=False)
    """Offsets and messages, each once."""

    @property
    def tolerated(self) -> tuple[Tolerated, ...]:
        """The warnings, in the order of the text."""
        return tuple([Tolerated(message, self.position(offset)) for offset, message in sorted(self.warnings)])

    def position(self, offset: int) -> Position:
        """Return the line and column of an offset."""
        return Position(self.file, self.lines.number(offset) + 1, self.lines.column(offset) + 1)

    @cached_property
    def lines(self) -> LineIndex:
        """The beginnings of its lines."""
        return LineIndex.of(self.text)


@dataclass(frozen=True, slots=True)
class Atom:
    """A word as it is written."""

    text: str
    offset: int
    source: SourceText = field(repr=False)

    def __str__(self) -> str:
        """Show the word in quotes, for errors."""
        return repr(self.text)

    @property
    def key(self) -> str:
        """The word in lower case: to PDDL, `Jack` and `jack` are the same."""
        return self.text.lower()


@dataclass(frozen=True, slots=True)
class Group:
    """A list in parentheses; the offset is that of the opening one."""

    items: tuple[Node, ...]
    offset: int
    source: SourceText = field(repr=False)

    def __str__(self) -> str:
        """Show how the list begins, for errors."""
        match self.items:
            case ():
                return "()"
            case (Atom(text),):
                return f"({text})"
            case (Atom(text), *_):
                return f"({text} ...)"
            case _:
                return "((...) ...)"

    @property
    def head(self) -> str:
        """The first word in lower case; empty when there is none."""
        first = self.items[0] if self.items else None
        return first.key if isinstance(first, Atom) else ""

    @property
    def rest(self) -> tuple[Node, ...]:
        """Everything behind the first part."""
        return self.items[1:]


Node: TypeAlias = Atom | Group


def where(node: Node) -> Position:
    """Return the line and column at which the part begins."""
    return node.source.position(node.offset)


def wrong(node: Node, message: str) -> InputError:
    """Return the error to raise about this part of the text."""
    return InputError(message, where(node))


def tolerate(node: Node, message: str) -> None:
    """Add a warning about this part of the text."""
    node.source.warnings.setdefault((node.offset, message))


def normalized(node: Node) -> object:
    """Return the words of the part in lower case, nested as they are, without positions."""
    return node.key if isinstance(node, Atom) else tuple([normalized(item) for item in node.items])


def text_of(group: Group) -> str:
    """Return the list as it stands in the text, comments included."""
    depth = 0
    text = group.source.text
    for match in _TOKEN.finditer(text, group.offset):
        token = match.group()
        depth += (token == "(") - (token == ")")
        if not depth:
            return text[group.offset : match.end()]
    raise ValueError("the list is not closed")  # cannot be: it was read


def tokens(text: str) -> Iterator[tuple[str, int]]:
    """Yield parentheses, words and comments, each with its offset."""
    return ((match.group(), match.start()) for match in _TOKEN.finditer(text))


def parse(text: str, file: str) -> tuple[Node, ...]:
    """Return the parts of the text in order; comments run from ``;`` to the end of the line.

    >>> [str(part) for part in parse("(move ?r - robot) ; ignored", "example.pddl")]
    ['(move ...)']
    """
    return _Parser(SourceText(file, text)).parse()


@dataclass(slots=True)
class _Parser:
    """A parser with a stack of its own. The mutable state is the lists that are open."""

    source: SourceText
    items: list[Node] = field(default_factory=list)
    """The parts so far of the innermost open list."""
    stack: list[tuple[int, list[Node]]] = field(default_factory=list)
    """For every open list, its offset and the parts so far of the list around it."""
    suspect: tuple[int, Atom] | None = None
    """A section that was still open where another one, by its keyword, began."""

    def parse(self) -> tuple[Node, ...]:
        add = self._add_word if _LONELY.search(self.source.text) is None else self._add_word_or_rest
        for match in _TOKEN.finditer(self.source.text):
            token, offset = match.group(), match.start()
            if token == "(":
                if len(self.stack) == MAX_DEPTH:
                    raise InputError(f"nested deeper than {MAX_DEPTH} lists", self.source.position(offset))
                self.stack.append((offset, self.items))
                self.items = []
            elif token == ")":
                if self.stack:
                    start, outer = self.stack.pop()
                    outer.append(Group(tuple(self.items), start, self.source))
                    self.items = outer
                elif self.items and _CLOSING.fullmatch(self.source.text, offset):
                    self.source.warnings.setdefault((offset, "this ')' closes nothing"))
                    break
                else:
                    raise InputError("this ')' closes nothing; expected '(' or the end of the file", self.source.position(offset))
            elif token[0] != ";":
                add(Atom(token, offset, self.source))
        if not self.stack:
            return tuple(self.items)
        raise self._unclosed()

    def _unclosed(self) -> InputError:
        """Return the error about a list that is open at the end: the one that the indentation shows, or the section, or how many are."""
        start, word = self.suspect or (0, None)
        text, opened = self.source.text, list[tuple[int, int]]()  # offsets, and columns of those that begin a line
        for token, offset in tokens(text):
            before = text[self.source.lines.start(offset) : offset]
            column = len(before) if before.isspace() or not before else -1
            is_less = column >= 0 and token[0] != ";" and opened and opened[-1][1] >= max(1, column + (token == ")"))
            if is_less and len(opened) > 1 and opened[-1][0] >= start:
                line = self.source.position(offset).line
                return InputError(f"this '(' is not closed; expected ')' before line {line}", self.source.position(opened[-1][0]))
            if token == "(":
                opened.append((offset, column))
            elif token == ")" and opened:
                opened.pop()
        if word:
            message = f"this '(' is not closed before the next section; expected ')' before {word} in line {where(word).line}"
            return InputError(message, self.source.position(start))
        line = self.source.position(self.stack[-1][0]).line
        message = f"the text ends here; expected {')' * len(self.stack)!r}, for the '(' in line {line} is not closed"
        return InputError(message, self.source.position(len(text.rstrip())))

    def _add_word(self, word: Atom) -> None:
        if not self.items and len(self.stack) > 2 and word.text[0] == ":" and not self.suspect:
            self.suspect = self.stack[1][0], word
        self.items.append(word)

    def _add_word_or_rest(self, word: Atom) -> None:
        """Add the word, or join it to a lonely question mark before it."""
        before = self.items[-1] if self.items else None
        if isinstance(before, Atom) and before.text == "?":
            self.items[-1] = Atom("?" + word.text, before.offset, self.source)
            tolerate(before, f"'? {word.text}' is read as '?{word.text}'")
        else:
            self._add_word(word)


# --- words ----------------------------------------------------------------------------------------
# Words of a PDDL file: names and numbers, and the errors about them.


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


def unknown(kind: str, atom: Atom, known: Collection[str]) -> InputError:
    """Return the error for a name that is not declared, with the nearest that is."""
    names = f"expected one of {', '.join(list(known)[:_SHOWN])}{', ...' if len(known) > _SHOWN else ''}" if known else "none is declared"
    hint = suggestion(atom.text, known) or names
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
