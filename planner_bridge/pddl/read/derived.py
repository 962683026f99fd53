"""PDDL derived predicates: rules, which together must have exactly one meaning (PDDL 2.2)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Final

from planner_bridge.pddl.read.formulas import condition
from planner_bridge.pddl.read.symbols import Names
from planner_bridge.pddl.read.terms import Scope
from planner_bridge.pddl.syntax.expressions import Group, Node, tolerate, wrong
from planner_bridge.pddl.syntax.words import CONNECTIVES, counted, new_name, operands, show_types
from pnm.core.logic.conditions import polarities
from pnm.core.logic.domain import Declaration
from pnm.core.logic.expressions import Variable
from pnm.core.logic.rules import Rule

DERIVED: Final = ":derived"


def rules(sections: Iterable[Group], names: Names) -> tuple[Rule, ...]:
    """Read the rules, in the order of the file.

    Raises:
        InputError: a head is no declared predicate with variables, or a fact would follow from its own absence.
    """
    found: list[tuple[Rule, Group]] = []
    for section in sections:
        names.requirements.need(section, ":derived-predicates")
        head, body = operands(section, 2)
        declared, variables = _head(head, names)
        found.append((Rule(declared.name, variables, condition(body, Scope(names).inside(variables))), section))
    _stratified(found)
    return tuple(rule for rule, _ in found)


def heads(sections: Iterable[Group], names: Names) -> dict[str, Declaration]:
    """Return every derived predicate; one that is declared nowhere else is declared by the head of its first rule."""
    found: dict[str, Declaration] = {}
    for section in sections:
        head = section.rest[0] if section.rest else None
        if not isinstance(head, Group) or not head.head or names.find_function(head):
            continue  # which is refused when the rule is read
        if names.has_predicate(head.head):
            declared = names.predicate(head)
        elif head.head in {name.lower() for name in found}:
            continue
        else:
            name = new_name(head.items[0], "predicate", CONNECTIVES)
            tolerate(head, f"the predicate {name!r} is derived here but not among the :predicates")
            declared = Declaration(name, names.variables(head.rest))
        found[declared.name] = declared
    return found


def _head(node: Node, names: Names) -> tuple[Declaration, tuple[Variable, ...]]:
    if not isinstance(node, Group):
        raise wrong(node, f"expected a predicate with variables such as (name ?x - type), found {node}")
    declared = names.predicate(node)
    variables = names.variables(node.rest)
    if len(variables) != len(declared.parameters):
        raise wrong(node, f"expected {declared}, found {counted(len(variables), 'variable')}")
    return declared, tuple(_narrowed(given, needed, node, names) for given, needed in zip(variables, declared.parameters, strict=True))


def _narrowed(given: Variable, needed: Variable, node: Node, names: Names) -> Variable:
    """Return the variable of a head with its own type, or with that of the declaration where its own is wider or missing."""
    if all(names.domain.matches((kind,), needed.types) for kind in given.types):
        return given
    if all(names.domain.matches((kind,), given.types) for kind in needed.types):
        return Variable(given.name, needed.types)
    raise wrong(node, f"{given.name!r} is of type {show_types(given.types)}; expected {show_types(needed.types)}")


# --- stratification ------------------------------------------------------------------------


def _stratified(found: list[tuple[Rule, Group]]) -> None:
    """Refuse a fact that follows from its own absence, whichever way round: then the rules have no one meaning."""
    derived = {rule.name for rule, _ in found}
    needs: dict[str, dict[str, None]] = {}
    for rule, _ in found:
        needs.setdefault(rule.name, {}).update(dict.fromkeys(name for name, _ in polarities(rule.condition) if name in derived))
    for rule, section in found:
        for name, positive in polarities(rule.condition):
            way = () if positive or name not in derived else _way(name, rule.name, needs)
            if way:
                chain = ", ".join(f"{one!r} from {other!r}" for one, other in pairwise(way))
                told = f"the derived predicate {rule.name!r} follows from the absence of {name!r}{f', {chain}' if chain else ''}"
                raise wrong(section, f"{told}; expected no such circle")


def _way(start: str, end: str, needs: Mapping[str, Iterable[str]]) -> tuple[str, ...]:
    """Return the shortest way from one derived predicate to another it rests on; empty when there is none."""
    ways: dict[str, tuple[str, ...]] = {start: (start,)}
    waiting = [start]
    while waiting and end not in ways:
        name = waiting.pop(0)
        for needed in needs[name]:
            if needed not in ways:
                ways[needed] = (*ways[name], needed)
                waiting.append(needed)
    return ways.get(end, ())
