"""PDDL derived predicates: rules, which together must have exactly one meaning (PDDL 2.2)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise
from typing import Final, assert_never

from planner_bridge.model.problem import Declaration
from planner_bridge.pddl.read.formulas import condition
from planner_bridge.pddl.read.symbols import SymbolTable
from planner_bridge.pddl.read.terms import TermScope
from planner_bridge.pddl.syntax.expressions import Group, Node, tolerate, wrong
from planner_bridge.pddl.syntax.words import CONNECTIVES, counted, new_name, operands, show_types
from pnm.core.logic.conditions import All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not
from pnm.core.logic.expressions import Variable
from pnm.core.logic.rules import Rule

DERIVED: Final = ":derived"


def rules(sections: Iterable[Group], symbols: SymbolTable) -> tuple[Rule, ...]:
    """Read the rules, in the order of the file.

    Raises:
        InputError: a head is no declared predicate with variables, or a fact would follow from its own absence.
    """
    found: list[tuple[Rule, Group]] = []
    for section in sections:
        symbols.requirements.need(section, ":derived-predicates")
        head, body = operands(section, 2)
        declared, variables = _head(head, symbols)
        found.append((Rule(declared.name, variables, condition(body, TermScope(symbols).inside(variables))), section))
    _stratified(found)
    return tuple(rule for rule, _ in found)


def derived_predicates(sections: Iterable[Group], symbols: SymbolTable) -> dict[str, Declaration]:
    """Return every derived predicate; one that is declared nowhere else is declared by the head of its first rule."""
    found: dict[str, Declaration] = {}
    for section in sections:
        head = section.rest[0] if section.rest else None
        if not isinstance(head, Group) or not head.head or symbols.find_function(head):
            continue  # which is refused when the rule is read
        if symbols.has_predicate(head.head):
            declared = symbols.predicate(head)
        elif head.head in {name.lower() for name in found}:
            continue
        else:
            name = new_name(head.items[0], "predicate", CONNECTIVES)
            tolerate(head, f"the predicate {name!r} is derived here but not among the :predicates")
            declared = Declaration(name, symbols.variables(head.rest))
        found[declared.name] = declared
    return found


def _head(node: Node, symbols: SymbolTable) -> tuple[Declaration, tuple[Variable, ...]]:
    if not isinstance(node, Group):
        raise wrong(node, f"expected a predicate with variables such as (name ?x - type), found {node}")
    declared = symbols.predicate(node)
    variables = symbols.variables(node.rest)
    if len(variables) != len(declared.parameters):
        raise wrong(node, f"expected {declared}, found {counted(len(variables), 'variable')}")
    return declared, tuple(_narrowed(given, needed, node, symbols) for given, needed in zip(variables, declared.parameters, strict=True))


def _narrowed(given: Variable, needed: Variable, node: Node, symbols: SymbolTable) -> Variable:
    """Return the variable of a head with its own type, or with that of the declaration where its own is wider or missing."""
    if all(symbols.matches((kind,), needed.types) for kind in given.types):
        return given
    if all(symbols.matches((kind,), given.types) for kind in needed.types):
        return Variable(given.name, needed.types)
    raise wrong(node, f"{given.name!r} is of type {show_types(given.types)}; expected {show_types(needed.types)}")


# --- stratification ------------------------------------------------------------------------


def _stratified(found: list[tuple[Rule, Group]]) -> None:
    """Refuse a fact that follows from its own absence, whichever way round: then the rules have no one meaning."""
    derived = {rule.name for rule, _ in found}
    needs: dict[str, dict[str, None]] = {}
    for rule, _ in found:
        needs.setdefault(rule.name, {}).update(dict.fromkeys(name for name, _ in _mentioned(rule.condition, True) if name in derived))
    for rule, section in found:
        for name, positive in _mentioned(rule.condition, True):
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


def _mentioned(condition: Condition, positive: bool) -> Iterator[tuple[str, bool]]:
    """Yield every predicate of the condition, and whether it is its truth that helps rather than its absence."""
    match condition:
        case Holds(fluent):
            yield fluent[0], positive
        case Compare() | Computed():
            return
        case Not(operand):
            yield from _mentioned(operand, not positive)
        case All(operands) | Any(operands):
            for operand in operands:
                yield from _mentioned(operand, positive)
        case Implies(left, right):
            yield from _mentioned(left, not positive)
            yield from _mentioned(right, positive)
        case ForAll(_, body) | Exists(_, body):
            yield from _mentioned(body, positive)
        case _:
            assert_never(condition)
