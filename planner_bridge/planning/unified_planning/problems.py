"""Translation of problems: unified-planning's to ours, by way of PDDL, and ours to unified-planning's, directly."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Iterable, Mapping
from itertools import product
from typing import Any, Final

import unified_planning.shortcuts as up
from unified_planning.exceptions import UPException
from unified_planning.io import PDDLWriter

from planner_bridge.model.grounding import dynamic_names
from planner_bridge.model.problem import TOTAL_TIME, Metric, Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.engines import Feature, problem_kind
from planner_bridge.planning.normal_form import Assignment, cost_function, functions_in_use, is_whole, schema_assignments
from planner_bridge.planning.unified_planning.declarations import Declarations, Terms
from planner_bridge.planning.unified_planning.expressions import condition_there, expression_there, fluent_there, number_there
from pnm.core.logic.conditions import Condition, conjuncts, names
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.expressions import DURATION, Arithmetic, Constant, Expression, ValueOf, expression_fluents
from pnm.errors import InputError

_ADDING: Final = {"assign": "add_effect", "increase": "add_increase_effect", "decrease": "add_decrease_effect"}
_TRAJECTORY: Final[Mapping[str, Callable[..., Any]]] = {
    "always": up.Always,
    "sometime": up.Sometime,
    "at-most-once": up.AtMostOnce,
    "sometime-before": up.SometimeBefore,
    "sometime-after": up.SometimeAfter,
}


def from_unified_planning(problem: up.Problem) -> Problem:
    """Turn a unified-planning Problem into ours, by way of its PDDL.

    Raises:
        InputError: the problem cannot be written as PDDL, or uses what we do not read.
    """
    writer = PDDLWriter(problem)
    name = problem.name or "problem"
    try:
        domain_text, problem_text = writer.get_domain(), writer.get_problem()
    except UPException as error:
        raise InputError(f"unified-planning cannot write {name} as PDDL: {error}") from error
    domain = parse_domain(domain_text, f"{name} (domain of a unified-planning Problem)")
    return parse_problem(problem_text, domain, f"{name} (a unified-planning Problem)")


def to_unified_planning(problem: Problem) -> up.Problem:
    """Turn a problem into one of unified-planning, without going through text.

    Functions that neither a condition nor the metric reads are left out, and a name that is taken
    already is changed.

    Raises:
        InputError: the problem uses what unified-planning cannot express.
    """
    return Translation(problem, up.Problem(problem.name)).translated


class Translation:
    """A problem in unified-planning, with the way back from names there to names here."""

    def __init__(self, problem: Problem, translated: up.Problem) -> None:
        self.translated = translated
        self._problem = problem
        self._dynamic = dynamic_names(problem)
        self._cost = cost_function(problem)
        functions = functions_in_use(problem)
        try:
            if missing := problem_kind(problem) & {Feature.DERIVED, Feature.PREFERENCES, Feature.TASKS}:
                raise InputError(" and ".join(sorted(feature.value for feature in missing)))
            self._declared = Declarations(problem, translated, functions - {self._cost}, is_whole(problem, functions))
            self.objects = {there.name: name for name, there in self._declared.objects.items()}
            """For every object there, its name here."""
            there = {name: self._action(schema) for name, schema in problem.domain.actions.items()}
            self.actions = {action.name: name for name, action in there.items()}
            """For every action there, its name here."""
            self._state()
            self._goals()
            self._metric(there)
        except UPException as error:
            raise InputError(str(error)) from error

    def _action(self, schema: ActionSchema) -> Any:
        parameters = OrderedDict((variable.name[1:], self._declared.type_of(variable.types)) for variable in schema.parameters)
        make = up.InstantaneousAction if schema.duration is None else up.DurativeAction
        action = make(self._declared.named(schema.name), parameters)
        terms = _parameters(schema, action)
        guards = [*self._declared.guards(schema.parameters, terms)]
        start, end = schema_assignments(schema)
        if schema.duration is None:
            for condition in (*guards, *self._conjuncts(schema.precondition, terms)):
                action.add_precondition(condition)
            self._effects(schema, action, (), end, terms)
        else:
            match [[limit.bound for limit in schema.duration if limit.operation == operation] for operation in ("=", ">=", "<=")]:
                case [[exactly], [], []]:
                    action.set_fixed_duration(self._expression(exactly, terms))
                case [[], [] | [_] as least, [most]]:
                    lower = least[0] if least else Constant(0)
                    action.set_closed_duration_interval(self._expression(lower, terms), self._expression(most, terms))
                case _:
                    raise InputError(f"the duration of {schema.name}, which has not one upper and at most one lower bound")
            during = up.OpenTimeInterval(up.StartTiming(), up.EndTiming())
            for condition in (*guards, *self._conjuncts(schema.precondition, terms)):
                action.add_condition(up.StartTiming(), condition)
            for condition in self._conjuncts(schema.invariant, terms):
                action.add_condition(during, condition)
            for condition in self._conjuncts(schema.end_condition, terms):
                action.add_condition(up.EndTiming(), condition)
            self._effects(schema, action, (up.StartTiming(),), start, terms)
            self._effects(schema, action, (up.EndTiming(),), end, terms)
        self.translated.add_action(action)
        return action

    def _effects(self, schema: ActionSchema, action: Any, moment: tuple[Any, ...], effects: Iterable[Assignment], terms: Terms) -> None:
        for change in effects:
            if not self._declared.knows(change.fluent):
                continue
            if change.early and names(change.condition) & self._dynamic:
                raise InputError(f"an effect at the end of {schema.name} that depends on a condition at its start")
            chosen, guards, inner = self._declared.variables(change.variables, self._timed(schema, terms))
            condition = up.And(*guards, condition_there(change.condition, self._declared, inner))
            target, value = fluent_there(change.fluent, self._declared, inner), self._expression(change.value, inner)
            getattr(action, _ADDING[change.operation])(*moment, target, value, condition, forall=chosen)

    def _timed(self, schema: ActionSchema, terms: Terms) -> Terms:
        """Return the terms with the duration, where it is known before the action begins."""
        match schema.duration:
            case (only,) if only.operation == "=" and not {fluent[0] for fluent in expression_fluents(only.bound)} & self._dynamic:
                return {**terms, DURATION[0]: self._expression(only.bound, terms)}
            case _:
                return terms

    def _state(self) -> None:
        for fluent, value in self._problem.init.items():
            if value is not False and self._declared.knows(fluent):
                self.translated.set_initial_value(fluent_there(fluent, self._declared, {}), self._expression(Constant(value), {}))
        for change in self._problem.timed:
            moment = up.GlobalStartTiming(number_there(change.time).constant_value())
            for fluent, value in change.changes.items():
                if self._declared.knows(fluent):
                    there = fluent_there(fluent, self._declared, {})
                    self.translated.add_timed_effect(moment, there, self._expression(Constant(value), {}))

    def _goals(self) -> None:
        for goal in self._conjuncts(self._problem.goal, {}):
            self.translated.add_goal(goal)
        for constraint in (*self._problem.domain.constraints, *self._problem.constraints):
            if constraint.operator not in _TRAJECTORY:
                raise InputError(f"the constraint {constraint.operator}")
            variables = constraint.variables
            for chosen in product(*(self._declared.tree.extent(variable.types) for variable in variables)):
                objects = [up.ObjectExp(self._declared.objects[name]) for name in chosen]
                terms = dict(zip((variable.name for variable in variables), objects, strict=True))
                parts = [condition_there(condition, self._declared, terms) for condition in constraint.conditions]
                self.translated.add_trajectory_constraint(_TRAJECTORY[constraint.operator](*parts))

    def _metric(self, actions: Mapping[str, Any]) -> None:
        metric = self._problem.metric
        if metric is None:
            return
        if self._cost is not None:
            totals = {}
            for name, action in actions.items():
                schema = self._problem.domain.actions[name]
                costs = [change.value for moment in schema_assignments(schema) for change in moment if change.fluent[0] == self._cost]
                total: Expression = Constant(0) if not costs else costs[0] if len(costs) == 1 else Arithmetic("+", tuple(costs))
                totals[action] = self._expression(total, self._timed(schema, _parameters(schema, action)))
            measure = up.MinimizeActionCosts(totals)
        elif metric == Metric("minimize", ValueOf(TOTAL_TIME)):
            measure = up.MinimizeMakespan() if self._problem.is_timed else up.MinimizeSequentialPlanLength()
        else:
            final = up.MinimizeExpressionOnFinalState if metric.direction == "minimize" else up.MaximizeExpressionOnFinalState
            measure = final(self._expression(metric.expression, {}))
        self.translated.add_quality_metric(measure)

    def _conjuncts(self, condition: Condition, terms: Terms) -> list[Any]:
        return [condition_there(part, self._declared, terms) for part in conjuncts(condition)]

    def _expression(self, expression: Expression, terms: Terms) -> Any:
        return expression_there(expression, self._declared, terms)


def _parameters(schema: ActionSchema, action: Any) -> Terms:
    return {variable.name: up.ParameterExp(action.parameter(variable.name[1:])) for variable in schema.parameters}
