"""The comments of a PDDL file, and what they are about.

Lines of text with comments beside them, which stand under each other where that looks well.
"""

from __future__ import annotations

from typing import Final, Literal

from planner_bridge.pddl.comments.table import Item, Lines, Path, Remark, Table, attached
from planner_bridge.pddl.read.reader import DOMAIN_SECTIONS, PROBLEM_SECTIONS
from planner_bridge.pddl.syntax.anchors import items
from planner_bridge.pddl.syntax.expressions import tokens
from planner_bridge.pddl.syntax.sections import define

_SECTIONS: Final = {"domain": DOMAIN_SECTIONS, "problem": PROBLEM_SECTIONS}


def comments(text: str, kind: Literal["domain", "problem"]) -> Table:
    """Return the comments of a domain or a problem that can be read."""
    if ";" not in text:
        return {}
    ends: dict[int, int] = {}
    remarks: list[Remark] = []
    opened: list[int] = []
    for token, offset in tokens(text):
        if token == "(":
            opened.append(offset)
        elif token == ")" and opened:
            ends[opened.pop()] = offset + 1
        elif token[0] == ";":
            remarks.append(Remark(token.rstrip(), offset))
    found = items(define(text, "", kind, _SECTIONS[kind]), kind, ends)
    verbatim = [(item.start, item.end) for item in found if item.opaque]
    own = [remark for remark in remarks if not any(start < remark.offset < end for start, end in verbatim)]
    return attached(own, found, Lines.of(text), _Below(found).path)


class _Below:
    """Tells whether a comment stands at the end of a list, and under which of its parts."""

    def __init__(self, found: list[Item]) -> None:
        self._whole = {item.path: item for item in found}
        sections = [item for item in found[1:] if self._around(item.path) == found[0]]
        self._last_section = max(sections, key=lambda item: item.start, default=found[0])

    def path(self, remark: Remark, last: Item | None, following: Item | None) -> Path | None:
        """Return the part under which the comment stands, or None if another one follows in the list."""
        if last is None:
            return None
        if remark.offset >= self._whole[last.path[:1]].end:
            return self._last_section.path
        around = last
        with_variables = last.path
        while around.end <= remark.offset:
            with_variables = around.path
            around = self._around(with_variables)
        return with_variables if following is None or following.start >= around.end else None

    def _around(self, path: Path) -> Item:
        path = path[:-1]
        while path not in self._whole:
            path = path[:-1]
        return self._whole[path]
