"""Plans as the first implementation of Petri Net Machines (cdondrup/petri_net) loads them: ``--seed-compatible``.

It knows variables, no facts; tests of them, ``and`` and ``or`` of two; and no parameters in conditions. So a plan is
written out: every call becomes a check of its precondition, the call, and a step for every change of a variable; a
last check is the goal. A fact ``(p a b)`` is a variable ``p__a__b`` that is true or not, a function one with a value.
It evaluates nothing but queries inside an operation, so what is calculated goes through variables of its own, one
operator at a time.

A file has two documents: the domain, and the plan.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from collections.abc import Sequence as List
from dataclasses import dataclass, field
from functools import reduce
from typing import Final, assert_never

from planner_bridge.model.grounding import ground_action, initial_knowledge
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.pddl.syntax.pretty_print import flat
from planner_bridge.pddl.syntax.words import number_text
from planner_bridge.pddl.write.forms import effects_form
from planner_bridge.yaml.emitter import Bare, Entry, Mapping, Sequence, Value, document, items, quoted, single
from pnm.core.logic.conditions import TRUE, All, Any, Compare, Computed, Condition, Exists, ForAll, Holds, Implies, Not, ground
from pnm.core.logic.effects import Effects, ForEach, Set, When, ground_effects
from pnm.core.logic.expressions import NOTHING, UNDEFINED, Arithmetic, Constant, Expression, Fluent, State, ValueOf, choices, fluent_text
from pnm.errors import InputError

_KNOWLEDGE_BASE: Final = ("rpn_planner_kb.rpn_planner_knowledge_base", "RPKnowledgeBase")
_ROS_ACTION: Final = ("rpn_ros_interface.action", "ROSAtomicAction")
_KB_ACTION: Final = ("pnp_actions.kb_action", "KBAction")
_RESERVED: Final = frozenset(
    (
        *("Query", "LocalQuery", "RemoteQuery", "Update", "LocalUpdate", "RemoteUpdate", "Exists", "Operation", "Comparison"),
        *("BooleanAssertion", "and", "or", "not", "LogicalAnd", "LogicalOr", "LogicalNot", "ABCMeta", "abstractoperation"),
        *("query", "update", "lock", "self", "while", "concurrent_actions"),
    )
)
"""Words that mean something else to it."""
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_COMPARISONS: Final = {"=": "eq", "<": "lt", "<=": "le", ">": "gt", ">=": "ge"}
_ARITHMETIC: Final = {"+": "add", "-": "sub", "*": "mul", "/": "truediv"}
_CHANGES: Final = {"increase": "add", "decrease": "sub", "scale-up": "mul", "scale-down": "truediv"}
_TRUE: Final = Bare("true")
_FALSE: Final = Bare("false")


def write_original(problem: Problem, plan: Plan) -> str:
    """Write the steps of a plan.

    Raises `InputError`, which names it, if something in the domain, the problem or the plan has no counterpart there.
    """
    used = [problem.domain.actions[name] for name in dict.fromkeys(step.action for step in plan.steps)]
    impossible = [
        *(f"the derived predicate {rule.name!r}" for rule in problem.domain.rules),
        *(f"the constraint {constraint}" for constraint in (*problem.domain.constraints, *problem.constraints)),
        *(f"the change of facts by themselves at {number_text(change.time)} s" for change in problem.timed),
        *(f"the duration of the action {schema.name!r}" for schema in used if schema.duration is not None),
    ]
    if impossible:
        raise InputError(f"the first implementation has no way to say {impossible[0]}")
    writer = _UnrolledPlan(problem, initial_knowledge(problem))
    for step in plan.steps:
        writer.call(step)
    writer.check(problem.goal, "goal")
    domain = Mapping((Entry(_class(_KNOWLEDGE_BASE), "external_knowledge_base"), Entry(Mapping(tuple(writer.actions.values())), "actions")))
    return f"{document(domain)}---\n{document(writer.plan())}"


@dataclass
class _UnrolledPlan:
    """Writes the steps. The mutable state is what has been written."""

    problem: Problem
    state: State
    """Tells the objects."""
    actions: dict[str, Entry] = field(default_factory=dict)
    steps: list[Entry] = field(default_factory=list)
    names: dict[str, Fluent] = field(default_factory=dict)
    """What variables stand for."""
    temporary: int = 0
    place: str = ""
    """What is being written, for errors."""

    def plan(self) -> Mapping:
        """Return the plan, with what is known at the beginning."""
        known = [Entry(self._literal(value), self._variable(fluent)) for fluent, value in self.problem.init.items() if value is not False]
        return Mapping((Entry(Mapping(tuple(known)), "initial_knowledge"), Entry(Sequence(tuple(self.steps)), "plan", apart=True)))

    # --- steps ---

    def call(self, step: PlanStep) -> None:
        """Write a check of the precondition, the call, and its effects."""
        schema = self.problem.domain.actions[step.action]
        action = ground_action(schema, step.arguments)
        self.place = f"the action {schema.name!r}"
        self.check(action.precondition, f"before_{_worded(schema.name)}")
        name = _worded(schema.name)
        if _NAME.fullmatch(name) is None or name in _RESERVED or name == "set_knowledge":
            raise InputError(f"the first implementation cannot call {self.place}: {name!r} means something else to it")
        fields = [_worded(variable.name[1:]) for variable in schema.parameters]
        params = items(map(_text, fields), short=True)
        entry = Entry(Mapping((Entry(_class(_ROS_ACTION), "type"), Entry(params, "params"))), name)
        if self.actions.setdefault(name, entry) != entry or len(set(fields)) < len(fields):
            raise InputError(f"the first implementation cannot call {self.place}: without '-', names in it are there twice")
        given = [Entry(_text(argument), _worded(field)) for field, argument in zip(action.parameters, action.arguments, strict=True)]
        self.steps.append(Entry(single(name, Mapping(tuple(given), short=True))))
        self._change(_expanded(action.end_effects, self.state))

    def check(self, condition: Condition, name: str) -> None:
        """Write a step that fails unless the condition holds."""
        if name == "goal":
            self.place = "the goal"
        if condition == TRUE:
            return
        tested = self._condition(condition)
        taken = {_worded(action) for action in self.problem.domain.actions} | self.actions.keys()
        word, count = name, 1
        while word in taken:
            count += 1
            word = f"{name}_{count}"
        self.actions[word] = Entry(Mapping((Entry(_class(_KB_ACTION), "type"), Entry(tested, "preconditions"))), word)
        self.steps.append(self._knowledge(word, single("LocalQuery", _text("checked"), short=True)))

    def _knowledge(self, name: str, operation: Value) -> Entry:
        return Entry(single(name, single("operation", operation, short=True)))

    def _store(self, name: str, value: Value) -> None:
        word = "set_knowledge"
        self.actions.setdefault(word, Entry(single("type", _class(_KB_ACTION)), word))
        self.steps.append(self._knowledge(word, single("LocalUpdate", items([_text(name), value], short=True), short=True)))

    def _temporary(self, value: Value) -> Value:
        """Store a value in a variable of its own; return what queries it."""
        self.temporary += 1
        name = f"temporary__{self.temporary}"
        self._store(name, value)
        return _query(name)

    # --- effects ---

    def _change(self, changes: List[tuple[Set, Condition]]) -> None:
        """Write effects, which are simultaneous: what they read is looked at before anything is changed."""
        numbers: dict[Fluent, Value] = {}
        deleted: list[tuple[Fluent, Value | None]] = []
        added: list[tuple[Fluent, Value | None]] = []
        for effect, condition in changes:
            match effect:
                case Set(fluent, Constant(bool() as truth)):
                    when = None if condition == TRUE else self._temporary(_both("or", self._condition(condition), single("or", Sequence())))
                    (added if truth else deleted).append((fluent, when))
                case Set(fluent) if condition == TRUE:
                    value = self._operand(effect.value)
                    if effect.operation != "assign":
                        value = _operation(_CHANGES[effect.operation], numbers.get(fluent, _query(self._variable(fluent))), value)
                    numbers[fluent] = value if len(changes) == 1 else self._temporary(value)
                case Set():
                    raise self._impossible(f"a conditional effect on a value, {flat(effects_form((effect,)))},")
        for fluent, when in deleted:
            kept = _FALSE if when is None else _both("and", self._holds(fluent), single("not", _is_true(when)))
            self._store(self._variable(fluent), kept)
        for fluent, when in added:
            self._store(self._variable(fluent), _TRUE if when is None else _both("or", self._holds(fluent), _is_true(when)))
        for fluent, value in numbers.items():
            self._store(self._variable(fluent), value)

    # --- conditions and expressions ---

    def _condition(self, condition: Condition) -> Value:
        match condition:
            case Holds(fluent):
                return self._holds(fluent)
            case Compare(operation, left, right):
                return _comparison(_COMPARISONS[operation], self._operand(left), self._operand(right))
            case Not(operand):
                return single("not", self._condition(operand))
            case All(operands):
                return _nested("and", [self._condition(operand) for operand in operands])
            case Any(operands):
                return _nested("or", [self._condition(operand) for operand in operands])
            case Implies(left, right):
                return _both("or", single("not", self._condition(left)), self._condition(right))
            case ForAll(variables, body):
                return _nested("and", [self._condition(ground(body, chosen)) for chosen in choices(variables, self.state, NOTHING)])
            case Exists(variables, body):
                return _nested("or", [self._condition(ground(body, chosen)) for chosen in choices(variables, self.state, NOTHING)])
            case Computed():
                raise self._impossible(str(condition))
            case _:
                assert_never(condition)

    def _holds(self, fluent: Fluent) -> Value:
        return _is_true(_query(self._variable(fluent)))

    def _operand(self, expression: Expression) -> Value:
        """Return a literal or a query; what has to be calculated is stored before."""
        match expression:
            case Constant(value) if value == UNDEFINED:
                raise self._impossible("'undefined'")
            case Constant(value):
                return self._literal(value)
            case ValueOf(fluent):
                return _query(self._variable(fluent))
            case Arithmetic("-", (operand,)):
                return self._temporary(_operation("neg", self._operand(operand)))
            case Arithmetic(operation, operands):
                values = [self._operand(operand) for operand in operands]
                return reduce(lambda left, right: self._temporary(_operation(_ARITHMETIC[operation], left, right)), values[1:], values[0])
            case _:
                assert_never(expression)

    def _impossible(self, what: str) -> InputError:
        return InputError(f"the first implementation has no way to say {what} of {self.place}")

    def _literal(self, value: bool | float | str) -> Value:
        match value:
            case bool():
                return _TRUE if value else _FALSE
            case str():
                return _text(value)
            case _:
                return Bare(number_text(value))

    def _variable(self, fluent: Fluent) -> str:
        name = "__".join(map(_worded, fluent))
        if name in _RESERVED:
            name += "_"
        if self.names.setdefault(name, fluent) != fluent or _NAME.fullmatch(name) is None:
            reason = f"{name!r} stands for {fluent_text(self.names[name])}" if self.names[name] != fluent else f"{name!r} is no name there"
            raise InputError(f"the first implementation has no variable for {fluent_text(fluent)}: {reason}")
        return name


def _expanded(effects: Effects, state: State, condition: Condition = TRUE) -> list[tuple[Set, Condition]]:
    """Return effects without quantifiers, each with the condition it happens under."""
    expanded: list[tuple[Set, Condition]] = []
    for effect in effects:
        match effect:
            case Set():
                expanded.append((effect, condition))
            case When(tested, inner):
                expanded += _expanded(inner, state, tested if condition == TRUE else All((condition, tested)))
            case ForEach(variables, inner):
                for chosen in choices(variables, state, NOTHING):
                    expanded += _expanded(ground_effects(inner, chosen), state, condition)
            case _:
                assert_never(effect)
    return expanded


# --- what it reads -------------------------------------------------------------------------


def _worded(name: str) -> str:
    return name.replace("-", "_")


def _text(text: str) -> Value:
    """Write a text, always in quotes."""
    return Bare(quoted(text))


def _class(named: tuple[str, str]) -> Value:
    return Mapping((Entry(_text(named[0]), "module"), Entry(_text(named[1]), "class")), short=True)


def _query(name: str) -> Value:
    return single("LocalQuery", _text(name), short=True)


def _comparison(operator: str, left: Value, right: Value) -> Value:
    return single("Comparison", items([_text(operator), items([left, right], short=True)], short=True), short=True)


def _operation(operator: str, *operands: Value) -> Value:
    return single("Operation", items([_text(operator), items(operands, short=True)], short=True), short=True)


def _is_true(value: Value) -> Value:
    return _comparison("eq", value, _TRUE)


def _both(word: str, left: Value, right: Value) -> Value:
    return single(word, items([left, right]))


def _nested(word: str, values: Iterable[Value]) -> Value:
    """Join conditions two by two: it cannot load three."""
    parts = list(values)
    while len(parts) > 1:
        pairs = [_both(word, *pair) for pair in zip(parts[::2], parts[1::2], strict=False)]
        parts = [*pairs, *parts[2 * len(pairs) :]]
    return parts[0] if parts else single(word, Sequence())
