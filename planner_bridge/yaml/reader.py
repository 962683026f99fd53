"""Domains and problems from YAML files in the language, with the comments in them.

`pnm.language` reads what people and planners share; what only planners need is read here: requirements,
constraints, preferences, metrics, and task networks, which are kept as their HDDL text.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl.comments import Table
from planner_bridge.pddl.expressions import CONNECTIVES, NAME, NUMBER, Group, with_article
from planner_bridge.pddl.expressions import parse as parse_lists
from planner_bridge.pddl.reader import HIERARCHY, NETWORK
from planner_bridge.yaml.read_comments import comments
from planner_bridge.yaml.read_constraints import is_about_states, read_constraint, read_metric, read_preference
from pnm.actions.bindings_file import read_binding
from pnm.core.logic.domain import ActionSchema, DomainModel, Preference, ProblemModel
from pnm.core.logic.expressions import DURATION, Variable
from pnm.core.machine.bindings import Bindings
from pnm.errors import InputError, Position, Tolerated
from pnm.files.text import read_text
from pnm.files.yaml_nodes import MAX_BYTES, Mapped, Node, compose
from pnm.language.domain import read_model
from pnm.language.files import ANCHORS, domain_document
from pnm.language.formulas.scope import FormulaScope, shown
from pnm.language.grammar import BINDING_KEYS, DomainKeys, NamedPlan, ProblemKeys

_LEFT_OUT: Final = ("instances", "external_knowledge_base", "knowledge", "action_types")
"""The keys of a domain that PDDL has nothing like."""
_KEYS: Final = {**NamedPlan.known, **DomainKeys.known}
_KEPT: Final = ("params", "preconditions", "effects", "duration", "preferences", *BINDING_KEYS)
"""The keys of an action that PDDL has, too, or a bindings file."""


@dataclass(frozen=True, slots=True)
class Contents:
    """A YAML file as planners see it."""

    domain: Domain
    problem: Problem | None
    comments: Table
    bindings: Bindings
    """The bindings of its actions to servers."""

    def of(self, kind: str) -> Table:
        """Return the comments of the domain, or of the problem."""
        return {path: note for path, note in self.comments.items() if path[:1] == (kind,)}


def read(path: Path) -> Contents:
    """Read a YAML file; raise `InputError` if the file cannot be read, is not such YAML, or has what PDDL has not."""
    return parse(read_text(path, MAX_BYTES), str(path))


def parse(text: str, file: str) -> Contents:
    """Read the text of a YAML file; raise `InputError` if it is not such YAML, or has what PDDL has not."""
    nodes = compose(text, file, ANCHORS)
    top = domain_document([Mapped.of(node, file) for node in nodes])
    if top is None:
        raise InputError("there is no domain in the file; expected the key 'actions'", Position(file, 1, 1))
    top.only(*_KEYS, *_recipes(top))
    keys = DomainKeys(top)
    model = read_model(keys, strict=True)
    if not model.domain.name:
        model = replace(model, name=model.name or Path(file).stem, domain=replace(model.domain, name=Path(file).stem))
    _check_names(model, keys)
    domain = _domain(model, keys)
    problem = None if top.filled("problem") is None else _problem(model, domain, keys.problem)
    bound = {name: read_binding(action) for name, action in keys.actions.items() if action.entry.nodes.keys() & BINDING_KEYS}
    return Contents(domain, problem, comments(text, nodes, top, domain) if "#" in text else {}, Bindings(bound))


def _domain(model: ProblemModel, keys: DomainKeys) -> Domain:
    top, written = keys.entry, keys.actions
    scope = FormulaScope(model, {}, strict=True, borrows=top.filled("problem") is None)
    actions: dict[str, ActionSchema] = {}
    for name, schema in model.domain.actions.items():
        timed = schema.duration is not None
        inner = scope.inside((*schema.parameters, *((Variable(DURATION[0]),) if timed else ())))
        soft: list[Preference] = []
        for node in written[name].preferences:
            node.mapped().needed("condition")
            soft.append(read_preference(node, inner, timed=timed))
        actions[name] = replace(schema, preferences=tuple(soft))
    for preference in keys.preferences:
        preference.mapped().needed("constraints")  # no state that could be preferred is known here
    left_out = [(f"{key!r}", top.nodes[key][0]) for key in (*_LEFT_OUT, *_recipes(top)) if key in top.nodes]
    for name, action in written.items():
        left_out += [(f"{key!r} of {name}", position) for key, (position, _) in action.entry.nodes.items() if key not in _KEPT]
    left_out.sort(key=lambda item: (item[1].line, item[1].column))
    return Domain(
        **{**_fields(model.domain), "actions": actions},
        requirements=_requirements(keys),
        constraints=tuple([read_constraint(node, scope) for node in keys.constraints]),
        preferences=tuple([read_preference(node, scope) for node in keys.preferences]),
        hierarchy=tuple([_hddl_text(node, HIERARCHY) for node in keys.hierarchy]),
        warnings=tuple([Tolerated(f"{what} is left out: PDDL has nothing like it", position) for what, position in left_out]),
    )


def _recipes(top: Mapped) -> list[str]:
    """Return the names of the plans that stand under their names."""
    others = top.nodes.keys() - _KEYS.keys()
    return [key for key, _, node in top.entries() if key in others and node.is_mapping and "plan" in node.mapped().nodes]


def _problem(model: ProblemModel, domain: Domain, section: ProblemKeys) -> Problem:
    scope = FormulaScope(model, {}, strict=True)
    soft = [read_preference(node, scope) for node in sorted(section.preferences, key=is_about_states, reverse=True)]
    every = (*soft, *domain.preferences, *(preference for schema in domain.actions.values() for preference in schema.preferences))
    return Problem(
        **{**_fields(model), "domain": domain, "init": {fluent: value for fluent, value in model.init.items() if value is not False}},
        metric=read_metric(section.metric, scope, {preference.name for preference in every if preference.name}),
        constraints=tuple([read_constraint(node, scope) for node in section.constraints]),
        preferences=tuple(soft),
        network="\n".join([_hddl_text(node, NETWORK) for node in section.network]),
        requirements=_requirements(section),
        warnings=domain.warnings,
    )


def _fields(model: DomainModel | ProblemModel) -> Mapping[str, Any]:
    kind = DomainModel if isinstance(model, DomainModel) else ProblemModel
    return {name: getattr(model, name) for name in kind.__dataclass_fields__}


def _requirements(keys: DomainKeys | ProblemKeys) -> tuple[str, ...]:
    """Read requirements, with or without their colons: a list of them, or a text of several."""
    words = [word for node in keys.requirements for word in node.written.split()]
    return tuple(dict.fromkeys(f":{word.lstrip(':').lower()}" for word in words))


def _hddl_text(node: Node, heads: tuple[str, ...]) -> str:
    """Read a section that is kept as its text."""
    lists = parse_lists(node.text, node.file) if node.text else ()
    if node.text and lists and isinstance(lists[0], Group) and lists[0].head in heads:
        return node.text
    raise node.wrong(f"expected the text of {' or '.join(heads)}, found {shown(node)}")


def _check_names(model: ProblemModel, keys: DomainKeys) -> None:
    """Refuse names that PDDL cannot have or cannot tell apart, and types that are kinds of themselves."""
    top, domain, section = keys.entry, model.domain, keys.entry.section("problem")
    _check_spelling("domain", [domain.name], top.node("name"))
    _check_spelling("problem", [model.name], section.node("name"))
    _check_spelling("requirement", [word[1:] for word in _requirements(keys)], top.node("requirements"))
    _check_spelling("type", domain.types, top.node("types"))
    _check_spelling("object", domain.constants, top.node("constants"))
    _check_spelling("object", model.own_objects, section.node("objects"))
    _check_spelling("predicate", domain.predicates, top.node("predicates"), CONNECTIVES)
    _check_spelling("function", domain.functions, top.node("functions"), CONNECTIVES)
    _check_spelling("action", domain.actions, top.node("actions"))
    for name, parents in domain.types.items():
        if any(name in domain.supertypes(parent) for parent in parents):
            raise InputError(f"the type {name!r} is a kind of itself", top.needed("types").position_of(name))
    for name, declared in domain.functions.items():
        same = domain.predicates.get(name)
        if same is not None and len(same.parameters) == len(declared.parameters):
            message = f"the function {name!r} has the name and the number of arguments of a predicate"
            raise InputError(message, top.needed("functions").position_of(name))


def _check_spelling(kind: str, names: Iterable[str], node: Node | None, forbidden: frozenset[str] = frozenset()) -> None:
    if node is None:
        return
    spelled: dict[str, str] = {}
    for name in names:
        if name.lower() in forbidden:
            raise InputError(f"{name!r} is a word of PDDL and cannot name {with_article(kind)}", node.position_of(name))
        if NAME.fullmatch(name) is None or NUMBER.fullmatch(name) is not None:
            message = f"{name!r} cannot name {with_article(kind)} in PDDL; expected letters, digits and _ - . @"
            raise InputError(message, node.position_of(name))
        if spelled.setdefault(name.lower(), name) != name:
            raise InputError(f"PDDL does not tell {name!r} from {spelled[name.lower()]!r}", node.position_of(name))
