"""Domains: the model that people and planners share, and how its actions are executed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Final

from pnm.core.logic.conditions import TRUE, Condition
from pnm.core.logic.domain import ProblemModel
from pnm.core.logic.rules import NO_RULES, Rules
from pnm.errors import Tolerated
from pnm.files.yaml_nodes import Mapped, Node
from pnm.knowledge.sources.registry import Choice, check_source
from pnm.language.actions import ACTION_KEYS, LanguageAction, read_action, read_class, read_schema
from pnm.language.declarations import read_declarations, read_derived, read_initial
from pnm.language.formulas.conditions import read_condition
from pnm.language.formulas.scope import NOTHING_DECLARED, Scope, shown

DOMAIN_KEYS: Final = (
    *("name", "instances", "external_knowledge_base", "knowledge", "action_types", "actions"),
    *("requirements", "types", "constants", "predicates", "functions", "derived", "constraints", "preferences", "hierarchy", "problem"),
)
PROBLEM_KEYS: Final = ("name", "objects", "init", "goal", "metric", "constraints", "preferences", "requirements", "network")


@dataclass(frozen=True)
class LanguageDomain:
    """A domain and its problem, and how the actions are executed, by name."""

    model: ProblemModel = NOTHING_DECLARED
    """With the section ``problem``, if there is one."""
    actions: Mapping[str, LanguageAction] = field(default_factory=dict)
    rules: Rules = NO_RULES
    """Those of the model, stratified."""
    sources: tuple[Choice, ...] = ()
    """The sources of knowledge that the file chose."""
    warnings: tuple[Tolerated, ...] = ()
    """What in the file was tolerated though it is not as it should be."""
    file: str = ""
    """Where it was read from."""


def domain_from(top: Mapped, warnings: tuple[Tolerated, ...] = ()) -> LanguageDomain:
    """Read a domain from a document that may have other keys as well.

    Raises:
        InputError: something is malformed, or has names that are not there.
    """
    for entry in top.mapping("action_types").values():
        entry.only(*ACTION_KEYS)  # only anchors are made there; their contents are read where they are used
    model, rules = read_model(top)
    entries = top.mapping("actions")
    return LanguageDomain(
        model,
        {name: read_action(schema, entries[name], Scope(model)) for name, schema in model.domain.actions.items()},
        rules,
        sources=(*_external(top), *_chosen(top)),
        warnings=warnings,
        file=top.file,
    )


def read_model(top: Mapped, *, strict: bool = False) -> tuple[ProblemModel, Rules]:
    """Read the domain of a document and its problem, and the rules in their strata.

    Args:
        top: the document.
        strict: whether planners are to understand it; see `pnm.language.formulas.scope.Scope`.

    Raises:
        InputError: something is malformed, or has names that are not there.
    """
    section = problem_section(top)
    declared = read_declarations(top, section, strict=strict)
    scope = Scope(declared, {}, strict, borrows=section is None)
    rules = read_derived(top, scope)
    domain = replace(declared.domain, rules=rules.rules)
    scope = replace(scope, declared=replace(declared, domain=domain))
    domain = replace(domain, actions={name: read_schema(name, entry, scope) for name, entry in top.mapping("actions").items()})
    if section is None:
        return replace(declared, domain=domain), rules
    facts, timed = read_initial(section, scope)
    return replace(declared, domain=domain, init=facts, timed=timed, goal=read_goal(section, scope)), rules


def problem_section(top: Mapped) -> Mapped | None:
    """Return the section ``problem``, None without one.

    Raises:
        InputError: it has an unknown key.
    """
    node = top.node("problem")
    if node is None or node.is_null:
        return None
    section = node.mapped()
    section.only(*PROBLEM_KEYS)
    return section


def read_goal(entry: Mapped, scope: Scope) -> Condition:
    """Read the key ``goal``; true when it is not there."""
    node = entry.node("goal")
    return TRUE if node is None or node.is_null else read_condition(node, scope)


def _external(top: Mapped) -> tuple[Choice, ...]:
    """Read which source stands for the class that a file for the original implementation names."""
    node = top.node("external_knowledge_base")
    if node is None or node.is_null:
        return ()
    module, name = read_class(node)
    return (Choice(check_source(f"{module}.{name}", node.position), {}, node.position),)


def _chosen(top: Mapped) -> tuple[Choice, ...]:
    """Read ``knowledge``: names of sources, or ``{name: {option: value}}``; one, or a list of them."""
    node = top.node("knowledge")
    if node is None or node.is_null:
        return ()
    return tuple([choice for item in ((node,) if node.items is None else node.items) for choice in _choices(item)])


def _choices(node: Node) -> list[Choice]:
    if node.text is not None:
        return [Choice(check_source(node.text, node.position), {}, node.position)]
    if not node.is_mapping:
        raise node.wrong(f"expected the name of a source of knowledge, found {shown(node)}")
    found: list[Choice] = []
    for name, position, options in node.mapped().entries():
        plain = {} if options.is_null else options.plain()
        if not isinstance(plain, dict):
            raise options.wrong(f"expected options of {name} (option: value), found {shown(options)}")
        found.append(Choice(check_source(name, position), plain, position))
    return found
