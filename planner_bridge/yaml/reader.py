"""Domains and problems from YAML files in the language, with the comments in them."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import yaml

from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl.comments.table import Anchor, AnchorPath, Comment, LineIndex, Table, attach
from planner_bridge.pddl.read.attach_comments import find_anchors
from planner_bridge.pddl.read.reader import domain_from, problem_from
from planner_bridge.pddl.syntax.expressions import Source
from planner_bridge.yaml.sections import Definitions, definitions
from planner_bridge.yaml.write_domain import SCHEMA_MARK
from pnm.files.text import read_text
from pnm.files.yaml_loader import compose
from pnm.files.yaml_nodes import MAX_BYTES, Mapped

_COMMENT: Final = re.compile(r"(?:(?<=\s)|(?<=\A)|(?<=\ufeff))#[^\r\n]*")
_CODE: Final = re.compile(r"^([ \t]*)[^\s#]", re.MULTILINE)
"""The beginning of a line that has more than a comment."""
_MARK: Final = re.compile(r"#+")


@dataclass(frozen=True, slots=True)
class Contents:
    """What a YAML file says, as far as PDDL can say it."""

    domain: Domain
    problem: Problem | None
    comments: Table

    def of(self, kind: str) -> Table:
        """Return the comments of the domain, or of the problem."""
        return {path: note for path, note in self.comments.items() if path[:1] == (kind,)}


def read(path: Path) -> Contents:
    """Read a YAML file.

    Raises:
        InputError: the file cannot be read, is not such YAML, or says what PDDL cannot.
    """
    return parse(read_text(path, MAX_BYTES), str(path))


def parse(text: str, file: str) -> Contents:
    """Read the text of a YAML file.

    Raises:
        InputError: it is not such YAML, or says what PDDL cannot.
    """
    nodes = compose(text, file)
    found = definitions([Mapped.of(node, file) for node in nodes], Source(file, text))
    domain = domain_from(found.domain)
    problem = problem_from(found.problem, domain) if found.problem else None
    return Contents(domain, problem, _comments(text, nodes, found) if "#" in text else {})


# --- comments ------------------------------------------------------------------------------


def _comments(text: str, nodes: Iterable[yaml.Node], found: Definitions) -> Table:
    """Return the comments, as PDDL writes them, and what they are about."""
    things = find_anchors(found.domain, "domain", {})
    if found.problem:
        things += [item for item in find_anchors(found.problem, "problem", {}) if item.path[1:] != (":domain",)]
    lines = LineIndex.of(text)
    remarks = [Comment(_MARK.sub(lambda marks: ";" * len(marks[0]), one.text, count=1), one.offset) for one in _remarks(text, nodes)]
    return attach(remarks, things, lines, _Below({thing.path: thing.start for thing in things}, lines).path)


def _remarks(text: str, nodes: Iterable[yaml.Node]) -> Iterator[Comment]:
    """Yield what begins with ``#`` outside of scalars."""
    spans = sorted((node.start_mark.index, node.end_mark.index) for node in _quoted(nodes))
    starts = [start for start, _ in spans]
    for match in _COMMENT.finditer(text):
        before = bisect_right(starts, match.start())
        if match.group().startswith(SCHEMA_MARK):
            continue
        if not before or spans[before - 1][1] <= match.start():
            yield Comment(match.group().rstrip(), match.start())


def _quoted(nodes: Iterable[yaml.Node]) -> Iterator[yaml.Node]:
    waiting = [*nodes]
    while waiting:
        node = waiting.pop()
        if isinstance(node, yaml.MappingNode):
            waiting.extend(part for pair in node.value for part in pair)
        elif isinstance(node, yaml.SequenceNode):
            waiting.extend(node.value)
        elif isinstance(node, yaml.ScalarNode) and node.style is not None:
            yield node


@dataclass(frozen=True, slots=True)
class _Below:
    """Tells by the columns whether a comment stands under something, or above what follows."""

    starts: dict[AnchorPath, int]
    """Where things begin."""
    lines: LineIndex

    def path(self, remark: Comment, last: Anchor | None, following: Anchor | None) -> AnchorPath | None:
        column = self.lines.column(remark.offset)
        code = _CODE.search(self.lines.text, remark.offset)
        if last is None or (following is not None and code and column <= len(code[1])):
            return None
        path = last.path
        while path and (path not in self.starts or self.lines.indent(self.starts[path]) > column):
            path = path[:-1]
        return path or last.path[:1]
