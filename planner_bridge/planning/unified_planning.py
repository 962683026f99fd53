"""Unified-planning: its problems to ours, by way of PDDL, and ours to its own, directly; and the request to one of its engines.

The only module that imports unified-planning, which takes 1 to 3 seconds and 150 MB.
"""

from __future__ import annotations

import re
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, Final, TypeAlias, assert_never

import unified_planning.shortcuts as up
from unified_planning.engines import PDDLPlanner, PlanGenerationResultStatus as Status
from unified_planning.engines.factory import DEFAULT_ENGINES
from unified_planning.engines.results import PlanGenerationResult
from unified_planning.exceptions import UPException, UPUnsupportedProblemTypeError
from unified_planning.io import PDDLReader, PDDLWriter
from unified_planning.model import ProblemKind

from planner_bridge.model.grounding import dynamic_names
from planner_bridge.model.plan import PlanningStatus
from planner_bridge.model.problem import TOTAL_TIME, Metric, Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.planning.engines import ENGINES, Feature, problem_kind
from planner_bridge.planning.normal_form import Assignment, cost_function, functions_in_use, is_whole, schema_assignments
from pnm.core.logic import conditions
from pnm.core.logic.conditions import All, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not, conjuncts, names
from pnm.core.logic.domain import ActionSchema, Declaration
from pnm.core.logic.expressions import (
    DURATION,
    Arithmetic,
    Constant,
    Expression,
    Fluent,
    ValueOf,
    Variable,
    expression_fluents,
    fluent_text,
)
from pnm.errors import InputError, suggestion

_ADDING: Final = {"assign": "add_effect", "increase": "add_increase_effect", "decrease": "add_decrease_effect"}
_TRAJECTORY: Final[Mapping[str, Callable[..., Any]]] = {
    "always": up.Always,
    "sometime": up.Sometime,
    "at-most-once": up.AtMostOnce,
    "sometime-before": up.SometimeBefore,
    "sometime-after": up.SometimeAfter,
}


def from_unified_planning(problem: up.Problem) -> Problem:
    """Turn a unified-planning Problem into ours, by PDDL; raise an `InputError` if it cannot be written, or has what we do not read."""
    writer = PDDLWriter(problem)
    name = problem.name or "problem"
    try:
        domain_text, problem_text = writer.get_domain(), writer.get_problem()
    except UPException as error:
        raise InputError(f"unified-planning cannot write {name} as PDDL: {error}") from error
    domain = parse_domain(domain_text, f"{name} (domain of a unified-planning Problem)")
    return parse_problem(problem_text, domain, f"{name} (a unified-planning Problem)")


def to_unified_planning(problem: Problem) -> up.Problem:
    """Turn a problem into one of unified-planning, not by text; raise an `InputError` if it uses what that cannot express.

    Functions that neither a condition nor the metric reads are left out, and a name that is taken already is changed.
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
            if missing := problem_kind(problem) & {Feature.DERIVED, Feature.PREFERENCES, Feature.TASKS, Feature.NATURE}:
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


# --- declarations ---------------------------------------------------------------------------------
# The types, objects and fluents of a problem in unified-planning, each with a name of its own.
#
# There types are a tree: every object has one type and every type one parent.


ROOT: Final = "object"


class TypeTree:
    """The types of a problem as a tree, for planners without `either`.

    A type with several parents, or an object of several types, is put below what these have in
    common. Where variables of some types would then range over too many objects, `is_exact` is False.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem

    @cached_property
    def parents(self) -> dict[str, str]:
        """For every type but the root its parent, parents first."""
        parents: dict[str, str] = {}
        waiting = dict(self._problem.domain.types)
        while waiting:
            for name, above in tuple(waiting.items()):
                if waiting.keys().isdisjoint(above):
                    parents[name] = _common([_path(parent, parents) for parent in above] or [[ROOT]])
                    del waiting[name]
        return parents

    @cached_property
    def type_of(self) -> dict[str, str]:
        """For every object its type in the tree."""
        return {name: self._common(types) for name, types in self._problem.objects.items()}

    def cover(self, types: Iterable[str]) -> str:
        """Return the smallest type in the tree that has all objects of the given types."""
        kinds = set(types)
        below = [name for name in self._problem.domain.types if kinds & self._problem.domain.supertypes(name)]
        return self._common([*kinds, *below, *{self.type_of[name] for name in self.extent(kinds)}])

    def extent(self, types: Iterable[str]) -> tuple[str, ...]:
        """Return the objects of one of the types."""
        members = {name for kind in types for name in self._problem.objects_by_type.get(kind, ())}
        return tuple(name for name in self._problem.objects if name in members)

    def is_exact(self, types: Iterable[str]) -> bool:
        """Whether the cover of the types has no other objects than theirs."""
        kinds = set(types)
        cover = self.cover(kinds)
        return len(self.extent(kinds)) == sum(cover in _path(own, self.parents) for own in self.type_of.values())

    def _common(self, types: Iterable[str]) -> str:
        return _common([_path(name, self.parents) for name in types])


def _path(name: str, parents: dict[str, str]) -> list[str]:
    path = [name]
    while path[-1] != ROOT:
        path.append(parents[path[-1]])
    return path


def _common(paths: list[list[str]]) -> str:
    return next(name for name in paths[0] if all(name in path for path in paths))


Terms: TypeAlias = Mapping[str, Any]
"""The terms that stand for the variables in scope."""


class Declarations:
    """Types, objects and fluents. The mutable state is the names taken, and the guard predicates for types that the tree lacks."""

    def __init__(self, problem: Problem, translated: up.Problem, functions: frozenset[str], whole: bool) -> None:
        self.tree = TypeTree(problem)
        self.translated = translated
        self._taken: set[str] = set()
        self._guards: dict[frozenset[str], Any] = {}
        self.types = {ROOT: up.UserType(self.named(ROOT))}
        for name, parent in self.tree.parents.items():
            self.types[name] = up.UserType(self.named(name), self.types[parent])
        self.objects = {name: up.Object(self.named(name), self.types[kind]) for name, kind in self.tree.type_of.items()}
        translated.add_objects(self.objects.values())
        self._fluents: dict[tuple[str, int], Any] = {}  # a predicate and a function may differ in nothing but their arity
        for declared in problem.domain.predicates.values():
            self._declare(declared, up.BoolType(), default_initial_value=False)
        for declared in problem.domain.functions.values():
            if declared.name in functions:
                number = up.IntType() if whole else up.RealType()
                self._declare(declared, self.type_of(declared.values) if declared.values else number)

    def named(self, name: str) -> str:
        """Return the name, changed if something else has it already: in unified-planning one name has one meaning."""
        while name in self._taken:
            name += "-"
        self._taken.add(name)
        return name

    def knows(self, fluent: Fluent) -> bool:
        """Whether the fluent is declared here: predicates are, and functions that matter."""
        return (fluent[0], len(fluent) - 1) in self._fluents

    def fluent(self, fluent: Fluent) -> Any:
        """Return the fluent in unified-planning, without its arguments; refuse one like ``total-time``, which the domain does not have."""
        if not self.knows(fluent):
            raise InputError(f"the use of {fluent_text(fluent)}")
        return self._fluents[fluent[0], len(fluent) - 1]

    def type_of(self, types: Iterable[str]) -> Any:
        """Return the type there that covers the given types."""
        return self.types[self.tree.cover(types)]

    def variables(self, variables: Iterable[Variable], terms: Terms) -> tuple[tuple[Any, ...], tuple[Any, ...], Terms]:
        """Return the variables of a quantifier, their guards, and the terms in its scope."""
        chosen = {variable: up.Variable(variable.name[1:], self.type_of(variable.types)) for variable in variables}
        inner = {**terms, **{variable.name: up.VariableExp(symbol) for variable, symbol in chosen.items()}}
        return tuple(chosen.values()), tuple(self.guards(chosen, inner)), inner

    def guards(self, variables: Iterable[Variable], terms: Terms) -> Iterator[Any]:
        """Yield the conditions that the variables are of their types, where the tree cannot express it."""
        for variable in variables:
            types = frozenset(variable.types)
            if self.tree.is_exact(types):
                continue
            if types not in self._guards:
                name = self.named(f"is-{'-or-'.join(sorted(types))}")
                guard = self._guards[types] = up.Fluent(name, up.BoolType(), it=self.type_of(types))
                self.translated.add_fluent(guard, default_initial_value=False)
                for member in self.tree.extent(types):
                    self.translated.set_initial_value(guard(self.objects[member]), True)
            yield self._guards[types](terms[variable.name])

    def _declare(self, declared: Declaration, kind: Any, **default: bool) -> None:
        parameters = {f"{variable.name[1:]}-{place}": self.type_of(variable.types) for place, variable in enumerate(declared.parameters)}
        there = self._fluents[declared.name, len(parameters)] = up.Fluent(self.named(declared.name), kind, **parameters)
        self.translated.add_fluent(there, **default)


# --- expressions ----------------------------------------------------------------------------------
# Conditions and expressions, in unified-planning.


_COMPARISONS: Final[Mapping[str, Callable[..., Any]]] = {"=": up.Equals, "<": up.LT, "<=": up.LE, ">": up.GT, ">=": up.GE}
_ARITHMETIC: Final[Mapping[str, Callable[..., Any]]] = {"+": up.Plus, "-": up.Minus, "*": up.Times, "/": up.Div}


def condition_there(condition: Condition, declared: Declarations, terms: Terms) -> Any:
    """Return the condition in unified-planning."""
    match condition:
        case Holds(fluent):
            return fluent_there(fluent, declared, terms)
        case Compare(operation, left, right):
            return _COMPARISONS[operation](expression_there(left, declared, terms), expression_there(right, declared, terms))
        case Not(operand):
            return up.Not(condition_there(operand, declared, terms))
        case All(operands):
            return up.And(*(condition_there(operand, declared, terms) for operand in operands))
        case conditions.Any(operands):
            return up.Or(*(condition_there(operand, declared, terms) for operand in operands))
        case Implies(left_condition, right_condition):
            return up.Implies(condition_there(left_condition, declared, terms), condition_there(right_condition, declared, terms))
        case ForAll(variables, body):
            chosen, guards, inner = declared.variables(variables, terms)
            then = condition_there(body, declared, inner)
            return up.Forall(up.Implies(up.And(*guards), then) if guards else then, *chosen)
        case Exists(variables, body):
            chosen, guards, inner = declared.variables(variables, terms)
            return up.Exists(up.And(*guards, condition_there(body, declared, inner)), *chosen)
        case Computed():
            raise InputError(f"planners cannot be told {condition}: they know facts and functions, not variables")
        case _:
            assert_never(condition)


def expression_there(expression: Expression, declared: Declarations, terms: Terms) -> Any:
    """Return the expression in unified-planning; `terms` may give `DURATION` a value, which is known before the action begins."""
    match expression:
        case Constant(bool() as truth):
            return up.Bool(truth)
        case Constant(float() | int() as number):
            return number_there(number)
        case Constant(str() as name):
            return terms[name] if name.startswith("?") else up.ObjectExp(declared.objects[name])
        case ValueOf(fluent) if fluent == DURATION:
            if DURATION[0] not in terms:
                raise InputError("an effect that depends on a duration the planner chooses")
            return terms[DURATION[0]]
        case ValueOf(fluent):
            return fluent_there(fluent, declared, terms)
        case Arithmetic("-", (operand,)):
            return up.Minus(0, expression_there(operand, declared, terms))
        case Arithmetic(operation, (first, *others)):
            result = expression_there(first, declared, terms)
            for operand in others:
                result = _ARITHMETIC[operation](result, expression_there(operand, declared, terms))
            return result
        case _:
            raise AssertionError(expression)


def fluent_there(fluent: Fluent, declared: Declarations, terms: Terms) -> Any:
    """Return the fluent in unified-planning."""
    arguments = (terms[term] if term.startswith("?") else up.ObjectExp(declared.objects[term]) for term in fluent[1:])
    return up.FluentExp(declared.fluent(fluent), arguments)


def number_there(number: float) -> Any:
    """Return the number in unified-planning: exactly what was written, and whole if it is."""
    return up.Int(int(number)) if number == int(number) else up.Real(Fraction(repr(number)))


# --- engines --------------------------------------------------------------------------------------
# The request to an engine of unified-planning, and its answer as plain data.


_STATUS: Final = {
    Status.UNSOLVABLE_PROVEN: PlanningStatus.UNSOLVABLE,
    Status.TIMEOUT: PlanningStatus.TIMED_OUT,
    Status.MEMOUT: PlanningStatus.OUT_OF_MEMORY,
    Status.INTERNAL_ERROR: PlanningStatus.CRASHED,
    Status.UNSUPPORTED_PROBLEM: PlanningStatus.UNSUPPORTED,
}
_OUT_OF_MEMORY: Final = re.compile(r"OutOfMemoryError|bad_alloc|MemoryError|insufficient memory|exit code: -9")
_UNSUPPORTED: Final = re.compile(r"^Unsupported \w|not supported")
_LENGTH: Final = 400
"""Characters of an engine's message that are passed on, half of them from the beginning and half from the end."""


class _StatedProblem(up.Problem):  # type: ignore[misc]  # unified-planning ships no types
    """A problem for planners that are given PDDL: without a value for every combination of objects."""

    @property
    def initial_values(self) -> dict[Any, Any]:
        """Only the values stated: other fluents are false, or have no value."""
        return self.explicit_initial_values  # type: ignore[no-any-return]

    @cached_property
    def kind(self) -> ProblemKind:
        """Cached, because it is read often and slow to compute."""
        return super().kind


Answer: TypeAlias = dict[str, object]
"""The status by name, a message, and the steps of the plan; or `unknown`, if there is no such engine."""


def ask(name: str, seconds: float) -> Answer:
    """Ask an engine for a plan for the problem in this folder. An engine that cannot cope with the metric is asked for any plan."""
    if unknown := look_up(name):
        return unknown
    deadline = time.monotonic() + seconds
    problem = parse_problem(Path("problem.pddl").read_text(), parse_domain(Path("domain.pddl").read_text()))
    answer = _answer(name, problem, deadline)
    if problem.metric is None or not _is_refused(answer):
        return answer
    again = _answer(name, replace(problem, metric=None), deadline)
    return answer if _is_refused(again) else {**again, "message": f"{again['message']} (without the metric: {answer['message']})".strip()}


def look_up(name: str) -> Answer:
    """Return the error if there is no such engine; nothing if there is."""
    environment = up.get_environment()
    environment.credits_stream = None
    installed = sorted(engine for engine in environment.factory.engines if environment.factory.engine(engine).is_oneshot_planner())
    if name in installed:
        return {}
    if name in DEFAULT_ENGINES:
        package = DEFAULT_ENGINES[name][0].partition(".")[0].replace("_", "-")
        return {"unknown": f"the planner {name} is not installed: pip install {package}"}
    planners = ("kairos", *(engine for engine in installed if "[" not in engine))
    hint = suggestion(name, (*planners, "race", *ENGINES))
    return {"unknown": f"there is no planner {name!r}; installed: {', '.join(planners)}{f'; {hint}' if hint else ''}"}


def _is_refused(answer: Answer) -> bool:
    return answer["status"] in (PlanningStatus.UNSUPPORTED.name, PlanningStatus.CRASHED.name)


def _answer(name: str, problem: Problem, deadline: float) -> Answer:
    try:
        there, actions, objects = _problem(name, problem)
        with up.OneshotPlanner(name=name) as planner:
            planner.skip_checks = True  # what it declares has been looked at already
            result = planner.solve(there, timeout=max(0.01, deadline - time.monotonic()))
    except (InputError, UPUnsupportedProblemTypeError) as error:
        return _no_plan(PlanningStatus.UNSUPPORTED, str(error))
    except UPException as error:
        return _no_plan(PlanningStatus.CRASHED, str(error))
    except MemoryError as error:
        return _no_plan(PlanningStatus.OUT_OF_MEMORY, str(error))
    if result.plan is None:
        return _reason(name, result)
    plan: Any = getattr(result.plan, "action_plan", result.plan)  # of a hierarchical plan, what is carried out
    if hasattr(plan, "timed_actions"):
        calls = [(call, float(start), float(duration or 0)) for start, call, duration in plan.timed_actions]
    else:
        sequential = plan if hasattr(plan, "actions") else next(iter(plan.all_sequential_plans()))
        calls = [(call, float(index), 0.0) for index, call in enumerate(sequential.actions)]
    steps = [
        (actions.get(call.action.name, call.action.name), [objects.get(name, name) for name in map(str, call.actual_parameters)], *times)
        for call, *times in calls
    ]
    return {"status": PlanningStatus.SOLVED.name, "steps": steps, "message": ""}


def _reason(name: str, result: PlanGenerationResult) -> Answer:
    log = "\n".join(message.message for message in result.log_messages or ())
    status = _STATUS.get(result.status, PlanningStatus.NO_PLAN)
    if status is PlanningStatus.UNSOLVABLE and not (name in ENGINES and ENGINES[name].proves_unsolvability):
        return _no_plan(PlanningStatus.NO_PLAN, f"{name} says that there is none, but this is no proof")
    if status is not PlanningStatus.CRASHED:
        return _no_plan(status, "")
    if _OUT_OF_MEMORY.search(log):
        return _no_plan(PlanningStatus.OUT_OF_MEMORY, log)
    return _no_plan(PlanningStatus.UNSUPPORTED if _UNSUPPORTED.search(log) else status, log)


def _no_plan(status: PlanningStatus, log: str) -> Answer:
    words = " ".join(log.split())
    return {"status": status.name, "message": words if len(words) <= _LENGTH else f"{words[: _LENGTH // 2]} ... {words[-_LENGTH // 2 :]}"}


def _problem(name: str, problem: Problem) -> tuple[Any, dict[str, str], dict[str, str]]:
    """Return the problem for the engine, which must support it, and how its actions and objects are called here."""
    engine = up.get_environment().factory.engine(name)
    if Feature.TASKS in problem_kind(problem):
        up.get_environment().error_used_name = False
        try:  # unified-planning reads it itself: tasks and methods are text to us
            there, actions, objects = PDDLReader().parse_problem("domain.pddl", "problem.pddl"), dict[str, str](), dict[str, str]()
        except Exception as error:  # the reader raises whatever its grammar raises
            raise InputError(f"unified-planning cannot read the problem: {error}") from error
    else:
        translation = Translation(problem, (_StatedProblem if issubclass(engine, PDDLPlanner) else up.Problem)(problem.name))
        there, actions, objects = translation.translated, translation.actions, translation.objects
    undeclared = ENGINES[name].undeclared if name in ENGINES else frozenset[str]()
    asked = there.kind.features - undeclared
    if not engine.supports(ProblemKind(asked, version=there.kind.version)):
        raise InputError(", ".join(sorted(asked - engine.supported_kind().features)).lower().replace("_", " "))
    return there, actions, objects
