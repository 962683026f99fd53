"""Declarations of the YAML language: types, objects, predicates, functions, derived facts, initial facts.

Types, constants and objects are PDDL's text (``r1 r2 - robot``) or lists of such texts, predicates and functions lists
of texts such as ``(at ?r - robot ?p - place)`` and ``(location ?r - robot) - place``. Every reader raises InputError, with
the position, for what is malformed or has names that are not there.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace
from math import isfinite
from typing import Final

from pnm.core.knowledge_base import parse_statement
from pnm.core.logic.domain import Declaration, DomainModel, ProblemModel, Types
from pnm.core.logic.effects import TimedChange
from pnm.core.logic.expressions import Constant, Fluent, Value, Variable, fluent_text
from pnm.core.logic.rules import DerivationRule, Rules, UnstratifiedError
from pnm.errors import InputError
from pnm.files.yaml_nodes import Node
from pnm.language.formulas.conditions import read_condition
from pnm.language.formulas.scope import FormulaScope, read_names, read_typed_text, shown, unknown
from pnm.language.grammar import DomainKeys, ProblemKeys, Rule, TimedFacts

_DECLARED: Final = re.compile(r"\(\s*([^\s()?-][^\s()?]*)\s*((?:[^()]|\([^()]*\))*)\)\s*(?:-\s*(\S+|\(\s*either\s[^()]*\)))?\s*\Z")


def read_declarations(top: DomainKeys, problem: ProblemKeys | None, *, strict: bool = False) -> ProblemModel:
    """Read ``types``, ``constants``, ``predicates`` and ``functions``, and the ``objects`` of a problem."""
    name, written = top.name or "", _names(top.types, FormulaScope())
    types = {kind: tuple(parent for parent in parents if parent != "object") for kind, parents in written.items() if kind != "object"}
    # one that is only a supertype is declared by that
    domain = DomainModel(name, types | {parent: () for parents in types.values() for parent in parents if parent not in types})
    problem_name = None if problem is None else problem.name
    scope = FormulaScope(ProblemModel("", domain), strict=strict)
    domain = replace(
        domain,
        constants=_names(top.constants, scope),
        predicates=_declarations(top.predicates, "predicate", scope),
        functions=_declarations(top.functions, "function", scope),
    )
    objects = {} if problem is None else _names(problem.objects, scope)
    return ProblemModel(problem_name or domain.name, domain, objects)


def _names(node: Node | None, scope: FormulaScope) -> dict[str, Types]:
    return {} if node is None else read_names(node, scope)


def _declarations(nodes: Iterable[Node], kind: str, scope: FormulaScope) -> dict[str, Declaration]:
    declarations: dict[str, Declaration] = {}
    for item in nodes:
        name, parameters, after = declaration_parts(item)
        values = tuple(after.strip("()").split())
        values = values[values[:1] == ("either",) :]
        for value in values:
            if value != "number":
                scope.check_type(value, item)
        variables = read_typed_text(parameters, item, scope, distinct=False)
        declared = Declaration(name, variables, () if values == ("number",) else values)
        if declarations.setdefault(name, declared) != declared:
            raise InputError(f"the {kind} {name!r} is declared twice, and differently", item.position_of(name))
    return declarations


def declaration_parts(node: Node) -> tuple[str, str, str]:
    """Return the name in a declaration, the text of the parameters, and that of the types behind it."""
    match = _DECLARED.match(node.text.strip()) if node.text is not None else None
    if match is None:
        raise node.wrong("expected something like (at ?r - robot ?p - place)")
    return match[1], match[2], match[3] or ""


def read_derived(top: DomainKeys, scope: FormulaScope) -> Rules:
    """Read ``derived``: a list of ``{fact: (reachable ?p - place), condition: c}``."""
    rules = [read_rule(node, scope) for node in top.derived]
    try:
        return Rules(tuple(rules))
    except UnstratifiedError as error:
        raise InputError(str(error), top.entry.position("derived")) from error


def read_rule(node: Node, scope: FormulaScope) -> DerivationRule:
    """Read one rule; variables of its head that have no type have that of the declaration."""
    keys = Rule(node.mapped())
    fact, condition = keys.fact, keys.condition
    name, text, _ = declaration_parts(fact)
    variables = read_typed_text(text, fact, scope)
    domain = scope.declared.domain
    declared = domain.predicates.get(name)
    if declared is None and (domain.fluents or scope.strict) and name not in (() if scope.strict else domain.fluents):
        raise unknown("predicate", name, domain.predicates.keys(), fact.position_of(name))
    if declared is not None:
        if len(variables) != len(declared.parameters):
            raise fact.wrong(f"expected {declared}, found {len(variables)} variables")
        pairs = zip(variables, declared.parameters, strict=True)
        variables = tuple(Variable(own.name, needed.types) if own.types == ("object",) else own for own, needed in pairs)
        for own, needed in zip(variables, declared.parameters, strict=True):
            if scope.strict and not all(domain.matches((kind,), needed.types) for kind in own.types):
                types = f"{' or '.join(own.types)}; expected {' or '.join(needed.types)}"
                raise InputError(f"{own.name!r} is of type {types}", fact.position_of(own.name))
    return DerivationRule(name, variables, read_condition(condition, replace(scope, variables={}).inside(variables)))


def read_facts(nodes: Iterable[Node], scope: FormulaScope) -> dict[Fluent, Value]:
    """Read facts: texts ``(at r1 hall)``, ``(= (battery r1) 80)``, ``(not (at r1 hall))``."""
    facts: dict[Fluent, Value] = {}
    for node in nodes:
        try:
            fluent, value = parse_statement(node.text or "")
        except InputError as error:
            raise node.wrong(f"expected a fact such as (at r1 kitchen) or (= (battery r1) 80), found {shown(node)}") from error
        if isinstance(value, float) and not isfinite(value):
            raise node.wrong(f"the number is too large: {node.text}")
        scope.check_change(fluent, node, Constant(value))
        if isinstance(value, str):
            scope.check_object(value, node)
        if scope.strict and facts.get(fluent, value) != value:
            raise node.wrong(f"{fluent_text(fluent)} has another value before; expected one value")
        facts[fluent] = value
    return facts


def read_initial(problem: ProblemKeys, scope: FormulaScope) -> tuple[dict[Fluent, Value], tuple[TimedChange, ...]]:
    """Read ``init``: the initial facts, and timed ones: ``{at: 5, facts: [...]}``, in seconds."""
    items = problem.init
    written = [TimedFacts(item.mapped()) for item in items if item.is_mapping]
    timed = [TimedChange(keys.at, read_facts(keys.facts, scope)) for keys in written]
    facts = read_facts([item for item in items if not item.is_mapping], scope)
    return facts, tuple(sorted(timed, key=lambda change: change.time))
