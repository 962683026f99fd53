"""Trajectory constraints, preferences and metrics in YAML files of the language: the formulas that only planners read (PDDL 3.0)."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Final, Literal

from planner_bridge.model.problem import TOTAL_TIME, Metric
from planner_bridge.pddl.expressions import TIME_SPECIFIERS, TimeSpecifier
from planner_bridge.pddl.formulas import IS_VIOLATED
from planner_bridge.pddl.symbols import CONSTRAINTS
from pnm.core.logic.conditions import Condition
from pnm.core.logic.domain import Preference
from pnm.core.logic.expressions import Constant, ValueOf, Variable, expression_fluents
from pnm.core.logic.trajectory import Constraint
from pnm.errors import InputError, suggestion
from pnm.files.yaml_keys import Key, Keys, listed, needed, pair, ref, text, written
from pnm.files.yaml_nodes import Mapped, Node
from pnm.language.formulas.readers import Quantified, read_condition, read_expression, read_quantified
from pnm.language.formulas.scope import FormulaScope, read_typed
from pnm.language.formulas.words import CONDITION, Words, needed_form

_COUNTS: Final[Mapping[str, tuple[int, int]]] = {**CONSTRAINTS, "at_end": (0, 1)}
"""For every operator of a constraint, how many times and how many conditions it takes."""
_ABOUT: Final = {
    "always": "all the time",
    "sometime": "at some time",
    "at-most-once": "at one time at most",
    "at_end": "at the end",
    "sometime-after": "the second at some time after the first",
    "sometime-before": "the second at some time before the first",
    "within": "before so many seconds have passed",
    "always-within": "the second within so many seconds of the first",
    "hold-during": "between two times",
    "hold-after": "after so many seconds",
}
_CONSTRAINT: Final = ref("constraint")
_EXPRESSION: Final = ref("expression")


class QuantifiedConstraint(Quantified):
    """A constraint on all objects of some types."""

    body = needed(_CONSTRAINT, "the constraint on them").named("constraint")


_OPERANDS: Final = {word: [*[_EXPRESSION] * times, *[CONDITION] * conditions] for word, (times, conditions) in _COUNTS.items()}
CONSTRAINT_WORDS: Final[Words] = {
    **{word: (_ABOUT[word], operands[0] if len(operands) == 1 else pair(*operands)) for word, operands in _OPERANDS.items()},
    "forall": ("for all objects of some types", QuantifiedConstraint.json()),
}
"""The words that a constraint begins with."""
METRIC_WORDS: Final[Words] = {"minimize": ("as small as can be", _EXPRESSION), "maximize": ("as large as can be", _EXPRESSION)}
_MOMENTS: Final[Mapping[str, TimeSpecifier]] = {moment.replace(" ", "_"): moment for moment in TIME_SPECIFIERS}
_DIRECTIONS: Final[Mapping[str, Literal["minimize", "maximize"]]] = {"minimize": "minimize", "maximize": "maximize"}


class PreferenceKeys(Keys):
    """A preference."""

    name = text("a name that a metric may count it by")
    variables = listed(ref("typed"), "for all objects of these types")
    moment = Key(Mapped.string, {"enum": [*_MOMENTS]}, "when, for a durative action")
    condition = written(CONDITION, "the condition that should hold")
    constraints = listed(ref("constraints"), "the constraints that should hold")


def read_constraint(node: Node, scope: FormulaScope, variables: tuple[Variable, ...] = ()) -> Constraint:
    """Read a constraint, around which these variables are bound."""
    construct = needed_form(node, CONSTRAINT_WORDS, "a constraint")
    if construct.word == "forall":
        inner, body = read_quantified(QuantifiedConstraint(construct.argument.mapped()), scope)
        return read_constraint(body, scope.inside(inner), (*variables, *inner))
    times, conditions = _COUNTS[construct.word]
    operands = construct.items(times + conditions) if times + conditions > 1 else (construct.argument,)
    wanted = tuple([read_condition(operand, scope) for operand in operands[times:]])
    seconds: list[float] = []
    for operand in operands[:times]:
        value = operand.plain()
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value < float("inf"):
            raise operand.wrong(f"expected a time of at least 0, found {operand.written or 'something else'}")
        seconds.append(float(value))
    return Constraint(construct.word.replace("_", " "), wanted, tuple(seconds), variables)


def read_preference(node: Node, scope: FormulaScope, *, timed: bool = False) -> Preference:
    """Read a preference; `timed` if it stands in a durative action, where it needs a moment."""
    keys = PreferenceKeys(node.mapped())
    entry = keys.entry
    variables: tuple[Variable, ...] = ()
    for quantifier in keys.variables:  # one for each text, which may hide variables of those before it
        variables += read_typed(quantifier, scope)
    scope = scope.inside(variables)
    wanted: Condition | tuple[Constraint, ...]
    if "constraints" in entry.nodes:
        wanted = tuple([read_constraint(constraint, scope) for constraint in keys.constraints])
    else:
        wanted = read_condition(entry.needed("condition"), scope)
    moment = keys.moment
    if moment is not None and moment not in _MOMENTS:
        hint = suggestion(moment, _MOMENTS.keys()) or f"expected one of {', '.join(_MOMENTS)}"
        raise InputError(f"unknown moment {moment!r}; {hint}", entry.position("moment"))
    if moment is not None and not timed:
        raise InputError("only a preference in an action with a duration has a moment", entry.position("moment"))
    if moment is None and timed:
        raise InputError(f"a preference in an action with a duration needs a moment, one of {', '.join(_MOMENTS)}", entry.start)
    return Preference(keys.name or "", wanted, variables, None if moment is None else _MOMENTS[moment])


def is_about_states(node: Node) -> bool:
    """Return whether the preference is about single states, as goals and preconditions are, rather than about their whole course."""
    return "constraints" not in node.mapped().nodes


def read_metric(node: Node | None, scope: FormulaScope, preferences: Collection[str]) -> Metric | None:
    """Read a metric; the names are those of the preferences that it may count."""
    if node is None:
        return None
    construct = needed_form(node, METRIC_WORDS, "a metric")
    argument = construct.argument
    expression = read_expression(argument)
    if isinstance(expression, Constant) and isinstance(expression.value, str):
        raise argument.wrong(f"expected a number or a function such as (total-time), found {expression}")
    for fluent in expression_fluents(expression):
        match fluent:
            case _ if fluent == TOTAL_TIME:
                pass
            case (word, name) if word == IS_VIOLATED:
                if name not in preferences:
                    hint = suggestion(name, preferences) or f"expected one of {', '.join(preferences) or 'none at all'}"
                    raise InputError(f"there is no preference {name!r} here; {hint}", argument.position_of(name))
            case _:
                scope.check_fluent(fluent, argument, "function")
                scope.check_value(ValueOf(fluent), (), argument)
    return Metric(_DIRECTIONS[construct.word], expression)
