"""PDDL terms, conditions, effects and constraints: from lists of words to expressions of the model, checked against the symbol table."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Final, TypeVar

from planner_bridge.model.problem import TOTAL_COST, TOTAL_TIME
from planner_bridge.pddl.expressions import (
    Atom,
    Group,
    Node,
    TimeSpecifier,
    Types,
    is_number,
    new_name,
    number,
    operands,
    show_types,
    time,
    unknown,
    wrong,
)
from planner_bridge.pddl.sections import Leniency, Refused
from planner_bridge.pddl.symbols import CONSTRAINTS, OUTCOMES, SymbolTable
from pnm.core.logic.conditions import TRUE, Any, Compare, Condition, Exists, ForAll, Holds, Implies, Not, conjunction
from pnm.core.logic.domain import Declaration, Preference
from pnm.core.logic.effects import CHANCES_MISS, OPERATIONS, Alternative, Effects, ForEach, OneOf, Set, When
from pnm.core.logic.expressions import DURATION, UNDEFINED, Arithmetic, Constant, Expression, Fluent, Value, ValueOf, Variable
from pnm.core.logic.trajectory import Constraint
from pnm.errors import InputError, counted

_MANY: Final = (range(2, sys.maxsize), "at least 2")
OPERANDS: Final[Mapping[str, tuple[range, str]]] = {"+": _MANY, "*": _MANY, "-": (range(1, 3), "1 or 2"), "/": (range(2, 3), "2")}
"""The number of operands of each arithmetic operator."""
IS_VIOLATED: Final = "is-violated"
_ANY: Final = ("object",)


@dataclass(frozen=True, slots=True)
class TermScope:
    """The terms that may stand at a place of a file: the symbol table, and the variables bound around it."""

    symbols: SymbolTable
    variables: Mapping[str, Variable] = field(default_factory=dict)
    """By name in lower case."""
    duration: bool = False
    """Whether ``?duration`` may be used."""
    rates: bool = False
    """Whether effects are those of a process: changes of numbers, ``(increase FUNCTION (* #t RATE))``."""
    metric: bool = False
    """Whether ``total-time`` and ``(is-violated PREFERENCE)`` may be used."""

    def inside(self, variables: Iterable[Variable]) -> TermScope:
        """Return the scope in which these variables are bound, too."""
        return replace(self, variables={**self.variables, **{variable.name.lower(): variable for variable in variables}})

    def quantified(self, node: Group) -> tuple[tuple[Variable, ...], Node]:
        """Return the variables and the body of ``(forall (?x - t) body)``, or of ``exists``."""
        variables, body = operands(node, 2)
        if not isinstance(variables, Group):
            raise wrong(variables, f"expected variables in parentheses, found {variables}")
        return self.symbols.variables(variables.items), body

    def fact(self, node: Node) -> Fluent:
        """Read a predicate with its arguments."""
        if not isinstance(node, Group):
            raise wrong(node, f"expected a fact in parentheses, found {node}")
        return self._fluent(node, self.symbols.predicate(node))

    def function(self, node: Node) -> Fluent:
        """Read a function with its arguments."""
        return self._fluent(node, self.symbols.function(node))

    def assigned(self, target: Node, given: Node) -> tuple[Fluent, Value]:
        """Read a function with its arguments, and the number or the object that it is given."""
        fluent, types = self.function(target), self.symbols.function(target).values
        if not types:
            return fluent, number(given)
        constant = self.value(given, types)
        if not isinstance(constant, Constant):
            raise wrong(given, f"expected an object, found {given}")
        return fluent, constant.value

    def _fluent(self, node: Node, declared: Declaration) -> Fluent:
        given = node.rest if isinstance(node, Group) else ()
        if len(given) != len(declared.parameters):
            raise wrong(node, f"{declared} takes {counted(len(declared.parameters), 'argument')}, found {len(given)}")
        return declared.name, *[self._argument(term, variable.types) for term, variable in zip(given, declared.parameters, strict=True)]

    def _argument(self, node: Node, needed: Types) -> str:
        match node:
            case Atom(text) if text[0] != "?":
                name, types = self.symbols.object(node, needed)
                fits = self.symbols.domain.matches(types, needed)
            case Atom() if node.key in self.variables:
                name, types = self.variables[node.key].name, self.variables[node.key].types
                fits = self.symbols.domain.may_match(types, needed)
            case Atom():
                raise unknown("variable", node, [variable.name for variable in self.variables.values()])
            case Group() if (declared := self.symbols.find_function(node)) and declared.values:
                raise wrong(node, f"{node} cannot be an argument here; expected an object or a variable")
            case Group():
                raise wrong(node, f"expected an object or a variable, found {node}")
        if not fits:
            raise _ill_typed(node, name, types, needed)
        return name

    def is_object(self, node: Node) -> bool:
        """Whether the part stands for an object rather than a number."""
        declared = self.symbols.find_function(node)
        if isinstance(node, Group):
            return declared is not None and bool(declared.values)
        if is_number(node):
            return False
        if node.text[0] == "?":
            return node.key in self.variables or node.key != DURATION[0]
        return self.symbols.find_object(node.text) is not None or declared is None or bool(declared.values)

    def value(self, node: Node, needed: Types = _ANY) -> Expression:
        """Read an object, a variable, or a function with objects for values, of these types."""
        declared = self.symbols.find_function(node)
        if declared is None or not declared.values or (isinstance(node, Atom) and self.symbols.find_object(node.text)):
            return Constant(self._argument(node, needed))
        fluent = self.function(node)
        if not self.symbols.domain.may_match(declared.values, needed):
            raise _ill_typed(node, declared.name, declared.values, needed)
        return ValueOf(fluent)

    def expression(self, node: Node) -> Expression:
        """Read a number, ``?duration``, the value of a function, or arithmetic over these."""
        match node:
            case Group() if node.head in OPERANDS:
                counts, expected = OPERANDS[node.head]
                if len(node.rest) not in counts:
                    raise wrong(node, f"'{node.head}' takes {expected} operands, found {len(node.rest)}")
                return Arithmetic(node.head, tuple([self.expression(part) for part in node.rest]))
            case Group() if self.metric and node.head == IS_VIOLATED:
                (name,) = operands(node, 1)
                if not isinstance(name, Atom):
                    raise wrong(name, f"expected the name of a preference, found {name}")
                if name.key not in self.symbols.preference_names:
                    raise unknown("preference", name, self.symbols.preference_names.values())
                return ValueOf((IS_VIOLATED, self.symbols.preference_names[name.key]))
            case Group():
                return self._number(node)
            case Atom() if is_number(node):
                return Constant(number(node))
            case Atom() if node.key == DURATION[0] and node.key not in self.variables:
                if not self.duration:
                    raise wrong(node, "'?duration' can only be used in the conditions and effects of a durative action")
                return ValueOf(DURATION)
            case Atom("#t"):
                raise Refused.CONTINUOUS_EFFECT.at(node)
            case Atom() if self.symbols.find_function(node) or (self.metric and node.key == TOTAL_TIME[0]):
                return self._number(node)
            case _:
                raise wrong(node, f"expected a number or a function in parentheses, found {node}")

    def _number(self, node: Node) -> Expression:
        declared = self.symbols.find_function(node)
        if self.metric and declared is None and (node.head if isinstance(node, Group) else node.key) == TOTAL_TIME[0]:
            return ValueOf(TOTAL_TIME)
        if declared is not None and declared.values:
            raise wrong(node, f"the values of {declared.name!r} are objects ({show_types(declared.values)}); expected a number")
        if self.metric:
            self.symbols.requirements.need(node, ":action-costs", ":numeric-fluents")
        return ValueOf(self.function(node))


def _ill_typed(node: Node, name: str, types: Types, needed: Types) -> InputError:
    return wrong(node, f"{name!r} is of type {show_types(types)}; expected {show_types(needed)}")


# --- conditions and effects -----------------------------------------------------------------------
# PDDL conditions and effects: from lists of words to pnm's, checked against the symbol table.
#
# Object fluents as arguments, ``(dirty (room-of ?r))``, are flattened: a variable stands for the value of the function
# (PDDL 3.1). It is bound around the fact, the comparison or the effect in which it stands; where the function has no
# value there is no choice for it, so that a fact about it does not hold.


_COMPOUND: Final = ("and", "or", "not", "imply", "forall", "exists")
_COMPARISONS: Final = ("=", "<", "<=", ">", ">=")
_OVER_NUMBERS: Final = frozenset((*OPERANDS, *OPERATIONS, *_COMPARISONS, "not"))
"""Heads whose operands are no arguments themselves but may have some."""


def condition(node: Node, scope: TermScope) -> Condition:
    """Read a condition; ``()`` is true."""
    if not isinstance(node, Group):
        raise wrong(node, f"expected a condition in parentheses, found {node}")
    if not node.items:
        return TRUE
    match node.head:
        case "and":
            return conjunction([condition(part, scope) for part in node.rest])
        case "or":
            scope.symbols.requirements.need(node, ":disjunctive-preconditions")
            return Any(tuple([condition(part, scope) for part in node.rest]))
        case "not":
            (operand,) = operands(node, 1)
            is_plain = not isinstance(operand, Group) or operand.head not in _COMPOUND
            scope.symbols.requirements.need(node, *([":negative-preconditions"] if is_plain else []), ":disjunctive-preconditions")
            return Not(condition(operand, scope))
        case "imply":
            scope.symbols.requirements.need(node, ":disjunctive-preconditions")
            left, right = operands(node, 2)
            return Implies(condition(left, scope), condition(right, scope))
        case "forall" | "exists" as word:
            scope.symbols.requirements.need(node, ":universal-preconditions" if word == "forall" else ":existential-preconditions")
            variables, body = scope.quantified(node)
            return (ForAll if word == "forall" else Exists)(variables, condition(body, scope.inside(variables)))
        case _:
            return _atom(node, scope)


def _atom(node: Group, scope: TermScope) -> Condition:
    """Read a fact or a comparison."""
    if (flat := _flattened(node, scope)) is not None:
        return Exists(tuple(flat.variables.values()), conjunction([*flat.values, _atom(flat.node, flat.scope)]))
    if node.head not in _COMPARISONS:
        if scope.symbols.lenient and scope.symbols.is_undeclared(node):
            Leniency.PREDICATE_UNDECLARED.note(node.items[0], node.items[0])
            return Any(())  # false
        return Holds(scope.fact(node))
    left, right = operands(node, 2)
    if node.head == "=" and (scope.is_object(left) or scope.is_object(right)):
        scope.symbols.requirements.need(node, ":equality", *([":object-fluents"] if scope.symbols.has_object_functions else []))
        return Compare("=", scope.value(left), scope.value(right))
    scope.symbols.requirements.need(node, ":numeric-fluents")
    return Compare(node.head, scope.expression(left), scope.expression(right))


def effects(node: Node, scope: TermScope) -> Effects:
    """Read an effect; ``and`` and ``()`` disappear in the tuple."""
    if not isinstance(node, Group):
        raise wrong(node, f"expected an effect in parentheses, found {node}")
    if not node.items:
        return ()
    match node.head:
        case "and":
            return tuple([effect for part in node.rest for effect in effects(part, scope)])
        case "forall":
            scope.symbols.requirements.need(node, ":conditional-effects")
            variables, body = scope.quantified(node)
            return (ForEach(variables, effects(body, scope.inside(variables))),)
        case "when":
            scope.symbols.requirements.need(node, ":conditional-effects")
            first, second = operands(node, 2)
            return (When(condition(first, scope), effects(second, scope)),)
        case _ if has_alternatives(node, scope):
            return (OneOf(tuple([Alternative(effects(part, scope), chance) for part, chance in alternatives(node, scope)])),)
        case operation if operation in OPERATIONS and node.rest and is_reward(node.rest[0], scope):
            Leniency.REWARD.note(node, node)
            return ()
        case "=":
            raise wrong(node, "'=' cannot stand in an effect; expected (assign FUNCTION VALUE)")
        case "or" | "imply" | "exists" as word:
            raise wrong(node, f"'{word}' cannot stand in an effect; expected a fact, not, forall, when or assign")
        case _:
            flat = _flattened(node, scope)
            if flat is None:
                return (_change(node, scope),)
            change = _change(flat.node, flat.scope)
            return (ForEach(tuple(flat.variables.values()), (When(conjunction(flat.values), (change,)),)),)


def has_alternatives(node: Group, scope: TermScope) -> bool:
    """Whether the part is ``(oneof ...)`` or ``(probabilistic ...)``, and no predicate of that name."""
    return node.head in OUTCOMES and not scope.symbols.has_predicate(node.head)


def alternatives(node: Group, scope: TermScope) -> list[tuple[Node, float | None]]:
    """Return the effects of ``(oneof EFFECT ...)`` or ``(probabilistic CHANCE EFFECT ...)``, and the chance of each, None without any.

    Where chances sum to less than 1, nothing happens with the rest of them.
    """
    scope.symbols.requirements.need(node, OUTCOMES[node.head])
    parts = 1 if node.head == "oneof" else 2
    if not node.rest or len(node.rest) % parts:
        form = f"({node.head} {'EFFECT' if parts == 1 else 'CHANCE EFFECT'} ...)"
        raise wrong(node, f"expected {form}, found {counted(len(node.rest), 'part')}")
    if parts == 1:
        return [(part, None) for part in node.rest]
    chances: list[Fraction] = []
    for part in node.rest[::2]:
        try:
            chances.append(Fraction(part.text if isinstance(part, Atom) else ""))
        except (ValueError, ZeroDivisionError) as error:
            raise wrong(part, f"expected a chance from 0 to 1, found {part}") from error
        if not 0 <= chances[-1] <= 1:
            raise wrong(part, f"expected a chance from 0 to 1, found {part}")
    found: list[tuple[Node, float | None]] = [(part, float(chance)) for part, chance in zip(node.rest[1::2], chances, strict=True)]
    rest = 1 - sum(chances)
    if rest < -CHANCES_MISS:
        raise wrong(node, f"the chances sum to {float(1 - rest):g}; expected 1 at most")
    return [*found, (Group((), node.offset, node.source), float(rest))] if rest > CHANCES_MISS else found


def is_reward(node: Node, scope: TermScope) -> bool:
    """Whether the part is the reward of probabilistic planning, and no function of that name."""
    return (node.head if isinstance(node, Group) else node.key) == "reward" and scope.symbols.find_function(node) is None


def _change(node: Group, scope: TermScope) -> Set:
    match node.head:
        case operation if scope.rates and operation not in ("increase", "decrease"):
            raise wrong(
                node, f"a process changes numbers as time passes; expected (increase FUNCTION (* #t RATE)) or decrease, found {node}"
            )
        case "not":
            return Set(_changed_fact(operands(node, 1)[0], scope), Constant(False))
        case operation if operation in OPERATIONS:
            target, value = operands(node, 2)
            return Set(scope.function(target), _new_value(node, target, value, scope), operation)
        case _:
            return Set(_changed_fact(node, scope), Constant(True))


def _changed_fact(node: Node, scope: TermScope) -> Fluent:
    fluent = scope.fact(node)
    if fluent[0] in scope.symbols.derived:
        raise wrong(node, f"{fluent[0]!r} is a derived predicate; no effect can change it")
    return fluent


def _new_value(node: Group, target: Node, value: Node, scope: TermScope) -> Expression:
    declared = scope.symbols.function(target)
    if not declared.values:
        cost = node.head == "increase" and declared.name.lower() == TOTAL_COST and not (isinstance(value, Group) and value.head in OPERANDS)
        scope.symbols.requirements.need(node, *((":action-costs",) if cost else ()), ":numeric-fluents")
        if not scope.rates:
            return scope.expression(value)
        factors = value.rest if isinstance(value, Group) and value.head == "*" else (value,)
        rate = [part for part in factors if not (isinstance(part, Atom) and part.key == "#t")]
        if len(rate) != len(factors) - 1:
            raise wrong(value, f"expected a change in a second, (* #t RATE), found {value}")
        terms = tuple(map(scope.expression, rate)) or (Constant(1.0),)
        return Arithmetic("*", terms) if len(terms) > 1 else terms[0]
    if node.head != "assign":
        raise wrong(node, f"the values of {declared.name!r} are objects ({show_types(declared.values)}); expected (assign ...)")
    if isinstance(value, Atom) and value.key == UNDEFINED and scope.symbols.find_object(value.text) is None:
        return Constant(UNDEFINED)
    return scope.value(value, declared.values)


def _flattened(node: Group, scope: TermScope) -> _Flattened | None:
    """Return the fact, comparison or effect without functions among its arguments; None when there are none."""
    if not scope.symbols.has_object_functions:
        return None
    flat = _Flattened(scope)
    flat.node = flat.flatten(node)
    return flat if flat.variables else None


@dataclass(slots=True)
class _Flattened:
    """A list without functions among its arguments. The mutable state grows while it is made."""

    scope: TermScope
    """With the variables that stand for values."""
    variables: dict[Fluent, Variable] = field(default_factory=dict)
    """For every function that was an argument, outermost last."""
    node: Group = field(init=False)

    @property
    def values(self) -> list[Compare]:
        """For every variable, that it equals its function."""
        return [Compare("=", ValueOf(fluent), Constant(variable.name)) for fluent, variable in self.variables.items()]

    def flatten(self, node: Group) -> Group:
        """Return the list with variables for the functions among its arguments."""
        if node.head in _OVER_NUMBERS:
            parts = [self.flatten(part) if isinstance(part, Group) and part.items else part for part in node.rest]
        else:
            parts = [self._argument(part) for part in node.rest]
        return Group((node.items[0], *parts), node.offset, node.source)

    def _argument(self, node: Node) -> Node:
        declared = self.scope.symbols.find_function(node) if isinstance(node, Group) else None
        if not isinstance(node, Group) or declared is None or not declared.values:
            return node
        flat = self.flatten(node)  # first, because it may bind variables
        fluent = self.scope.function(flat)
        if fluent not in self.variables:
            name, count = f"?{declared.name}", 1
            while name.lower() in self.scope.variables:
                count += 1
                name = f"?{declared.name}{count}"
            self.variables[fluent] = Variable(name, declared.values)
            self.scope = self.scope.inside((self.variables[fluent],))
        return Atom(self.variables[fluent].name, node.offset, node.source)


# --- constraints ----------------------------------------------------------------------------------
# PDDL preferences, split from the hard part of a condition, and trajectory constraints (PDDL 3.0).


T = TypeVar("T")


def is_preference(node: Node, scope: TermScope) -> bool:
    """Whether the part is a preference, and no predicate of that name."""
    return isinstance(node, Group) and node.head == "preference" and not scope.symbols.has_predicate("preference")


def preference(node: Group, scope: TermScope, read: Callable[[Node], T]) -> tuple[str, T]:
    """Read ``(preference NAME BODY)``, or ``(preference BODY)``: return the name, empty without one, and the body."""
    scope.symbols.requirements.need(node, ":preferences")
    match node.rest:
        case (Atom() as word, body):
            name = new_name(word, "preference")
            return scope.symbols.preference_names.setdefault(name.lower(), name), read(body)
        case (Group() as body,):
            return "", read(body)
        case _:
            raise wrong(node, f"expected (preference NAME CONDITION), found {counted(len(node.rest), 'part')}")


def with_variables(variables: tuple[Variable, ...], preferences: Iterable[Preference]) -> list[Preference]:
    """Return the preferences, each with the variables of a quantifier around it."""
    return [replace(preference, variables=(*variables, *preference.variables)) for preference in preferences]


def split_preferences(node: Node, scope: TermScope, moment: TimeSpecifier | None = None) -> tuple[Condition, tuple[Preference, ...]]:
    """Read a condition: return its hard part, and its preferences, at the moment of a durative action if one is given."""
    hard, soft = _split(node, scope)
    return conjunction(hard), tuple([replace(preference, moment=moment) for preference in soft] if moment else soft)


def _split(node: Node, scope: TermScope) -> tuple[list[Condition], list[Preference]]:
    match node:
        case Group() if is_preference(node, scope):
            name, wanted = preference(node, scope, lambda body: condition(body, scope))
            return [], [Preference(name, wanted)]
        case Group() if node.head == "and":
            return _joined(_split(part, scope) for part in node.rest)
        case Group() if node.head == "forall" and _has_preferences(node):
            scope.symbols.requirements.need(node, ":universal-preconditions")
            variables, body = scope.quantified(node)
            hard, soft = _split(body, scope.inside(variables))
            return [ForAll(variables, conjunction(hard))] if hard else [], with_variables(variables, soft)
        case _:
            return [condition(node, scope)], []


def _has_preferences(node: Group) -> bool:
    return any(isinstance(part, Group) and (part.head == "preference" or _has_preferences(part)) for part in node.rest)


def _joined(parts: Iterable[tuple[list[T], list[Preference]]]) -> tuple[list[T], list[Preference]]:
    both = list(parts)
    return [part for hard, _ in both for part in hard], [preference for _, soft in both for preference in soft]


def constraints(parts: tuple[Node, ...], scope: TermScope) -> tuple[tuple[Constraint, ...], tuple[Preference, ...]]:
    """Read ``(:constraints ...)``: return the hard constraints, and the preferences over constraints."""
    if len(parts) > 1:
        Leniency.SEVERAL_CONSTRAINTS.note(parts[1])
    hard, soft = _joined(_constraints(part, scope) for part in parts)
    return tuple(hard), tuple(soft)


def _constraints(node: Node, scope: TermScope) -> tuple[list[Constraint], list[Preference]]:
    scope.symbols.requirements.need(node, ":constraints")
    match node:
        case Group(items=()):
            return [], []
        case Group() if node.head == "and":
            return _joined(_constraints(part, scope) for part in node.rest)
        case Group() if node.head == "forall":
            variables, body = scope.quantified(node)
            hard, soft = _constraints(body, scope.inside(variables))
            return [replace(part, variables=(*variables, *part.variables)) for part in hard], with_variables(variables, soft)
        case Group() if is_preference(node, scope):
            name, (hard, soft) = preference(node, scope, lambda body: _constraints(body, scope))
            if soft:
                raise wrong(node.rest[-1], "a preference cannot stand inside another")
            return [], [Preference(name, tuple(hard))]
        case Group(items=(Atom() as at, Atom() as moment, body)) if (at.key, moment.key) == ("at", "end"):
            return [Constraint("at end", (condition(body, scope),))], []
        case Group() if node.head in CONSTRAINTS:
            times, conditions = CONSTRAINTS[node.head]
            if len(node.rest) != times + conditions:
                form = " and ".join([*([counted(times, "time")] if times else []), counted(conditions, "condition")])
                raise wrong(node, f"'{node.head}' takes {form}, found {counted(len(node.rest), 'part')}")
            wanted = tuple([condition(part, scope) for part in node.rest[times:]])
            return [Constraint(node.head, wanted, tuple([time(part) for part in node.rest[:times]]))], []
        case _:
            raise wrong(node, f"expected and, forall, preference, at end, {', '.join(CONSTRAINTS)}; found {node}")
