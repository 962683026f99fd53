"""Domains: which actions there are, and what else executing plans needs to know. What only planners need is left alone.

What a domain declares as PDDL does, and the facts of a problem: from YAML.

Types, constants and objects are PDDL's text (``r1 r2 - robot``) or lists of such texts, predicates and functions lists
of texts such as ``(at ?r - robot ?p - place)`` and ``(location ?r - robot) - place``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

from pnm.core.logic.conditions import TRUE, Condition
from pnm.core.logic.effects import TimedChange
from pnm.core.logic.expressions import Fluent, Value
from pnm.core.logic.rules import NO_RULES, Rules
from pnm.errors import Tolerated
from pnm.files.yaml_nodes import Mapped, Node
from pnm.knowledge.sources.registry import Choice, check_source
from pnm.language.actions import ACTION_KEYS, LanguageAction, read_action, read_class
from pnm.language.declarations import NOTHING_DECLARED, Declared, read_declared, read_derived, read_initial
from pnm.language.formulas.conditions import read_condition
from pnm.language.formulas.scope import shown

DOMAIN_KEYS: Final = (
    *("name", "instances", "external_knowledge_base", "knowledge", "action_types", "actions"),
    *("requirements", "types", "constants", "predicates", "functions", "derived", "constraints", "preferences", "hierarchy", "problem"),
)
_PROBLEM_KEYS: Final = (*("name", "objects", "init", "goal", "metric", "constraints", "preferences", "requirements", "network"),)


@dataclass(frozen=True)
class LanguageDomain:
    """The actions of a domain by name, what it declares, and what is so at the beginning."""

    name: str = ""
    actions: Mapping[str, LanguageAction] = field(default_factory=dict)
    declared: Declared = NOTHING_DECLARED
    rules: Rules = NO_RULES
    """What derives facts."""
    facts: Mapping[Fluent, Value] = field(default_factory=dict)
    """What is so at the beginning, as the section ``problem`` says."""
    timed: tuple[TimedChange, ...] = ()
    """What changes by itself later."""
    goal: Condition = TRUE
    """The goal of the section ``problem``."""
    sources: tuple[Choice, ...] = ()
    """The sources of knowledge that the file chose."""
    warnings: tuple[Tolerated, ...] = ()
    """What in the file was not as it should be."""
    file: str = ""
    """Where it was read from."""


def domain_from(top: Mapped, warnings: tuple[Tolerated, ...] = ()) -> LanguageDomain:
    """Read a domain from a document that may say other things as well.

    Raises:
        InputError: something is malformed, or has names that are not there.
    """
    problem_node = top.node("problem")
    problem = None if problem_node is None or problem_node.is_null else problem_node.mapped()
    if problem is not None:
        problem.only(*_PROBLEM_KEYS)
    declared = read_declared(top, problem)
    _check_action_types(top)
    facts, timed = ({}, ()) if problem is None else read_initial(problem, declared.scope(()))
    return LanguageDomain(
        name=top.string("name") or "",
        actions={name: read_action(name, entry, declared) for name, entry in top.mapping("actions").items()},
        declared=declared,
        rules=read_derived(top, declared),
        facts=facts,
        timed=timed,
        goal=TRUE if problem is None else read_goal(problem, declared),
        sources=(*_external(top), *_chosen(top)),
        warnings=warnings,
        file=top.file,
    )


def read_goal(entry: Mapped, declared: Declared) -> Condition:
    """Read the key ``goal``; true when it is not there."""
    node = entry.node("goal")
    return TRUE if node is None or node.is_null else read_condition(node, declared.scope(()))


def _check_action_types(top: Mapped) -> None:
    """Only anchors are made there; what they mean is read where they are used."""
    for entry in top.mapping("action_types").values():
        entry.only(*ACTION_KEYS)


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
