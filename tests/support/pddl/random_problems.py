"""Strategies for hypothesis: small random PDDL domains, problems, states and plans.

Numbers are small multiples of powers of two, so that every planner calculates with them exactly.
What one action does to one number at one moment is one thing: PDDL 2.1 gives no meaning to
``(and (assign (f) 1) (increase (f) 1))``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Final

from hypothesis import strategies as st

from planner_bridge.model.problem import Domain, Problem
from pnm.core.logic.conditions import TRUE, Any as AnyOf, Compare, Condition, Exists, ForAll, Holds, Implies, Not, conjunction
from pnm.core.logic.domain import ActionSchema, Declaration, DurationConstraint
from pnm.core.logic.effects import Alternative, Effect, Effects, ForEach, OneOf, Set, TimedChange, When
from pnm.core.logic.expressions import DURATION, Arithmetic, Constant, Expression, Fluent, Value, ValueOf, Variable

TYPES: Final = {"t": (), "u": ("t",), "w": ()}
NUMBERS: Final = st.sampled_from([0.0, 1.0, 2.0, 3.0, 0.5, -1.0])
DURATIONS: Final = st.sampled_from([1.0, 2.0, 0.5, 3.0, 0.0])
STARTS: Final = st.sampled_from([0.0, 1.0, 2.0, 3.0, 0.5, 1.5, 4.0, 5.0])
REQUIREMENTS: Final = (
    *(":typing", ":negative-preconditions", ":disjunctive-preconditions", ":equality", ":universal-preconditions"),
    *(":existential-preconditions", ":conditional-effects", ":numeric-fluents"),
)
Draw = Callable[[st.SearchStrategy[Any]], Any]


@dataclass(frozen=True)
class Features:
    """What is used besides the rest."""

    timed: bool = False
    """Durative actions and timed facts."""
    uncertain: bool = False
    """Actions of several outcomes, which differ in facts."""
    exists: bool = True
    foreign: bool = False
    """Only what unified-planning takes as PDDL means it.

    It compares objects of types that may fit only. What an effect does for all objects of a type it does once if it does not mention
    the object: also if there is none of that type, and also if it adds to a number.
    """


KINDS: Final = ("t", "object", "u", "w")
"""The types of parameters and variables."""
Scope = Mapping[str, str]
"""The terms that may be used, variables and objects, with their types."""


@dataclass(frozen=True)
class _Maker:
    """Draws what stands inside an action or a goal."""

    draw: Draw
    domain: Domain
    features: Features
    scope: Scope
    with_duration: bool = False

    def inside(self, variables: Iterable[Variable]) -> _Maker:
        return replace(self, scope={**self.scope, **{one.name: one.types[0] for one in variables}})

    def fluent(self, among: Mapping[str, Declaration]) -> Fluent:
        fitting = [one for one in among.values() if all(self.terms(parameter.types[0]) for parameter in one.parameters)]
        chosen = self.draw(st.sampled_from([fitting[0], *fitting]))  # the one without parameters more often: there things meet
        return chosen.name, *(self.draw(st.sampled_from(self.terms(parameter.types[0]))) for parameter in chosen.parameters)

    def terms(self, kind: str) -> list[str]:
        return [name for name, own in self.scope.items() if kind in self.domain.supertypes(own)]

    def variables(self, most: int = 2) -> tuple[Variable, ...]:
        kinds = self.draw(st.lists(st.sampled_from(KINDS), min_size=1, max_size=most))
        return tuple(Variable(f"?q{len(self.scope)}{number}", (kind,)) for number, kind in enumerate(kinds))

    # --- conditions ---

    def condition(self, depth: int = 2) -> Condition:
        leaves = ["fact", "no fact", "fact", "compare", *(["same"] if self.scope else [])]
        inner = ["and", "or", "imply", "not", "forall", *(["exists"] if self.features.exists else [])]
        match self.draw(st.sampled_from([*leaves, *(inner if depth else [])])):
            case "fact":
                return Holds(self.fluent(self.domain.predicates))
            case "no fact":
                return Not(Holds(self.fluent(self.domain.predicates)))
            case "compare":
                return Compare(self.draw(st.sampled_from([">=", "<=", "=", "<", ">"])), self.number(), self.number())
            case "same":
                one = self.draw(st.sampled_from(sorted(self.scope)))
                others = self.terms(self.scope[one]) if self.features.foreign else sorted(self.scope)
                return Compare("=", Constant(one), Constant(self.draw(st.sampled_from(others))))
            case "and":
                return conjunction([self.condition(depth - 1), self.condition(depth - 1)])
            case "or":
                return AnyOf((self.condition(depth - 1), self.condition(depth - 1)))
            case "imply":
                return Implies(self.condition(depth - 1), self.condition(depth - 1))
            case "not":
                return Not(self.condition(depth - 1))
            case quantifier:
                variables = self.variables()
                body = self.inside(variables).condition(depth - 1)
                return ForAll(variables, body) if quantifier == "forall" else Exists(variables, body)

    def number(self) -> Expression:
        leaf: list[Expression] = [Constant(self.draw(NUMBERS)), ValueOf(self.fluent(self.domain.functions))]
        if self.with_duration:
            leaf.append(ValueOf(DURATION))
        one = self.draw(st.sampled_from(leaf))
        match self.draw(st.sampled_from(["one", "one", "+", "-", "*", "/", "minus"])):
            case "one":
                return one
            case "*" | "/" as operation:
                return Arithmetic(operation, (one, Constant(2.0)))
            case "minus":
                return Arithmetic("-", (one,))
            case operation:
                return Arithmetic(operation, (one, self.draw(st.sampled_from(leaf))))

    # --- effects ---

    def effects(self) -> Effects:
        """Draw one to three effects that leave no number with two meanings."""
        drawn = tuple(one for _ in range(self.draw(st.integers(1, 3))) for one in self.effect())
        return _one_way(drawn, {})

    def effect(self) -> Effects:
        match self.draw(st.sampled_from(["set", "set", "set", "when", "forall", *(["one of"] * 3 if self.features.uncertain else [])])):
            case "one of":
                ways = self.draw(st.sampled_from([(None,), (None, None), (None, None, None), (0.25, 0.75), (0.5, 0.5, 0.0)]))
                few = replace(self, features=replace(self.features, foreign=True))
                return (OneOf(tuple(Alternative(few.sets(in_loop=True) if self.draw(st.booleans()) else (), way) for way in ways)),)
            case "set":
                return self.sets()
            case "when":
                return (When(self.condition(1), self.effect() if self.features.uncertain else self.sets()),)
            case _:
                variables = self.variables()
                inner = self.inside(variables)
                sets = inner.sets(in_loop=True)
                return (ForEach(variables, (When(inner.condition(1), sets),) if self.draw(st.booleans()) else sets),)

    def sets(self, in_loop: bool = False) -> Effects:
        kind = self.draw(st.sampled_from(["add", "delete", "both", *(["number"] if not (in_loop and self.features.foreign) else [])]))
        if kind == "number":
            adding = ["increase", "decrease"]
            operation = self.draw(st.sampled_from([*adding, *([] if in_loop else ["assign", "scale-up", "scale-down"])]))
            value = Constant(2.0) if operation.startswith("scale") else self.number()
            return (Set(self.fluent(self.domain.functions), value, operation),)
        fluent = self.fluent(self.domain.predicates)
        add, delete = Set(fluent, Constant(True)), Set(fluent, Constant(False))
        return {"add": (add,), "delete": (delete,), "both": self.draw(st.sampled_from([(add, delete), (delete, add)]))}[kind]


def _one_way(effects: Effects, used: dict[str, bool]) -> Effects:
    """Leave out what changes a number that is changed already, unless it is always added to."""
    kept: list[Effect] = []
    for effect in effects:
        match effect:
            case Set(fluent, _, operation) if fluent[0].startswith("f"):
                adds = operation in ("increase", "decrease")
                if fluent[0] not in used or (adds and used[fluent[0]]):
                    used[fluent[0]] = adds
                    kept.append(effect)
            case Set():
                kept.append(effect)
            case When(condition, inner):
                if left := _one_way(inner, used):
                    kept.append(When(condition, left))
            case ForEach(variables, inner):
                if left := _one_way(inner, used):
                    kept.append(ForEach(variables, left))
            case OneOf():
                kept.append(effect)
    return tuple(kept)


# --- domains and problems ------------------------------------------------------------------


def _declarations(draw: Draw, features: Features, letter: str, most: int, arity: int) -> dict[str, Declaration]:
    """Draw declarations; the first has no parameters, so that something can always be said."""
    found = {f"{letter}0": Declaration(f"{letter}0")}
    for number in range(1, draw(st.integers(1, most))):
        kinds = draw(st.lists(st.sampled_from(KINDS), max_size=arity))
        parameters = tuple(Variable(f"?a{position}", (kind,)) for position, kind in enumerate(kinds))
        found[f"{letter}{number}"] = Declaration(f"{letter}{number}", parameters)
    return found


def _bounds(make: _Maker) -> tuple[DurationConstraint, ...]:
    fixed = Constant(make.draw(DURATIONS))
    match make.draw(st.sampled_from(["=", "=", "fluent", "both", "<=", "free"])):
        case "=":
            return (DurationConstraint("=", fixed),)
        case "fluent":
            return (DurationConstraint("=", ValueOf(make.fluent(make.domain.functions))),)
        case "<=":
            return (DurationConstraint("<=", fixed),)
        case "both":
            return (DurationConstraint(">=", fixed), DurationConstraint("<=", Arithmetic("+", (fixed, Constant(2.0)))))
        case _:
            return ()


def _action(draw: Draw, domain: Domain, features: Features, name: str) -> ActionSchema:
    kinds = draw(st.lists(st.sampled_from(KINDS), max_size=2))
    parameters = tuple(Variable(f"?v{number}", (kind,)) for number, kind in enumerate(kinds))
    scope = {one.name: one.types[0] for one in parameters} | {constant: types[0] for constant, types in domain.constants.items()}
    make = _Maker(draw, domain, features, scope)
    if not (features.timed and draw(st.integers(0, 3))):
        precondition = make.condition() if draw(st.booleans()) else TRUE
        return ActionSchema(name, parameters, precondition, end_effects=make.effects())
    bounds = _bounds(make)
    make = replace(make, with_duration=True)
    conditions = [make.condition(1) if draw(st.booleans()) else TRUE for _ in range(3)]
    start = replace(make, features=replace(features, uncertain=False)).effects() if draw(st.booleans()) else ()
    return ActionSchema(name, parameters, *conditions, start, make.effects(), bounds)


@st.composite
def domains(draw: Draw, features: Features) -> Domain:
    """Draw a domain with one to four actions."""
    requirements = (*REQUIREMENTS, *((":durative-actions", ":duration-inequalities", ":timed-initial-literals") if features.timed else ()))
    constants = {"c": ("u",)} if draw(st.booleans()) else {}
    facts, numbers = _declarations(draw, features, "p", 4, 2), _declarations(draw, features, "f", 2, 1)
    domain = Domain("d", TYPES, constants, facts, numbers, requirements=requirements)
    names = [f"a{number}" for number in range(draw(st.integers(1, 4)))]
    return replace(domain, actions={name: _action(draw, domain, features, name) for name in names})


@st.composite
def problems(draw: Draw, features: Features = Features()) -> Problem:
    """Draw a problem in which every number has a value."""
    domain = draw(domains(features))
    kinds = draw(st.lists(st.sampled_from(["t", "u", "w"]), min_size=2, max_size=3))
    own = {f"o{number}": (kind,) for number, kind in enumerate([*kinds, "u", "w"] if features.foreign else kinds)}
    problem = Problem("x", domain, own)
    problem = replace(problem, init=draw(states(problem)))
    make = _Maker(draw, domain, features, {name: types[0] for name, types in problem.objects.items()})
    timed: dict[float, dict[Fluent, Value]] = {}
    for _ in range(draw(st.integers(0, 2)) if features.timed else 0):
        number = draw(st.integers(0, 2)) == 0
        fluent = make.fluent(domain.functions if number else domain.predicates)
        timed.setdefault(draw(STARTS), {})[fluent] = draw(NUMBERS if number else st.booleans())
    changes = tuple(TimedChange(time, timed[time]) for time in sorted(timed))
    return replace(problem, timed=changes, goal=conjunction([make.condition(), make.condition(1)]))


def fluents(problem: Problem, declared: Mapping[str, Declaration]) -> list[Fluent]:
    """Return every ground fluent of the declarations."""
    found: list[Fluent] = []
    for one in declared.values():
        choices = product(*(problem.objects_by_type[parameter.types[0]] for parameter in one.parameters))
        found += [(one.name, *arguments) for arguments in choices]
    return found


@st.composite
def states(draw: Draw, problem: Problem) -> dict[Fluent, Value]:
    """Draw the true facts and the value of every number."""
    facts = fluents(problem, problem.domain.predicates)
    state: dict[Fluent, Value] = dict.fromkeys(draw(st.lists(st.sampled_from(facts), unique=True)), True)
    return state | {fluent: draw(NUMBERS) for fluent in fluents(problem, problem.domain.functions)}


@st.composite
def conditions_on(draw: Draw, problem: Problem, features: Features = Features()) -> Condition:
    """Draw a condition on the problem's states."""
    return _Maker(draw, problem.domain, features, {name: types[0] for name, types in problem.objects.items()}).condition(3)
