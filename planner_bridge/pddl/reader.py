"""PDDL domains and problems: text to model. Model to text is in `planner_bridge.pddl.writer`.

Sections may stand in any order, so a file is first cut into its sections and these are then
interpreted in the order in which they need each other: types, constants, predicates and
functions, actions. Every error is an `InputError` with file, line and column.

Names are compared without case and spelled as first declared, in a problem as in its domain.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Final, Literal, TypeAlias

from planner_bridge.model import Declaration, Domain, Metric, Problem
from planner_bridge.pddl import declarations
from planner_bridge.pddl.actions import DURATIVE, INSTANTANEOUS, actions
from planner_bridge.pddl.conditions import Reader, operands
from planner_bridge.pddl.names import Names, is_number, number, unsupported
from planner_bridge.pddl.sections import Definition, define
from planner_bridge.pddl.sexpr import Atom, Group, Node, wrong
from pnm.conditions import Condition
from pnm.effects import TimedChange
from pnm.expressions import Fluent, Value, show
from pnm.text_files import read_text

MAX_BYTES: Final = 50_000_000

_DOMAIN_SECTIONS: Final = (":requirements", ":predicates", ":types", ":constants", ":functions", INSTANTANEOUS, DURATIVE)
_PROBLEM_SECTIONS: Final = (":domain", ":init", ":goal", ":objects", ":metric", ":requirements", ":length")
_DIRECTIONS: Final[dict[str, Literal["minimize", "maximize"]]] = {"minimize": "minimize", "maximize": "maximize"}
_CONTINGENT: Final = ("or", "oneof", "unknown")

_Change: TypeAlias = tuple[Fluent, Value]


def read_domain(path: Path) -> Domain:
    """Read a PDDL domain.

    Raises:
        InputError: the file cannot be read, is not a domain, or uses PDDL that is not supported.
    """
    return parse_domain(read_text(path, MAX_BYTES), str(path))


def read_problem(path: Path, domain: Domain) -> Problem:
    """Read a PDDL problem for a domain; the name it gives the domain is not compared.

    Raises:
        InputError: the file cannot be read, is not a problem for this domain, or uses PDDL that is not supported.
    """
    return parse_problem(read_text(path, MAX_BYTES), domain, str(path))


def parse_domain(text: str, file: str = "domain.pddl") -> Domain:
    """Read a PDDL domain from its text.

    >>> parse_domain("(define (domain d) (:predicates (at ?r)))").predicates["at"].parameters
    (Variable(name='?r', types=('object',)),)

    Raises:
        InputError: the text is not a domain, or uses PDDL that is not supported.
    """
    definition = define(text, file, "domain", _DOMAIN_SECTIONS)
    domain = Domain(
        definition.name,
        declarations.requirements(definition.parts(":requirements")),
        declarations.types(definition.parts(":types")),
    )
    names = Names(domain, {})
    facts = declarations.predicates(definition.parts(":predicates"), names)
    domain = replace(
        domain,
        constants=declarations.objects(definition.parts(":constants"), names),
        predicates=facts,
        functions=declarations.functions(definition.parts(":functions"), names, facts),
    )
    return replace(domain, actions=actions(definition.every(INSTANTANEOUS, DURATIVE), Names(domain, domain.constants)))


def parse_problem(text: str, domain: Domain, file: str = "problem.pddl") -> Problem:
    """Read a PDDL problem from its text.

    Raises:
        InputError: the text is not a problem for this domain, or uses PDDL that is not supported.
    """
    definition = define(text, file, "problem", _PROBLEM_SECTIONS)
    own = declarations.objects(definition.parts(":objects"), Names(domain, domain.constants))
    names = Names(domain, {**domain.constants, **own})
    init, timed = _initial(definition.parts(":init"), Reader(names))
    return Problem(definition.name, domain, own, init, timed, _goal(definition, Reader(names)), _metric(definition, names))


# --- initial state -------------------------------------------------------------------------


def _initial(parts: Iterable[Node], reader: Reader) -> tuple[dict[Fluent, Value], tuple[TimedChange, ...]]:
    init: dict[Fluent, Value] = {}
    timed: dict[float, dict[Fluent, Value]] = {}
    for part in parts:
        match part:
            # `at` may also be a predicate; only a timed literal has a number before a list
            case Group(items=(Atom(), Atom() as time, Group() as change)) if part.head == "at" and is_number(time):
                _put(timed.setdefault(_time(time), {}), _change(change, reader), part)
            case _:
                _put(init, _change(part, reader), part)
    true = {fluent: value for fluent, value in init.items() if value is not False}
    return true, tuple([TimedChange(time, timed[time]) for time in sorted(timed)])


def _time(node: Node) -> float:
    time = number(node)
    if time < 0:
        raise wrong(node, f"expected a time of at least 0, found {node}")
    return time


def _change(node: Node, reader: Reader) -> _Change:
    match node:
        case Group() if node.head == "=":
            function, value = operands(node, 2)
            return reader.function(function), number(value)
        case Group() if node.head == "not":
            return reader.fact(operands(node, 1)[0]), False
        case Group() if node.head in _CONTINGENT and not reader.names.has_predicate(node.head):
            raise unsupported(node, f"uncertain initial states ({node.head} in :init)", "a contingent planner")
        case Group():
            return reader.fact(node), True
        case _:
            raise wrong(node, f"expected a fact, (= FUNCTION NUMBER) or (at TIME ...), found {node}")


def _put(found: dict[Fluent, Value], change: _Change, node: Node) -> None:
    fluent, value = change
    if found.setdefault(fluent, value) != value:
        raise wrong(node, f"{show(fluent)} has another value before; expected one value")


# --- goal and metric -----------------------------------------------------------------------


def _goal(definition: Definition, reader: Reader) -> Condition:
    section = definition.one(":goal")
    if section is None:
        raise wrong(definition.whole, "there is no :goal; expected (:goal CONDITION)")
    if len(section.rest) != 1:
        raise wrong(section, f"expected (:goal CONDITION), found {len(section.rest)} conditions")
    return reader.condition(section.rest[0])


def _metric(definition: Definition, names: Names) -> Metric | None:
    section = definition.one(":metric")
    if section is None:
        return None
    # total-time is the one function that is there undeclared, and only here
    functions = {**names.domain.functions, "total-time": Declaration("total-time")}
    reader = Reader(Names(replace(names.domain, functions=functions), names.objects))
    match section.rest:
        case (Atom() as direction, expression) if direction.key in _DIRECTIONS:
            return Metric(_DIRECTIONS[direction.key], reader.expression(expression))
        case _:
            raise wrong(section, "expected (:metric minimize EXPRESSION) or (:metric maximize EXPRESSION)")
