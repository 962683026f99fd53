"""The words of formulas, taking apart the mappings with one key that formulas are made of, and values that they compute.

A word may begin with a capital letter or with a small one: ``Comparison`` is ``comparison``. Only in values, where a
mapping may be one as it stands, words that could well be the names of fields are written with a capital letter.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import reduce
from typing import Any, Final, TypeAlias

from pnm.core.logic.computed_values import (
    CHANGING,
    LOGICAL,
    OPERATORS,
    Compound,
    Data,
    KnowledgeOperation,
    Layer,
    Literal,
    Operation,
    Parameter,
    Query,
    Update,
)
from pnm.core.logic.expressions import ValueOf
from pnm.errors import InputError, Position, suggestion
from pnm.files.yaml_keys import ANYTHING as ANY_VALUE, Schema, described, pair, ref
from pnm.files.yaml_nodes import Node
from pnm.language.formulas.scope import ANYTHING, FormulaScope, fluent_in, is_variable, read_fluent, shown

Words: TypeAlias = Mapping[str, tuple[str, Schema]]
"""The words that a form may begin with: their meaning, and the schema of their argument."""

CONDITION: Final = ref("condition")
VALUE: Final = ref("value")
_ASKED: Final = ref("query")
_CHANGED: Final = ref("update")
FLUENT: Final[Schema] = {"type": "string", "pattern": r"^\s*\(\s*[^\s()?].*\)\s*$"}
"""The text of a fact or function."""
_FACT: Final = ref("factOrOne")

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
QUERY_WORDS: Final[Words] = {
    "query": ("the value of a variable: of the run if it has one, else of what all runs share", _ASKED),
    "localQuery": ("the value of a variable of this run", _ASKED),
    "remoteQuery": ("the value of a variable that all runs share", _ASKED),
    "personQuery": ("the answer of a person", _ASKED),
}
SYNONYMS: Final[Mapping[str, str]] = {
    **{"logicalAnd": "and", "logicalOr": "or", "logicalNot": "not"},
    **{"scale-up": "scale_up", "scale-down": "scale_down"},
}
TESTS: Final[Words] = {
    "and": ("all of them", CONDITION),
    "or": ("at least one of them", CONDITION),
    "not": ("not this one", CONDITION),
    "imply": ("if the first then also the second", pair(CONDITION, CONDITION)),
    "forall": ("for all objects of some types", ref("quantified")),
    "exists": ("some object of some types, or a variable that has a value", ref("exists")),
    "comparison": ("compares two values by an operator such as eq or <", ref("comparison")),
    "operation": ("an operator over values, such as contains", ref("computed")),
    "booleanAssertion": ("whether a value is equal to true, or to false", pair(VALUE, {"type": "boolean"})),
    "holds": ("a fact, such as (at ?r kitchen)", _FACT),
    **QUERY_WORDS,
}
"""The words that a condition begins with."""
_CAPITAL: Final = frozenset({"comparison", "operation", "booleanAssertion", "holds", "value", "literal", *QUERIES, *UPDATES})
_FIELDS: Final = frozenset({"comparison", "operation", "holds", "exists", "value", "literal", "query", "update"})
"""In values, mappings with these keys are data."""
ARITHMETIC_WORDS: Final[Words] = {
    "value": ("the value of a function", _FACT),
    "operation": ("arithmetic: + - * / over expressions", ref("computed")),
}
VALUES: Final[Words] = {
    **{word: TESTS[word] for word in TESTS if word != "forall"},
    "value": ("the value of a function, or the truth of a fact", _FACT),
    "literal": ("the value as it stands", ANY_VALUE),
}
"""The words that a computed value begins with."""
OPERATIONS: Final[Words] = {
    "update": ("stores a value in both: the run, and what all runs share", _CHANGED),
    "localUpdate": ("stores a value in a variable of this run", _CHANGED),
    "remoteUpdate": ("stores a value where all runs see it", _CHANGED),
    "personUpdate": ("tells a person something", _CHANGED),
    **QUERY_WORDS,
    "operation": TESTS["operation"],
}
"""The words that an operation on knowledge begins with."""

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
    """The position of the word."""
    argument: Node
    written: str
    """The word as the file has it."""

    def items(self, *allowed: int) -> tuple[Node, ...]:
        """Return the operands: those of a list, or the one that stands for itself; only these counts are allowed."""
        items = self.argument.each
        if len(items) not in allowed:
            raise self.argument.wrong(f"{self.written} takes {' or '.join(map(str, allowed))} operands, found {len(items)}")
        return items


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


def forms(words: Words, *, most: int | None = 1) -> dict[str, Any]:
    """Return the keys of a schema of mappings that are one of the forms; without `most`, of any mapping that may be one."""
    known = {_spelled(word): described(*about) for word, about in words.items()}
    if most is None:
        return {"properties": known}
    patterns: dict[str, Schema] = {}
    for word, (_, schema) in words.items():
        names = [name for name in (word, *(synonym for synonym, meaning in SYNONYMS.items() if meaning == word)) if name[0].isalpha()]
        others = [key for name in names for key in (name, name[0].upper() + name[1:]) if key != _spelled(word)]
        patterns |= {f"^({'|'.join(others)})$": schema} if others else {}
    return {"properties": known, "patternProperties": patterns, "additionalProperties": False, "maxProperties": most}


OPERATORS_KNOWN: Final = sorted(OPERATORS.keys() | _NAMES.keys())


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


# --- values ---------------------------------------------------------------------------------------
# Computed values, and operations on knowledge: from YAML to `pnm.core.logic.computed_values`.
#
# A text that begins with ``?`` is a parameter of the action, and ``(battery r1)`` the value of a function or the
# truth of a fact; any other text, number, list or mapping stands for itself, and ``{Literal: x}`` does whatever x is.


def read_data(node: Node, scope: FormulaScope = ANYTHING) -> Data:
    """Read a value."""
    construct = form(node, (*VALUES, *UPDATES), in_value=True)
    if construct is not None:
        return read_form(construct, scope)
    if node.items is not None:
        return _whole(tuple(read_data(item, scope) for item in node.items), None)
    if node.is_mapping:
        entries = node.mapped().entries()
        return _whole(tuple(read_data(value, scope) for _, _, value in entries), tuple(key for key, _, _ in entries))
    text = node.text
    if text is None:
        return read_literal(node)
    if is_variable(text):
        scope.check_variable(text, node)
        return Parameter(text)
    fluent = fluent_in(text)
    if fluent is not None:
        scope.check_fluent(fluent, node)
        return _truth(ValueOf(fluent)) if fluent[0] in scope.declared.domain.predicates else ValueOf(fluent)
    return Literal.of(text)


def _whole(items: tuple[Data, ...], keys: tuple[str, ...] | None) -> Data:
    """Return a literal if all parts are."""
    values = [item.value for item in items if isinstance(item, Literal)]
    if len(values) < len(items):
        return Compound(items, keys)
    return Literal.of(values if keys is None else dict(zip(keys, values, strict=True)))


def read_literal(node: Node) -> Literal:
    """Read a value as it stands."""
    return Literal.of(node.plain())


def read_form(construct: Form, scope: FormulaScope) -> Data:
    """Read a value that is computed."""
    word = construct.word
    if word in QUERIES:
        return _query(construct, scope)
    match word:
        case "and" | "or":
            return Operation(word, tuple(read_data(operand, scope) for operand in construct.argument.each))
        case "not":
            return Operation("not", (read_data(construct.items(1)[0], scope),))
        case "imply":
            left, right = (read_data(operand, scope) for operand in construct.items(2))
            return Operation("or", (Operation("not", (left,)), right))
        case "exists":  # ``Exists: [Query: v]`` or ``Exists: {Query: v}``
            return Operation("exists", (_query(needed_form(construct.items(1)[0], QUERIES, "a query"), scope),))
        case "comparison":
            operator, first, second = comparison_parts(construct)
            return Operation(read_operator(operator), _compared_values(read_data(first, scope), read_data(second, scope)))
        case "operation":
            return _operation(construct, scope)
        case "booleanAssertion":
            inner, wanted = construct.items(2)
            value = wanted.plain()
            if not isinstance(value, bool):
                raise wanted.wrong("expected true or false")
            return Operation("eq", _compared_values(read_data(inner, scope), Literal.of(value)))
        case "holds":
            return _truth(ValueOf(read_fluent(construct.items(1)[0], scope)))
        case "value":
            return ValueOf(read_fluent(construct.items(1)[0], scope))
        case "literal":
            return read_literal(construct.argument)
        case _:
            raise construct.argument.wrong(f"{construct.written} changes knowledge; it is a step of its own, not a value")


def _query(construct: Form, scope: FormulaScope) -> Query:
    name, *meta = construct.items(1, 2)
    return Query(_name(name, scope), QUERIES[construct.word], *(read_data(option, scope) for option in meta))


def _name(node: Node, scope: FormulaScope) -> Data:
    """Read the name of a variable, which may be computed."""
    data = read_data(node, scope)
    if isinstance(data, Compound) or (isinstance(data, Literal) and not isinstance(data.value, str)):
        hint = f"; write {node.written!r} with quotes" if node.written else ""
        raise node.wrong(f"expected the name of a variable{hint}")
    return data


def _compared_values(left: Data, right: Data) -> tuple[Data, Data]:
    """Return both values; where one is true or false, so is the other."""
    return (_truth(left) if _is_flag(right) else left), (_truth(right) if _is_flag(left) else right)


def _is_flag(data: Data) -> bool:
    return isinstance(data, Literal) and isinstance(data.value, bool)


def _truth(data: Data) -> Data:
    """Return the truth of a fact, which is false when it is not recorded; anything else as it is."""
    return Operation("truth", (data,)) if isinstance(data, ValueOf) else data


def comparison_parts(construct: Form) -> tuple[Node, Node, Node]:
    """Return the operator and both sides of ``Comparison: [operator, [a, b]]``."""
    operator, pair = construct.items(2)
    if pair.items is None or len(pair.items) != 2:
        raise pair.wrong(f"{construct.written} takes a list of the two values it compares")
    return operator, *pair.items


def operation_parts(construct: Form) -> tuple[Node, tuple[Node, ...]]:
    """Return the operator and the operands of ``Operation: [operator, [a, b, ...]]``, or ``[operator, a]``."""
    operator, rest = construct.items(2)
    return operator, rest.each


def _operation(construct: Form, scope: FormulaScope, *, changing: bool = False) -> Operation:
    operator, rest = operation_parts(construct)
    name = read_operator(operator, changing=changing)
    if not rest:
        raise operator.wrong(f"{name} has no operands")
    operands = tuple(read_data(operand, scope) for operand in rest)
    if name == "sub" and len(operands) == 1 and operator.text == ARITHMETIC["sub"]:
        return Operation("neg", operands)
    if name in ARITHMETIC and len(operands) > 2:
        first = Operation(name, operands[:2])
        return reduce(lambda left, right: Operation(name, (left, right)), operands[2:], first)
    return Operation(name, operands)


def read_operation(node: Node, scope: FormulaScope = ANYTHING) -> KnowledgeOperation:
    """Read an operation on knowledge: an update, a query, or an operator that changes it."""
    construct = needed_form(node, OPERATIONS, "an update, a query or an operation")
    if construct.word in UPDATES:
        name, value, *meta = construct.items(2, 3)
        return Update(_name(name, scope), read_data(value, scope), UPDATES[construct.word], *(read_data(option, scope) for option in meta))
    if construct.word in QUERIES:
        return _query(construct, scope)
    operation = _operation(construct, scope, changing=True)
    sizes = {"setitem": 3, "delitem": 2}
    if operation.operator in sizes:
        first = operation_parts(construct)[1][0]
        if len(operation.operands) != sizes[operation.operator]:
            raise first.wrong(f"{operation.operator} takes {sizes[operation.operator]} operands, found {len(operation.operands)}")
        if not isinstance(operation.operands[0], Query):
            raise first.wrong(f"{operation.operator} changes the result of a query; expected a query as its first operand")
    return operation
