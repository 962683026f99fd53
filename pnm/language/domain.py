"""Domains: the model that people and planners share, and how its actions are executed: from YAML to schemas and bindings."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite
from typing import Final, assert_never

from pnm.actions.bindings_file import read_binding, stored_fluents
from pnm.core.knowledge_base import parse_statement
from pnm.core.logic.computed_values import Data, Query, parts
from pnm.core.logic.conditions import TRUE, Condition, fluents, free_variables
from pnm.core.logic.domain import ActionSchema, Declaration, DomainModel, ProblemModel, Types
from pnm.core.logic.effects import Effects, ForEach, OneOf, Set, TimedChange, When, every_effect, has_outcomes, is_early
from pnm.core.logic.expressions import DURATION, Constant, Fluent, Value, Variable, expression_variables, fluent_text, variables_in
from pnm.core.logic.rules import DerivationRule, Rules, UnstratifiedError
from pnm.core.machine.bindings import DEFAULT, Binding
from pnm.errors import InputError, Position, Tolerated, located
from pnm.files.yaml_nodes import Mapped, Node
from pnm.knowledge.sources import SourceChoice, check_source
from pnm.language.formulas.readers import read_condition, read_conditions, read_duration, read_effects, read_outcomes, read_timed_effects
from pnm.language.formulas.scope import NOTHING_DECLARED, FormulaScope, read_names, read_typed, read_typed_text, shown, unknown
from pnm.language.formulas.words import read_data
from pnm.language.grammar import (
    RESERVED,
    Action,
    ActionKind,
    ClassName,
    DomainKeys,
    EventKeys,
    ProblemKeys,
    ProcessKeys,
    RuleKeys,
    TimedFacts,
)

CLASSES: Final = {"ROSAtomicAction": ActionKind.ROS, "RPNAtomicAction": ActionKind.RPN, "KBAction": ActionKind.KB}
"""The classes that files for the original implementation name; none of them is imported."""
_KINDS: Final[dict[str, ActionKind]] = {kind.value: kind for kind in CLASSES.values()}
OPERATION: Final = "operation"
"""The parameter of an `ActionKind.KB` action that has the operation on knowledge."""


@dataclass(frozen=True)
class LanguageAction:
    """An action schema, and how its calls are executed."""

    schema: ActionSchema
    kind: ActionKind
    position: Position
    is_open: bool = False
    """Whether the domain has no ``params`` for it: then every step may give what it likes."""
    binding: Binding = DEFAULT
    resources: tuple[str, ...] = ()
    returns: tuple[tuple[str, Data], ...] = ()
    """The answers of a simulated server, by result field."""
    recoveries: Node | None = None
    """The recoveries of the domain, for `pnm.language.steps` to read."""

    @property
    def name(self) -> str:
        """The name of the schema."""
        return self.schema.name

    @cached_property
    def objects(self) -> frozenset[str]:
        """The parameters, with ``?``, that stand for objects: by their type, or because facts have them as arguments."""
        typed = (variable.name for variable in self.schema.parameters if variable.types != ("object",))
        return frozenset(typed).union(*map(_in_fluents, self._conditions), _in_effects(self._effects))

    @cached_property
    def mentioned(self) -> frozenset[str]:
        """The parameters, with ``?``, that the conditions and effects mention."""
        return frozenset().union(*map(free_variables, self._conditions), _in_effects(self._effects, values=True))

    @property
    def _conditions(self) -> tuple[Condition, ...]:
        return self.schema.precondition, self.schema.invariant, self.schema.end_condition, self.schema.expected

    @property
    def _effects(self) -> Effects:
        return (*self.schema.start_effects, *self.schema.end_effects)


def _in_fluents(condition: Condition) -> frozenset[str]:
    """Return the variables that are arguments of facts and functions."""
    return frozenset(name for fluent in fluents(condition, _AnyObject()) for name in variables_in(fluent))


class _AnyObject:
    """A state with one object that stands for all that quantifiers speak of."""

    def value(self, fluent: Fluent, /) -> None:
        return None

    def objects(self, types: tuple[str, ...], /) -> tuple[str, ...]:
        return ("any",)


def _in_effects(effects: Effects, *, values: bool = False) -> frozenset[str]:
    names: set[str] = set()
    for effect in effects:
        match effect:
            case Set(fluent, value):
                names |= variables_in(fluent) | (expression_variables(value) if values else frozenset())
            case When(condition, inner):
                names |= (free_variables(condition) if values else _in_fluents(condition)) | _in_effects(inner, values=values)
            case ForEach(variables, inner):
                names |= _in_effects(inner, values=values) - {variable.name for variable in variables}
            case OneOf():
                names |= _in_effects(effect.effects, values=values)
            case _:
                assert_never(effect)
    return frozenset(names)


def read_schema(name: str, keys: Action, scope: FormulaScope) -> ActionSchema:
    """Read the schema of an action from its keys, given the names around it; the action's parameters come besides."""
    params, duration = keys.params, keys.duration
    parameters = () if params is None else read_typed(params, scope)
    bound = replace(scope, variables=None if params is None and not scope.strict else {}).inside(parameters)
    bounds = None if duration is None else read_duration(duration, bound)
    inner = bound.inside((Variable(DURATION[0]),)) if scope.strict and bounds is not None else bound
    conditions = read_conditions(keys.preconditions, inner)
    start_effects, end = read_timed_effects(keys.effects, inner)
    end_effects = end.effects if keys.outcomes is None else (*end.effects, read_outcomes(keys.outcomes, inner))
    if has_outcomes(start_effects):
        raise InputError("a robot says at the end how an action has turned out; expected one_of there", keys.entry.position("effects"))
    schema = ActionSchema(name, parameters, *conditions, start_effects, end_effects, bounds, expected=end.expected)
    if scope.strict:
        timed = (schema.invariant, schema.end_condition) != (TRUE, TRUE), bool(schema.start_effects)
        for key, has_moments in zip(("preconditions", "effects"), timed, strict=True):
            if has_moments and schema.duration is None:
                raise InputError(f"only an action with a duration has moments; expected {key} without them", keys.entry.position(key))
        if any(map(is_early, schema.start_effects if schema.duration is not None else schema.end_effects)):
            raise InputError(
                "only an effect at the end of an action with a duration can be tested at its start", keys.entry.position("effects")
            )
    return schema


def read_nature(name: str, keys: ProcessKeys, scope: FormulaScope) -> ActionSchema:
    """Read a process or an event."""
    parameters = () if keys.params is None else read_typed(keys.params, scope)
    inner = replace(scope, variables={}).inside(parameters)
    condition = TRUE if keys.preconditions is None else read_condition(keys.preconditions, inner)
    written, where = read_effects(keys.effects, inner), keys.entry.position("effects")
    if written.expected != TRUE or has_outcomes(written.effects) or any(map(is_early, written.effects)):
        raise InputError(f"{name} happens by itself, in one way; expected effects on facts and functions alone", where)
    changed = (effect for effect in every_effect(written.effects) if isinstance(effect, Set))
    if not isinstance(keys, EventKeys) and any(effect.operation not in ("increase", "decrease") for effect in changed):
        raise InputError("a process changes numbers as time passes; expected increase or decrease, by how much in a second", where)
    return ActionSchema(name, parameters, condition, end_effects=written.effects)


def read_action(schema: ActionSchema, keys: Action, scope: FormulaScope) -> LanguageAction:
    """Read how an action is executed."""
    if schema.name in RESERVED:
        raise InputError(f"{schema.name!r} is a word of the language; expected another name for the action", keys.entry.start)
    kind = ActionKind.ROS
    if (node := keys.type) is not None:
        name = read_class(node)[1] if node.is_mapping else node.text
        if name is None:
            raise node.wrong(f"expected a kind of action such as ros_action, found {shown(node)}")
        known = CLASSES if node.is_mapping else _KINDS
        if name not in known:
            raise unknown("kind of action", name, known, node.position)
        kind = known[name]
    is_open = keys.params is None
    inner = replace(scope, variables=None if is_open else {}).inside(schema.parameters)
    check_stored(keys.store, keys.entry, inner)
    model, own = scope.declared, {variable.name[1:]: variable.types for variable in schema.parameters}
    words = replace(model.vocabulary, actions={schema.name: own}) if keys.found and model.domain.fluents else None
    returns: list[tuple[str, Data]] = []
    for name, _, value in keys.simulated.entries():
        data = read_data(value, inner)
        if any(isinstance(part, Query) for part in parts(data)):
            raise value.wrong(f"a simulated server knows its goal, not the variables of the run; expected something like ?{name}")
        returns.append((name, data))
    return LanguageAction(
        schema,
        kind,
        keys.entry.start,
        is_open,
        binding=read_binding(keys, schema.name, words),
        resources=tuple(keys.resources),
        returns=tuple(returns),
        recoveries=keys.recoveries,
    )


def check_stored(store: Mapping[str, str], entry: Mapped, scope: FormulaScope) -> None:
    """Refuse a fluent that a result cannot set by the key ``store``: of what is not there, or what follows from other facts."""
    for fluent, node in stored_fluents(store, entry):
        scope.check_fluent(fluent, node)
        if fluent[0] in scope.declared.domain.rules.derived:
            raise node.wrong(f"facts of {fluent[0]} follow from rules; no result sets them")


def read_class(node: Node) -> tuple[str, str]:
    """Read ``{module: a.b, class: C}``, which names a class for the original implementation; nothing is imported."""
    keys = ClassName(node.mapped())
    if not keys.module or not keys.class_:
        raise node.wrong("expected the keys 'module' and 'class'")
    return keys.module, keys.class_


# --- declarations ---------------------------------------------------------------------------------
# Declarations of the YAML language: types, objects, predicates, functions, derived facts, initial facts.
#
# Types, constants and objects are PDDL's text (``r1 r2 - robot``) or lists of such texts, predicates and functions lists
# of texts such as ``(at ?r - robot ?p - place)`` and ``(location ?r - robot) - place``. Every reader raises InputError, with
# the position, for what is malformed or has names that are not there.


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


def read_rule(node: Node, scope: FormulaScope) -> DerivationRule:
    """Read ``{fact: (reachable ?p - place), condition: c}``; variables of its head that have no type have that of the declaration."""
    keys = RuleKeys(node.mapped())
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


# --- domain ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LanguageDomain:
    """A domain and its problem, and how the actions are executed, by name."""

    model: ProblemModel = NOTHING_DECLARED
    """With the section ``problem``, if there is one."""
    actions: Mapping[str, LanguageAction] = field(default_factory=dict)
    sources: tuple[SourceChoice, ...] = ()
    """The sources of knowledge that the file chose."""
    warnings: tuple[Tolerated, ...] = ()
    """The tolerated mistakes in the file."""
    file: str = ""
    """Its source file."""


def domain_from(top: Mapped, warnings: tuple[Tolerated, ...] = ()) -> LanguageDomain:
    """Read a domain from a document that may have other keys as well."""
    keys = DomainKeys(top)
    keys.action_types  # noqa: B018  only anchors are made there; their contents are read where they are used
    model, actions = read_model(keys), keys.actions
    return LanguageDomain(
        model,
        {name: read_action(schema, actions[name], FormulaScope(model)) for name, schema in model.domain.actions.items()},
        sources=_read_sources(keys),
        warnings=warnings,
        file=top.file,
    )


def read_model(top: DomainKeys, *, strict: bool = False) -> ProblemModel:
    """Read the domain of a document and its problem; `strict` is that of `FormulaScope`."""
    section = top.problem if top.entry.filled("problem") else None
    declared = read_declarations(top, section, strict=strict)
    scope = FormulaScope(declared, {}, strict, borrows=section is None)
    rules = tuple([read_rule(node, scope) for node in top.derived])
    try:
        domain = replace(declared.domain, rules=Rules(rules))
    except UnstratifiedError as error:
        raise InputError(str(error), top.entry.position("derived")) from error
    scope = replace(scope, declared=replace(declared, domain=domain))
    domain = replace(
        domain,
        actions={name: read_schema(name, keys, scope) for name, keys in top.actions.items()},
        processes={name: read_nature(name, keys, scope) for name, keys in top.processes.items()},
        events={name: read_nature(name, keys, scope) for name, keys in top.events.items()},
    )
    whole = replace(declared, domain=domain)
    for name, keys in top.actions.items():
        with located(keys.entry.start):
            known = [way.name for way in whole.outcomes(name)] if name in domain.uncertain else []
        for told, where, _ in keys.told.entries():
            if told not in known:
                raise unknown("outcome", told, known, where)
    if section is None:
        return replace(declared, domain=domain)
    written = [TimedFacts(item.mapped()) for item in section.init if item.is_mapping]
    changes = [TimedChange(keys.at, read_facts(keys.facts, scope)) for keys in written]
    timed = tuple(sorted(changes, key=lambda change: change.time))
    facts = read_facts([item for item in section.init if not item.is_mapping], scope)
    return replace(declared, domain=domain, init=facts, timed=timed, goal=read_goal(section.goal, scope))


def read_goal(node: Node | None, scope: FormulaScope) -> Condition:
    """Read a goal; true when there is none."""
    return TRUE if node is None else read_condition(node, scope)


def _read_sources(top: DomainKeys) -> tuple[SourceChoice, ...]:
    """Read the sources of knowledge that a file chooses.

    ``external_knowledge_base`` has a class of the original implementation, for which a registered source stands; ``knowledge``
    has names of sources, or ``{name: {option: value}}``: one, or a list of them.
    """
    sources: list[SourceChoice] = []
    external = top.external_knowledge_base
    if external is not None:
        name = check_source(".".join(read_class(external)), external.position)
        sources.append(SourceChoice(name, {}, external.position))
    for node in top.knowledge:
        if node.text is not None:
            sources.append(SourceChoice(check_source(node.text, node.position), {}, node.position))
        elif not node.is_mapping:
            raise node.wrong(f"expected the name of a source of knowledge, found {shown(node)}")
        else:
            for name, position, options in node.mapped().entries():
                plain = {} if options.is_null else options.plain()
                if not isinstance(plain, dict):
                    raise options.wrong(f"expected options of {name} (option: value), found {shown(options)}")
                sources.append(SourceChoice(check_source(name, position), plain, position))
    return tuple(sources)
