"""The comments of a YAML file, and the things they are about: named as in PDDL, so that they find their place there.

`planner_bridge.pddl.forms` has the names of things; where they stand is found here, in the values of the language.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Final

import yaml

from planner_bridge.model.problem import Domain
from planner_bridge.pddl.comments import Anchor, AnchorPath, Comment, LineIndex, Table, attach
from planner_bridge.pddl.forms import (
    ACTION,
    COMPOUND,
    Form,
    condition_form,
    effects_form,
    fact_anchor,
    form_anchor,
    hierarchy_anchor,
    rule_anchor,
)
from planner_bridge.pddl.writer import change_form, constraint_form, preference_form, rule_form
from planner_bridge.yaml.read_constraints import is_about_states, read_constraint, read_preference
from planner_bridge.yaml.write_domain import SCHEMA_MARK
from pnm.core.logic.domain import ActionSchema
from pnm.errors import Position
from pnm.files.yaml_nodes import Mapped, Node
from pnm.language.domain import declaration_parts, read_facts
from pnm.language.formulas.conditions import read_condition
from pnm.language.formulas.effects import ConditionsByMoment, read_effects
from pnm.language.formulas.scope import ANYTHING, read_names

_COMMENT: Final = re.compile(r"(?:(?<=\s)|(?<=\A)|(?<=\ufeff))#[^\r\n]*")
_CODE: Final = re.compile(r"^([ \t]*)[^\s#]", re.MULTILINE)
"""The beginning of a line that has more than a comment."""
_MARK: Final = re.compile(r"#+")
_PARTS: Final = {"params": "parameters", "duration": "duration", "preconditions": "condition", "effects": "effect"}
"""The keys of an action, and what PDDL's comments call them."""
_FORMULAS: Final = ("condition", "at_start", "effects")
"""The keys of a quantifier or of ``when`` that have formulas."""


def comments(text: str, nodes: Iterable[yaml.Node], document: Mapped, domain: Domain) -> Table:
    """Return the comments in the file of a domain, marked as in PDDL, given its documents and the one that has the domain."""
    lines = LineIndex.of(text)
    anchors = [*_Anchors(lines, domain).of_document(document)]
    texts = ((_MARK.sub(lambda marks: ";" * len(marks[0]), remark.text, count=1), remark.offset) for remark in _remarks(text, nodes))
    remarks = [Comment(marked, offset) for marked, offset in texts]
    return attach(remarks, anchors, lines, _Outline({anchor.path: anchor.start for anchor in anchors}, lines).thing_above)


def _remarks(text: str, nodes: Iterable[yaml.Node]) -> Iterator[Comment]:
    """Yield the texts that begin with ``#`` outside of scalars."""
    spans: list[tuple[int, int]] = []
    waiting = [*nodes]
    while waiting:
        node = waiting.pop()
        if isinstance(node, yaml.MappingNode):
            waiting.extend(part for pair in node.value for part in pair)
        elif isinstance(node, yaml.SequenceNode):
            waiting.extend(node.value)
        elif isinstance(node, yaml.ScalarNode) and node.style is not None:
            spans.append((node.start_mark.index, node.end_mark.index))
    spans.sort()
    starts = [start for start, _ in spans]
    for match in _COMMENT.finditer(text):
        before = bisect_right(starts, match.start())
        if match.group().startswith(SCHEMA_MARK):
            continue
        if not before or spans[before - 1][1] <= match.start():
            yield Comment(match.group().rstrip(), match.start())


@dataclass(frozen=True, slots=True)
class _Outline:
    """The columns of things, by which a comment stands under one of them, or above what follows."""

    starts: dict[AnchorPath, int]
    """The beginnings of things."""
    lines: LineIndex

    def thing_above(self, remark: Comment, last: Anchor | None, following: Anchor | None) -> AnchorPath | None:
        column = self.lines.column(remark.offset)
        code = _CODE.search(self.lines.text, remark.offset)
        if last is None or (following is not None and code and column <= len(code[1])):
            return None
        path = last.path
        while path and (path not in self.starts or self.lines.indent(self.starts[path]) > column):
            path = path[:-1]
        return path or last.path[:1]


# --- the things of a file ------------------------------------------------------------------


def _condition(node: Node) -> Form:
    return condition_form(read_condition(node))


def _effect(node: Node) -> Form:
    return effects_form(read_effects(node).effects)


@dataclass(frozen=True, slots=True)
class _Anchors:
    lines: LineIndex
    domain: Domain

    def of_document(self, top: Mapped) -> Iterator[Anchor]:
        yield self._item(("domain",), top.nodes["name"][0] if "name" in top.nodes else Position(top.file, 1, 1))
        yield from self._sections(top, ("domain",))
        for key, where, node in top.entries():
            if key == "problem" and not node.is_null:
                yield self._item(("problem",), where)
                yield from self._sections(node.mapped(), ("problem",))

    def _item(self, path: AnchorPath, position: Position, *, opaque: bool = False) -> Anchor:
        offset = self.lines.starts[position.line - 1] + position.column - 1
        return Anchor(path, offset, offset + 1, opaque)

    def _sections(self, entry: Mapped, path: AnchorPath) -> Iterator[Anchor]:
        for key, where, node in entry.entries():
            section, items = (*path, f":{key}"), node.listed
            match key:
                case "requirements" | "types" | "constants" | "objects" | "predicates" | "functions" | "init" | "goal" | "metric":
                    yield self._item(section, where)
                    yield from self._inside(key, node, section)
                case "constraints":
                    yield self._item(section, where)
                    for item in items:
                        yield self._item((*section, form_anchor(constraint_form(read_constraint(item, ANYTHING)))), item.position)
                case "preferences":
                    for item in items:
                        holder = (*path, ":goal" if is_about_states(item) else ":constraints")
                        yield self._item((*holder, form_anchor(preference_form(read_preference(item, ANYTHING)))), item.position)
                case "derived":
                    for item, rule in zip(items, self.domain.rules, strict=True):
                        inner = (*path, section[-1], rule_anchor(rule_form(rule)))
                        yield self._item(inner, item.position)
                        yield from self._formulas(item.mapped().needed("condition"), inner, _condition)
                case "hierarchy" | "network":
                    for item in items:
                        yield self._item((*path, *hierarchy_anchor(item.written)), item.position, opaque=True)
                case "actions" if not node.is_null:
                    for name, position, action in node.mapped().entries():
                        yield from self._action(self.domain.actions[name], position, action, path)

    def _inside(self, key: str, node: Node, path: AnchorPath) -> Iterator[Anchor]:
        """Yield the things in a section that has names, declarations, facts or a formula."""
        if key == "goal" and not node.is_null:
            yield from self._formulas(node, path, _condition)
        for item in node.listed:
            match key:
                case "types" | "constants" | "objects" if not item.is_null:
                    yield from (self._item((*path, name.lower()), item.position_of(name)) for name in read_names(item))
                case "predicates" | "functions":
                    yield self._item((*path, declaration_parts(item)[0].lower()), item.position)
                case "init" if item.is_mapping:
                    time = item.mapped().needed("at").written
                    for fact in item.mapped().listed("facts"):
                        yield self._item((*path, fact_anchor(["at", time, _fact(fact)])), fact.position)
                case "init":
                    yield self._item((*path, fact_anchor(_fact(item))), item.position)

    def _action(self, schema: ActionSchema, position: Position, action: Node, path: AnchorPath) -> Iterator[Anchor]:
        inner = (*path, ACTION, schema.name.lower())
        yield self._item(inner, position)
        for key, where, node in () if action.is_null else action.mapped().entries():
            if key in _PARTS:
                yield self._item((*inner, _PARTS[key]), where)
            if key in ("preconditions", "effects") and not node.is_null:
                yield from self._formulas(node, (*inner, _PARTS[key]), _condition if key == "preconditions" else _effect)
            if key == "preferences":
                if "preconditions" not in action.mapped().nodes:
                    yield self._item((*inner, "condition"), where)
                for item in node.listed:
                    preference = read_preference(item, ANYTHING, timed=schema.duration is not None)
                    yield self._item((*inner, "condition", form_anchor(preference_form(preference))), item.position)

    def _formulas(self, node: Node, path: AnchorPath, form: Callable[[Node], Form]) -> Iterator[Anchor]:
        """Yield conditions or effects that stand beside each other, and those in them; ``and`` and moments are looked through."""
        entries = node.mapped().entries() if node.is_mapping else ()
        keys = [key.lower() for key, _, _ in entries]
        if node.items is not None:
            for item in node.items:
                yield from self._formulas(item, path, form)
        elif keys in (["and"], ["logicaland"]) or (keys and set(keys) <= set(ConditionsByMoment.known)):
            for _, _, value in entries:
                yield from self._formulas(value, path, form)
        elif not node.is_null and (keys or not node.is_mapping):
            whole = form(node)
            inner = (*path, form_anchor(whole))
            yield self._item(inner, node.position)
            for part, own_form in _parts(whole, node, form):
                yield from self._formulas(part, inner, own_form)


def _fact(node: Node) -> Form:
    ((fluent, value),) = read_facts((node,), ANYTHING).items()
    return change_form(fluent, value)


def _parts(whole: Form, node: Node, form: Callable[[Node], Form]) -> Iterator[tuple[Node, Callable[[Node], Form]]]:
    """Yield the formulas in another that comments can be about, each with how it is read: the negation of a fact has none."""
    match whole:
        case ["not", [str() as head, *_]] if head not in COMPOUND and head != "and":
            return
        case [str() as head, *_] if head in COMPOUND:
            argument = node.mapped().entries()[0][2]
        case _:
            return
    entries = argument.mapped().entries() if argument.is_mapping else ()
    if any(key in _FORMULAS for key, _, _ in entries):
        yield from ((value, _effect if key == "effects" else _condition) for key, _, value in entries if key in _FORMULAS)
    else:
        yield argument, form
