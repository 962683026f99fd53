"""The errors a person can cause, each with one sentence and its data as attributes; and the words of messages, as they may be shown."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from math import isfinite
from typing import Final, TypeGuard


class PnmError(Exception):
    """Something the caller can do something about; never raised as such, only as a subclass."""


@dataclass(frozen=True, slots=True)
class Position:
    """A position in a file; lines and columns count from 1. Without them, the file as a whole."""

    file: str
    line: int = 0
    column: int = 0

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}" if self.line else self.file


class InputError(PnmError):
    """A file or a value from outside is wrong; nothing was started because of it."""

    def __init__(self, message: str, position: Position | None = None) -> None:
        super().__init__(f"{position}: {message}" if position else message)
        self.message = message
        self.position = position


@contextmanager
def located(position: Position) -> Iterator[None]:
    """Raise what is found wrong inside as wrong at this position."""
    try:
        yield
    except InputError as error:
        raise InputError(error.message, position) from error


@dataclass(frozen=True, slots=True)
class Tolerated:
    """A mistake in a file that was understood all the same; shown as a warning."""

    message: str
    position: Position

    def __str__(self) -> str:
        return f"{self.position}: warning: {self.message}"


def check_seconds(what: str, *seconds: float | None) -> None:
    """Refuse waits that never end, or that are no number; raise `InputError`. None stands for a default."""
    for wait in seconds:
        if wait is not None and not (_is_number(wait) and wait >= 0.0):
            raise InputError(f"{what} waits for {wait!r} seconds; expected a finite number from 0")


def check_counts(what: str, **counts: int) -> None:
    """Refuse what is no whole number from 0 among the named ones; raise `InputError`."""
    for name, count in counts.items():
        if not (_is_number(count) and count == int(count) >= 0):
            raise InputError(f"{what}: expected a whole number from 0 for {name}, found {count!r}")


def check_kinds(what: str, values: Mapping[str, tuple[object, type]]) -> None:
    """Refuse named values that are of another kind than expected; raise `InputError`."""
    for name, (value, kind) in values.items():
        if not isinstance(value, kind):
            found = repr(value) if len(repr(value)) < 200 else f"a {type(value).__name__}"
            raise InputError(f"{what}: expected {kind.__name__} for {name}, found {found}")


def _is_number(value: object) -> TypeGuard[float]:
    return isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)


class NotEnabled(PnmError):
    """A transition was fired although its preset is not covered by the marking."""

    def __init__(self, transition: str, missing: dict[str, int]) -> None:
        super().__init__(f"{transition} is not enabled; missing tokens: {missing}")
        self.transition = transition
        self.missing = missing


class RunError(PnmError):
    """A run was driven wrongly: begun twice, asked for a result before its end, or succeeded by one that loses something."""


class RosError(PnmError):
    """ROS 2 is not there, does not start, or does not answer in time."""


def not_installed(what: str, error: ImportError, extra: str) -> InputError:
    """Return the refusal of something that needs what an extra brings, with the command that installs it."""
    return InputError(f"{what} needs {error.name}, which is not installed; {installation(extra)}")


def installation(extra: str) -> str:
    """Return the command that installs an extra: from the folder that this was installed from, or by name."""
    from importlib.metadata import PackageNotFoundError, distribution  # here and below, because it is seldom needed
    from json import loads
    from shlex import quote
    from urllib.parse import unquote, urlsplit

    try:
        origin = loads(distribution("petri-net-machines").read_text("direct_url.json") or "{}")  # PEP 610
    except (PackageNotFoundError, ValueError):
        origin = {}
    if (folder := origin.get("dir_info")) is None:
        return f"pip install 'petri-net-machines[{extra}]'"
    path = unquote(urlsplit(origin["url"]).path)
    return f"pip install {'-e ' if folder.get('editable') else ''}{quote(f'{path}[{extra}]')}"


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural if need be.

    >>> counted(1, "operand"), counted(2, "operand")
    ('1 operand', '2 operands')
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"


def listed(texts: Sequence[str], word: str = "and", most: int = 4) -> str:
    """Return the texts as a list of words; of many the first ones, and how many more there are.

    >>> listed(["a", "b"]), listed(["a", "b", "c"], most=2)
    ('a and b', 'a and 2 more')
    """
    shown = texts if len(texts) <= most else [*texts[: most - 1], f"{len(texts) - most + 1} more"]
    return f" {word} ".join(filter(None, (", ".join(shown[:-1]), shown[-1]))) if shown else ""


def suggestion(name: str, known: Collection[str]) -> str:
    """Return a suggestion of the nearest known name ("did you mean …?"), or nothing when none is near; the first of equally near ones.

    If none is near as it is spelled, capitals do not count.
    """
    spelled = {one.lower(): one for one in reversed([*known])}
    near = get_close_matches(name, known, 1) or [spelled[one] for one in get_close_matches(name.lower(), spelled, 1)]
    return f"did you mean {near[0]!r}?" if near else ""


_JOINERS: Final = "\u200c\u200d"
"""Neither printable nor dangerous: without them Persian words and many emoji fall apart."""


def printable(text: str) -> str:
    """Return a text on one line, without what controls a terminal, turns the order of its letters around, or is no letter in XML.

    Every text that leaves the process passes here, or through `printable_lines`: it may come from files and from other machines.

    >>> printable("a\\x1b[2Jb\\nc")
    'a\ufffd[2Jb c'
    """
    if text.isprintable():
        return text
    return "".join(
        letter if letter.isprintable() or letter in _JOINERS else " " if letter.isspace() else "\N{REPLACEMENT CHARACTER}"
        for letter in text
    )


def printable_lines(text: str) -> str:
    """Return a text with its lines, each of them printable."""
    return text if text.isprintable() else "\n".join(map(printable, text.split("\n")))
