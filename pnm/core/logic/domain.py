"""The model of a domain and of a problem that PDDL and YAML files share: types, objects, predicates, functions, action schemas, rules.

It knows neither format. `planner_bridge.model.problem` adds what only planners need.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from math import isfinite
from typing import Final, Literal, TypeAlias

from pnm.core.logic.conditions import TRUE, Condition, choices_in
from pnm.core.logic.effects import Alternative, Effects, TimedChange, choices_in_effects, has_outcomes, names_written, outcomes
from pnm.core.logic.expressions import EXISTS, UNDEFINED, Expression, Fluent, OnlyObjects, Unknown, Value, Variable, fluent_text
from pnm.core.logic.rules import NO_RULES, Rules
from pnm.core.logic.trajectory import Constraint
from pnm.errors import InputError, Position, suggestion

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

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters, without ``?``."""
        return tuple([variable.name[1:] for variable in self.parameters])

    def environment(self, arguments: Iterable[str]) -> dict[str, object]:
        """Return the objects for the variables, of which there are as many."""
        return {variable.name: argument for variable, argument in zip(self.parameters, arguments, strict=True)}


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
    """The rules for derived predicates: one object for all that is planned and known in the domain."""
    processes: Mapping[str, ActionSchema] = field(default_factory=dict)
    """What goes on while its precondition holds (PDDL+): its effects say by how much numbers increase or decrease in a second."""
    events: Mapping[str, ActionSchema] = field(default_factory=dict)
    """What comes about as soon as its precondition holds (PDDL+)."""

    @cached_property
    def fluents(self) -> dict[str, Declaration]:
        """Predicates and functions; of two with the same name, the function."""
        return {**self.predicates, **self.functions}

    @cached_property
    def nature(self) -> tuple[ActionSchema, ...]:
        """What happens by itself: processes and events."""
        return (*self.processes.values(), *self.events.values())

    @cached_property
    def moved(self) -> frozenset[str]:
        """The functions whose numbers change as time passes."""
        return frozenset(name for process in self.processes.values() for name in names_written(process.end_effects))

    @cached_property
    def schemas(self) -> tuple[ActionSchema, ...]:
        """All that changes facts: actions, processes, events."""
        return (*self.actions.values(), *self.nature)

    @cached_property
    def uncertain(self) -> frozenset[str]:
        """The actions that may turn out in several ways."""
        return frozenset(name for name, schema in self.actions.items() if has_outcomes(schema.end_effects))

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
        derived = domain.rules.derived
        types = {name: domain.supertypes(name) for name in ("object", *domain.types)}
        types_of = {name: types["object"].union(*map(domain.supertypes, kinds)) for name, kinds in self.objects.items()}
        kinds = {name: FluentKind.OBJECT if declared.values else FluentKind.NUMBER for name, declared in domain.functions.items()}
        signatures = {
            name: Signature(kinds.get(name, FluentKind.FACT), tuple(variable.types for variable in declared.parameters), declared.values)
            for name, declared in domain.fluents.items()
        }
        return Vocabulary(
            *(domain.parameters, frozenset(domain.fluents), frozenset(self.objects), derived, signatures, types, types_of),
            outcomes={name: tuple([way.name for way in self.outcomes(name)]) for name in domain.uncertain},
        )

    def outcomes(self, action: str) -> tuple[Alternative, ...]:
        """Return the ways in which an action may turn out, for any arguments."""
        return outcomes(self.domain.actions[action].end_effects, OnlyObjects(self.objects_by_type))

    @property
    def is_timed(self) -> bool:
        """Whether the starts of a plan are times: some action lasts, or facts change by themselves."""
        return bool(self.timed or self.domain.nature) or any(schema.duration is not None for schema in self.domain.actions.values())

    @cached_property
    def objects(self) -> dict[str, Types]:
        """Every object and constant by name, with its types."""
        return {**self.domain.constants, **self.own_objects}

    @cached_property
    def objects_by_type(self) -> dict[str, tuple[str, ...]]:
        """For every type, its objects in the order in which they were declared."""
        objects: dict[str, list[str]] = {name: [] for name in ("object", *self.domain.types)}
        kinds = {types: sorted(self.all_types(types)) for types in {*self.objects.values()}}
        for name, types in self.objects.items():
            for kind in kinds[types]:
                objects.setdefault(kind, []).append(name)
        return {kind: tuple(names) for kind, names in objects.items()}

    def count(self, types: Types) -> int:
        """Return the number of objects of any of the types."""
        return len(frozenset().union(*(self.objects_by_type.get(kind, ()) for kind in types)))

    def ranges(self) -> Iterator[tuple[str, int]]:
        """Yield for everything that quantifiers may stand in what it is, and over how many choices of objects they range."""
        for rule in self.domain.rules:
            yield f"the rule of {rule.name}", choices_in(rule.condition, self.count)
        for schema in self.domain.schemas:
            conditions = (schema.precondition, schema.invariant, schema.end_condition)
            yield f"a condition of {schema.name}", max(choices_in(condition, self.count) for condition in conditions)
            effects = (schema.start_effects, schema.end_effects)
            yield f"the effects of {schema.name}", max(choices_in_effects(part, self.count) for part in effects)
        yield "the goal", choices_in(self.goal, self.count)

    def all_types(self, types: Iterable[str]) -> frozenset[str]:
        """Return the types and all of their supertypes."""
        return frozenset().union(*map(self.domain.supertypes, types))


# --- the declared names, and the refusal of all others in files about them -----------------


class FluentKind(Enum):
    """The kind of a fluent's values."""

    FACT = "predicate"
    NUMBER = "function with numbers for values"
    OBJECT = "function with objects for values"


@dataclass(frozen=True, slots=True)
class Signature:
    """The use of a predicate or function."""

    kind: FluentKind
    parameters: tuple[tuple[str, ...], ...] = ()
    """For every parameter, the types of its objects."""
    values: tuple[str, ...] = ()
    """The types of the objects that are its values."""


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """The declared names of a domain and its problem. Checks raise InputError, with the position and the nearest name."""

    actions: Mapping[str, Mapping[str, tuple[str, ...]]]
    """For every action, its parameters without ``?``, and their types."""
    fluents: frozenset[str] = frozenset()
    """Predicates and functions."""
    objects: frozenset[str] = frozenset()
    derived: frozenset[str] = frozenset()
    """Predicates whose facts follow from others by rules."""
    signatures: Mapping[str, Signature] = field(default_factory=dict)
    """The uses of predicates and functions."""
    types: Mapping[str, frozenset[str]] = field(default_factory=dict)
    """For every type, the type itself and its supertypes."""
    types_of: Mapping[str, frozenset[str]] = field(default_factory=dict)
    """For every object, its types and their supertypes."""
    open: frozenset[str] = frozenset()
    """The predicates and functions whose facts may also be about objects that are not declared."""
    is_complete: bool = True
    """Whether there are no other predicates and functions than those declared."""
    outcomes: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """For every action that may turn out in several ways, their names."""

    def spelled(self, name: str) -> str:
        """Return the declared name that is the same but for capitals, which PDDL does not tell apart; else the name as it is."""
        every = (self.actions, self.fluents, self.objects)
        if any(name in declared for declared in every):
            return name
        return next((one for declared in every for one in declared if one.casefold() == name.casefold()), name)

    def check_action(self, name: str, position: Position) -> None:
        """Refuse an action that is not declared."""
        _check(name, self.actions, "action", position)

    def check_parameter(self, action: str, name: str, position: Position) -> None:
        """Refuse a parameter that the action does not have."""
        known = self.actions[action]
        if name not in known:
            raise InputError(f"{name} is not a parameter of {action} ({', '.join(known) or 'it has none'})", position)

    def check_outcome(self, action: str, name: str, position: Position) -> None:
        """Refuse an outcome that the action does not have."""
        if action not in self.outcomes:
            raise InputError(f"{action} can turn out in one way only, so there is no outcome {name!r}", position)
        _check(name, self.outcomes[action], "outcome", position)

    def check_stored(self, action: str, fluent: Fluent, position: Position, found: Types = ()) -> None:
        """Refuse a fluent that the result of an action cannot set: of undeclared names, or with other arguments than declared.

        What ``?found`` stands for has the types `found`.
        """
        self.check_set(fluent[0], position)
        needed = self.signatures[fluent[0]].parameters
        if len(fluent) - 1 != len(needed):
            raise InputError(f"{fluent_text(fluent)} has {len(fluent) - 1} arguments; expected {len(needed)}", position)
        for argument, types in zip(fluent[1:], needed, strict=True):
            if not argument.startswith("?"):
                self.check_object(argument, types, position)
                continue
            if not (own := found if argument == "?found" else ()):
                self.check_parameter(action, argument[1:], position)
                own = self.actions[action][argument[1:]]
            if not any(self.types[kind] & {*types} for kind in own) and not any(self.types[kind] & {*own} for kind in types):
                raise InputError(f"{argument} is a {alternatives(own)}; expected a {alternatives(types)}", position)

    def with_objects(self, found: Mapping[str, Iterable[str]]) -> Vocabulary:
        """Return the names with those of objects that were found, of these types, besides."""
        new = {name: kinds for name, kinds in found.items() if name not in self.objects}
        types = {name: frozenset({"object"}).union(*(self.types.get(kind, ()) for kind in kinds)) for name, kinds in new.items()}
        return replace(self, objects=self.objects | new.keys(), types_of={**self.types_of, **types})

    def arguments(self, action: str, parameter: str) -> tuple[str, ...]:
        """Return the objects that a parameter of an action may stand for, in the order of the alphabet."""
        return self._objects_of(self.actions[action][parameter])

    def values(self, function: str) -> tuple[str, ...]:
        """Return the objects that may be values of a function, in the order of the alphabet; none if its values are numbers."""
        return self._objects_of(self.signatures[function].values) if function in self.signatures else ()

    def _objects_of(self, types: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(sorted(name for name, kinds in self.types_of.items() if not kinds.isdisjoint(types)))

    def check_call(self, what: str, position: Position) -> None:
        """Refuse ``move(r1, hall)`` if the action or an object is not declared, or the number of arguments is wrong."""
        name, _, rest = what.partition("(")
        self.check_action(name, position)
        if rest:
            arguments = [argument.strip() for argument in rest.rstrip(")").split(",") if argument.strip()]
            if len(arguments) != len(self.actions[name]):
                raise InputError(f"{name} takes {len(self.actions[name])} arguments, found {len(arguments)}", position)
            for argument in arguments:
                _check(argument, self.objects, "object", position)

    def check_set(self, name: str, position: Position | None) -> None:
        """Refuse a predicate or function that is not declared, or that is neither set nor reported."""
        _check(name, self.fluents, "predicate or function", position)
        if name in self.derived:
            raise InputError(f"facts of {name} follow from rules; they are neither set nor reported", position)

    def check_change(self, fluent: Fluent, value: Value, position: Position) -> None:
        """Refuse a new value of undeclared names, or of what cannot be set."""
        self.check_set(fluent[0], position)
        for argument in (*fluent[1:], *((value,) if isinstance(value, str) and value != UNDEFINED else ())):
            _check(argument, self.objects, "object", position)

    def check_report(self, fluent: Fluent, value: Value | Unknown) -> None:
        """Refuse a reported value of undeclared names, of another kind, or with other arguments than declared."""
        name, text = fluent[0], fluent_text(fluent)
        if not self.may_be_reported(name) or name in self.fluents:
            self.check_set(name, None)
        for found in fluent[2:] if name == EXISTS else ():
            self.check_type(found, None)
            self.check_object(fluent[1], (found,), None)
        signature = self.signatures.get(name)
        if signature is None:
            return
        kind = FluentKind.FACT if isinstance(value, bool) else FluentKind.OBJECT if isinstance(value, str) else FluentKind.NUMBER
        if kind is not signature.kind and not isinstance(value, Unknown):
            raise InputError(f"{text} is reported as a {kind.value}; {name} is a {signature.kind.value}")
        if len(fluent) - 1 != len(signature.parameters):
            raise InputError(f"{text} has {len(fluent) - 1} arguments; expected {len(signature.parameters)}")
        for argument, types in zip(fluent[1:], signature.parameters, strict=True):
            self._check_reported(name, argument, types)
        if isinstance(value, str) and value != UNDEFINED:
            self._check_reported(name, value, signature.values)
        if isinstance(value, float) and not isfinite(value):
            raise InputError(f"{text} is reported as {value}; expected a finite number")

    def may_be_reported(self, name: str) -> bool:
        """Return whether there may be facts of this name."""
        return name in self.fluents or name == EXISTS or not self.is_complete

    def _check_reported(self, name: str, reported: str, types: Iterable[str]) -> None:
        if reported in self.objects or name not in self.open:
            self.check_object(reported, types, None)

    def check_type(self, name: str, position: Position | None) -> None:
        """Refuse a type that is not declared."""
        _check(name, self.types, "type", position)

    def check_object(self, name: str, types: Iterable[str], position: Position | None) -> None:
        """Refuse an object that is not declared, or that is of none of the types."""
        _check(name, self.objects, "object", position)
        if self.types_of[name].isdisjoint(types):
            raise InputError(f"{name} is a {alternatives(self.types_of[name])}; expected a {alternatives(types)}", position)

    def check_kind(self, name: str, kind: FluentKind, position: Position) -> Signature:
        """Return the signature of a predicate or function, which must be of this kind and not derived."""
        known = [declared for declared, signature in self.signatures.items() if signature.kind is kind]
        if name in self.signatures and name not in known:
            raise InputError(f"{name} is a {self.signatures[name].kind.value}; expected a {kind.value}", position)
        _check(name, known, kind.value, position)
        self.check_set(name, position)
        return self.signatures[name]


def alternatives(types: Iterable[str]) -> str:
    """Return the names of types, any of which would do."""
    return " or ".join(sorted(set(types) - {"object"})) or "object"


def _check(name: str, known: Collection[str], what: str, position: Position | None) -> None:
    if name not in known:
        names = sorted(known)
        hint = suggestion(name, names) or f"expected one of {', '.join(names[:20])}"
        raise InputError(f"there is no {what} {name!r} in the domain; {hint}", position)


Types: TypeAlias = tuple[str, ...]
"""The types of a term: an object that is of any of them fits."""
