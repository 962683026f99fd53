"""Domains and problems: small and frozen. Conditions and effects are pnm's, with variables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

from pnm.core.logic.conditions import TRUE, Condition
from pnm.core.logic.declared_names import FluentKind, Signature, Vocabulary
from pnm.core.logic.effects import Effects, TimedChange
from pnm.core.logic.expressions import Expression, Fluent, Value, Variable
from pnm.core.logic.rules import Rule
from pnm.core.logic.trajectory import Constraint
from pnm.errors import Position, Tolerated


@dataclass(frozen=True, slots=True)
class DurationConstraint:
    """``(= ?duration e)``, ``(<= ?duration e)`` or ``(>= ?duration e)``."""

    operation: Literal["=", "<=", ">="]
    bound: Expression

    def __str__(self) -> str:
        return f"({self.operation} ?duration {self.bound})"


@dataclass(frozen=True, slots=True)
class Preference:
    """What a plan should bring about but need not; a metric counts how often it does not: ``(is-violated name)``.

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


@dataclass(frozen=True, slots=True)
class Declaration:
    """A predicate, or a function, with its typed parameters."""

    name: str
    parameters: tuple[Variable, ...] = ()
    values: tuple[str, ...] = ()
    """Of a function whose values are objects, their types; empty for predicates and numeric functions."""

    def __str__(self) -> str:
        return f"({' '.join((self.name, *map(str, self.parameters)))})"


def _signature(declared: Declaration, kind: FluentKind) -> Signature:
    return Signature(kind, tuple(variable.types for variable in declared.parameters), declared.values)


@dataclass(frozen=True, slots=True)
class Borrowed:
    """An object that a domain names without declaring it: every problem has to."""

    types: tuple[str, ...]
    """What it is where it is named first."""
    position: Position = field(compare=False)


@dataclass(frozen=True)
class Domain:
    """Types, constants, predicates, functions and actions, all by name in the order of the file."""

    name: str
    requirements: tuple[str, ...] = ()
    types: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """For every type, the types it is directly a kind of; ``object`` is the root and not listed."""
    constants: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """For every constant, its types."""
    predicates: Mapping[str, Declaration] = field(default_factory=dict)
    functions: Mapping[str, Declaration] = field(default_factory=dict)
    """Functions, with numbers or objects for values."""
    actions: Mapping[str, ActionSchema] = field(default_factory=dict)
    rules: tuple[Rule, ...] = ()
    """How derived predicates follow from others."""
    constraints: tuple[Constraint, ...] = ()
    preferences: tuple[Preference, ...] = ()
    """Constraints that should be kept but need not."""
    hierarchy: tuple[str, ...] = ()
    """Tasks and methods, as their HDDL text: only a hierarchical planner reads them."""
    borrowed: Mapping[str, Borrowed] = field(default_factory=dict)
    """Objects that only problems declare."""
    warnings: tuple[Tolerated, ...] = field(default=(), compare=False, repr=False)
    """What in the file was not as it should be."""

    @property
    def parameters(self) -> dict[str, tuple[str, ...]]:
        """For every action, the names of its parameters, without ``?``."""
        return {name: tuple(variable.name[1:] for variable in schema.parameters) for name, schema in self.actions.items()}

    def supertypes(self, name: str) -> frozenset[str]:
        """Return the type itself and everything it is a kind of, ``object`` included."""
        found = {"object", name}
        waiting = [name]
        while waiting:
            for parent in self.types.get(waiting.pop(), ()):
                if parent not in found:
                    found.add(parent)
                    waiting.append(parent)
        return frozenset(found)


@dataclass(frozen=True, slots=True)
class Metric:
    """What a plan should minimise or maximise; ``(total-time)`` is a fluent like any other here."""

    direction: Literal["minimize", "maximize"]
    expression: Expression


@dataclass(frozen=True)
class Problem:
    """Objects, an initial state and a goal for a domain."""

    name: str
    domain: Domain
    own_objects: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """For every object of the problem, its types; the domain's constants come besides."""
    init: Mapping[Fluent, Value] = field(default_factory=dict)
    """True facts and the values of functions."""
    timed: tuple[TimedChange, ...] = ()
    """Ordered by time."""
    goal: Condition = TRUE
    metric: Metric | None = None
    constraints: tuple[Constraint, ...] = ()
    """The problem's own; those of the domain come besides."""
    preferences: tuple[Preference, ...] = ()
    """Goals and constraints that should be kept but need not; those of the domain come besides."""
    network: str = ""
    """The tasks to be carried out, as their HDDL text: only a hierarchical planner reads it."""
    requirements: tuple[str, ...] = ()
    """The problem's own; those of the domain come besides."""
    warnings: tuple[Tolerated, ...] = field(default=(), compare=False, repr=False)
    """What in the file, and in that of the domain, was not as it should be."""

    @property
    def vocabulary(self) -> Vocabulary:
        """The names that files about this problem may use."""
        fluents = frozenset((*self.domain.predicates, *self.domain.functions))
        derived = frozenset(rule.name for rule in self.domain.rules)
        types = {name: self.domain.supertypes(name) for name in ("object", *self.domain.types)}
        types_of = {name: types["object"].union(*map(self.domain.supertypes, kinds)) for name, kinds in self.objects.items()}
        predicates = {name: _signature(declared, FluentKind.FACT) for name, declared in self.domain.predicates.items()}
        functions = {
            name: _signature(one, FluentKind.OBJECT if one.values else FluentKind.NUMBER) for name, one in self.domain.functions.items()
        }
        return Vocabulary(self.domain.parameters, fluents, frozenset(self.objects), derived, {**predicates, **functions}, types, types_of)

    @property
    def is_timed(self) -> bool:
        """Whether the starts of a plan are times: some action lasts, or facts change by themselves."""
        return bool(self.timed) or any(schema.duration is not None for schema in self.domain.actions.values())

    @cached_property
    def objects(self) -> dict[str, tuple[str, ...]]:
        """Every object and constant by name, with its types."""
        return {**self.domain.constants, **self.own_objects}

    @cached_property
    def objects_by_type(self) -> dict[str, tuple[str, ...]]:
        """For every type, its objects in the order in which they were declared."""
        found: dict[str, list[str]] = {name: [] for name in ("object", *self.domain.types)}
        for name, types in self.objects.items():
            for one in sorted(frozenset().union(*(self.domain.supertypes(kind) for kind in types))):
                found.setdefault(one, []).append(name)
        return {kind: tuple(names) for kind, names in found.items()}
