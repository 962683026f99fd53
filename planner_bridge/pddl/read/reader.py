"""PDDL domains and problems: text to model. Model to text is in `planner_bridge.pddl.write.writer`.

Sections may stand in any order, so a file is first cut into its sections and these are then
interpreted in the order in which they need each other: types, constants, predicates and
functions, rules, constraints, actions. Every error is an `InputError` with file, line and
column; what is not as it should be but can be understood becomes a warning of the model.

Names are compared without case and spelled as first declared, in a problem as in its domain.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Final, Literal

from planner_bridge.model.missing_numbers import missing_numbers
from planner_bridge.model.problem import Domain, Metric, Problem
from planner_bridge.pddl.read import declarations
from planner_bridge.pddl.read.actions import DURATIVE, INSTANTANEOUS, actions
from planner_bridge.pddl.read.constraints import constraints, split_preferences
from planner_bridge.pddl.read.derived import DERIVED, derived_predicates, rules
from planner_bridge.pddl.read.initial_state import initial_state
from planner_bridge.pddl.read.requirements import Leniency, Requirements, requirements
from planner_bridge.pddl.read.sections import Definition, define
from planner_bridge.pddl.read.symbols import TOTAL_COST, SymbolTable
from planner_bridge.pddl.read.terms import TermScope
from planner_bridge.pddl.syntax.expressions import Atom, Group, text_of, where, wrong
from pnm.core.logic.conditions import TRUE, Condition
from pnm.core.logic.domain import Preference, check_choices
from pnm.core.logic.expressions import fluent_text
from pnm.errors import Tolerated
from pnm.files.text import read_any_text

MAX_BYTES: Final = 50_000_000

HIERARCHY: Final = (":task", ":method")
NETWORK: Final = (":htn", ":tasks")
DOMAIN_SECTIONS: Final = (
    *(":requirements", ":predicates", ":types", ":constants", ":functions", INSTANTANEOUS, DURATIVE, DERIVED, ":constraints"),
    *HIERARCHY,
)
MAX_READ: Final = 200_000
"""Choices of objects that the quantifiers of a problem may range over; planners cope with more than questions at run time may ask."""
PROBLEM_SECTIONS: Final = (*(":domain", ":init", ":goal", ":objects", ":metric", ":constraints", ":requirements", ":length"), *NETWORK)
_DIRECTIONS: Final[dict[str, Literal["minimize", "maximize"]]] = {"minimize": "minimize", "maximize": "maximize"}


def read_domain(path: Path | str) -> Domain:
    """Read a PDDL domain.

    Raises:
        InputError: the file cannot be read, is not a domain, or uses PDDL that is not supported.
    """
    text, warnings = read_any_text(path, MAX_BYTES)
    return _domain(define(text, str(path), "domain", DOMAIN_SECTIONS), warnings)


def read_problem(path: Path | str, domain: Domain) -> Problem:
    """Read a PDDL problem for a domain.

    Raises:
        InputError: the file cannot be read, is not a problem for this domain, or uses PDDL that is not supported.
    """
    text, warnings = read_any_text(path, MAX_BYTES)
    return _problem(define(text, str(path), "problem", PROBLEM_SECTIONS), domain, warnings)


def parse_domain(text: str, file: str = "domain.pddl") -> Domain:
    """Read a PDDL domain from its text.

    >>> parse_domain("(define (domain d) (:predicates (at ?r)))").predicates["at"].parameters
    (Variable(name='?r', types=('object',)),)

    Raises:
        InputError: the text is not a domain, or uses PDDL that is not supported.
    """
    return _domain(define(text, file, "domain", DOMAIN_SECTIONS))


def parse_problem(text: str, domain: Domain, file: str = "problem.pddl") -> Problem:
    """Read a PDDL problem from its text.

    Raises:
        InputError: the text is not a problem for this domain, or uses PDDL that is not supported.
    """
    return _problem(define(text, file, "problem", PROBLEM_SECTIONS), domain)


def _domain(definition: Definition, warnings: tuple[Tolerated, ...] = ()) -> Domain:
    """Interpret the sections of a domain; `warnings` are those about the characters of the file."""
    words = requirements(definition.parts(":requirements"))
    needed = Requirements(words)
    domain = Domain(definition.name, declarations.types(definition.lists(":types"), needed), requirements=words)
    symbols = SymbolTable(domain, {}, needed)
    rule_sections = definition.every(DERIVED)
    predicates = declarations.predicates(definition.parts(":predicates"), symbols)
    domain = replace(
        domain,
        constants=declarations.objects(definition.lists(":constants"), symbols),
        predicates=predicates,
        functions=declarations.functions(definition.lists(":functions"), symbols, predicates),
    )
    derived = derived_predicates(rule_sections, SymbolTable(domain, domain.constants, needed))
    domain = replace(domain, predicates={**domain.predicates, **derived})
    symbols = SymbolTable(domain, domain.constants, needed, lenient=True, derived=frozenset(derived))
    domain_rules = rules(rule_sections, symbols)
    hard, soft = constraints(definition.parts(":constraints"), TermScope(symbols))
    schemas = actions(definition.every(INSTANTANEOUS, DURATIVE), symbols)
    return replace(
        domain,
        functions={**domain.functions, **({TOTAL_COST: symbols.costs} if symbols.costs else {})},
        borrowed=symbols.borrowed,
        actions=schemas,
        rules=domain_rules,
        constraints=hard,
        preferences=soft,
        hierarchy=_verbatim_sections(definition, HIERARCHY, needed),
        warnings=(*warnings, *definition.whole.source.tolerated),
    )


def _verbatim_sections(definition: Definition, keys: tuple[str, ...], needed: Requirements) -> tuple[str, ...]:
    """Return the texts of sections that only hierarchical planners read (HDDL)."""
    sections = definition.every(*keys)
    for section in sections:
        needed.need(section, ":hierarchy", ":htn")
    return tuple(map(text_of, sections))


def _problem(definition: Definition, domain: Domain, warnings: tuple[Tolerated, ...] = ()) -> Problem:
    """Interpret the sections of a problem; `warnings` are those about the characters of the file."""
    _check_domain_name(definition, domain)
    if (length := definition.one(":length")) is not None:
        Leniency.LENGTH.note(length)
    words = requirements(definition.parts(":requirements"))
    needed = Requirements((*domain.requirements, *words, ":typing"))
    shared = SymbolTable(domain, domain.constants, needed)
    own = declarations.borrow(declarations.objects(definition.lists(":objects"), shared), shared, definition.whole)
    preferences = (*domain.preferences, *(preference for action in domain.actions.values() for preference in action.preferences))
    symbols = SymbolTable(
        domain,
        {**domain.constants, **own},
        needed,
        derived=domain.rules.derived,
        preference_names={preference.name.lower(): preference.name for preference in preferences if preference.name},
    )
    network = "\n".join(_verbatim_sections(definition, NETWORK, needed))
    init, timed = initial_state(definition.parts(":init"), TermScope(symbols))
    goal, goals = _goal(definition, TermScope(symbols))
    hard, soft = constraints(definition.parts(":constraints"), TermScope(symbols))
    metric = _metric(definition, TermScope(symbols, metric=True))
    problem = Problem(
        definition.name,
        replace(domain, functions={**domain.functions, TOTAL_COST: symbols.costs}) if symbols.costs else domain,
        own,
        init,
        timed,
        goal,
        metric,
        hard,
        (*goals, *soft),
        network,
        words,
    )
    objects = where((*definition.every(":objects"), definition.whole)[0])
    for what, choices in problem.ranges():
        check_choices(choices, objects, f"the quantifiers in {what}", MAX_READ)
    for fluent in missing_numbers(problem):
        Leniency.NUMBER_MISSING.note(definition.one(":init") or definition.whole, fluent_text(fluent))
    return replace(problem, warnings=(*domain.warnings, *warnings, *definition.whole.source.tolerated))


def _check_domain_name(definition: Definition, domain: Domain) -> None:
    section = definition.one(":domain")
    match section:
        case Group(items=(_, Atom() as name)):
            if name.key != domain.name.lower():
                Leniency.OTHER_DOMAIN.note(name, name, domain.name)
        case None:
            Leniency.NO_DOMAIN.note(definition.whole, domain.name)
        case _:
            raise wrong(section, f"expected (:domain {domain.name})")


def _goal(definition: Definition, scope: TermScope) -> tuple[Condition, tuple[Preference, ...]]:
    section = definition.one(":goal")
    if section is None:
        if not definition.every(*NETWORK):
            Leniency.NO_GOAL.note(definition.whole)
        return TRUE, ()
    if len(section.rest) != 1:
        raise wrong(section, f"expected (:goal CONDITION), found {len(section.rest)} conditions")
    return split_preferences(section.rest[0], scope)


def _metric(definition: Definition, scope: TermScope) -> Metric | None:
    section = definition.one(":metric")
    if section is None:
        return None
    match section.rest:
        case (Atom() as direction, expression) if direction.key in _DIRECTIONS:
            return Metric(_DIRECTIONS[direction.key], scope.expression(expression))
        case _:
            raise wrong(section, "expected (:metric minimize EXPRESSION) or (:metric maximize EXPRESSION)")
