"""The task of a policy: facts as bits of a whole number, and ground actions with every way in which they may turn out.

A state is the number whose bits are the facts that are true. A durative action counts as one step here, its end conditions
and end effects after its start effects: policies carry out one action of several outcomes at a time.
"""

from __future__ import annotations

from collections import Counter, defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Final, NamedTuple, assert_never

from planner_bridge.model.grounding import dynamic_names, initial_knowledge
from planner_bridge.model.problem import Problem
from pnm.core.logic.conditions import All, Compare, Computed, Condition, Holds, conjuncts, evaluate, every_part, names, parts_of
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.effects import Alternative, Effects, ForEach, OneOf, Set, When, every_effect, has_outcomes, outcomes
from pnm.core.logic.expressions import NOTHING, Constant, Environment, Fluent, bind, choices
from pnm.errors import PnmError

MOST_ACTIONS: Final = 200_000
"""Ground actions at most."""
_MOST_PARTS: Final = 64
"""Alternatives of a condition at most."""


class Unsuitable(PnmError):
    """The problem has something that policies know nothing of."""


class PartialState(NamedTuple):
    """A partial state: the facts that are true in it, and those that are false; others may be either."""

    true: int = 0
    false: int = 0

    def holds(self, state: int) -> bool:
        """Whether the state is one of those that it stands for."""
        return state & self.true == self.true and not state & self.false

    def implies(self, other: PartialState) -> bool:
        """Whether all states that it stands for are among those of the other."""
        return not (other.true & ~self.true or other.false & ~self.false)

    def joined(self, other: PartialState) -> PartialState:
        """What both say; check `is_possible`."""
        return PartialState(self.true | other.true, self.false | other.false)

    @property
    def is_possible(self) -> bool:
        """Whether no fact is both."""
        return not self.true & self.false


ANY: Final = PartialState()
"""Every state."""


def places(bits: int) -> Iterator[int]:
    """Yield the places of the bits that are set."""
    while bits:
        low = bits & -bits
        yield low.bit_length() - 1
        bits ^= low


class Change(NamedTuple):
    """Facts that become true and facts that become false, in states for which the condition holds; what is both is true."""

    condition: PartialState
    add: int
    delete: int

    def before(self, after: PartialState) -> PartialState | None:
        """Return what has to hold before the change, its condition aside, so that this holds after it; None if it cannot."""
        if self.add & after.false or self.delete & ~self.add & after.true:
            return None
        return PartialState(after.true & ~self.add, after.false & ~self.delete)


class PolicyOutcome(NamedTuple):
    """A way in which an action may turn out, with its chance."""

    name: str
    chance: float
    changes: tuple[Change, ...]

    def after(self, state: int) -> int:
        """Return the state after it."""
        add = delete = 0
        for condition, adds, deletes in self.changes:
            if condition.holds(state):
                add |= adds
                delete |= deletes
        return state & ~delete | add

    def known_after(self, part: PartialState) -> PartialState:
        """Return what is so after it in all states of the part: a change whose condition is not known leaves its facts unknown."""
        sure, possible = [0, 0], [0, 0]
        for condition, adds, deletes in self.changes:
            if condition.joined(part).is_possible:
                found = sure if part.implies(condition) else possible
                found[0], found[1] = found[0] | adds, found[1] | deletes
        true = part.true & ~(sure[1] | possible[1]) | sure[0]
        return PartialState(true, (part.false | sure[1]) & ~(sure[0] | possible[0]))

    def before(self, after: PartialState, state: int) -> PartialState:
        """Return what has to hold before, with the same changes as in this state, which leads to what has to hold after it."""
        before, add, delete = ANY, 0, 0
        for change in self.changes:
            if change.condition.holds(state) and (change.condition == ANY or change.add & after.true or change.delete & after.false):
                before, add, delete = before.joined(change.condition), add | change.add, delete | change.delete
        for condition, adds, deletes in self.changes:
            if (deletes & after.true & ~add or adds & after.false) and not condition.holds(state):
                missing, present = condition.true & ~state, condition.false & state  # one fact is enough for it not to happen
                before = before.joined(PartialState(0, missing & -missing) if missing else PartialState(present & -present, 0))
        return before.joined(PartialState(after.true & ~add, after.false & ~delete))


@dataclass(frozen=True, eq=False, slots=True)
class PolicyAction:
    """A ground action: in which states it can be used, each part on its own, and its outcomes, whose chances sum to 1."""

    name: str
    arguments: tuple[str, ...]
    conditions: tuple[PartialState, ...]
    outcomes: tuple[PolicyOutcome, ...]

    def condition_in(self, state: int) -> PartialState | None:
        """Return the part of the condition that holds in the state; None if the action cannot be used there."""
        return next((part for part in self.conditions if part.holds(state)), None)

    def __str__(self) -> str:
        return f"{self.name}({', '.join(self.arguments)})"


@dataclass(frozen=True)
class PolicyTask:
    """Facts, the initial state, the parts of the goal, each of which is enough, and the ground actions that may ever be used."""

    facts: tuple[Fluent, ...]
    initial: int
    goal: tuple[PartialState, ...]
    actions: tuple[PolicyAction, ...]
    alternatives: Mapping[str, tuple[Alternative, ...]]
    """The outcomes of every action, before it is ground."""

    def goal_in(self, state: int) -> PartialState | None:
        """Return the part of the goal that holds in the state."""
        return next((part for part in self.goal if part.holds(state)), None)

    def named(self, bits: int) -> list[Fluent]:
        """Return the facts of these bits."""
        return [self.facts[number] for number in places(bits)]

    def usable(self, state: int) -> Iterator[PolicyAction]:
        """Yield the actions that can be used in the state."""
        for place in (-1, *places(state)):
            for part, action in self._by_fact.get(place, ()):
                if part.holds(state) and (len(action.conditions) == 1 or action.condition_in(state) is part):
                    yield action

    @cached_property
    def _by_fact(self) -> dict[int, list[tuple[PartialState, PolicyAction]]]:
        """Return the actions by one of the facts that they need, that which the fewest of them do; -1 if they need none."""
        counts = Counter(place for action in self.actions for part in action.conditions for place in places(part.true))
        found: dict[int, list[tuple[PartialState, PolicyAction]]] = defaultdict(list)
        for action in self.actions:
            for part in action.conditions:
                found[min(places(part.true), key=counts.__getitem__, default=-1)].append((part, action))
        return found

    def excluded(self, true: int) -> int:
        """Return the facts that cannot be true together with these."""
        return sum(group & ~true for group in self.groups if group & true)

    @cached_property
    def groups(self) -> tuple[int, ...]:
        """Sets of facts, of which exactly one is true in every state that can be reached: facts that differ in one argument."""
        found: dict[tuple[object, ...], int] = defaultdict(int)
        keys: dict[int, list[tuple[object, ...]]] = {}
        for number, (name, *arguments) in enumerate(self.facts):
            keys[number] = [(name, place, *arguments[:place], *arguments[place + 1 :]) for place in range(len(arguments))]
            for key in keys[number]:
                found[key] |= 1 << number
        found = {key: group for key, group in found.items() if group & (group - 1) and (self.initial & group).bit_count() == 1}
        for action in self.actions:
            always = action.conditions[0].true
            for part in action.conditions:
                always &= part.true
            for change in (change for outcome in action.outcomes for change in outcome.changes):
                for number in places(change.add | change.delete):
                    for key in keys[number]:
                        group = found.get(key, 0)
                        add, delete = change.add & group, change.delete & group
                        if add == delete and not add & (add - 1):
                            continue
                        moves = add.bit_count() == delete.bit_count() == 1 and delete & always
                        if not moves or change.condition != ANY:
                            found.pop(key, None)
        return tuple(found.values())


def policy_task(problem: Problem) -> PolicyTask:
    """Return the task of the problem; raise `Unsuitable` if it has more than facts that only actions change, or is too large."""
    return _Grounding(problem).task()


class _Grounding:
    """The facts of a problem that actions change, in the order in which they were met: mutable state."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.state, self.changing = problem, initial_knowledge(problem), dynamic_names(problem)
        conditions = [problem.goal]
        for schema in problem.domain.actions.values():
            conditions += (schema.precondition, schema.invariant, schema.end_condition)
            effects = every_effect((*schema.start_effects, *schema.end_effects))
            conditions += (effect.condition for effect in effects if isinstance(effect, When))
        read = frozenset().union(*map(names, conditions))
        self.only_counted = self.changing & problem.domain.functions.keys() - read
        unsuitable = {
            "facts that change by themselves": problem.timed or problem.domain.nature,
            "constraints": problem.constraints or problem.domain.constraints,
            "preferences": problem.has_preferences,
            "tasks and methods": problem.has_tasks,
            "derived facts": read & problem.domain.rules.derived,
            "numbers and objects that actions change": self.changing & problem.domain.functions.keys() & read,
            "computed conditions": any(isinstance(part, Computed) for condition in conditions for part in every_part(condition)),
        }
        if present := [what for what, is_there in unsuitable.items() if is_there]:
            raise Unsuitable(f"no policy is looked for: the problem has {' and '.join(present)}")
        self.facts: list[Fluent] = []
        self.bits: dict[Fluent, int] = {}
        self.of_types = {
            variable.types: frozenset(self.state.objects(variable.types))
            for schema in problem.domain.actions.values()
            for variable in schema.parameters
        }

    def task(self) -> PolicyTask:
        alternatives = {name: outcomes(schema.end_effects, self.state) for name, schema in self.problem.domain.actions.items()}
        goal = self.parts(self.problem.goal)
        initial = sum(self.bit(fact) for fact, value in self.problem.init.items() if value is True and fact[0] in self.changing)
        actions = list(self.actions(alternatives, initial))
        return PolicyTask(tuple(self.facts), initial, goal, tuple(actions), alternatives)

    def bit(self, fact: Fluent) -> int:
        if fact not in self.bits:
            self.bits[fact] = 1 << len(self.facts)
            self.facts.append(fact)
        return self.bits[fact]

    def parts(self, condition: Condition, env: Environment = NOTHING, truth: bool = True) -> tuple[PartialState, ...]:
        """Return the parts of the condition, or of its opposite: each is enough."""
        match condition:
            case Holds(fluent) if fluent[0] in self.changing:
                bit = self.bit(bind(fluent, env))
                return (PartialState(bit, 0) if truth else PartialState(0, bit),)
            case Holds() | Compare():
                return (ANY,) if evaluate(condition, self.state, env) is truth else ()
        inner, is_every = parts_of(condition, self.state, env, truth)
        alternatives = [self.parts(*part) for part in inner]
        if not is_every:
            return tuple(dict.fromkeys(part for one in alternatives for part in one))
        found: tuple[PartialState, ...] = (ANY,)
        for more in alternatives:
            found = tuple(dict.fromkeys(both for part, other in product(found, more) if (both := part.joined(other)).is_possible))
            if len(found) > _MOST_PARTS:
                raise Unsuitable(f"no policy is looked for: {condition} has too many alternatives")
        return found

    def changes(self, effects: Effects, env: Environment, condition: PartialState = ANY) -> Iterator[Change]:
        for effect in effects:
            match effect:
                case Set(fluent, Constant(bool() as value)):
                    bit = self.bit(bind(fluent, env))
                    yield Change(condition, bit if value else 0, 0 if value else bit)
                case Set():
                    assert effect.fluent[0] in self.only_counted, effect
                case When(inner, then):
                    for part in self.parts(inner, env):
                        if (both := condition.joined(part)).is_possible:
                            yield from self.changes(then, env, both)
                case ForEach(variables, inner):
                    for chosen in choices(variables, self.state, env):
                        yield from self.changes(inner, chosen, condition)
                case OneOf():
                    raise AssertionError("which outcome it is has been chosen")
                case _:
                    assert_never(effect)

    def actions(self, alternatives: Mapping[str, tuple[Alternative, ...]], initial: int) -> Iterator[PolicyAction]:
        """Yield the ground actions that may be used once, if nothing is ever undone."""
        instances = _Instances(self, initial)
        for schema, env in instances:
            start = _merged(self.changes(schema.start_effects, env))
            if len(start) > 1 or any(change.condition != ANY for change in start) or has_outcomes(schema.start_effects):
                raise Unsuitable(f"no policy is looked for: {schema.name} has effects at its start that depend on something")
            begun = start[0] if start else Change(ANY, 0, 0)
            later = [begun.before(part) for part in self.parts(All((schema.invariant, schema.end_condition)), env)]
            early = self.parts(schema.precondition, env)
            both = (one.joined(other) for one, other in product(early, later) if other is not None)
            conditions = tuple(part for part in dict.fromkeys(both) if part.is_possible)
            if not conditions:
                continue
            ways = alternatives[schema.name]
            found = tuple(
                PolicyOutcome(
                    way.name,
                    1.0 / len(ways) if way.chance is None else way.chance,
                    _merged(self.composed(begun, self.changes(way.effects, env))),
                )
                for way in ways
            )
            for change in (change for outcome in found for change in outcome.changes):
                instances.reach(change.add)
            if any(outcome.changes for outcome in found):
                yield PolicyAction(schema.name, tuple(str(env[variable.name]) for variable in schema.parameters), conditions, found)

    def composed(self, begun: Change, ended: Iterable[Change]) -> Iterator[Change]:
        """Yield the changes of a whole action: what its start has changed, and its end did not change back."""
        changes = list(ended)
        if not (begun.add or begun.delete):
            yield from changes
            return
        add, delete = begun.add, begun.delete
        for change in changes:
            if change.condition == ANY:
                add, delete = add & ~(change.delete & ~change.add) | change.add, delete & ~change.add | change.delete
            elif change.delete & add or change.add & delete:
                raise Unsuitable("no policy is looked for: the end of an action undoes its start under a condition")
            elif (before := begun.before(change.condition)) is not None:
                yield Change(before, change.add, change.delete)
        yield Change(ANY, add, delete)


def _merged(changes: Iterable[Change]) -> tuple[Change, ...]:
    """Return the changes, those of the same condition as one."""
    found: dict[PartialState, tuple[int, int]] = {}
    for condition, add, delete in changes:
        before = found.get(condition, (0, 0))
        found[condition] = before[0] | add, before[1] | delete
    return tuple(Change(condition, add, delete) for condition, (add, delete) in found.items())


class _Instances:
    """The choices of objects for the parameters of actions whose facts can be true together, if nothing is ever undone.

    Each comes when the last fact that it needs does: a join of all facts so far, as databases make them (semi-naive evaluation). The
    facts, and those still to come, are mutable state.
    """

    def __init__(self, grounding: _Grounding, initial: int) -> None:
        self.grounding, self.seen = grounding, initial
        self.tables: dict[tuple[object, ...], dict[Fluent, None]] = defaultdict(dict)
        """The facts so far: of a predicate, and of a predicate with an object in one place."""
        self.waiting = deque[Fluent]()
        self.schemas: list[tuple[ActionSchema, list[Fluent]]] = []
        self.needing: dict[str, list[tuple[int, int]]] = defaultdict(list)
        for fact, value in grounding.problem.init.items():
            if value is True and fact[0] in grounding.changing:
                self.waiting.append(fact)
            elif value is True:
                self.add(fact)
        for number, schema in enumerate(grounding.problem.domain.actions.values()):
            atoms = [part.fluent for part in conjuncts(schema.precondition) if isinstance(part, Holds)]
            self.schemas.append((schema, atoms))
            for place, atom in enumerate(atoms):
                if atom[0] in grounding.changing:
                    self.needing[atom[0]].append((number, place))

    def add(self, fact: Fluent) -> None:
        self.tables[fact[:1]][fact] = None
        for place, name in enumerate(fact[1:], 1):
            self.tables[fact[0], place, name][fact] = None

    def reach(self, bits: int) -> None:
        """Note that these facts can be true."""
        if new := bits & ~self.seen:
            self.seen |= new
            self.waiting += (self.grounding.facts[number] for number in places(new))

    def __iter__(self) -> Iterator[tuple[ActionSchema, dict[str, object]]]:
        found = set[tuple[str, ...]]()
        for number, place, fact in self.triggers():
            schema, atoms = self.schemas[number]
            types = {variable.name: variable.types for variable in schema.parameters}
            first = {} if fact is None else self.matched(atoms[place], fact, {}, types)
            rest = [atom for other, atom in enumerate(atoms) if other != place]
            for env in () if first is None else self.joined(rest, first, types):
                free = tuple(variable for variable in schema.parameters if variable.name not in env)
                for whole in choices(free, self.grounding.state, env):
                    key = (schema.name, *(str(whole[variable.name]) for variable in schema.parameters))
                    if key not in found:
                        found.add(key)
                        if len(found) > MOST_ACTIONS:
                            raise Unsuitable(f"no policy is looked for: there are more than {MOST_ACTIONS} ground actions")
                        yield schema, dict(whole)

    def triggers(self) -> Iterator[tuple[int, int, Fluent | None]]:
        """Yield what may be new: actions by their numbers with a fact for one of their atoms, or without one that changes."""
        for number, (_, atoms) in enumerate(self.schemas):
            if not any(atom[0] in self.grounding.changing for atom in atoms):
                yield number, -1, None
        while self.waiting:
            fact = self.waiting.popleft()
            self.add(fact)
            for number, place in self.needing[fact[0]]:
                yield number, place, fact

    def joined(self, atoms: list[Fluent], env: dict[str, object], types: Mapping[str, tuple[str, ...]]) -> Iterator[dict[str, object]]:
        if not atoms:
            yield env
            return
        tables = [(self.table(atom, env), number) for number, atom in enumerate(atoms)]
        table, number = min(tables, key=lambda pair: len(pair[0]))
        rest = [*atoms[:number], *atoms[number + 1 :]]
        for fact in tuple(table):
            if (more := self.matched(atoms[number], fact, env, types)) is not None:
                yield from self.joined(rest, more, types)

    def table(self, atom: Fluent, env: Mapping[str, object]) -> Mapping[Fluent, None]:
        """Return the facts that may match the atom, as few as are told apart by one object."""
        bound = bind(atom, env)
        keys = [(atom[0], place, name) for place, name in enumerate(bound[1:], 1) if not name.startswith("?")]
        found = [self.tables[key] for key in keys if key in self.tables]
        return {} if len(found) < len(keys) else min(found, key=len, default=self.tables[atom[:1]])

    def matched(
        self, atom: Fluent, fact: Fluent, env: Mapping[str, object], types: Mapping[str, tuple[str, ...]]
    ) -> dict[str, object] | None:
        if len(atom) != len(fact):
            return None
        more = dict(env)
        for term, name in zip(atom[1:], fact[1:], strict=True):
            if not term.startswith("?"):
                if term != name:
                    return None
            elif term in more:
                if more[term] != name:
                    return None
            elif name not in self.grounding.of_types[types[term]]:
                return None
            else:
                more[term] = name
        return more
