"""The comments of a PDDL file, attached to the things they are about: sections, declarations, actions, conditions, facts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from planner_bridge.pddl.comments import Anchor, AnchorPath, Comment, CommentTable, LineIndex, attach
from planner_bridge.pddl.expressions import Atom, Group, Node, tokens
from planner_bridge.pddl.reader import DOMAIN_SECTIONS, HIERARCHY, NETWORK, PROBLEM_SECTIONS
from planner_bridge.pddl.sections import define, typed_runs
from planner_bridge.pddl.writer import ACTION, COMPOUND, PARTS, fact_anchor, form_anchor, form_of, is_timed, rule_anchor


def comments(text: str, kind: Literal["domain", "problem"]) -> CommentTable:
    """Return the comments of the text of a domain or a problem, which must be correct."""
    if ";" not in text:
        return {}
    ends: dict[int, int] = {}
    all_comments: list[Comment] = []
    opened: list[int] = []
    for token, offset in tokens(text):
        if token == "(":
            opened.append(offset)
        elif token == ")" and opened:
            ends[opened.pop()] = offset + 1
        elif token[0] == ";":
            all_comments.append(Comment(token.rstrip(), offset))
    definition = define(text, "", kind, DOMAIN_SECTIONS if kind == "domain" else PROBLEM_SECTIONS)
    finder = _AnchorFinder(ends)
    anchors = [finder.anchor(definition.whole, (kind,))]
    for section in definition.sections:
        anchors.extend(finder.section(section, (kind,)))
    verbatim = [(anchor.start, anchor.end) for anchor in anchors if anchor.opaque]
    free = [comment for comment in all_comments if not any(start < comment.offset < end for start, end in verbatim)]
    return attach(free, anchors, LineIndex.of(text), _ListEnds(anchors).owner_above)


class _ListEnds:
    """Decides whether a comment stands at the end of a list, and under which of its parts."""

    def __init__(self, anchors: list[Anchor]) -> None:
        self._anchors = {anchor.path: anchor for anchor in anchors}
        sections = [anchor for anchor in anchors[1:] if self._around(anchor.path) == anchors[0]]
        self._last_section = max(sections, key=lambda anchor: anchor.start, default=anchors[0])

    def owner_above(self, comment: Comment, last: Anchor | None, following: Anchor | None) -> AnchorPath | None:
        """Return the part under which the comment stands, or None if another one follows in the list."""
        if last is None:
            return None
        if comment.offset >= self._anchors[last.path[:1]].end:
            return self._last_section.path
        around = last
        under = last.path
        while around.end <= comment.offset:
            under = around.path
            around = self._around(under)
        return under if following is None or following.start >= around.end else None

    def _around(self, path: AnchorPath) -> Anchor:
        path = path[:-1]
        while path not in self._anchors:
            path = path[:-1]
        return self._anchors[path]


@dataclass(frozen=True, slots=True)
class _AnchorFinder:
    """Finds the things in a definition that comments can be about."""

    ends: Mapping[int, int]
    """For the offset of every list, the offset behind it."""

    def anchor(self, node: Node, path: AnchorPath, last: Node | None = None, opaque: bool = False) -> Anchor:
        behind = last or node
        end = behind.offset + len(behind.text) if isinstance(behind, Atom) else self.ends.get(behind.offset, behind.offset + 1)
        return Anchor(path, node.offset, end, opaque)

    def section(self, section: Group, path: AnchorPath) -> Iterator[Anchor]:
        head = section.head
        name = section.rest[0] if section.rest else section
        inner = (*path, head)
        if head in (*HIERARCHY, *NETWORK):  # kept as they stand, with the comments in them
            yield self.anchor(section, (*inner, name.key if isinstance(name, Atom) else ""), opaque=True)
        elif head == ":derived":
            inner = (*inner, rule_anchor(form_of(section)))
            yield self.anchor(section, inner)
            yield from self.formulas(section.rest[1:], inner)
        elif head in (":action", ":durative-action"):
            yield from self.action(section, (*path, ACTION, form_anchor(form_of(name))))
        else:
            yield self.anchor(section, inner)
            if head in (":types", ":constants", ":objects"):
                names = (name for names, _ in typed_runs(section.rest) for name in names)
                yield from (self.anchor(name, (*inner, name.key)) for name in names if isinstance(name, Atom))
            elif head in (":predicates", ":functions"):
                yield from (self.anchor(part, (*inner, part.head)) for part in section.rest if isinstance(part, Group))
            elif head == ":init":
                facts = (part for part in section.rest if isinstance(part, Group))
                yield from (self.anchor(fact, (*inner, fact_anchor(form_of(fact)))) for fact in facts)
            elif head in (":goal", ":constraints"):
                yield from self.formulas(section.rest, inner)

    def action(self, section: Group, path: AnchorPath) -> Iterator[Anchor]:
        yield self.anchor(section, path)
        for keyword, value in zip(section.rest[1::2], section.rest[2::2], strict=False):
            part = PARTS.get(form_anchor(form_of(keyword)), "")
            yield self.anchor(keyword, (*path, part), value)
            if part in ("condition", "effect"):
                yield from self.formulas((value,), (*path, part))

    def formulas(self, nodes: Iterable[Node], path: AnchorPath) -> Iterator[Anchor]:
        """Yield the anchors of conditions or effects that stand beside each other, and of the forms in them."""
        for node in nodes:
            if not isinstance(node, Group) or not node.items or node.head.startswith("?"):
                continue
            if node.head == "and":
                yield from self.formulas(node.rest, path)
            elif is_timed(form := form_of(node)):
                yield from self.formulas(node.items[2:], path)
            else:
                inner = (*path, form_anchor(form))
                yield self.anchor(node, inner)
                operand = node.rest[0] if node.rest else None
                is_compound = isinstance(operand, Group) and (operand.head in COMPOUND or operand.head == "and")
                if node.head in COMPOUND and (node.head != "not" or is_compound):
                    yield from self.formulas(node.rest, inner)
