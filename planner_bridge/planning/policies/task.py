"""The task of a policy: facts as bits of a whole number, and ground actions with every way in which they may turn out.

A state is the number whose bits are the facts that are true, those about numbers (`numbers`) and derived ones among them. A durative
action counts as one step here, its end conditions and end effects after its start effects: policies carry out one action of several
outcomes at a time.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, reduce
from operator import or_
from typing import Final, NamedTuple

from planner_bridge.planning.policies.numbers import AtLeast, Scale
from pnm.core.logic.effects import Alternative, Set
from pnm.core.logic.expressions import Fluent, fluent_text
from pnm.core.net.net import places as places
from pnm.errors import PnmError


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
NEVER: Final = PartialState(1, 1)
"""No state."""
LEAST_CHANCE: Final = 1e-12
"""A chance that counts as so much at least, where it is divided by."""
OF_METRIC: Final = "of the metric"
"""The measure of costs where the problem has a metric, in place of seconds or calls."""


@dataclass(frozen=True, eq=False)
class GroundRules:
    """The rules for derived facts, stratum by stratum: a fact, and what is enough for it. What was derived is kept: mutable state."""

    strata: tuple[tuple[tuple[int, PartialState], ...], ...] = ()
    derived: int = 0
    """All derived facts."""
    _kept: dict[PartialState, tuple[dict[int, PartialState], PartialState]] = field(default_factory=dict, repr=False)

    @cached_property
    def read(self) -> int:
        """The facts on which derived ones depend."""
        bodies = [body for rules in self.strata for _, body in rules]
        return reduce(or_, (body.true | body.false for body in bodies), 0) & ~self.derived

    def closed(self, part: PartialState) -> PartialState:
        """Return the part with the derived facts that are true in all its states, and those that are false."""
        if not self.derived:
            return part
        more = self._derive(part)[1]
        return PartialState(part.true & ~self.derived | more.true, part.false & ~self.derived | more.false)

    def state(self, stored: int) -> int:
        """Return the state with these stored facts."""
        return self.closed(PartialState(stored, ~stored)).true

    def stored(self, part: PartialState, state: int) -> PartialState:
        """Return what has to be stored so that the part holds as it does in the state.

        For a derived fact that is true, that is what one of its proofs starts from; for a false one, something that is missing for each.
        """
        true, false = part
        proofs, done = self._derive(PartialState(state, ~state))[0] if (true | false) & self.derived else {}, 0
        while left := (true | false) & self.derived & ~done:
            fact = left & -left
            done |= fact
            if fact & true:
                true, false = true | proofs[fact].true, false | proofs[fact].false
                continue
            for body in (body for rules in self.strata for head, body in rules if head == fact):
                missing, present = body.true & ~state, body.false & state
                if not (missing & false or present & true):
                    one = (missing | present) & ~self.derived or missing | present
                    one &= -one
                    true, false = true | one & present, false | one & missing
        return PartialState(true & ~self.derived, false & ~self.derived)

    def _derive(self, part: PartialState) -> tuple[dict[int, PartialState], PartialState]:
        """Return why derived facts are true, each after those from which it follows, and which are true and false."""
        known = PartialState(part.true & self.read, part.false & self.read)
        if known not in self._kept:
            proofs, true, possible = dict[int, PartialState](), known.true, self.read & ~known.false
            for rules in self.strata:
                before = None
                while before != (true, possible):
                    before = true, possible
                    for head, body in rules:
                        if not (head & true or body.true & ~before[0] or body.false & possible):
                            true |= head
                            proofs[head] = body
                        if not (body.true & ~possible or body.false & true):
                            possible |= head
            self._kept[known] = proofs, PartialState(true & self.derived, self.derived & ~possible)
        return self._kept[known]


NO_RULES: Final = GroundRules()


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


class Counting(NamedTuple):
    """An effect on a number, in states for which the condition holds."""

    condition: PartialState
    effect: Set


class PolicyOutcome(NamedTuple):
    """A way in which an action may turn out, with its chance."""

    name: str
    chance: float
    changes: tuple[Change, ...]
    counting: tuple[Counting, ...] = ()
    """What it does with numbers; that is among the changes, as facts about these."""
    rules: GroundRules = NO_RULES

    def numbers(self) -> Iterator[tuple[Fluent, PartialState, tuple[Set, ...]]]:
        """Yield what it does with each number under each condition."""
        found: dict[tuple[Fluent, PartialState], tuple[Set, ...]] = defaultdict(tuple)
        for condition, effect in self.counting:
            found[effect.fluent, condition] += (effect,)
        for (fluent, condition), effects in found.items():
            yield fluent, condition, effects

    def after(self, state: int) -> int:
        """Return the state after it."""
        add = delete = 0
        for condition, adds, deletes in self.changes:
            if condition.holds(state):
                add |= adds
                delete |= deletes
        return self.rules.state(state & ~delete | add)

    def known_after(self, part: PartialState) -> PartialState:
        """Return what is so after it in all states of the part: a change whose condition is not known leaves its facts unknown."""
        part, sure, possible = self.rules.closed(part), [0, 0], [0, 0]
        for condition, adds, deletes in self.changes:
            if condition.joined(part).is_possible:
                found = sure if part.implies(condition) else possible
                found[0], found[1] = found[0] | adds, found[1] | deletes
        true = part.true & ~(sure[1] | possible[1]) | sure[0]
        return self.rules.closed(PartialState(true, (part.false | sure[1]) & ~(sure[0] | possible[0])))

    def before(self, after: PartialState, state: int) -> PartialState:
        """Return what has to hold before, with the same changes as in this state, which leads to what has to hold after it."""
        before, add, delete = ANY, 0, 0
        if (after.true | after.false) & self.rules.derived:
            after = self.rules.stored(after, self.after(state))
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
    cost: float = 1.0

    def condition_in(self, state: int) -> PartialState | None:
        """Return the part of the condition that holds in the state; None if the action cannot be used there."""
        return next((part for part in self.conditions if part.holds(state)), None)

    def __str__(self) -> str:
        return f"{self.name}({', '.join(self.arguments)})"


@dataclass(frozen=True)
class PolicyTask:
    """Facts, the initial state, the parts of the goal, each of which is enough, and the ground actions that may ever be used."""

    facts: tuple[Fluent | AtLeast, ...]
    initial: int
    goal: tuple[PartialState, ...]
    actions: tuple[PolicyAction, ...]
    alternatives: Mapping[str, tuple[Alternative, ...]]
    """The outcomes of every action, before it is ground."""
    scales: tuple[Scale, ...] = ()
    """The numbers that actions change."""
    measure: str = "calls"
    """What the costs of actions are."""
    rules: GroundRules = NO_RULES

    def goal_in(self, state: int) -> PartialState | None:
        """Return the part of the goal that holds in the state."""
        return next((part for part in self.goal if part.holds(state)), None)

    def named(self, bits: int) -> list[Fluent]:
        """Return the stored facts of these bits, without those about numbers."""
        return [fact for number in places(bits & ~self.rules.derived) if not isinstance(fact := self.facts[number], AtLeast)]

    def texts(self, bits: int) -> list[str]:
        """Return the facts of these bits, those about numbers among them, as PDDL has them."""
        return [str(fact) if isinstance(fact := self.facts[number], AtLeast) else fluent_text(fact) for number in places(bits)]

    def values(self, state: int) -> dict[Fluent, bool | float]:
        """Return the facts that are true in the state, and the numbers."""
        return {**dict.fromkeys(self.named(state), True), **{scale.fluent: scale.value(state) for scale in self.scales}}

    def closed(self, part: PartialState) -> PartialState:
        """Return the partial state with all that it says of numbers: what is at least 30 is at least 20."""
        for scale in self.scales:
            least, top = scale.range(*part)
            part = PartialState(part.true | scale.up_to(least), part.false | scale.mask & ~scale.up_to(top))
        return part

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

    @cached_property
    def reachable(self) -> int:
        """The facts that may become true, if nothing is ever undone."""
        changes = (change.add for action in self.actions for outcome in action.outcomes for change in outcome.changes)
        return reduce(or_, changes, self.initial)

    def excluded(self, true: int) -> int:
        """Return the facts that cannot be true together with these."""
        return sum(group & ~true for group in self.groups if group & true)

    @cached_property
    def groups(self) -> tuple[int, ...]:
        """Sets of facts, of which exactly one is true in every state that can be reached: facts that differ in one argument."""
        found: dict[tuple[object, ...], int] = defaultdict(int)
        keys: dict[int, list[tuple[object, ...]]] = {}
        for number, fact in enumerate(self.facts):
            if isinstance(fact, AtLeast) or self.rules.derived >> number & 1:
                keys[number] = []
                continue
            name, *arguments = fact
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
                        if add == delete and not add & (add - 1) and not add & ~always:
                            continue
                        moves = add.bit_count() == delete.bit_count() == 1 and delete & always
                        if not moves or change.condition != ANY:
                            found.pop(key, None)
        return tuple(found.values())
