"""The actions of a domain: from YAML to schemas, which `pnm.language.ground_calls` grounds, and to how they are executed."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final

from pnm.actions.bindings_file import read_binding
from pnm.core.logic.computed_values import Data, Query, parts
from pnm.core.logic.conditions import TRUE, Condition, fluents, free_variables
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.effects import Effects, ForEach, Set, When, is_early
from pnm.core.logic.expressions import DURATION, Fluent, Variable, expression_variables, variables_in
from pnm.core.machine.bindings import DEFAULT, Binding
from pnm.errors import InputError, Position
from pnm.files.yaml_nodes import Node
from pnm.language.formulas.effects import read_conditions, read_duration, read_timed_effects
from pnm.language.formulas.scope import FormulaScope, read_typed, shown, unknown
from pnm.language.formulas.values import read_data
from pnm.language.grammar import RESERVED, Action, ActionKind, ClassName

CLASSES: Final = {"ROSAtomicAction": ActionKind.ROS, "RPNAtomicAction": ActionKind.RPN, "KBAction": ActionKind.KB}
"""The classes that files for the original implementation name; none of them is imported."""
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
    """The recoveries of the domain, for `pnm.language.plan_tree` to read."""

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
    schema = ActionSchema(
        name, parameters, conditions.start, conditions.always, conditions.end, start_effects, end.effects, bounds, expected=end.expected
    )
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


def read_action(schema: ActionSchema, keys: Action, scope: FormulaScope) -> LanguageAction:
    """Read how an action is executed."""
    if schema.name in RESERVED:
        raise InputError(f"{schema.name!r} is a word of the language; expected another name for the action", keys.entry.start)
    is_open = keys.params is None
    inner = replace(scope, variables=None if is_open else {}).inside(schema.parameters)
    returns: list[tuple[str, Data]] = []
    for name, _, value in keys.simulated.entries():
        data = read_data(value, inner)
        if any(isinstance(part, Query) for part in parts(data)):
            raise value.wrong(f"a simulated server knows its goal, not the variables of the run; expected something like ?{name}")
        returns.append((name, data))
    return LanguageAction(
        schema,
        ActionKind.ROS if keys.type is None else _kind(keys.type),
        keys.entry.start,
        is_open,
        binding=read_binding(keys),
        resources=tuple(keys.resources),
        returns=tuple(returns),
        recoveries=keys.recoveries,
    )


def _kind(node: Node) -> ActionKind:
    """Return how the action is executed."""
    kinds: dict[str, ActionKind] = {kind.value: kind for kind in CLASSES.values()}
    name = read_class(node)[1] if node.is_mapping else node.text
    if name is None:
        raise node.wrong(f"expected a kind of action such as ros_action, found {shown(node)}")
    known = CLASSES if node.is_mapping else kinds
    if name not in known:
        raise unknown("kind of action", name, known, node.position)
    return known[name]


def read_class(node: Node) -> tuple[str, str]:
    """Read ``{module: a.b, class: C}``, which names a class for the original implementation; nothing is imported."""
    keys = ClassName(node.mapped())
    if not keys.module or not keys.class_:
        raise node.wrong("expected the keys 'module' and 'class'")
    return keys.module, keys.class_
