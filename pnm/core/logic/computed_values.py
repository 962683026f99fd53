"""Values computed from the knowledge of a run: literals, queries of knowledge bases, and Python's operators over them.

A *query* asks for a variable: in the local knowledge of the run, in the global one, in both, or a person. What
is not known locally has to be asked for outside of the run; evaluating then raises `Unanswered`, and is repeated
when the answer is there. A variable without a value is `MISSING`, as is
``null``: equal to itself, and no operand of arithmetic.
"""

from __future__ import annotations

import json
import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache, partial, reduce
from math import isnan
from typing import Final, Protocol, TypeAlias, assert_never, runtime_checkable

from pnm.core.logic.expressions import NOTHING, UNDEFINED, Environment, Fluent, Unknown, Value, ValueOf, bind, variables_in
from pnm.errors import PnmError


class _Missing:
    """The answer for a variable without a value; distinct from every value, None included."""

    def __repr__(self) -> str:
        return "MISSING"


MISSING: Final = _Missing()


class Layer(Enum):
    """The knowledge base that a query asks and an update goes to."""

    LOCAL = "local"
    """The knowledge of the run."""
    GLOBAL = "global"
    """The knowledge that all runs share."""
    ALL = "all"
    """A query asks the local, then the global knowledge; an update goes to both."""
    PERSON = "person"
    """A question to, or a message for, a person."""


@dataclass(frozen=True, slots=True)
class Literal:
    """A value as it stands in the file: anything JSON has."""

    json: str
    """The value as JSON text, so that literals can be compared and hashed."""

    @staticmethod
    def of(value: object) -> Literal:
        """Return the literal for a value made of what JSON has."""
        return Literal(json.dumps(value, sort_keys=True, ensure_ascii=False))

    @property
    def value(self) -> object:
        """The value; a new one each time, so that changing it does not change the literal."""
        return _atom(self.json) if self.json[:1] not in "[{" else json.loads(self.json)

    def __str__(self) -> str:
        return self.json


@dataclass(frozen=True, slots=True)
class Parameter:
    """The value that the call gives the parameter of its action; the name begins with ``?``."""

    name: str

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Query:
    """The value of a variable. Its name and the meta data for the knowledge base may be computed themselves."""

    name: Data
    layer: Layer = Layer.ALL
    meta: Data = Literal("null")

    def __str__(self) -> str:
        meta = "" if self.meta == Literal("null") else f", {self.meta}"
        return f"{self.layer.value}[{self.name.value if isinstance(self.name, Literal) else self.name}{meta}]"


@dataclass(frozen=True, slots=True)
class Compound:
    """A list or a mapping with queries in it."""

    items: tuple[Data, ...]
    keys: tuple[str, ...] | None = None
    """Of a mapping, in the order of the items; None for a list."""

    def __str__(self) -> str:
        if self.keys is None:
            return f"[{', '.join(map(str, self.items))}]"
        return f"{{{', '.join(f'{key}: {item}' for key, item in zip(self.keys, self.items, strict=True))}}}"


@dataclass(frozen=True, slots=True)
class Operation:
    """One of `OPERATORS` over its operands, or ``and``, ``or``, ``not`` or ``exists``."""

    operator: str
    operands: tuple[Data, ...]

    def __str__(self) -> str:
        return f"{self.operator}({', '.join(map(str, self.operands))})"


Data: TypeAlias = Literal | Parameter | Query | Compound | Operation | ValueOf
"""`ValueOf` is the value of a fluent; of a fact, its truth."""


@dataclass(frozen=True, slots=True)
class Update:
    """Store a value under a name."""

    name: Data
    value: Data
    layer: Layer = Layer.LOCAL
    meta: Data = Literal("null")

    def __str__(self) -> str:
        return f"{Query(self.name, self.layer, self.meta)} := {self.value}"


KnowledgeOperation: TypeAlias = Update | Query | Operation
"""The work of a step on knowledge alone. An operation other than ``setitem`` and ``delitem`` changes nothing."""


@dataclass(frozen=True, slots=True)
class Question:
    """A query with its name and meta data computed, as it is asked outside of the run."""

    name: str
    layer: Layer
    meta: str
    """JSON text."""

    def __str__(self) -> str:
        return f"{self.layer.value}[{self.name}]"


class Unanswered(PnmError):
    """The value depends on the answer to a question that is asked outside of the run."""

    def __init__(self, question: Question) -> None:
        super().__init__(f"{question} has not been answered yet")
        self.question = question


@runtime_checkable
class Answers(Protocol):
    """The knowledge that values are computed from."""

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return the value of a fluent."""

    def local_variable(self, name: str, /) -> object:
        """Return a variable of the run, or `MISSING`."""

    def parameter(self, name: str, /) -> object:
        """Return the argument of a parameter of the call's action, named with ``?``; or `MISSING`."""

    def answer(self, question: Question, /) -> object:
        """Return the answer to the question, or `MISSING`; raise `Unanswered` when it was not asked yet."""


def compute(data: Data, answers: Answers) -> object:
    """Return the value, or `MISSING`.

    Raises `Unanswered` if a question has to be asked first, `Uncomputable` if an operation is not possible with these operands.
    """
    match data:
        case Literal():
            return data.value
        case Parameter(name):
            return answers.parameter(name)
        case ValueOf(fluent):
            value = answers.value(fluent)
            return MISSING if value in (None, UNDEFINED) or isinstance(value, Unknown) else value
        case Query(_, layer):
            question = question_of(data, answers)
            if layer in (Layer.LOCAL, Layer.ALL):
                known = answers.local_variable(question.name)
                if known is not MISSING or layer is Layer.LOCAL:
                    return known
            return answers.answer(question)
        case Compound(items, keys):
            values = [_null(compute(item, answers)) for item in items]
            return bounded(values if keys is None else dict(zip(keys, values, strict=True)))
        case Operation(name, operands) if name in _LAZY:
            return _LAZY[name](compute(operand, answers) for operand in operands)
        case Operation(name, operands):
            return operate(name, [_null(compute(operand, answers)) for operand in operands])
        case _:
            assert_never(data)


@lru_cache(maxsize=10_000)
def _atom(text: str) -> object:
    """Return the value of a literal that is no list and no mapping: it cannot be changed, so it is the same every time."""
    return json.loads(text)


def question_of(query: Query, answers: Answers) -> Question:
    """Return the question of a query, with its name and meta data computed; raises as `compute` does."""
    name, meta = variable_name(query.name, answers), _null(compute(query.meta, answers))
    try:
        return Question(name, query.layer, "null" if meta is None else json.dumps(meta, sort_keys=True))
    except (TypeError, ValueError, RecursionError) as error:
        raise Uncomputable(f"the value for {name} cannot be written as JSON: {error}") from error


def variable_name(name: Data, answers: Answers) -> str:
    """Return the computed name of a variable, which must be a text; raises as `compute` does."""
    text = compute(name, answers)
    if not isinstance(text, str):
        raise Uncomputable(f"{name} is {text!r}; expected the name of a variable")
    return text


def is_true(value: object) -> bool:
    """Return whether the value counts as true (`as_truth`); a missing one does not."""
    return value is not MISSING and as_truth(value)


_LAZY: Final[dict[str, Callable[[Iterator[object]], bool]]] = {
    "and": lambda values: all(map(is_true, values)),
    "or": lambda values: any(map(is_true, values)),
    "not": lambda values: not is_true(next(values)),
    "exists": lambda values: next(values) not in (MISSING, None),
}
LOGICAL: Final = frozenset(_LAZY)
"""Operators that evaluate their operands one by one, and no more than needed."""


def _null(value: object) -> object:
    return None if value is MISSING else value


def parts(data: Data) -> Iterator[Data]:
    """Yield the data itself and everything in it."""
    yield data
    match data:
        case Query(name, _, meta):
            yield from parts(name)
            yield from parts(meta)
        case Compound(items) | Operation(_, items):
            for item in items:
                yield from parts(item)


def may_ask(data: Data) -> bool:
    """Return whether its value may have to be asked for outside of the run; a parameter may stand for anything."""
    return any(isinstance(part, Parameter) or (isinstance(part, Query) and part.layer is not Layer.LOCAL) for part in parts(data))


def fluents_in(data: Data, env: Environment = NOTHING) -> frozenset[Fluent]:
    """Return the fluents that the value depends on."""
    return frozenset(bind(part.fluent, env) for part in parts(data) if isinstance(part, ValueOf))


def parameters_in(data: Data) -> frozenset[str]:
    """Return the parameters, with ``?``, that the value depends on."""
    own = frozenset(part.name for part in parts(data) if isinstance(part, Parameter))
    return own.union(*(variables_in(fluent) for fluent in fluents_in(data)))


def substituted(data: Data, env: Environment) -> Data:
    """Substitute the environment's values for parameters, and for the variables of fluents."""
    return filled(data, {name: Literal.of(value) for name, value in env.items()}, env) if env else data


def filled(data: Data, values: Mapping[str, Data], env: Environment) -> Data:
    """Substitute computed values for parameters, and the environment's values for the variables of fluents."""
    match data:
        case Parameter(name):
            return values.get(name, data)
        case ValueOf(fluent):
            return ValueOf(bind(fluent, env))
        case Query(name, layer, meta):
            return Query(filled(name, values, env), layer, filled(meta, values, env))
        case Compound(items, keys):
            return Compound(tuple(filled(item, values, env) for item in items), keys)
        case Operation(name, operands):
            return Operation(name, tuple(filled(operand, values, env) for operand in operands))
        case Literal():
            return data
        case _:
            assert_never(data)


# --- Python's operators over values from files and servers ---------------------------------


class Uncomputable(PnmError):
    """The operands are of the wrong kind, or the result would be too large."""


def operate(name: str, operands: list[object]) -> object:
    """Apply one of `OPERATORS`; raise `Uncomputable` if that is not possible with these operands."""
    if name in _GROWING and _size(operands) > MAX_SIZE:
        raise Uncomputable(f"{name} of operands as large as that")
    try:
        if name == "mod" and isinstance(operands[0], str):
            raise TypeError("the remainder of a text")  # in Python that is another operation, which makes texts of any size
        result = OPERATORS[name](*operands)
        if isinstance(result, complex) or (isinstance(result, int) and result.bit_length() > MAX_BITS):
            raise ValueError("the result is no number that JSON can say")
        bounded(result)
    except (TypeError, ValueError, ArithmeticError, LookupError, RecursionError) as error:
        raise Uncomputable(f"{name}({_shown(operands)}): {error}") from error
    return result


def alike(left: object, right: object) -> bool:
    """Return whether two values are equal, as `_compared`; also inside of lists and mappings."""
    left, right = _compared(left, right)
    if isinstance(left, list | tuple) and type(left) is type(right):
        return len(left) == len(right) and all(map(alike, left, right))
    if isinstance(left, dict) and isinstance(right, dict):
        return left.keys() == right.keys() and all(alike(value, right[key]) for key, value in left.items())
    return isinstance(left, bool) is isinstance(right, bool) and left == right


def is_less(left: object, right: object) -> bool:
    """Return whether a value is less than another one, as `_compared`; of lists the first items that are not alike decide."""
    left, right = _compared(left, right)
    if isinstance(left, list) and isinstance(right, list):
        unlike = next(((one, other) for one, other in zip(left, right, strict=False) if not alike(one, other)), None)
        return is_less(*unlike) if unlike else len(left) < len(right)
    if isinstance(left, bool) is not isinstance(right, bool):
        raise ValueError("a truth value is neither less nor more than another value")  # in Python true is 1
    if any(isinstance(each, float) and isnan(each) for each in (left, right)):
        raise ValueError("NaN is neither less nor more than a number")  # in Python every such comparison is false
    return bool(operator.lt(left, right))  # type: ignore[arg-type]


def _compared(left: object, right: object) -> tuple[object, object]:
    """Return two values as all operators that compare do: a text beside a truth value or a number is read as one, if it can be.

    What people say are texts, and so are results of many servers; ``no`` is not another thing than false because of where it stood.
    A truth value equals no number: in Python true is 1.
    """
    match left, right:
        case str() as text, bool():
            return _TRUTHS.get(spoken(text), text), right
        case str() as text, int() | float() if _NUMBER.match(text.strip()):
            return int(text) if text.strip().lstrip("+-").isdigit() else float(text), right
        case bool() | int() | float(), str():
            return _compared(right, left)[::-1]
        case _:
            return left, right


def _places(container: object, value: object) -> list[int]:
    """Return the positions of a value in a list, a mapping or a text."""
    if not isinstance(container, Iterable):
        raise TypeError(f"{type(container).__name__} has no items")
    return [position for position, item in enumerate(container) if alike(item, value)]


def _index_of(container: object, value: object) -> int:
    if not (places := _places(container, value)):
        raise ValueError("there is no such item")
    return places[0]


def as_truth(value: object) -> bool:
    """Return whether the value counts as true: as in Python, but for a text that says that it is false."""
    return _TRUTHS.get(spoken(value), bool(value)) if isinstance(value, str) else bool(value)


def spoken(text: str) -> str:
    """Return the words of an answer without what a person may write as well: capitals, quotes, full stops, spaces."""
    return " ".join(text.casefold().strip(" .!'\"").split())


def bounded(value: object) -> object:
    """Return the value; raise `Uncomputable` if it is too large or deep: a few lists, each twice in the next, would fill any memory."""
    waiting, size = [(value, 0)], 0
    while waiting:
        part, depth = waiting.pop()
        size += len(part) if isinstance(part, str) else 1
        if size > MAX_SIZE or depth > MAX_DEPTH:
            raise Uncomputable("the list or mapping would be too large, or nested too deep")
        if isinstance(part, list | dict):
            waiting += [(item, depth + 1) for item in (part.values() if isinstance(part, dict) else part)]
    return value


def _shown(operands: list[object]) -> str:
    try:
        shown = ", ".join(map(repr, operands))
    except (ValueError, RecursionError):
        return "…"
    return shown if len(shown) < 200 else "…"


def _size(operands: list[object]) -> int:
    """Return an upper bound for how many characters, items or bits the result has."""
    sizes = [len(each) if isinstance(each, str | list | dict) else each.bit_length() if isinstance(each, int) else 64 for each in operands]
    counts = [operand for operand in operands if isinstance(operand, int) and not isinstance(operand, bool)]
    return sum(sizes) * max([1, *map(abs, counts)])


def _changed(change: Callable[..., None], container: object, *item: object) -> object:
    changed = container.copy() if isinstance(container, list | dict) else container
    change(changed, *item)
    return changed


MAX_SIZE: Final = 1_000_000
MAX_DEPTH: Final = 100
MAX_BITS: Final = 14_000
"""Of a whole number: Python writes none of more than 4300 digits."""
_PLAIN: Final = (
    *("is_", "is_not"),
    *("abs", "add", "floordiv", "mod", "mul", "neg", "pos", "pow", "sub", "truediv", "concat", "getitem", "index"),
    *("and_", "inv", "invert", "lshift", "or_", "rshift", "xor"),
)
OPERATORS: Final[Mapping[str, Callable[..., object]]] = {
    **{name: getattr(operator, name) for name in _PLAIN},
    "eq": alike,
    "ne": lambda left, right: not alike(left, right),
    "lt": is_less,
    "gt": lambda left, right: is_less(right, left),
    "le": lambda left, right: is_less(left, right) or alike(left, right),
    "ge": lambda left, right: is_less(right, left) or alike(left, right),
    "min": lambda *operands: reduce(lambda left, right: right if is_less(right, left) else left, operands),
    "max": lambda *operands: reduce(lambda left, right: right if is_less(left, right) else left, operands),
    "contains": lambda some, value: operator.contains(some, value) if isinstance(some, str) else bool(_places(some, value)),
    "countOf": lambda container, value: len(_places(container, value)),
    "indexOf": _index_of,
    "truth": as_truth,
    "not_": lambda value: not as_truth(value),
    "div": operator.truediv,
    "setitem": partial(_changed, operator.setitem),
    "delitem": partial(_changed, operator.delitem),
}
"""Python's operators by the names of its module `operator`; ``setitem`` and ``delitem`` give a changed copy."""
CHANGING: Final = frozenset({"setitem", "delitem"})
"""Operators that, as a step of a plan, store their result as their first operand, which is then a query."""
_TRUTHS: Final = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}
"""Truth values as people and servers write them."""
_NUMBER: Final = re.compile(r"[-+]?(?:[0-9]{1,300}(?:\.[0-9]{0,300})?|\.[0-9]{1,300})(?:[eE][-+]?[0-9]{1,3})?\Z")
_GROWING: Final = frozenset({"concat", "add", "mul", "pow", "lshift"})
