"""The words of formulas, and taking apart the mappings with one key that formulas are made of.

A word may begin with a capital letter or with a small one: ``Comparison`` is ``comparison``. Only in values, where a
mapping may be one as it stands, words that could well be the names of fields are written with a capital letter.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Final

from pnm.core.logic.computed_values import CHANGING, LOGICAL, OPERATORS, Layer
from pnm.errors import InputError, Position, suggestion
from pnm.files.yaml_nodes import Node
from pnm.language.formulas.scope import shown

QUERIES: Final[Mapping[str, Layer]] = {
    "query": Layer.ALL,
    "localQuery": Layer.LOCAL,
    "remoteQuery": Layer.GLOBAL,
    "personQuery": Layer.PERSON,
}
UPDATES: Final[Mapping[str, Layer]] = {
    "update": Layer.ALL,
    "localUpdate": Layer.LOCAL,
    "remoteUpdate": Layer.GLOBAL,
    "personUpdate": Layer.PERSON,
}
SYNONYMS: Final[Mapping[str, str]] = {"logicalAnd": "and", "logicalOr": "or", "logicalNot": "not"}
LOGIC: Final = ("and", "or", "not", "imply", "forall", "exists")
TESTS: Final = (*LOGIC, "comparison", "operation", "booleanAssertion", "holds", *QUERIES)
"""What a condition begins with."""
_CAPITAL: Final = frozenset({"comparison", "operation", "booleanAssertion", "holds", "value", "literal", *QUERIES, *UPDATES})
_FIELDS: Final = frozenset({"comparison", "operation", "holds", "exists", "value", "literal", "query", "update"})
"""In values, mappings with these keys are data."""
VALUES: Final = (*(word for word in TESTS if word != "forall"), "value", "literal")
"""What a value that is computed begins with."""

COMPARISONS: Final[Mapping[str, str]] = {"eq": "=", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}
"""Python's names of the comparisons that PDDL has too."""
ARITHMETIC: Final[Mapping[str, str]] = {"add": "+", "sub": "-", "mul": "*", "truediv": "/"}
"""Python's names of the operations that PDDL has too."""
_NAMES: Final = {symbol: name for table in (COMPARISONS, ARITHMETIC) for name, symbol in table.items()}


@dataclass(frozen=True, slots=True)
class Form:
    """A mapping with one key: a word, and its argument."""

    word: str
    """In the spelling of the tables of this module."""
    position: Position
    """Where the word stands."""
    argument: Node
    written: str
    """The word as the file has it."""

    def items(self, *allowed: int) -> tuple[Node, ...]:
        """Return the operands: those of a list, or the one that stands for itself; only these counts are allowed."""
        items = (self.argument,) if self.argument.items is None else self.argument.items
        if len(items) not in allowed:
            raise self.argument.wrong(f"{self.written} takes {' or '.join(map(str, allowed))} operands, found {len(items)}")
        return items

    def operands(self) -> tuple[Node, ...]:
        """Return any number of operands: those of a list, or the one that stands for itself."""
        return (self.argument,) if self.argument.items is None else self.argument.items


def form(node: Node, words: Collection[str], *, in_value: bool = False) -> Form | None:
    """Take apart a mapping that is one of the forms; None for anything else."""
    if not node.is_mapping:
        return None
    entries = node.mapped().entries()
    for key, position, argument in entries:
        word = _word(key)
        if word in words and not (in_value and key in _FIELDS):
            if len(entries) > 1:
                raise InputError(f"{key!r} stands beside other keys; expected it alone, or a list of such entries", position)
            return Form(word, position, argument, key)
    if in_value and len(entries) == 1:
        ((key, position, _),) = entries
        near = get_close_matches(_word(key), sorted(_CAPITAL & frozenset(words)), 1, 0.8)
        if near and key[:1].isupper() and key not in _FIELDS:
            suggestion = f"did you mean {_spelled(near[0])!r}? A mapping that stands for itself is {{Literal: ...}}"
            raise InputError(f"unknown word {key!r}; {suggestion}", position)
    return None


def needed_form(node: Node, words: Collection[str], what: str) -> Form:
    """Take apart a mapping that must be one of the forms."""
    construct = form(node, words)
    if construct is not None:
        return construct
    keys = list(node.mapped().nodes) if node.is_mapping else []
    if not keys:
        raise node.wrong(f"expected {what}, found {shown(node)}")
    near = get_close_matches(_word(keys[0]), sorted(words), 1)
    expected = f"expected {what}, which begins with one of: {', '.join(map(_spelled, words))}"
    hint = f"did you mean {_spelled(near[0])!r}?" if near else expected
    raise InputError(f"unknown word {keys[0]!r}; {hint}", node.mapped().entries()[0][1])


def _word(key: str) -> str:
    small = key[:1].lower() + key[1:]
    return SYNONYMS.get(small, small)


def _spelled(word: str) -> str:
    return word[:1].upper() + word[1:] if word in _CAPITAL else word


def read_operator(node: Node, *, changing: bool = False) -> str:
    """Read the name of an operator; symbols are replaced by names."""
    written = node.text
    name = _NAMES.get(written or "", written or "")
    known = OPERATORS.keys() - (frozenset() if changing else CHANGING)
    if name not in known:
        if name in CHANGING:
            raise node.wrong(f"{name} changes knowledge; it is a step of its own, not a value")
        hint = suggestion(name, sorted({*(known - LOGICAL), *_NAMES})) or f"expected one of: {', '.join(sorted(known))}"
        raise node.wrong(f"there is no operator {shown(node)}; {hint}")
    return name
