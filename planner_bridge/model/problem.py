"""Domains and problems of planning: the shared model of `pnm.core.logic.domain`, and what only planners need."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from math import prod
from typing import Concatenate, Final, Literal, ParamSpec, TypeVar
from weakref import ref

from pnm.core.logic.conditions import choices_in
from pnm.core.logic.domain import DomainModel, Preference, ProblemModel, Types
from pnm.core.logic.expressions import Expression, Fluent
from pnm.core.logic.trajectory import Constraint
from pnm.errors import Position, Tolerated

TOTAL_TIME: Final[Fluent] = ("total-time",)
"""The names that metrics use for the duration of a plan, or its number of steps."""
TOTAL_COST: Final = "total-cost"
"""The one function that is used undeclared, and that actions may change although it has no value."""


@dataclass(frozen=True, slots=True)
class Borrowed:
    """An object that a domain names without declaring it: every problem has to."""

    types: Types
    """Those that are needed where it is named first."""
    position: Position = field(compare=False)


@dataclass(frozen=True, repr=False)
class Domain(DomainModel):
    """A domain as planners see it."""

    requirements: tuple[str, ...] = ()
    constraints: tuple[Constraint, ...] = ()
    preferences: tuple[Preference, ...] = ()
    """Soft constraints."""
    hierarchy: tuple[str, ...] = ()
    """Tasks and methods, as their HDDL text: only a hierarchical planner reads them."""
    borrowed: Mapping[str, Borrowed] = field(default_factory=dict)
    """Objects that only problems declare."""
    warnings: tuple[Tolerated, ...] = field(default=(), compare=False, repr=False)
    """The tolerated mistakes in the file."""

    def __repr__(self) -> str:
        return f"<Domain {self.name}: {len(self.actions)} actions, {len(self.fluents)} predicates and functions>"


@dataclass(frozen=True, slots=True)
class Metric:
    """The expression that a plan should minimise or maximise; ``(total-time)`` is a fluent like any other here."""

    direction: Literal["minimize", "maximize"]
    expression: Expression


@dataclass(frozen=True, repr=False)
class Problem(ProblemModel):
    """A problem as planners see it: its initial state has true facts and the values of functions."""

    domain: Domain
    metric: Metric | None = None
    constraints: tuple[Constraint, ...] = ()
    """The problem's own; those of the domain come besides."""
    preferences: tuple[Preference, ...] = ()
    """Soft goals and soft constraints; those of the domain come besides."""
    network: str = ""
    """The initial task network, as its HDDL text: only a hierarchical planner reads it."""
    requirements: tuple[str, ...] = ()
    """The problem's own; those of the domain come besides."""
    unknown: frozenset[Fluent] = field(default=frozenset(), compare=False)  # which PDDL cannot write
    """The fluents that may be so or not: for planners, which know no such thing, they are false or without a value."""
    guards: Mapping[Fluent, str] = field(default_factory=dict)
    """Facts of the initial state that only keep actions from being used: for each, which calls these are, in words."""
    warnings: tuple[Tolerated, ...] = field(default=(), compare=False, repr=False)
    """The tolerated mistakes in the file, and in that of the domain."""

    def __repr__(self) -> str:
        return f"<Problem {self.name} of {self.domain.name}: {len(self.objects)} objects, goal {self.goal}>"

    @cached_property
    def members(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """The objects of every type, if outcomes of actions may be other ones for other objects; else empty."""
        return tuple(self.objects_by_type.items()) if self.domain.uncertain else ()

    def ranges(self) -> Iterator[tuple[str, int]]:
        """Yield for everything that quantifiers may stand in what it is, and over how many choices of objects they range."""
        yield from super().ranges()
        own = (*self.domain.constraints, *self.constraints)
        of_actions = (preference for schema in self.domain.actions.values() for preference in schema.preferences)
        for preference in (*self.domain.preferences, *self.preferences, *of_actions):
            wanted = preference.wanted if isinstance(preference.wanted, tuple) else (Constraint("at end", (preference.wanted,)),)
            own += tuple(replace(constraint, variables=(*preference.variables, *constraint.variables)) for constraint in wanted)
        for constraint in own:
            around = prod(self.count(variable.types) for variable in constraint.variables) if constraint.variables else 0
            yield str(constraint), sum(choices_in(condition, self.count, around) for condition in constraint.conditions)

    @property
    def sign(self) -> float:
        """The factor with which less of the metric is better: -1 where it is maximized."""
        return -1.0 if self.metric and self.metric.direction == "maximize" else 1.0

    @property
    def has_preferences(self) -> bool:
        """Whether there are preferences: here, in the domain, or in an action."""
        return bool(self.preferences or self.domain.preferences or any(schema.preferences for schema in self.domain.actions.values()))

    @property
    def has_tasks(self) -> bool:
        """Whether there is a task network, or methods (HDDL)."""
        return bool(self.network or self.domain.hierarchy)


P = ParamSpec("P")
T = TypeVar("T")

_KEPT: Final = 2_000
"""Answers about one domain, at most; then all are found anew."""


def once_per_domain(find: Callable[Concatenate[Domain, P], T]) -> Callable[Concatenate[Domain, P], T]:
    """Return a function that keeps its answers for as long as the domain is in use; domains are told apart by identity.

    The other arguments are positional and hashable. An answer that has a reference to its domain would keep both for good.
    """
    kept: dict[int, tuple[ref[Domain], dict[object, T]]] = {}

    @wraps(find)
    def once(domain: Domain, /, *args: P.args, **kwargs: P.kwargs) -> T:
        number = id(domain)
        if number not in kept:
            kept[number] = ref(domain, lambda _: kept.pop(number, None)), {}
        answers = kept[number][1]
        try:
            return answers[args]
        except KeyError:
            if len(answers) >= _KEPT:
                answers.clear()
        answer = answers[args] = find(domain, *args, **kwargs)
        return answer

    return once
