"""PDDL derived predicates: their rules, which must be stratified (PDDL 2.2)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Final

from planner_bridge.pddl.read.formulas import condition
from planner_bridge.pddl.read.requirements import Leniency
from planner_bridge.pddl.read.symbols import SymbolTable
from planner_bridge.pddl.read.terms import TermScope
from planner_bridge.pddl.syntax.expressions import Group, Node, wrong
from planner_bridge.pddl.syntax.words import CONNECTIVES, new_name, operands, show_types
from pnm.core.logic.conditions import polarities
from pnm.core.logic.domain import Declaration
from pnm.core.logic.expressions import Variable
from pnm.core.logic.rules import DerivationRule, Rules
from pnm.errors import counted

DERIVED: Final = ":derived"


def rules(sections: Iterable[Group], symbols: SymbolTable) -> Rules:
    """Read the rules, which must be stratified, in the order of the file."""
    read: list[tuple[DerivationRule, Group]] = []
    for section in sections:
        symbols.requirements.need(section, ":derived-predicates")
        head, body = operands(section, 2)
        if not isinstance(head, Group):
            raise wrong(head, f"expected a predicate with variables such as (name ?x - type), found {head}")
        declared = symbols.predicate(head)
        given = symbols.variables(head.rest)
        if len(given) != len(declared.parameters):
            raise wrong(head, f"expected {declared}, found {counted(len(given), 'variable')}")
        variables = tuple(_narrowed(own, needed, head, symbols) for own, needed in zip(given, declared.parameters, strict=True))
        read.append((DerivationRule(declared.name, variables, condition(body, TermScope(symbols).inside(variables))), section))
    _check_stratification(read)
    return Rules(tuple(rule for rule, _ in read))


def derived_predicates(sections: Iterable[Group], symbols: SymbolTable) -> dict[str, Declaration]:
    """Return every derived predicate; one that is declared nowhere else is declared by the head of its first rule."""
    derived: dict[str, Declaration] = {}
    for section in sections:
        head = section.rest[0] if section.rest else None
        if not isinstance(head, Group) or not head.head or symbols.find_function(head):
            continue  # which is refused when the rule is read
        if symbols.has_predicate(head.head):
            declared = symbols.predicate(head)
        elif head.head in {name.lower() for name in derived}:
            continue
        else:
            name = new_name(head.items[0], "predicate", CONNECTIVES)
            Leniency.DERIVED_UNDECLARED.note(head, name)
            declared = Declaration(name, symbols.variables(head.rest))
        derived[declared.name] = declared
    return derived


def _narrowed(given: Variable, needed: Variable, node: Node, symbols: SymbolTable) -> Variable:
    """Return the variable of a head with its own type, or with that of the declaration where its own is wider or missing."""
    if all(symbols.domain.matches((kind,), needed.types) for kind in given.types):
        return given
    if all(symbols.domain.matches((kind,), given.types) for kind in needed.types):
        return Variable(given.name, needed.types)
    raise wrong(node, f"{given.name!r} is of type {show_types(given.types)}; expected {show_types(needed.types)}")


def _check_stratification(rules: list[tuple[DerivationRule, Group]]) -> None:
    """Refuse rules that are not stratified: a fact that follows from its own absence has no meaning (PDDL 2.2)."""
    derived = {rule.name for rule, _ in rules}
    needs: dict[str, dict[str, None]] = {}
    for rule, _ in rules:
        needs.setdefault(rule.name, {}).update(dict.fromkeys(name for name, _ in polarities(rule.condition) if name in derived))
    for rule, section in rules:
        for name, positive in polarities(rule.condition):
            path = () if positive or name not in derived else _shortest_path(name, rule.name, needs)
            if path:
                chain = ", ".join(f"{head!r} from {needed!r}" for head, needed in pairwise(path))
                circle = f"the derived predicate {rule.name!r} follows from the absence of {name!r}{f', {chain}' if chain else ''}"
                raise wrong(section, f"{circle}; expected no such circle")


def _shortest_path(start: str, end: str, needs: Mapping[str, Iterable[str]]) -> tuple[str, ...]:
    """Return the shortest path from one derived predicate to another that it needs; empty when there is none."""
    paths: dict[str, tuple[str, ...]] = {start: (start,)}
    waiting = [start]
    while waiting and end not in paths:
        name = waiting.pop(0)
        for needed in needs[name]:
            if needed not in paths:
                paths[needed] = (*paths[name], needed)
                waiting.append(needed)
    return paths.get(end, ())
