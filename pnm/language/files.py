"""Files of the language: YAML documents, with anchors for the kinds of actions known beforehand.

Domains are printed without what defines their anchors, between ellipses, and with an indentation that no longer is
what it was: such an excerpt is read as it was meant, with a warning, if it cannot be read as it stands.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from pnm.errors import InputError, Position, Tolerated
from pnm.language.actions import CLASSES
from pnm.text_files import read_text
from pnm.yaml_files import MAX_BYTES, Mapped, parse_yaml

ANCHORS: Final = {"base_action": {}, **{kind.value: {"type": kind.value} for kind in CLASSES.values()}}
"""What ``*ros_action`` and the like stand for in files that do not define them."""
SCHEMA: Final = Path(__file__).with_name("schema.json")
"""What editors complete and check these files by."""
MAX_EXCERPT: Final = 100_000
"""Characters of an excerpt; longer texts are not mended."""
_LONE_KEY: Final = re.compile(r"( *)-( +)[^\s#'\"\[{][^#'\"\[{]*:\s*\Z")


def read_documents(path: Path) -> tuple[tuple[Mapped, ...], tuple[Tolerated, ...]]:
    """Read the documents of a file, and tell what in it was not as it should be.

    Raises:
        InputError: there is no such file, or it is not YAML, not text, too large, or a document is not a mapping.
    """
    return parse_documents(read_text(path, MAX_BYTES), str(path))


def parse_documents(text: str, file: str) -> tuple[tuple[Mapped, ...], tuple[Tolerated, ...]]:
    """Read the documents of a text, and tell what in it was not as it should be.

    Raises:
        InputError: it is not YAML, too large, or a document is not a mapping.
    """
    try:
        return parse_yaml(text, file, ANCHORS), ()
    except InputError as error:
        meant, changed = _as_meant(text) if len(text) <= MAX_EXCERPT else (text, [])
        if not changed:
            raise
        try:
            found = parse_yaml(meant, file, ANCHORS)
        except InputError:
            raise error from None
        return found, tuple(Tolerated(message, Position(file, line, 1)) for line, message in changed)


def _as_meant(text: str) -> tuple[str, list[tuple[int, str]]]:
    """Return the text without a leading ellipsis and with indentation mended, and what was done in which line."""
    lines = text.splitlines()
    changed: list[tuple[int, str]] = []
    first = next((number for number, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), len(lines))
    if first < len(lines) and lines[first].rstrip() == "...":
        lines[first] = ""
        changed.append((first + 1, "'...' at the beginning is left out"))
    for number, line in enumerate(lines):
        found = _LONE_KEY.match(line)
        if found is None or number + 1 == len(lines):
            continue
        dash, key = len(found[1]), len(found[1]) + 1 + len(found[2])
        if dash < _indent(lines[number + 1]) < key:
            changed.append((number + 2, f"indented by less than what it belongs to in line {number + 1}"))
            _push(lines, number + 1, dash, key + 1)
    return "\n".join(lines) + "\n", changed


def _push(lines: list[str], start: int, outer: int, inner: int) -> None:
    """Indent what belongs to the key above more than the key."""
    more = " " * (inner - _indent(lines[start]))
    for number in range(start, len(lines)):
        if lines[number].strip() and _indent(lines[number]) <= outer:
            return
        lines[number] = more + lines[number]


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip(" ")) if line.strip() else 0
