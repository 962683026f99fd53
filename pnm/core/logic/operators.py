"""Python's operators over values from files and servers: what is impossible, or would be too large, is refused."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable, Mapping
from functools import reduce
from math import isnan
from typing import Final

from pnm.errors import PnmError


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
        raise ValueError("a truth value is neither less nor more than anything else")  # in Python true is 1
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


def _lesser(left: object, right: object) -> object:
    return right if is_less(right, left) else left


def _greater(left: object, right: object) -> object:
    return right if is_less(left, right) else left


def _places(container: object, value: object) -> list[int]:
    """Return the positions of a value in a list, a mapping or a text."""
    if not isinstance(container, Iterable):
        raise TypeError(f"{type(container).__name__} has no items")
    return [position for position, item in enumerate(container) if alike(item, value)]


def _contains(container: object, value: object) -> bool:
    return operator.contains(container, value) if isinstance(container, str) else bool(_places(container, value))


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


def _setitem(container: object, key: object, value: object) -> object:
    changed = container.copy() if isinstance(container, list | dict) else container
    operator.setitem(changed, key, value)  # type: ignore[call-overload]
    return changed


def _delitem(container: object, key: object) -> object:
    changed = container.copy() if isinstance(container, list | dict) else container
    operator.delitem(changed, key)  # type: ignore[call-overload]
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
    "min": lambda *operands: reduce(_lesser, operands),
    "max": lambda *operands: reduce(_greater, operands),
    "contains": _contains,
    "countOf": lambda container, value: len(_places(container, value)),
    "indexOf": _index_of,
    "truth": as_truth,
    "not_": lambda value: not as_truth(value),
    "div": operator.truediv,
    "setitem": _setitem,
    "delitem": _delitem,
}
"""Python's operators by the names of its module `operator`; ``setitem`` and ``delitem`` give a changed copy."""
CHANGING: Final = frozenset({"setitem", "delitem"})
"""Operators that, as a step of a plan, store their result as their first operand, which is then a query."""
_TRUTHS: Final = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}
"""Truth values as people and servers write them."""
_NUMBER: Final = re.compile(r"[-+]?(?:[0-9]{1,300}(?:\.[0-9]{0,300})?|\.[0-9]{1,300})(?:[eE][-+]?[0-9]{1,3})?\Z")
_GROWING: Final = frozenset({"concat", "add", "mul", "pow", "lshift"})
