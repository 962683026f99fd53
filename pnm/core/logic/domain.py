"""The model of a domain and of a problem that PDDL and YAML files share: types, objects, predicates, functions, action schemas, rules.

It knows neither format. `planner_bridge.model.problem` adds what only planners need.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final, Literal, TypeAlias

from pnm.core.logic.conditions import TRUE, Condition, choices_in
from pnm.core.logic.declared_names import FluentKind, Signature, Vocabulary
from pnm.core.logic.effects import Effects, TimedChange, choices_in_effects
from pnm.core.logic.expressions import Expression, Fluent, Value, Variable
from pnm.core.logic.rules import NO_RULES, Rules
from pnm.core.logic.trajectory import Constraint
from pnm.errors import InputError, Position

Types: TypeAlias = tuple[str, ...]
"""The types of a term: an object that is of any of them fits."""


MAX_CHOICES: Final = 50_000
"""Choices of objects that the quantifiers of a condition, or of effects, may range over: all are looked at, again and again."""


def check_choices(choices: int, position: Position, what: str = "the quantifiers", limit: int = MAX_CHOICES) -> None:
    """Refuse quantifiers that range over more choices of objects than the limit."""
    if choices > limit:
        raise InputError(f"{what} range over {choices} choices of objects; expected {limit} at most", position)


@dataclass(frozen=True, slots=True)
class DurationConstraint:
    """``(= ?duration e)``, ``(<= ?duration e)`` or ``(>= ?duration e)``."""

    operation: Literal["=", "<=", ">="]
    bound: Expression

    def __str__(self) -> str:
        return f"({self.operation} ?duration {self.bound})"


@dataclass(frozen=True, slots=True)
class Preference:
    """A soft goal or soft constraint: a plan may violate it, and a metric counts how often it does: ``(is-violated name)``.

    With variables there is one instance for every choice of objects, all of the same name.
    """

    name: str
    """Empty when it has none, and then no metric counts it."""
    wanted: Condition | tuple[Constraint, ...]
    """A condition on the goal state or on the state an action is in, or constraints that should all be kept."""
    variables: tuple[Variable, ...] = ()
    """Of the quantifiers around it, outermost first."""
    moment: Literal["at start", "over all", "at end"] | None = None
    """Of a durative action's condition, when it should hold."""


@dataclass(frozen=True, slots=True)
class ActionSchema:
    """An action with parameters. Instantaneous when `duration` is None.

    An instantaneous action keeps its precondition in `precondition` and its effect in `end_effects`.
    """

    name: str
    parameters: tuple[Variable, ...] = ()
    precondition: Condition = TRUE
    """At start."""
    invariant: Condition = TRUE
    """Over all."""
    end_condition: Condition = TRUE
    """At end."""
    start_effects: Effects = ()
    end_effects: Effects = ()
    duration: tuple[DurationConstraint, ...] | None = None
    """Empty for a durative action of any duration."""
    preferences: tuple[Preference, ...] = ()
    """Conditions that should hold besides; a robot acts without them."""
    expected: Condition = TRUE
    """A condition on variables that the action's server is expected to bring about; PDDL has none."""


@dataclass(frozen=True, slots=True)
class Declaration:
    """A predicate, or a function, with its typed parameters."""

    name: str
    parameters: tuple[Variable, ...] = ()
    values: Types = ()
    """Of a function whose values are objects, their types; empty for predicates and numeric functions."""

    def __str__(self) -> str:
        return f"({' '.join((self.name, *map(str, self.parameters)))})"


@dataclass(frozen=True)
class DomainModel:
    """Types, constants, predicates, functions, actions and rules, all by name in the order of the file."""

    name: str
    types: Mapping[str, Types] = field(default_factory=dict)
    """For every type, its direct supertypes; ``object`` is the root and not listed."""
    constants: Mapping[str, Types] = field(default_factory=dict)
    predicates: Mapping[str, Declaration] = field(default_factory=dict)
    functions: Mapping[str, Declaration] = field(default_factory=dict)
    """Functions, with numbers or objects for values."""
    actions: Mapping[str, ActionSchema] = field(default_factory=dict)
    rules: Rules = NO_RULES
    """How derived predicates follow from others: one object for all that is planned and known in the domain."""

    @cached_property
    def fluents(self) -> dict[str, Declaration]:
        """Predicates and functions; of two with the same name, the function."""
        return {**self.predicates, **self.functions}

    @property
    def parameters(self) -> dict[str, dict[str, Types]]:
        """For every action, its parameters without ``?``, and their types."""
        return {name: {variable.name[1:]: variable.types for variable in schema.parameters} for name, schema in self.actions.items()}

    # --- types ---

    def supertypes(self, name: str) -> frozenset[str]:
        """Return the type itself and all of its supertypes, ``object`` included."""
        types, waiting = {"object", name}, [name]
        while waiting:
            new = set(self.types.get(waiting.pop(), ())) - types
            types |= new
            waiting += new
        return frozenset(types)

    def matches(self, given: Types, needed: Types) -> bool:
        """Return whether an object of the given types, all of them declared, fits the needed ones."""
        return given == needed or any(not self._supertypes[kind].isdisjoint(needed) for kind in given)

    def may_match(self, given: Types, needed: Types) -> bool:
        """Return whether some object that fits the given types also fits the needed ones: a variable stands for such."""
        if self.matches(given, needed):
            return True
        below = [self._subtypes[kind] for kind in needed]
        return any(not self._subtypes[kind].isdisjoint(other) for kind in given for other in below)

    def joined(self, *types: Types) -> Types:
        """Return the types of something that is of all of these, without those that follow from another."""
        every = tuple(dict.fromkeys(kind for some in types for kind in some))
        return tuple(kind for kind in every if not any(kind in self._supertypes[other] for other in every if other != kind))

    @cached_property
    def _supertypes(self) -> dict[str, frozenset[str]]:
        return {name: self.supertypes(name) for name in ("object", *self.types)}

    @cached_property
    def _subtypes(self) -> dict[str, frozenset[str]]:
        return {name: frozenset(below for below, above in self._supertypes.items() if name in above) for name in self._supertypes}


@dataclass(frozen=True)
class ProblemModel:
    """Objects, an initial state and a goal for a domain."""

    name: str
    domain: DomainModel
    own_objects: Mapping[str, Types] = field(default_factory=dict)
    """For every object of the problem, its types; the domain's constants come besides."""
    init: Mapping[Fluent, Value] = field(default_factory=dict)
    """Facts and the values of functions."""
    timed: tuple[TimedChange, ...] = ()
    """Changes that come by themselves (timed initial literals), ordered by time."""
    goal: Condition = TRUE

    @property
    def vocabulary(self) -> Vocabulary:
        """The names that files about this problem may use."""
        domain = self.domain
        fluents = frozenset((*domain.predicates, *domain.functions))
        derived = domain.rules.derived
        types = {name: domain.supertypes(name) for name in ("object", *domain.types)}
        types_of = {name: types["object"].union(*map(domain.supertypes, kinds)) for name, kinds in self.objects.items()}
        predicates = {name: _signature(declared, FluentKind.FACT) for name, declared in domain.predicates.items()}
        kinds = {name: FluentKind.OBJECT if declared.values else FluentKind.NUMBER for name, declared in domain.functions.items()}
        functions = {name: _signature(declared, kinds[name]) for name, declared in domain.functions.items()}
        return Vocabulary(domain.parameters, fluents, frozenset(self.objects), derived, {**predicates, **functions}, types, types_of)

    @property
    def is_timed(self) -> bool:
        """Whether the starts of a plan are times: some action lasts, or facts change by themselves."""
        return bool(self.timed) or any(schema.duration is not None for schema in self.domain.actions.values())

    @cached_property
    def objects(self) -> dict[str, Types]:
        """Every object and constant by name, with its types."""
        return {**self.domain.constants, **self.own_objects}

    @cached_property
    def objects_by_type(self) -> dict[str, tuple[str, ...]]:
        """For every type, its objects in the order in which they were declared."""
        objects: dict[str, list[str]] = {name: [] for name in ("object", *self.domain.types)}
        for name, types in self.objects.items():
            for kind in sorted(self.all_types(types)):
                objects.setdefault(kind, []).append(name)
        return {kind: tuple(names) for kind, names in objects.items()}

    def count(self, types: Types) -> int:
        """Return how many objects are of any of the types."""
        return len(frozenset().union(*(self.objects_by_type.get(kind, ()) for kind in types)))

    def ranges(self) -> Iterator[tuple[str, int]]:
        """Yield for everything that quantifiers may stand in what it is, and over how many choices of objects they range."""
        for rule in self.domain.rules:
            yield f"the rule of {rule.name}", choices_in(rule.condition, self.count)
        for schema in self.domain.actions.values():
            conditions = (schema.precondition, schema.invariant, schema.end_condition)
            yield f"a condition of {schema.name}", max(choices_in(condition, self.count) for condition in conditions)
            effects = (schema.start_effects, schema.end_effects)
            yield f"the effects of {schema.name}", max(choices_in_effects(part, self.count) for part in effects)
        yield "the goal", choices_in(self.goal, self.count)

    def all_types(self, types: Iterable[str]) -> frozenset[str]:
        """Return the types and all of their supertypes."""
        return frozenset().union(*map(self.domain.supertypes, types))


def _signature(declared: Declaration, kind: FluentKind) -> Signature:
    return Signature(kind, tuple(variable.types for variable in declared.parameters), declared.values)
