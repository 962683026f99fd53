"""PDDL domains and problems: text to model. Model to text is in `planner_bridge.pddl.writer`.

Sections may stand in any order, so a file is first cut into its sections and these are then
interpreted in the order in which they need each other: types, constants, predicates and
functions, rules, constraints, actions. Every error is an `InputError` with file, line and
column; what is not as it should be but can be understood becomes a warning of the model.

Names are compared without case and spelled as first declared, in a problem as in its domain.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import chain, pairwise
from pathlib import Path
from typing import Final, Literal, TypeAlias

from planner_bridge.model.determinization import check_outcomes
from planner_bridge.model.problem import TOTAL_COST, Domain, Metric, Problem
from planner_bridge.pddl.actions import DURATIVE, EVENT, INSTANTANEOUS, PROCESS, actions
from planner_bridge.pddl.comments import Anchor, AnchorPath, Comment, CommentTable, LineIndex, attach
from planner_bridge.pddl.expressions import (
    CONNECTIVES,
    Atom,
    Group,
    Node,
    is_number,
    new_name,
    operands,
    show_types,
    text_of,
    time,
    tokens,
    where,
    wrong,
)
from planner_bridge.pddl.formulas import TermScope, condition, constraints, is_reward, split_preferences
from planner_bridge.pddl.sections import REFUSED_IN_INIT, Definition, Leniency, Requirements, define, requirements, typed_runs
from planner_bridge.pddl.symbols import (
    SymbolTable,
    borrowed_objects,
    declared_functions,
    declared_objects,
    declared_predicates,
    declared_types,
)
from planner_bridge.pddl.writer import ACTION, COMPOUND, PARTS, fact_anchor, form_anchor, form_of, is_timed, rule_anchor
from pnm.core.logic.conditions import TRUE, Compare, Condition, every_part
from pnm.core.logic.domain import ActionSchema, Declaration, Preference, ProblemModel, check_choices
from pnm.core.logic.effects import Set, TimedChange, every_effect
from pnm.core.logic.expressions import Fluent, Value, Variable, expression_fluents, fluent_text
from pnm.core.logic.rules import DerivationRule, Rules, UnstratifiedError
from pnm.errors import Tolerated, counted
from pnm.files.text import read_any_text

MAX_BYTES: Final = 50_000_000

DERIVED: Final = ":derived"
HIERARCHY: Final = (":task", ":method")
NETWORK: Final = (":htn", ":tasks")
DOMAIN_SECTIONS: Final = (
    *(":requirements", ":predicates", ":types", ":constants", ":functions", INSTANTANEOUS, DURATIVE, DERIVED, ":constraints"),
    *(PROCESS, EVENT),
    *HIERARCHY,
)
MAX_READ: Final = 200_000
"""Choices of objects that the quantifiers of a problem may range over; planners cope with more than questions at run time may ask."""
PROBLEM_SECTIONS: Final = (
    *(":domain", ":init", ":goal", ":goal-reward", ":objects", ":metric", ":constraints", ":requirements", ":length"),
    *NETWORK,
)
_DIRECTIONS: Final[dict[str, Literal["minimize", "maximize"]]] = {"minimize": "minimize", "maximize": "maximize"}


def read_domain(path: Path | str) -> Domain:
    """Read a PDDL domain; raise an `InputError` if the file cannot be read, is none, or uses PDDL that is not supported."""
    text, warnings = read_any_text(path, MAX_BYTES)
    return _domain(define(text, str(path), "domain", DOMAIN_SECTIONS), warnings)


def read_problem(path: Path | str, domain: Domain) -> Problem:
    """Read a PDDL problem for a domain; raise an `InputError` if the file cannot be read, is none, or uses PDDL that is not supported."""
    text, warnings = read_any_text(path, MAX_BYTES)
    return _problem(define(text, str(path), "problem", PROBLEM_SECTIONS), domain, warnings)


def parse_domain(text: str, file: str = "domain.pddl") -> Domain:
    """Read a PDDL domain from its text; raise an `InputError` if it is none, or uses PDDL that is not supported.

    >>> parse_domain("(define (domain d) (:predicates (at ?r)))").predicates["at"].parameters
    (Variable(name='?r', types=('object',)),)
    """
    return _domain(define(text, file, "domain", DOMAIN_SECTIONS))


def parse_problem(text: str, domain: Domain, file: str = "problem.pddl") -> Problem:
    """Read a PDDL problem for a domain from its text; raise an `InputError` if it is none, or uses PDDL that is not supported."""
    return _problem(define(text, file, "problem", PROBLEM_SECTIONS), domain)


def _domain(definition: Definition, warnings: tuple[Tolerated, ...] = ()) -> Domain:
    """Interpret the sections of a domain; `warnings` are those about the characters of the file."""
    words = requirements(definition.parts(":requirements"))
    needed = Requirements(words)
    domain = Domain(definition.name, declared_types(definition.lists(":types"), needed), requirements=words)
    symbols = SymbolTable(domain, {}, needed)
    rule_sections = definition.every(DERIVED)
    predicates = declared_predicates(definition.parts(":predicates"), symbols)
    domain = replace(
        domain,
        constants=declared_objects(definition.lists(":constants"), symbols),
        predicates=predicates,
        functions=declared_functions(definition.lists(":functions"), symbols, predicates),
    )
    derived = derived_predicates(rule_sections, SymbolTable(domain, domain.constants, needed))
    domain = replace(domain, predicates={**domain.predicates, **derived})
    symbols = SymbolTable(domain, domain.constants, needed, lenient=True, derived=frozenset(derived))
    domain_rules = rules(rule_sections, symbols)
    hard, soft = constraints(definition.parts(":constraints"), TermScope(symbols))
    schemas, processes, events = (actions(definition.every(*heads), symbols) for heads in ((INSTANTANEOUS, DURATIVE), (PROCESS,), (EVENT,)))
    return replace(
        domain,
        functions={**domain.functions, **({TOTAL_COST: symbols.costs} if symbols.costs else {})},
        borrowed=symbols.borrowed,
        actions=schemas,
        rules=domain_rules,
        processes=processes,
        events=events,
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
    if (reward := definition.one(":goal-reward")) is not None:
        Leniency.GOAL_REWARD.note(reward)
    words = requirements(definition.parts(":requirements"))
    needed = Requirements((*domain.requirements, *words, ":typing"))
    shared = SymbolTable(domain, domain.constants, needed)
    own = borrowed_objects(declared_objects(definition.lists(":objects"), shared), shared, definition.whole)
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
    goal_section, metric_section = definition.one(":goal"), definition.one(":metric")
    goal: Condition = TRUE
    goals: tuple[Preference, ...] = ()
    if goal_section is not None:
        if len(goal_section.rest) != 1:
            raise wrong(goal_section, f"expected (:goal CONDITION), found {len(goal_section.rest)} conditions")
        goal, goals = split_preferences(goal_section.rest[0], TermScope(symbols))
    elif not definition.every(*NETWORK):
        Leniency.NO_GOAL.note(definition.whole)
    hard, soft = constraints(definition.parts(":constraints"), TermScope(symbols))
    metric = _metric(metric_section, TermScope(symbols, metric=True)) if metric_section else None
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
    check_outcomes(problem, objects)
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


def _metric(section: Group, scope: TermScope) -> Metric | None:
    match section.rest:
        case (Atom(), measure) if is_reward(measure, scope):
            Leniency.REWARD.note(section, section)
            return None
        case (Atom() as direction, expression) if direction.key in _DIRECTIONS:
            return Metric(_DIRECTIONS[direction.key], scope.expression(expression))
        case _:
            raise wrong(section, "expected (:metric minimize EXPRESSION) or (:metric maximize EXPRESSION)")


# --- derived predicates ---------------------------------------------------------------------------
# The rules of derived predicates must be stratified (PDDL 2.2).


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
        variables: list[Variable] = []
        for own, needed in zip(given, declared.parameters, strict=True):
            if all(symbols.domain.matches((kind,), needed.types) for kind in own.types):
                variables.append(own)
            elif all(symbols.domain.matches((kind,), own.types) for kind in needed.types):  # its own type is wider or missing
                variables.append(Variable(own.name, needed.types))
            else:
                raise wrong(head, f"{own.name!r} is of type {show_types(own.types)}; expected {show_types(needed.types)}")
        rule = DerivationRule(declared.name, tuple(variables), condition(body, TermScope(symbols).inside(variables)))
        read.append((rule, section))
    try:
        return Rules(tuple(rule for rule, _ in read))
    except UnstratifiedError as error:  # a fact that follows from its own absence has no meaning (PDDL 2.2)
        section = next(section for rule, section in read if rule is error.rule)
        chain = "".join(f", {head!r} from {needed!r}" for head, needed in pairwise(error.path))
        circle = f"the derived predicate {error.rule.name!r} follows from the absence of {error.path[0]!r}{chain}"
        raise wrong(section, f"{circle}; expected no such circle") from error


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


# --- initial state --------------------------------------------------------------------------------
# The initial state of a PDDL problem: facts, values of functions, and timed initial literals.


_Change: TypeAlias = tuple[Fluent, Value]


def initial_state(parts: Iterable[Node], scope: TermScope) -> tuple[dict[Fluent, Value], tuple[TimedChange, ...]]:
    """Read ``(:init ...)``: the state at first, without false facts, and the timed changes by time."""
    init: dict[Fluent, Value] = {}
    timed: dict[float, dict[Fluent, Value]] = {}
    for part in parts:
        match part:
            # `at` may also be a predicate; only a timed literal has a number before a list
            case Group(items=(Atom(), Atom() as moment, Group() as change)) if part.head == "at" and is_number(moment):
                scope.symbols.requirements.need(part, ":timed-initial-literals", ":timed-initial-fluents")
                _put(timed.setdefault(time(moment), {}), _change(change, scope), part)
            case _:
                _put(init, _change(part, scope), part)
    true = {fluent: value for fluent, value in init.items() if value is not False}
    return true, tuple([TimedChange(moment, timed[moment]) for moment in sorted(timed) if timed[moment]])


def _change(node: Node, scope: TermScope) -> _Change | None:
    """Return a fluent and its value; None for one that no condition can read."""
    match node:
        case Group() if node.head in ("=", "assign"):
            target, value = operands(node, 2)
            if node.head != "=":
                Leniency.ASSIGN_IN_INIT.note(node, node.head)
            if scope.symbols.is_undeclared(target):
                Leniency.VALUE_UNDECLARED.note(node, target)
                return None
            return scope.assigned(target, value)
        case Group() if node.head == "not":
            (negated,) = operands(node, 1)
            fact = _fact(negated, scope)
            return (fact, False) if fact else None
        case Group() if node.head in REFUSED_IN_INIT and not scope.symbols.has_predicate(node.head):
            raise REFUSED_IN_INIT[node.head].at(node)
        case Group():
            fact = _fact(node, scope)
            return (fact, True) if fact else None
        case _:
            raise wrong(node, f"expected a fact, (= FUNCTION VALUE) or (at TIME ...), found {node}")


def _fact(node: Node, scope: TermScope) -> Fluent | None:
    """Return a fact; None, with a warning, if it is not declared with these arguments."""
    if isinstance(node, Group):
        if scope.symbols.is_undeclared(node):
            Leniency.FACT_UNDECLARED.note(node, node.items[0])
            return None
        declared = scope.symbols.predicate(node)
        if len(node.rest) != len(declared.parameters):
            Leniency.FACT_ARITY.note(node, declared, counted(len(declared.parameters), "argument"), len(node.rest))
            return None
    fluent = scope.fact(node)
    if fluent[0] in scope.symbols.derived:
        raise wrong(node, f"{fluent[0]!r} is a derived predicate; it follows from others and cannot be given")
    return fluent


def _put(state: dict[Fluent, Value], change: _Change | None, node: Node) -> None:
    if change is None:
        return
    fluent, value = change
    before = state.get(fluent, value)
    if before != value:
        if isinstance(value, bool):
            raise wrong(node, f"{fluent_text(fluent)} has another value before; expected one value")
        Leniency.VALUE_TWICE.note(node, fluent_text(fluent))
    elif fluent in state:
        Leniency.FACT_TWICE.note(node, fluent_text(fluent))
    state[fluent] = value


# --- numbers without a value ----------------------------------------------------------------------
# Numbers that actions read and that have no value in the initial state: such an action cannot be applied, which no planner says.
#
# Only functions with at most one parameter are looked at: of others, such as distances, those that are left out mostly say something.


def missing_numbers(problem: ProblemModel) -> tuple[Fluent, ...]:
    """Return the numbers without a value that actions, processes and events of the domain read, if nothing assigns one later."""
    actions = problem.domain.schemas
    effects = [effect for action in actions for effect in every_effect((*action.start_effects, *action.end_effects))]
    assigned = {effect.fluent[0] for effect in effects if isinstance(effect, Set) and effect.operation == "assign"}
    assigned |= {fluent[0] for change in problem.timed for fluent in change.changes}
    numbers = {name for name, declared in problem.domain.functions.items() if not declared.values} - assigned
    read = dict.fromkeys(fluent for action in actions for fluent in numbers_read(problem, action) if fluent[0] in numbers)
    return tuple(fluent for fluent in read if fluent not in problem.init)


def numbers_read(problem: ProblemModel, action: ActionSchema) -> Iterator[Fluent]:
    """Yield everything that the action reads with at most one parameter, for all objects of its type; untyped ones may be any object."""
    types = {variable.name: variable.types for variable in action.parameters if variable.types != ("object",)}
    parts = chain.from_iterable(map(every_part, (action.precondition, action.invariant, action.end_condition)))
    compared = (side for part in parts if isinstance(part, Compare) for side in (part.left, part.right))
    bounds = (constraint.bound for constraint in action.duration or ())
    effects = every_effect((*action.start_effects, *action.end_effects))
    values = (effect.value for effect in effects if isinstance(effect, Set))
    for fluent in chain.from_iterable(map(expression_fluents, (*compared, *bounds, *values))):
        match fluent:
            case (_,):
                yield fluent
            case (name, variable) if variable in types:
                yield from ((name, each) for kind in types[variable] for each in problem.objects_by_type.get(kind, ()))
            case _:
                pass


# --- comments -------------------------------------------------------------------------------------
# The comments of a file, attached to the things they are about: sections, declarations, actions, conditions, facts.


def comments(text: str, kind: Literal["domain", "problem"]) -> CommentTable:
    """Return the comments of the text of a domain or a problem, which must be correct."""
    if ";" not in text:
        return {}
    ends: dict[int, int] = {}
    all_comments: list[Comment] = []
    opened: list[int] = []
    for token, offset in tokens(text):
        if token == "(":
            opened.append(offset)
        elif token == ")" and opened:
            ends[opened.pop()] = offset + 1
        elif token[0] == ";":
            all_comments.append(Comment(token.rstrip(), offset))
    definition = define(text, "", kind, DOMAIN_SECTIONS if kind == "domain" else PROBLEM_SECTIONS)
    finder = _AnchorFinder(ends)
    anchors = [finder.anchor(definition.whole, (kind,))]
    for section in definition.sections:
        anchors.extend(finder.section(section, (kind,)))
    verbatim = [(anchor.start, anchor.end) for anchor in anchors if anchor.opaque]
    free = [comment for comment in all_comments if not any(start < comment.offset < end for start, end in verbatim)]
    return attach(free, anchors, LineIndex.of(text), _ListEnds(anchors).owner_above)


class _ListEnds:
    """Decides whether a comment stands at the end of a list, and under which of its parts."""

    def __init__(self, anchors: list[Anchor]) -> None:
        self._anchors = {anchor.path: anchor for anchor in anchors}
        sections = [anchor for anchor in anchors[1:] if self._around(anchor.path) == anchors[0]]
        self._last_section = max(sections, key=lambda anchor: anchor.start, default=anchors[0])

    def owner_above(self, comment: Comment, last: Anchor | None, following: Anchor | None) -> AnchorPath | None:
        """Return the part under which the comment stands, or None if another one follows in the list."""
        if last is None:
            return None
        if comment.offset >= self._anchors[last.path[:1]].end:
            return self._last_section.path
        around = last
        under = last.path
        while around.end <= comment.offset:
            under = around.path
            around = self._around(under)
        return under if following is None or following.start >= around.end else None

    def _around(self, path: AnchorPath) -> Anchor:
        path = path[:-1]
        while path not in self._anchors:
            path = path[:-1]
        return self._anchors[path]


@dataclass(frozen=True, slots=True)
class _AnchorFinder:
    """Finds the things in a definition that comments can be about."""

    ends: Mapping[int, int]
    """For the offset of every list, the offset behind it."""

    def anchor(self, node: Node, path: AnchorPath, last: Node | None = None, opaque: bool = False) -> Anchor:
        behind = last or node
        end = behind.offset + len(behind.text) if isinstance(behind, Atom) else self.ends.get(behind.offset, behind.offset + 1)
        return Anchor(path, node.offset, end, opaque)

    def section(self, section: Group, path: AnchorPath) -> Iterator[Anchor]:
        head = section.head
        name = section.rest[0] if section.rest else section
        inner = (*path, head)
        if head in (*HIERARCHY, *NETWORK):  # kept as they stand, with the comments in them
            yield self.anchor(section, (*inner, name.key if isinstance(name, Atom) else ""), opaque=True)
        elif head == ":derived":
            inner = (*inner, rule_anchor(form_of(section)))
            yield self.anchor(section, inner)
            yield from self.formulas(section.rest[1:], inner)
        elif head in (":action", ":durative-action"):
            yield from self.action(section, (*path, ACTION, form_anchor(form_of(name))))
        elif head in (PROCESS, EVENT):
            yield from self.action(section, (*inner, form_anchor(form_of(name))))
        else:
            yield self.anchor(section, inner)
            if head in (":types", ":constants", ":objects"):
                names = (name for names, _ in typed_runs(section.rest) for name in names)
                yield from (self.anchor(name, (*inner, name.key)) for name in names if isinstance(name, Atom))
            elif head in (":predicates", ":functions"):
                yield from (self.anchor(part, (*inner, part.head)) for part in section.rest if isinstance(part, Group))
            elif head == ":init":
                facts = (part for part in section.rest if isinstance(part, Group))
                yield from (self.anchor(fact, (*inner, fact_anchor(form_of(fact)))) for fact in facts)
            elif head in (":goal", ":constraints"):
                yield from self.formulas(section.rest, inner)

    def action(self, section: Group, path: AnchorPath) -> Iterator[Anchor]:
        yield self.anchor(section, path)
        for keyword, value in zip(section.rest[1::2], section.rest[2::2], strict=False):
            part = PARTS.get(form_anchor(form_of(keyword)), "")
            yield self.anchor(keyword, (*path, part), value)
            if part in ("condition", "effect"):
                yield from self.formulas((value,), (*path, part))

    def formulas(self, nodes: Iterable[Node], path: AnchorPath) -> Iterator[Anchor]:
        """Yield the anchors of conditions or effects that stand beside each other, and of the forms in them."""
        for node in nodes:
            if not isinstance(node, Group) or not node.items or node.head.startswith("?"):
                continue
            if node.head == "and":
                yield from self.formulas(node.rest, path)
            elif is_timed(form := form_of(node)):
                yield from self.formulas(node.items[2:], path)
            else:
                inner = (*path, form_anchor(form))
                yield self.anchor(node, inner)
                operand = node.rest[0] if node.rest else None
                is_compound = isinstance(operand, Group) and (operand.head in COMPOUND or operand.head == "and")
                if node.head in COMPOUND and (node.head != "not" or is_compound):
                    yield from self.formulas(node.rest, inner)
