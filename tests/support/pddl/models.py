"""Strategies for hypothesis: PDDL models as they are read, of a domain with robots, rooms and docks."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

from hypothesis import strategies as st

from planner_bridge.model.problem import Domain, Metric, Problem
from planner_bridge.pddl.expressions import TIME_SPECIFIERS
from planner_bridge.pddl.symbols import CONSTRAINTS
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, conjuncts
from pnm.core.logic.domain import MAX_CHOICES, ActionSchema, Declaration, DurationConstraint, Preference, ProblemModel
from pnm.core.logic.effects import OPERATIONS, Alternative, Effect, Effects, ForEach, OneOf, Set, TimedChange, When
from pnm.core.logic.expressions import DURATION, UNDEFINED, Arithmetic, Constant, Expression, Fluent, ValueOf, Variable
from pnm.core.logic.rules import DerivationRule, Rules
from pnm.core.logic.trajectory import Constraint
from tests.support.files import input_error

TYPES = {"thing": (), "robot": ("thing",), "room": ("thing",), "dock": ("room", "place"), "place": ()}
KINDS = st.sampled_from([("object",), ("thing",), ("robot",), ("dock",), ("robot", "place")])
NUMBERS = st.one_of(st.integers(-1000, 1000).map(float), st.floats(allow_nan=False, allow_infinity=False))
FUNCTIONS: list[Fluent] = [("charge", "?r"), ("charge", "R1"), ("total-cost",)]
FACTS: list[Fluent] = [("at", "?r", "hall"), ("at", "R1", "hall"), ("idle",)]
OWN = (Variable("?r", ("robot",)), Variable("?Other", ("object",)))


def expressions(duration: bool) -> st.SearchStrategy[Expression]:
    values = st.sampled_from([*FUNCTIONS, *([DURATION] if duration else [])]).map(ValueOf)
    return st.recursive(
        st.one_of(NUMBERS.map(Constant), values),
        lambda inner: st.one_of(
            st.builds(Arithmetic, st.sampled_from("+*"), st.lists(inner, min_size=2, max_size=3).map(tuple)),
            st.builds(Arithmetic, st.just("/"), st.tuples(inner, inner)),
            st.builds(Arithmetic, st.just("-"), st.lists(inner, min_size=1, max_size=2).map(tuple)),
        ),
        max_leaves=4,
    )


def joined(parts: list[Condition]) -> Condition:
    flat = conjuncts(All(tuple(parts)))
    return flat[0] if len(flat) == 1 else All(flat)


VARIABLES = st.lists(st.builds(Variable, st.sampled_from(["?x", "?y", "?z"]), KINDS), max_size=2, unique_by=lambda one: one.name).map(tuple)


def conditions(duration: bool = False) -> st.SearchStrategy[Condition]:
    numbers = st.builds(Compare, st.sampled_from(["=", "<", "<=", ">", ">="]), expressions(duration), expressions(duration))
    terms = st.sampled_from([*map(Constant, ["?r", "?Other", "R1", "hall"]), ValueOf(("home", "?r")), ValueOf(("home", "R1"))])
    return st.recursive(
        st.one_of(st.sampled_from(FACTS).map(Holds), numbers, st.builds(Compare, st.just("="), terms, terms)),
        lambda inner: st.one_of(
            st.lists(inner, max_size=3).map(joined),
            st.builds(Any, st.lists(inner, max_size=3).map(tuple)),
            inner.map(Not),
            st.builds(Implies, inner, inner),
            st.builds(ForAll, VARIABLES, inner),
            st.builds(Exists, VARIABLES, inner),
        ),
        max_leaves=6,
    )


WEIGHTS = st.lists(st.integers(1, 9), max_size=3)


def one_of(parts: list[Effects], weights: list[int]) -> OneOf:
    """Alternatives, with chances if there are as many weights."""
    chances = [weight / sum(weights) for weight in weights] if len(weights) >= len(parts) else []
    chances = chances and [*chances[: len(parts) - 1], 1.0 - sum(chances[: len(parts) - 1])]
    return OneOf(tuple(Alternative(part, max(0.0, chances[number]) if chances else None) for number, part in enumerate(parts)))


def effects(duration: bool = False, uncertain: bool = False) -> st.SearchStrategy[tuple[Effect, ...]]:
    truth = st.builds(Set, st.sampled_from(FACTS), st.booleans().map(Constant))
    numbers = st.builds(Set, st.sampled_from(FUNCTIONS), expressions(duration), st.sampled_from(OPERATIONS))
    places = st.sampled_from([Constant("?Other"), Constant("hall"), ValueOf(("home", "R1")), Constant(UNDEFINED)])
    one = st.recursive(
        st.one_of(truth, numbers, st.builds(Set, st.just(("home", "?r")), places)),
        lambda inner: st.one_of(
            st.builds(When, conditions(duration), st.lists(inner, max_size=2).map(tuple)),
            st.builds(ForEach, VARIABLES, st.lists(inner, max_size=2).map(tuple)),
            *(
                []
                if not uncertain
                else [st.builds(one_of, st.lists(st.lists(inner, max_size=2).map(tuple), min_size=1, max_size=3), WEIGHTS)]
            ),
        ),
        max_leaves=4,
    )
    return st.lists(one, max_size=3).map(tuple)


def early_effects() -> st.SearchStrategy[tuple[Effect, ...]]:
    """Effects at the end on conditions at the start, which are not trivial: a trivial one is written away."""
    real = conditions(duration=True).filter(lambda condition: condition != TRUE)
    inner = effects(duration=True, uncertain=True).filter(
        lambda found: not any(isinstance(one, When) and one.condition == TRUE for one in found)
    )
    early = st.builds(When, real, inner, early=st.just(True))
    around = st.one_of(
        *(early, st.builds(ForEach, VARIABLES, st.tuples(early)), st.builds(When, real, st.tuples(early))),
        st.builds(one_of, st.lists(st.one_of(st.tuples(early), inner), min_size=1, max_size=2), WEIGHTS),
    )
    return st.tuples(effects(duration=True, uncertain=True), st.lists(around, max_size=2)).map(lambda both: (*both[0], *both[1]))


def constraints() -> st.SearchStrategy[Constraint]:
    def one(operator: str) -> st.SearchStrategy[Constraint]:
        times, several = CONSTRAINTS.get(operator, (0, 1))
        seconds = st.tuples(*[st.floats(0, 1e9)] * times)
        return st.builds(Constraint, st.just(operator), st.tuples(*[conditions()] * several), seconds, VARIABLES)

    return st.sampled_from([*CONSTRAINTS, "at end"]).flatmap(one)


def over(constraint: Constraint) -> Constraint:
    """The constraint in a place without an action around it."""
    return replace(constraint, variables=(*OWN, *constraint.variables))


PREFERENCES = st.builds(Preference, st.sampled_from(["p", "Q-2", ""]), conditions(), VARIABLES)
WISHES = st.builds(Preference, st.sampled_from(["p", "c", ""]), st.lists(constraints(), max_size=2).map(tuple), st.just(OWN))
RULES = st.builds(DerivationRule, st.sampled_from(["calm", "near"]), st.just(OWN), conditions())
INSTANTANEOUS = st.builds(
    ActionSchema,
    st.just("now"),
    st.just(OWN),
    precondition=conditions(),
    end_effects=effects(uncertain=True),
    preferences=st.lists(PREFERENCES, max_size=2).map(tuple),
)
DURATIVE = st.builds(
    ActionSchema,
    st.just("later"),
    st.just(OWN),
    precondition=conditions(duration=True),
    invariant=conditions(duration=True),
    end_condition=conditions(duration=True),
    start_effects=effects(duration=True),
    end_effects=early_effects(),
    preferences=st.lists(
        st.builds(Preference, st.sampled_from(["p", ""]), conditions(duration=True), VARIABLES, st.sampled_from(TIME_SPECIFIERS)),
        max_size=2,
    ).map(tuple),
    duration=st.lists(st.builds(DurationConstraint, st.sampled_from(["=", "<=", ">="]), expressions(duration=False)), max_size=2).map(
        tuple
    ),
)


def domain_of(actions: list[ActionSchema]) -> Domain:
    return Domain(
        "d",
        TYPES,
        {"R1": ("robot",), "hall": ("dock",), "odd": ("robot", "place")},
        {
            "at": Declaration("at", (Variable("?r", ("robot",)), Variable("?l", ("room", "robot")))),
            "same": Declaration("same", (Variable("?x"), Variable("?x"), Variable("?y", ("dock",)))),
            "idle": Declaration("idle"),
            "calm": Declaration("calm", OWN),
            "near": Declaration("near", OWN),
        },
        {
            "charge": Declaration("charge", (Variable("?r", ("robot",)),)),
            "home": Declaration("home", (Variable("?r", ("robot",)),), ("room", "place")),
            "total-cost": Declaration("total-cost"),
        },
        {one.name: one for one in actions},
        requirements=(":typing", ":adl"),
    )


KEPT = st.lists(constraints(), max_size=2).map(lambda found: tuple(map(over, found)))
SOFT = st.lists(WISHES, max_size=2).map(tuple)
DOMAINS = st.builds(
    lambda actions, rules, kept, soft: replace(
        domain_of(list(actions)),
        rules=Rules(tuple(rules)),
        constraints=kept,
        preferences=soft,
        hierarchy=("(:task t)", "(:method m\n    :parameters () ; why\n\t:task (t))"),
    ),
    st.tuples(INSTANTANEOUS, DURATIVE),
    st.lists(RULES, max_size=2),
    KEPT,
    SOFT,
).filter(lambda domain: not any(input_error(partial(ProblemModel("", domain).outcomes, name)) for name in domain.uncertain))  # too many
GROUND_FACTS = st.sampled_from([("at", "R1", "hall"), ("at", "r2", "hall"), ("idle",)])
GROUND_FUNCTIONS = st.sampled_from([("charge", "R1"), ("charge", "r2"), ("total-cost",)])


def values(truth: st.SearchStrategy[bool]) -> st.SearchStrategy[dict[Fluent, bool | float | str]]:
    homes = st.dictionaries(st.sampled_from([("home", "R1"), ("home", "r2")]), st.sampled_from(["hall", "y"]))
    parts = st.tuples(st.dictionaries(GROUND_FACTS, truth), st.dictionaries(GROUND_FUNCTIONS, NUMBERS), homes)
    return parts.map(lambda found: {**found[0], **found[1], **found[2]})


TIMED = st.dictionaries(st.floats(0, 1e9), values(st.booleans()).filter(bool), max_size=3).map(
    lambda found: tuple(TimedChange(time, found[time]) for time in sorted(found))
)
PROBLEMS = st.builds(
    lambda init, timed, number, goals, kept, soft: Problem(
        "p",
        domain_of([]),
        {"r2": ("robot",), "x": ("object",), "y": ("robot", "place")},
        init,
        timed,
        All((Holds(("idle",)), Compare(">", ValueOf(("charge", "r2")), Constant(number)))),
        Metric("minimize", Arithmetic("*", (ValueOf(("is-violated", "p")), ValueOf(("total-time",))))),
        kept,
        (*(replace(one, variables=(*OWN, *one.variables)) for one in goals), Preference("p", Holds(("idle",))), *soft),
        network="(:htn :subtasks (and))\n(:tasks)",
        requirements=(":typing",),
    ),
    values(st.just(True)),
    TIMED,
    NUMBERS,
    st.lists(PREFERENCES, max_size=2),
    KEPT,
    SOFT,
).filter(lambda problem: all(choices <= MAX_CHOICES for _, choices in problem.ranges()))  # more are refused
