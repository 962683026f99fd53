"""Dead ends: partial states from which nothing leads to the goal whatever happens, and the actions that must not be used because of them.

Delete relaxation in both directions: a fact that may become true stays possibly true, one that may become false possibly false, and an
action may have all its outcomes at once. What does not reach the goal even so never does, and neither does any state with the
literals that keep it from doing so: those are the dead end. An action that may lead to a dead end is forbidden in the states of a
part; that an action is not forbidden is one more condition of it here.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from typing import Final

from planner_bridge.planning.policies.task import ANY, Change, PartialState, PolicyAction, PolicyTask, places

_ALWAYS: Final = 0
_GOAL: Final = 1


class DeadStates:
    """The dead ends so far and the forbidden actions: mutable state.

    A literal is a number: twice the place of a fact, plus 2 for true and 3 for false; others stand for "this pair of an action and a part
    does not forbid it". A rule makes its literals possible once all that it needs is. That a derived fact is false is always possible.
    """

    def __init__(self, task: PolicyTask) -> None:
        self.task, self.ends = task, list[PartialState]()
        self.is_certain = True
        """Whether all of them are known to be dead ends: a time-out proves nothing."""
        self.forbidden: dict[PolicyAction, list[PartialState]] = defaultdict(list)
        self._count = 2 * len(task.facts) + 2
        self._facts = range(2, 2 * len(task.facts) + 2)
        """Two literals of each fact: that it is false, and that it is true."""
        self._groups = {1 << number: group for group in task.groups for number in places(group)}
        self._needs: list[list[int]] = []
        self._left: list[int] = []
        """How many literals each rule needs."""
        self._makes: list[tuple[int, ...]] = []
        self._needed_by: list[list[int]] = [[] for _ in range(self._count)]
        self._made_by: list[list[int]] = [[] for _ in range(self._count)]
        self._rules_of: dict[PolicyAction, list[int]] = defaultdict(list)
        self._leading: dict[tuple[int, bool], list[tuple[PartialState, int, int, int, PolicyAction]]] = defaultdict(list)
        """For every fact that becomes true, or false, how: under this condition, with other facts that it excludes, by these changes."""
        levels = sum(scale.mask for scale in task.scales)
        counted: dict[tuple[Change, ...], int] = {}
        """What actions do with numbers, once for all that do the same, with the literal that some of them can be used."""
        for action in task.actions:
            changes: dict[PartialState, tuple[int, int]] = {}
            for change in (change for outcome in action.outcomes for change in outcome.changes):
                add, delete = changes.get(change.condition, (0, 0))
                changes[change.condition] = add | change.add, delete | change.delete
            numbers = tuple(
                Change(condition, add & levels, delete & levels) for condition, (add, delete) in changes.items() if (add | delete) & levels
            )
            if numbers and numbers not in counted:
                counted[numbers] = self._literal()
                for condition, add, delete in numbers:
                    self._rule([counted[numbers], *_literals(condition)], _literals(PartialState(add, delete)))
            for part in action.conditions:
                if numbers:
                    self._rules_of[action].append(len(self._needs))
                    self._rule(_literals(part), [counted[numbers]])
                excluded = self.task.excluded(part.true)
                for outcome in action.outcomes:
                    if [change.condition for change in outcome.changes] == [ANY]:
                        ((_, add, delete),) = outcome.changes
                        way = part, excluded, add, delete & ~add, action
                        for place in places(add | delete):
                            self._leading[place, not add >> place & 1].append(way)
                for condition, (add, delete) in changes.items():
                    if (add | delete) & ~levels:
                        self._rules_of[action].append(len(self._needs))
                        self._rule(_literals(part.joined(condition)), _literals(PartialState(add & ~levels, delete & ~levels)))
        for part in task.goal:
            self._rule(_literals(part), [_GOAL])
        for fact, part in (rule for rules in task.rules.strata for rule in rules):
            self._rule(_literals(part), _literals(PartialState(fact)))
        read = [part for action in task.actions for part in action.conditions] + [
            change.condition for action in task.actions for outcome in action.outcomes for change in outcome.changes
        ]
        self._weights = [self._weight(literal) for literal in range(self._count)]
        """By which a literal is chosen, the least first, to say why the goal cannot be reached."""
        self.read = task.rules.read
        """The facts on which anything depends."""
        for part in (*read, *task.goal):
            self.read |= part.true | part.false

    def _literal(self) -> int:
        """Return a new literal."""
        self._count += 1
        self._needed_by.append([])
        self._made_by.append([])
        return self._count - 1

    def _weight(self, literal: int) -> tuple[bool, int, int]:
        in_group = literal in self._facts and not literal & 1 and 1 << (literal // 2 - 1) in self._groups
        return not in_group, len(self._made_by[literal]), literal

    def _rule(self, needs: list[int], makes: Iterable[int]) -> None:
        number = len(self._needs)
        self._needs.append(needs or [_ALWAYS])
        self._left.append(len(self._needs[number]))
        self._makes.append(tuple(makes))
        for literal in self._needs[number]:
            self._needed_by[literal].append(number)
        for literal in self._makes[number]:
            self._made_by[literal].append(number)

    # --- what is dead ---

    def __contains__(self, state: int) -> bool:
        return any(end.holds(state) for end in self.ends)

    def is_forbidden(self, action: PolicyAction, state: int) -> bool:
        """Return whether the action must not be used in the state."""
        return action in self.forbidden and any(part.holds(state) for part in self.forbidden[action])

    def explained(self, state: int) -> PartialState | None:
        """Return a part with the state in it from which the goal cannot be reached even if nothing is undone; None if it may be."""
        reached = self._reached(PartialState(state & self.read, ~state & self.read))
        if reached is None:
            return None
        return self._reason(reached, state)

    def exactly(self, state: int) -> PartialState:
        """Return the part that stands for the state, and for others that differ in nothing of importance."""
        read = self.read & ~self.task.rules.derived
        true = state & read
        return PartialState(true, ~state & read & ~self.task.excluded(true))

    def _reached(self, part: PartialState) -> bytearray | None:
        """Return which literals can be reached; None if the goal can."""
        left = self._left.copy()
        reached = bytearray(self._count)
        true, false = part.true & ~self.task.rules.derived, part.false | self.task.excluded(part.true)
        count = len(self.task.facts)
        everything = (1 << count) - 1
        waiting = [_ALWAYS]
        for kind, literals in ((0, false), (1, true)):
            bits = format(everything & ~literals, f"0{count}b")[::-1]
            waiting += [literal for literal, bit in zip(self._facts[kind::2], bits, strict=False) if bit == "1"]
        for literal in waiting:
            reached[literal] = 1
        needed_by, makes = self._needed_by, self._makes
        while waiting:
            for rule in needed_by[waiting.pop()]:
                left[rule] -= 1
                if not left[rule]:
                    for literal in makes[rule]:
                        if not reached[literal]:
                            if literal == _GOAL:
                                return None
                            reached[literal] = 1
                            waiting.append(literal)
        return reached

    def _reason(self, reached: bytearray, state: int) -> PartialState:
        """Return literals of the state that keep the goal from being reached: each rule for the goal misses one, and so on."""
        chosen, waiting = {_GOAL}, [_GOAL]
        weight, needs = self._weights.__getitem__, self._needs
        while waiting:
            for rule in self._made_by[waiting.pop()]:
                if chosen.isdisjoint(needs[rule]):
                    literal = min([literal for literal in needs[rule] if not reached[literal]], key=weight)
                    chosen.add(literal)
                    waiting.append(literal)
        true = false = 0
        for literal in chosen:
            if literal in self._facts:
                bit = 1 << (literal // 2 - 1)
                if literal & 1:
                    true |= bit
                elif here := self._groups.get(bit, 0) & state:
                    true |= here
                else:
                    false |= bit
        return PartialState(true, false & ~self.task.rules.derived)

    # --- what is forbidden because of it ---

    def add(self, part: PartialState) -> None:
        """Note a dead end, and forbid what leads to it."""
        self.ends.append(part)
        true, false = part
        leading = (way for place in places(true | false) for way in self._leading[place, bool(false >> place & 1)])
        for condition, excluded, add, delete, action in {id(way): way for way in leading}.values():
            if not (add & false or delete & true or (condition.false | excluded) & true & ~add or condition.true & false & ~delete):
                self.forbid(action, condition.joined(PartialState(true & ~add, false & ~delete)))

    def allow(self, action: PolicyAction, part: PartialState) -> None:
        """Take back that the action is forbidden in states of the part."""
        if part in self.forbidden[action]:
            self.forbidden[action].remove(part)

    def forbid(self, action: PolicyAction, part: PartialState) -> None:
        """Forbid the action in states of the part, unless it is forbidden there already."""
        known = self.forbidden[action]
        if any(part.implies(other) for other in known):
            return
        self.forbidden[action] = [other for other in known if not other.implies(part)] + [part]
        escape = self._literal()
        for literal in _literals(PartialState(part.false, part.true)):
            self._rule([literal], [escape])
        self._weights.append(self._weight(escape))
        for rule in self._rules_of[action]:
            self._needs[rule].append(escape)
            self._left[rule] += 1
            self._needed_by[escape].append(rule)


def _literals(part: PartialState) -> list[int]:
    return [2 * place + 2 for place in places(part.true)] + [2 * place + 3 for place in places(part.false)]
