"""The grounding of a task: its facts, the values of its numbers, and the ground actions that may be used, if nothing is ever undone."""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce
from itertools import product
from math import inf
from typing import Final, TypeAlias, assert_never

from planner_bridge.model.grounding import conditions_of, dynamic_names, initial_knowledge, modelled_duration
from planner_bridge.model.guards import is_forbidden, without_guards
from planner_bridge.model.problem import TOTAL_TIME, Problem
from planner_bridge.model.rates import NO_RATES, Call, Chance
from planner_bridge.planning.policies.numbers import AtLeast, PartlyKnown, Scale, values_from
from planner_bridge.planning.policies.task import (
    ANY,
    NO_RULES,
    OF_METRIC,
    Change,
    Counting,
    GroundRules,
    PartialState,
    PolicyAction,
    PolicyOutcome,
    PolicyTask,
    Unsuitable,
    places,
)
from pnm.core.logic.conditions import All, Compare, Computed, Condition, Holds, conjuncts, evaluate, every_part, ground, names, parts_of
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.effects import (
    Alternative,
    Effects,
    ForEach,
    OneOf,
    Set,
    When,
    changes,
    every_effect,
    has_outcomes,
    is_early,
    names_written,
    outcomes,
)
from pnm.core.logic.expressions import (
    DURATION,
    NOTHING,
    Constant,
    Environment,
    Fluent,
    Truth,
    ValueOf,
    bind,
    choices,
    expression_fluents,
    fluent_text,
    ground_expression,
    is_number,
    value_of,
)
from pnm.core.machine.plan_graph import GroundAction

Seconds: TypeAlias = Callable[[GroundAction], float]
"""Returns how long an action is expected to take."""
Chances: TypeAlias = Callable[[GroundAction, Sequence[Alternative]], Chance]
"""Returns how likely the outcomes of an action are."""
MOST_ACTIONS: Final = 200_000
"""Ground actions at most."""
_MOST_PARTS: Final = 64
"""Alternatives of a condition at most."""
_DIGITS: Final = 9
"""Digits of numbers behind the point."""
_LEAST_COST: Final = 0.001
"""That of an action at least: what costs nothing would come no nearer to the goal."""


def even_chances(action: GroundAction, ways: Sequence[Alternative]) -> Chance:
    """Return the chances of the outcomes of an action as the domain says, and else all of them as likely."""
    return NO_RATES.outcomes(Call("", action.name), ways)


def policy_task(
    problem: Problem, seconds: Seconds | None = None, chances: Chances | None = None, is_over: Callable[[], bool] = lambda: False
) -> PolicyTask:
    """Return the task of the problem; raise `Unsuitable` if it has more than facts and numbers that only actions change, or is too large.

    Args:
        seconds: how long actions take, where plans are measured by that; by default, as long as the domain says.
        chances: how likely outcomes are; by default, as the domain says, and else all of an action as likely.
        is_over: says that the time is over, or nobody waits for it any more; then it is `Unsuitable`, too.
    """
    return _Grounding(problem, seconds, chances, is_over).task()


def _changing(problem: Problem) -> frozenset[str]:
    """Return the predicates and functions that actions change, and what follows from these."""
    changing, rules = dynamic_names(problem), problem.domain.rules
    return changing.union(name for name in rules.derived if rules.base((name,)) & changing)


def task_from(known: PolicyTask, before: Problem, now: Problem) -> PolicyTask | None:
    """Return the task of a problem, with the facts and the actions of a task that is known; None if it needs others.

    The state may be another one, and more calls may be forbidden. What actions cost, and how likely their outcomes are, stays as it was.

    Args:
        before: the problem of the task that is known.
    """
    state, changing, alike = initial_knowledge(now), _changing(now), []
    for problem in (without_guards(before), without_guards(now)):
        constant = {fluent: value for fluent, value in problem.init.items() if fluent[0] not in changing}
        alike.append(replace(problem, domain=replace(problem.domain, requirements=()), init=constant))
    if alike[0] != alike[1] or not before.guards.keys() <= now.guards.keys():
        return None
    bits = {fact: 1 << number for number, fact in enumerate(known.facts) if not isinstance(fact, AtLeast)}
    initial = 0
    for fact in (fact for fact, value in now.init.items() if value is True and fact[0] in changing):
        if not bits.get(fact, 0) & known.reachable:
            return None
        initial |= bits[fact]
    for scale in known.scales:
        value = state.value(scale.fluent)
        value = round(float(value), _DIGITS) if is_number(value) else -inf
        number = bisect_right(scale.values, value) - 1
        if number < 0 or (scale.is_exact and scale.values[number] != value):
            return None
        initial |= scale.up_to(number)
    if any((initial & group).bit_count() != 1 for group in known.groups):
        return None
    actions = known.actions
    if before.guards != now.guards:
        actions = tuple(action for action in actions if not is_forbidden(now, action.name, action.arguments))
    return replace(known, initial=known.rules.state(initial), actions=actions)


class _Grounding:
    """The facts of a problem that actions change, in the order in which they were met: mutable state."""

    def __init__(self, problem: Problem, seconds: Seconds | None, chances: Chances | None, is_over: Callable[[], bool]) -> None:
        self.problem, self.state, self.rules, self.changing = problem, initial_knowledge(problem), problem.domain.rules, _changing(problem)
        self.constant = PartlyKnown({}, self.state, self.changing)
        """What is known if nothing is known of what changes."""
        self.seconds = seconds or (lambda action: action.duration or 0.0)
        self.chances, self.is_over = chances or even_chances, is_over
        metric = problem.metric if problem.metric and problem.metric.direction == "minimize" else None
        counted = metric.expression.fluent if metric and isinstance(metric.expression, ValueOf) else TOTAL_TIME
        self.total = counted if counted[0] in self.changing else None
        """What the metric counts, if it does."""
        self.measure = OF_METRIC if self.total else "s" if seconds or problem.is_timed else "calls"
        conditions, functions = [*conditions_of(problem)], problem.domain.functions
        read = frozenset().union(*map(names, conditions))
        self.counted = frozenset(name for name in self.changing & read & functions.keys() if not functions[name].values)
        """Functions for numbers that actions change, and conditions read."""
        unsuitable = {
            "facts that change by themselves": problem.timed or problem.domain.nature,
            "constraints": problem.constraints or problem.domain.constraints,
            "preferences": problem.has_preferences,
            "tasks and methods": problem.has_tasks,
            "derived facts about numbers that change": self.counted & self.rules.below,
            "objects for values that actions change": self.changing & functions.keys() & read - self.counted,
            "durations that depend on what actions change": any(
                not self.changing.isdisjoint(one[0] for one in expression_fluents(bound.bound))
                for schema in problem.domain.actions.values()
                for bound in schema.duration or ()
            ),
            "effects at the end that depend on what held before the start": any(
                schema.start_effects and any(map(is_early, schema.end_effects)) for schema in problem.domain.actions.values()
            ),
            "computed conditions": any(isinstance(part, Computed) for condition in conditions for part in every_part(condition)),
        }
        if present := [what for what, is_there in unsuitable.items() if is_there]:
            raise Unsuitable(f"no policy is looked for: the problem has {' and '.join(present)}")
        self.facts: list[Fluent | AtLeast] = []
        self.bits: dict[Fluent, int] = {}
        self.scales: dict[Fluent, Scale] = {}
        """Of numbers, once their values are known; until then, comparisons with these may be true or false."""
        self.compared: dict[Fluent, dict[Compare, None]] = defaultdict(dict)
        self.truths: dict[Compare, list[Truth]] = {}
        """Of comparisons, for each value of their number."""
        self.shifts: dict[tuple[Fluent, tuple[Set, ...]], list[tuple[tuple[int, int], int, int]] | None] = {}
        """What effects on numbers do with the facts about these; None if it is not in order."""
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
        if self.counted:
            self.scale(actions)
            initial |= sum(scale.up_to(scale.values.index(self.number(fluent))) for fluent, scale in self.scales.items())
            goal, actions = self.parts(self.problem.goal), list(self.actions(alternatives, initial))
        if rules := self.ground_rules():
            initial = rules.state(initial)
            with_rules = ((action, tuple(way._replace(rules=rules) for way in action.outcomes)) for action in actions)
            actions = [replace(action, outcomes=ways) for action, ways in with_rules]
        scales = tuple(self.scales.values())
        return PolicyTask(tuple(self.facts), initial, goal, tuple(actions), alternatives, scales, self.measure, rules or NO_RULES)

    def check_time(self) -> None:
        if self.is_over():
            raise Unsuitable("no policy is looked for: the ways to use its actions were not all found in time")

    # --- numbers ---

    def number(self, fluent: Fluent) -> float:
        """Return the number at first."""
        value = self.state.value(fluent)
        if not is_number(value):
            raise Unsuitable(f"no policy is looked for: {fluent_text(fluent)} has no value")
        return round(float(value), _DIGITS)

    def known(self, fluent: Fluent, value: float) -> PartlyKnown:
        """Return what is known if all that is known of what changes is this number."""
        return PartlyKnown({fluent: value}, self.state, self.changing)

    def after(self, fluent: Fluent, effects: tuple[Set, ...], value: float) -> float:
        """Return the number after effects on it."""
        after = changes(effects, self.known(fluent, value))[fluent]
        if not is_number(after):
            raise Unsuitable(f"no policy is looked for: what is done with {fluent_text(fluent)} depends on more than itself")
        return round(after, _DIGITS)

    def limits(self, fluent: Fluent) -> Iterator[float]:
        """Yield what the number is compared with; what is infinite stands for what is not so simple."""
        for condition in self.compared[fluent]:
            others = [side for side in (condition.left, condition.right) if side != ValueOf(fluent)]
            limit = value_of(others[0], self.constant) if len(others) == 1 else inf
            yield from (limit,) if is_number(limit) else (inf, -inf)

    def comparison(self, condition: Compare, truth: bool) -> tuple[PartialState, ...]:
        """Return the parts of a comparison: one for each run of values for which it has this truth."""
        mentioned = {fluent for side in (condition.left, condition.right) for fluent in expression_fluents(side)}
        fluent, *more = sorted(fluent for fluent in mentioned if fluent[0] in self.counted)
        if more:
            raise Unsuitable(f"no policy is looked for: {condition} compares numbers that change")
        self.compared[fluent][condition] = None
        if (scale := self.scales.get(fluent)) is None:
            return (ANY,)
        if condition not in self.truths:
            self.truths[condition] = [evaluate(condition, self.known(fluent, value)) for value in scale.values]
        return tuple(PartialState(*run) for run in scale.runs([one is truth for one in self.truths[condition]]))

    def levels(self, outcome: PolicyOutcome) -> Iterator[Change]:
        """Yield what an outcome does with numbers, as changes of the facts about these."""
        seen: dict[Fluent, list[PartialState]] = defaultdict(list)
        for fluent, condition, effects in outcome.numbers():
            if (scale := self.scales.get(fluent)) is None:
                continue
            if (fluent, effects) not in self.shifts:
                after = [self.after(fluent, effects, value) for value in scale.values]
                self.shifts[fluent, effects] = [*scale.changes(after)] if after == sorted(after) else None
            shifts = self.shifts[fluent, effects]
            if shifts is None or any(condition.joined(other).is_possible for other in seen[fluent]):
                raise Unsuitable(f"no policy is looked for: what is done with {fluent_text(fluent)} depends on several things")
            seen[fluent].append(condition)
            for before, add, delete in shifts:
                yield Change(condition.joined(PartialState(*before)), add, delete)

    def scale(self, actions: Iterable[PolicyAction]) -> None:
        """Find the values of all numbers, with a fact for each: those that may come about if all else may be as actions need it."""
        moves: dict[Fluent, dict[tuple[Condition, tuple[Set, ...]], None]] = defaultdict(dict)
        for action in actions:
            schema = self.problem.domain.actions[action.name]
            env = schema.environment(action.arguments)
            for outcome in action.outcomes:
                for fluent, _, effects in outcome.numbers():
                    needed = [part for part in conjuncts(ground(schema.precondition, env)) if names(part) & self.counted]
                    moves[fluent][All(tuple(needed)), effects] = None
        for fluent in self.compared:

            def after(value: float, fluent: Fluent = fluent) -> Iterator[float]:
                known = self.known(fluent, value)
                return (self.after(fluent, how, value) for needed, how in moves[fluent] if evaluate(needed, known) is not False)

            self.scales[fluent] = scale = Scale(fluent, *values_from(self.number(fluent), after, self.limits(fluent)), len(self.facts))
            self.facts += scale.levels

    # --- facts ---

    def bit(self, fact: Fluent) -> int:
        if fact not in self.bits:
            self.bits[fact] = 1 << len(self.facts)
            self.facts.append(fact)
        return self.bits[fact]

    def ground_rules(self) -> GroundRules | None:
        """Return the rules for the derived facts that were met, and for those that they follow from; None if there are none."""
        derived, strata = 0, defaultdict[int, list[tuple[int, PartialState]]](list)
        for fact in self.facts:  # grows
            self.check_time()
            if isinstance(fact, AtLeast):
                continue
            for rule in (rule for rule in self.rules if rule.name == fact[0]):
                derived |= self.bits[fact]
                terms = [*zip(fact[1:], rule.variables, strict=True)]
                if all(name in self.state.objects(variable.types) for name, variable in terms):
                    parts = self.parts(rule.condition, {variable.name: name for name, variable in terms})
                    strata[self.rules.strata[rule.name]] += ((self.bits[fact], part) for part in parts)
        return GroundRules(tuple(tuple(strata[stratum]) for stratum in sorted(strata)), derived) if derived else None

    def parts(self, condition: Condition, env: Environment = NOTHING, truth: bool = True) -> tuple[PartialState, ...]:
        """Return the parts of the condition, or of its opposite: each is enough."""
        match condition:
            case Holds(fluent) if fluent[0] in self.changing:
                bit = self.bit(bind(fluent, env))
                return (PartialState(bit, 0) if truth else PartialState(0, bit),)
            case Compare() if names(condition) & self.counted:
                compared = ground(condition, env)
                assert isinstance(compared, Compare)
                return self.comparison(compared, truth)
            case Holds() | Compare():
                return (ANY,) if evaluate(condition, self.state, env) is truth else ()
        inner, is_every = parts_of(condition, self.state, env, truth)
        alternatives = [self.parts(*part) for part in inner]
        if not is_every:
            return tuple(dict.fromkeys(part for one in alternatives for part in one))
        single = [one[0] for one in alternatives if len(one) == 1]
        found: tuple[PartialState, ...] = tuple(part for part in (reduce(PartialState.joined, single, ANY),) if part.is_possible)
        for more in (one for one in alternatives if len(one) != 1):
            found = tuple(dict.fromkeys(both for part, other in product(found, more) if (both := part.joined(other)).is_possible))
            if len(found) > _MOST_PARTS:
                raise Unsuitable(f"no policy is looked for: {condition} has too many alternatives")
        return found

    def changes(self, effects: Effects, env: Environment, condition: PartialState = ANY) -> Iterator[Change | Counting]:
        for effect in effects:
            match effect:
                case Set(fluent, Constant(bool() as value)):
                    bit = self.bit(bind(fluent, env))
                    yield Change(condition, bit if value else 0, 0 if value else bit)
                case Set(fluent, expression, operation) if fluent[0] in self.counted:
                    amount = value_of(expression, self.constant, env)
                    constant = Constant(amount) if is_number(amount) else ground_expression(expression, env)
                    yield Counting(condition, Set(bind(fluent, env), constant, operation))
                case Set():
                    pass  # nothing depends on it
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
            arguments = tuple(str(env[variable.name]) for variable in schema.parameters)
            duration = modelled_duration(schema, arguments, self.state)
            inner = env if duration is None else {**env, DURATION[0]: duration}
            begun, counting = self.begun(schema, inner) if schema.start_effects else (Change(ANY, 0, 0), [])
            ended = [begun.before(part) for part in self.parts(All((schema.invariant, schema.end_condition)), env)]
            both = (one.joined(other) for one, other in product(self.parts(schema.precondition, env), ended) if other is not None)
            conditions = tuple(part for part in dict.fromkeys(both) if part.is_possible)
            if not conditions:
                continue
            ways, found = alternatives[schema.name], []
            chances = self.chances(self.ground(schema, arguments, duration), ways) if len(ways) > 1 else None
            for way in ways:
                its, more = _split(self.changes(way.effects, inner))
                before = ((begun.before(condition), effect) for condition, effect in more)
                counted = (*counting, *(Counting(condition, effect) for condition, effect in before if condition is not None))
                outcome = PolicyOutcome(way.name, chances.of(way.name) if chances else 1.0, _merged(self.composed(begun, its)), counted)
                found.append(outcome._replace(changes=(*outcome.changes, *self.levels(outcome))))
            for change in (change for outcome in found for change in outcome.changes):
                instances.reach(change.add)
            if any(outcome.changes or outcome.counting for outcome in found):
                cost = sum(outcome.chance * self.price(schema, way.effects, inner) for way, outcome in zip(ways, found, strict=True))
                if self.measure == "s":
                    cost = self.seconds(self.ground(schema, arguments, duration))
                yield PolicyAction(schema.name, arguments, conditions, tuple(found), max(cost, _LEAST_COST))

    def begun(self, schema: ActionSchema, env: Environment) -> tuple[Change, list[Counting]]:
        """Return what an action does at its start."""
        early, counting = _split(self.changes(schema.start_effects, env))
        start = _merged(early)
        later = (part.condition for part in every_effect(schema.end_effects) if isinstance(part, When))
        read = names(All((schema.invariant, schema.end_condition, *later)))
        depends = any(condition != ANY for condition, *_ in (*start, *counting)) or has_outcomes(schema.start_effects)
        depends |= any(one.effect.fluent[0] in read for one in counting)
        depends |= not self.rules.base(read & self.rules.derived).isdisjoint(names_written(schema.start_effects))
        if len(start) > 1 or depends:
            raise Unsuitable(f"no policy is looked for: {schema.name} has effects at its start that depend on something, or others on them")
        return (start[0] if start else Change(ANY, 0, 0)), counting

    def ground(self, schema: ActionSchema, arguments: tuple[str, ...], duration: float | None) -> GroundAction:
        """Return a ground action as far as it says how long it takes, and how it turns out."""
        return GroundAction(schema.name, arguments, schema.names, duration=duration)

    def price(self, schema: ActionSchema, ended: Effects, env: Environment) -> float:
        """Return what an action adds to the metric, if that counts; 1 otherwise."""
        if self.total is None:
            return 1.0
        after = changes((*schema.start_effects, *ended), self.known(self.total, 0.0), env).get(self.total)
        return after if is_number(after) else 0.0

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


def _split(changes: Iterable[Change | Counting]) -> tuple[list[Change], list[Counting]]:
    facts, numbers = list[Change](), list[Counting]()
    for change in changes:
        if isinstance(change, Change):
            facts.append(change)
        else:
            numbers.append(change)
    return facts, numbers


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
            holding = (part.fluent for part in conjuncts(schema.precondition) if isinstance(part, Holds))
            atoms = [atom for atom in holding if atom[0] not in grounding.rules.derived]
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
            self.waiting += [fact for number in places(new) if not isinstance(fact := self.grounding.facts[number], AtLeast)]

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
                    self.grounding.check_time()
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
        self.grounding.check_time()
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
