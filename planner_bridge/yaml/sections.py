"""The documents of a YAML file as the sections of a PDDL domain and of a PDDL problem."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from difflib import get_close_matches
from pathlib import Path
from typing import Final

from planner_bridge.pddl.read.reader import HIERARCHY, NETWORK
from planner_bridge.pddl.read.sections import Definition
from planner_bridge.pddl.syntax.expressions import Atom, Group, Source, parse, tolerate
from planner_bridge.pddl.syntax.expressions import Node as Part
from planner_bridge.pddl.syntax.words import new_name
from planner_bridge.yaml.nodes import Parts
from pnm.errors import InputError, Position
from pnm.files.yaml_nodes import Mapped, Node
from pnm.language.actions import ACTION_KEYS
from pnm.language.domain import DOMAIN_KEYS
from pnm.language.files import PLAN_KEYS
from pnm.language.formulas.words import needed_form

_LEFT_OUT: Final = ("instances", "external_knowledge_base", "knowledge", "action_types")
"""What a domain may say besides, and PDDL does not."""
_PDDL_PARTS: Final = ("params", "preconditions", "effects", "duration", "preferences")
_PROBLEM_KEYS: Final = ("name", "requirements", "objects", "init", "goal", "metric", "constraints", "preferences", "network")
_OPERATORS: Final = {
    "always": (0, 1),
    "sometime": (0, 1),
    "at-most-once": (0, 1),
    "at_end": (0, 1),
    "sometime-after": (0, 2),
    "sometime-before": (0, 2),
    "within": (1, 1),
    "always-within": (1, 2),
    "hold-during": (2, 1),
    "hold-after": (1, 1),
}
"""For every constraint, how many times and how many conditions it takes."""


@dataclass(frozen=True, slots=True)
class Definitions:
    """What a file defines."""

    domain: Definition
    problem: Definition | None


def definitions(documents: Iterable[Mapped], source: Source) -> Definitions:
    """Return the sections of the domain in a file, and of its problem.

    Raises:
        InputError: there is no domain, or something is malformed.
    """
    found: Definitions | None = None
    for document in documents:
        if document.nodes.keys().isdisjoint(set(DOMAIN_KEYS) - {"name"}):
            continue
        document.only(*DOMAIN_KEYS, *PLAN_KEYS)
        if found is not None:
            raise InputError("there is a domain in this file already", document.start)
        found = _Cutter(Parts(source)).definitions(document)
    if found is None:
        raise InputError("there is no domain in the file; expected the key 'actions'", Position(source.file, 1, 1))
    return found


@dataclass(frozen=True)
class _Cutter:
    parts: Parts
    texts: dict[int, str] = field(default_factory=dict)
    """Of sections that are kept as they stand."""

    def definitions(self, top: Mapped) -> Definitions:
        start = self._key_offset(top, "name") if "name" in top.nodes else 0
        name = self._name(top, "name", Path(self.parts.source.file).stem, start)
        domain = self._definition("domain", name, start, self._domain(top))
        node = top.node("problem")
        if node is None or node.is_null:
            return Definitions(domain, None)
        entry = node.mapped()
        entry.only(*_PROBLEM_KEYS)
        offset = self._key_offset(top, "problem")
        own = self._name(entry, "name", name.text, offset)
        sections = [self.parts.headed(":domain", (name,), offset), *self._problem(entry)]
        return Definitions(domain, self._definition("problem", own, offset, sections))

    def _definition(self, kind: str, name: Atom, offset: int, sections: Iterable[Group]) -> Definition:
        found = tuple(sections)
        head = self.parts.headed(kind, (name,), offset)
        return Definition(new_name(name, kind), self.parts.headed("define", (head, *found), offset), found, self.texts)

    def _name(self, entry: Mapped, key: str, default: str, offset: int) -> Atom:
        node = entry.node(key)
        if node is None or node.is_null:
            return self.parts.atom(default, offset)
        found = self.parts.one(node, "a name")
        if not isinstance(found, Atom):
            raise node.wrong(f"expected a name, found {found}")
        return found

    # --- sections ---

    def _domain(self, top: Mapped) -> Iterator[Group]:
        for key in _LEFT_OUT:
            if key in top.nodes:
                tolerate(self.parts.atom(key, self._key_offset(top, key)), f"{key!r} is left out: PDDL has nothing like it")
        yield from self._declared(top, "requirements", "types", "constants", "predicates", "functions")
        yield from self._each(top, "derived", self._rule)
        for preference in self._listed(top, "preferences"):
            preference.mapped().needed("constraints")  # no state that could be preferred is known here
        yield from self._constraints(top)
        yield from self._each(top, "hierarchy", lambda node: self._verbatim(node, HIERARCHY))
        actions = top.node("actions")
        if actions is not None and not actions.is_null:
            for name, where, node in actions.mapped().entries():
                yield self._action(name, self._offset(where), Mapped(top.file, where, {}) if node.is_null else node.mapped())

    def _problem(self, entry: Mapped) -> Iterator[Group]:
        yield from self._declared(entry, "requirements", "objects")
        yield from self._each(entry, "network", self._network)
        if "init" in entry.nodes:
            yield self._section(entry, "init", self._facts(entry.needed("init")))
        yield from self._goal(entry)
        yield from self._constraints(entry)
        metric = entry.node("metric")
        if metric is not None and not metric.is_null:
            found = needed_form(metric, ("minimize", "maximize"), "a metric")
            offset = self._offset(found.position)
            yield self._section(entry, "metric", (self.parts.atom(found.word, offset), self.parts.expression(found.argument)))

    def _declared(self, entry: Mapped, *keys: str) -> Iterator[Group]:
        for key in keys:
            if key in entry.nodes:
                words: tuple[Part, ...] = self.parts.texts(entry.node(key), "number" if key == "functions" else "object")
                if key == "requirements":
                    words = tuple(
                        [self.parts.atom(f":{one.text.lstrip(':')}", one.offset) if isinstance(one, Atom) else one for one in words]
                    )
                yield self._section(entry, key, words)

    def _section(self, entry: Mapped, key: str, items: Iterable[Part]) -> Group:
        return self.parts.headed(f":{key}", items, self._key_offset(entry, key))

    def _each(self, entry: Mapped, key: str, read: Callable[[Node], Group]) -> Iterator[Group]:
        node = entry.node(key)
        if node is not None and not node.is_null:
            yield from map(read, (node,) if node.items is None else node.items)

    def _rule(self, node: Node) -> Group:
        entry = node.mapped()
        entry.only("fact", "condition")
        head = self.parts.fact(entry.needed("fact"), "a fact such as (reachable ?p - place)")
        return self.parts.headed(":derived", (head, self.parts.condition(entry.needed("condition"))), self.parts.offset(node))

    def _verbatim(self, node: Node, heads: tuple[str, ...]) -> Group:
        """Read a section that is kept as it stands; a section of its keyword and its name stands for it."""
        if node.text is None:
            raise node.wrong(f"expected the text of {' or '.join(heads)}")
        found = parse(node.text, self.parts.source.file) if node.text else ()
        match found:
            case (Group() as group, *_) if group.head in heads:
                name = [self.parts.atom(one.text, self.parts.offset(node)) for one in group.rest[:1] if isinstance(one, Atom)]
                self.texts[self.parts.offset(node)] = node.text
                return self.parts.headed(group.head, name, self.parts.offset(node))
            case _:
                raise node.wrong(f"expected the text of {' or '.join(heads)}")

    def _network(self, node: Node) -> Group:
        return self._verbatim(node, NETWORK)

    # --- constraints and preferences ---

    def _constraints(self, entry: Mapped) -> Iterator[Group]:
        """Read what must be so all the time, and what should."""
        found = [self._constraint(one) for one in self._listed(entry, "constraints")]
        found += [self._preference(one) for one in self._listed(entry, "preferences") if "constraints" in one.mapped().nodes]
        if found or "constraints" in entry.nodes:
            offset = self._key_offset(entry, "constraints" if "constraints" in entry.nodes else "preferences")
            yield self.parts.headed(":constraints", (self.parts.headed("and", found, offset),), offset)

    def _listed(self, entry: Mapped, key: str) -> tuple[Node, ...]:
        node = entry.node(key)
        return () if node is None or node.is_null else (node,) if node.items is None else node.items

    def _constraint(self, node: Node) -> Part:
        offset = self.parts.offset(node)
        found = needed_form(node, (*_OPERATORS, "forall"), "a constraint")
        if found.word == "forall":
            entry = found.argument.mapped()
            entry.only("variables", "constraint")
            return self._under(entry.needed("variables"), self._constraint(entry.needed("constraint")), offset)
        times, conditions = _OPERATORS[found.word]
        items = found.items(times + conditions) if times + conditions > 1 else (found.argument,)
        parts = [*map(self.parts.expression, items[:times]), *map(self.parts.condition, items[times:])]
        return self.parts.headed(found.word.replace("_", " "), parts, offset)

    def _under(self, variables: Node, body: Part, offset: int) -> Part:
        """Put quantifiers around a part: one for each text, which may hide variables of those outside of it."""
        for node in reversed((variables,) if variables.items is None else variables.items):
            body = self.parts.headed("forall", (self.parts.group(self.parts.text(node), self.parts.offset(node)), body), offset)
        return body

    def _preference(self, node: Node) -> Part:
        entry = node.mapped()
        entry.only("name", "variables", "moment", "condition", "constraints")
        offset = self.parts.offset(node)
        if "constraints" in entry.nodes:
            body: Part = self.parts.headed("and", map(self._constraint, self._listed(entry, "constraints")), offset)
        else:
            body = self.parts.condition(entry.needed("condition"))
        moment = entry.string("moment")
        if moment is not None:
            known = ("at_start", "over_all", "at_end")
            if moment not in known:
                near = get_close_matches(moment, known, 1) or known
                raise InputError(f"unknown moment {moment!r}; did you mean {near[0]!r}?", entry.position("moment"))
            body = self.parts.headed(moment.replace("_", " "), (body,), offset)
        name = [self._name(entry, "name", "", offset)] if "name" in entry.nodes else []
        found = self.parts.headed("preference", (*name, body), offset)
        return self._under(entry.needed("variables"), found, offset) if "variables" in entry.nodes else found

    def _wanted(self, entry: Mapped, parts: list[Part]) -> list[Part]:
        """Add the preferences about states to what must hold."""
        soft = [self._preference(one) for one in self._listed(entry, "preferences") if "constraints" not in one.mapped().nodes]
        return [*parts, *soft]

    def _goal(self, entry: Mapped) -> Iterator[Group]:
        node = entry.node("goal")
        hard = [] if node is None or node.is_null else [self.parts.condition(node)]
        found = self._wanted(entry, hard)
        if node is not None or found:
            offset = self._key_offset(entry, "goal" if node is not None else "preferences")
            yield self.parts.headed(":goal", (self.parts.headed("and", found, offset),), offset)

    # --- actions ---

    def _action(self, name: str, offset: int, entry: Mapped) -> Group:
        entry.only(*ACTION_KEYS)
        for key in entry.nodes:
            if key not in _PDDL_PARTS:
                tolerate(self.parts.atom(key, self._key_offset(entry, key)), f"{key!r} of {name} is left out: PDDL has nothing like it")
        durative = "duration" in entry.nodes
        parts: list[Part] = [self.parts.atom(name, offset)]
        if "params" in entry.nodes:
            parts += self._part(entry, "params", ":parameters", self._parameters(entry.needed("params")))
        if durative:
            parts += self._part(entry, "duration", ":duration", self.parts.duration(entry.needed("duration")))
        wanted = self._conditions(entry, durative)
        if wanted is not None:
            key = "preconditions" if "preconditions" in entry.nodes else "preferences"
            parts += self._part(entry, key, ":condition" if durative else ":precondition", wanted)
        effects = entry.node("effects")
        if effects is not None and not effects.is_null:
            parts += self._part(entry, "effects", ":effect", self.parts.moments(effects, True) if durative else self.parts.effects(effects))
        return self.parts.headed(":durative-action" if durative else ":action", parts, offset)

    def _part(self, entry: Mapped, key: str, keyword: str, value: Part) -> list[Part]:
        return [self.parts.atom(keyword, self._key_offset(entry, key)), value]

    def _parameters(self, node: Node) -> Group:
        """Read typed variables; in a list, names may stand without their ``?``."""
        words = self.parts.texts(node)
        return self.parts.group(words if node.items is None else self._marked(words), self.parts.offset(node))

    def _marked(self, words: tuple[Part, ...]) -> Iterator[Part]:
        is_type = False
        for word in words:
            if isinstance(word, Atom) and not is_type and word.text[0] not in "?-":
                yield self.parts.atom(f"?{word.text}", word.offset)
            else:
                yield word
            is_type = isinstance(word, Atom) and word.text == "-"

    def _conditions(self, entry: Mapped, durative: bool) -> Part | None:
        node = entry.node("preconditions")
        hard: list[Part] = []
        if node is not None and not node.is_null:
            hard.append(self.parts.moments(node, False) if durative else self.parts.condition(node))
        found = self._wanted(entry, hard)
        return self.parts.headed("and", found, found[0].offset) if found else None

    # --- facts ---

    def _facts(self, node: Node) -> Iterator[Part]:
        for item in (node,) if node.items is None else node.items:
            if not item.is_mapping:
                yield self.parts.fact(item, "a fact such as (at r1 kitchen) or (= (battery r1) 80)")
                continue
            entry = item.mapped()
            entry.only("at", "facts")
            time = entry.needed("at")
            for change in self._listed(entry, "facts"):
                offset = self.parts.offset(change)
                yield self.parts.headed("at", (self.parts.one(time, "a time"), self.parts.fact(change)), offset)

    # --- offsets ---

    def _key_offset(self, entry: Mapped, key: str) -> int:
        return self._offset(entry.nodes[key][0])

    def _offset(self, position: Position) -> int:
        return self.parts.source.offset(position)
