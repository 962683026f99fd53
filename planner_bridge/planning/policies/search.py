"""The search for a policy that reaches the goal for certain as long as every outcome comes up sooner or later (strong cyclic).

After PRP (Muise, McIlraith and Beck, *Improved Non-Deterministic Planning by Exploiting State Relevance*, 2012), with states settled by
their strongly connected components (Tarjan 1972):

- A depth-first walk from the initial state gives each state an action: of a plan that Kairos finds as if outcomes could be chosen.
  Plans are kept, as what has to hold before each of their steps, and used for other states too.
- A state without a plan is a dead end. What leads to such states is forbidden from then on, and the walk goes back to the first
  state on its way with an action that is forbidden now.
- When the walk leaves a component, all that it leads to is settled, and so it is settled as a whole: each state *needs* the condition of
  its action, and what its successors need, carried back through the outcomes; the least that is so. These are entries of the policy for
  good, for whatever states they fit: a policy is closed on partial states, of which there are few.
"""

from __future__ import annotations

import time
from bisect import insort
from collections import defaultdict, deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import reduce
from math import inf
from operator import or_
from typing import Final, NamedTuple

from planner_bridge.model.plan import CancelToken
from planner_bridge.planning.policies.dead_ends import DeadStates
from planner_bridge.planning.policies.encoding import OutcomePlanner, OutOfTime, Step
from planner_bridge.planning.policies.task import ANY, LEAST_CHANCE, PartialState, PolicyAction, PolicyOutcome, PolicyTask

_EXACT: Final = 1e-10
_CLOSE: Final = 1e-3
SAME: Final = 1e-6
"""Risks that differ by less are the same."""


class SettledPart(NamedTuple):
    """An entry of a policy: how good it is, what has to hold, what to do. Better ones are less."""

    risk: float
    """Of not reaching the goal; 0 if it is reached for certain, as long as every outcome comes up sooner or later."""
    expected: float
    """The cost that is expected from there on: of every action 1, if nothing else is known."""
    distance: float
    """Actions until the goal, with luck."""
    need: PartialState
    number: int
    """In the order in which they were found, so that entries can be sorted."""
    action: PolicyAction | None
    """None at the goal."""


class KeptStep(NamedTuple):
    """A step of a plan. The nearest to the goal comes first."""

    distance: int
    """Steps until the goal."""
    number: int
    """In the order in which they were kept, so that they can be sorted."""
    need: PartialState
    """What has to hold before it, so that the rest of the plan can follow."""
    action: PolicyAction
    ahead: int
    """Facts that become true by it or after it."""


class BestWays(NamedTuple):
    """What is best in states all ways of which were looked at: the action, the risk, and the expected cost."""

    choice: Mapping[int, PolicyAction]
    risks: Mapping[int, float]
    costs: Mapping[int, float]


@dataclass
class _Frame:
    """A state on the way of the walk, and its successors that are still to be looked at."""

    state: int
    action: PolicyAction
    successors: Iterator[int]
    low: int = 0


class Interrupted(Exception):
    """The search was cancelled, or its time is over."""


class Search:
    """The search for a strong cyclic policy: entries, dead ends and plans so far are mutable state."""

    def __init__(self, task: PolicyTask, kairos: OutcomePlanner, until: float = inf, cancel: CancelToken | None = None) -> None:
        self.task, self.kairos, self.until, self._cancel = task, kairos, until, cancel
        self.dead = DeadStates(task)
        self.entries: list[SettledPart] = []
        """In the order in which they were found."""
        self._found: dict[int, tuple[SettledPart | None, int]] = {}
        """The best ones for states, among how many."""
        self._best = BestWays({}, {}, {})
        self._followed = set[int]()
        """States that were given their entry since."""
        self._lost = frozenset[int]()
        """States that are given up."""
        self._plans: list[KeptStep] = []
        self._kept = set[tuple[PartialState, PolicyAction]]()
        self._looked_at = set[int]()
        """States of which is known whether they are dead ends even if nothing is undone."""
        self._chosen: dict[int, PolicyAction] = {}
        """Actions for single states, which come before those of plans."""
        self._doomed = set[int]()
        """States without a plan, even if some relaxation has one."""
        self._forbidden_here: dict[int, list[tuple[PolicyAction, PartialState]]] = defaultdict(list)
        self._avoided = set[int]()
        """States in which plans for others led in a circle."""

    def take_over(self, other: Search) -> None:
        """Take over what a search has found for the same facts and goal, with all actions of this one, and maybe more.

        Dead ends stay, and what is forbidden because of them; plans do without what they have in actions that are missing, and entries
        if none is missing. The other search may go on meanwhile, in its thread: what is taken is copied at once.
        """
        actions = set(self.task.actions)
        for end in [*other.dead.ends]:
            self.dead.add(end)
        self._plans, self._kept = [step for step in [*other._plans] if step.action in actions], other._kept.copy()
        entries = [*other.entries]
        self.entries = entries if all(entry.action in actions for entry in entries) else []
        if other.dead.is_certain:  # else a plan may only not have been found in time
            self._doomed = other._doomed.copy()
            for action, parts in [*other.dead.forbidden.items()]:
                for part in parts if action in actions else ():
                    self.dead.forbid(action, part)
            for state, forbidden in [*other._forbidden_here.items()]:
                self._forbidden_here[state] = [(action, part) for action, part in forbidden if action in actions]

    def is_over(self, until: float) -> bool:
        """Return whether it is this time, on the clock of `time.monotonic`, or the search was cancelled."""
        return time.monotonic() > until or (self._cancel is not None and self._cancel.is_set())

    def settled(self, state: int) -> SettledPart | None:
        """Return the entry for the state; None if there is none yet."""
        if part := self.task.goal_in(state):
            return SettledPart(0.0, 0.0, 0.0, part, 0, None)
        if state in self._lost:
            return SettledPart(1.0, 0.0, inf, ANY, 0, None)
        found, among = self._found.get(state, (None, 0))
        if among < len(self.entries):
            fitting = [entry for entry in self.entries[among:] if not (entry[3][0] & ~state or entry[3][1] & state)]
            found = min(fitting if found is None else [*fitting, found], default=None)
            self._found[state] = found, len(self.entries)
        return found

    def give_up(self, lost: frozenset[int]) -> None:
        """Give these states up, and forbid nothing because of them; forget the entries that take other chances."""
        self.dead, self._lost = DeadStates(self.task), lost
        self.entries, self._found = [entry for entry in self.entries if not entry.risk], {}
        self._doomed.clear()
        self._forbidden_here.clear()

    def follow(self, best: BestWays, state: int) -> None:
        """Make entries of what is best for all states that can be reached from this one, instead of plans of their own."""
        self._chosen, self._best, self._followed = dict(best.choice), best, set()
        self.run(state)

    def _is_settled(self, state: int) -> bool:
        """Return whether there is an entry for the state, as good as is known to be possible."""
        entry = self.settled(state)
        if entry is None or state not in self._best.choice or state in self._followed:
            return entry is not None
        return entry.risk <= self._best.risks[state] + SAME and entry.expected <= self._best.costs[state] * (1.0 + _CLOSE)

    def run(self, state: int) -> bool:
        """Settle the state; return whether there is a policy for it, in so far as `dead.is_certain`. Raises `Interrupted`."""
        order: dict[int, int] = {}
        stack: list[int] = []
        frames: list[_Frame] = []
        if self._is_settled(state):
            return True

        def enter(state: int) -> None:
            """Give a state an action; go back as long as there is none."""
            while (action := self._action(state)) is None:
                at = next((at for at, frame in enumerate(frames) if self.dead.is_forbidden(frame.action, frame.state)), None)
                if at is None:
                    if not frames:
                        raise _NoPolicy
                    at = len(frames) - 1
                    self._forbid_here(frames[at].action, frames[at].state, state)
                state = frames[at].state
                leave(state)
                del frames[at:]
            order[state] = len(stack)
            stack.append(state)
            frames.append(_Frame(state, action, iter([*dict.fromkeys(way.after(state) for way in action.outcomes)]), order[state]))

        def leave(state: int) -> list[int]:
            """Take the state, and what came after it, off the stack."""
            component = stack[order[state] :]
            del stack[order[state] :]
            for one in component:
                del order[one]
            return component

        try:
            enter(state)
            while frames:
                if self.is_over(self.until):
                    raise Interrupted
                frame = frames[-1]
                successor = next(frame.successors, None)
                if successor is None:
                    frames.pop()
                    if frames:
                        frames[-1].low = min(frames[-1].low, frame.low)
                    if frame.low == order[frame.state]:
                        component = leave(frame.state)
                        if not self._settle(component):
                            enter(frame.state)
                elif successor in order:
                    frame.low = min(frame.low, order[successor])
                elif not self._is_settled(successor):
                    enter(successor)
        except _NoPolicy:
            return False
        return True

    # --- an action for a state ---

    def _action(self, state: int) -> PolicyAction | None:
        """Return an action for a state that is not settled; None if it is a dead end, which is noted."""
        while state not in self.dead and state not in self._doomed:
            action = self._known(state)
            if action is not None:
                self._chosen[state] = action
                return action
            if self._is_dead(state):
                return None
            if state not in self._avoided and (nearest := self._nearest(state)) is not None:
                self.keep(state, [nearest])
                continue
            steps: list[Step] | None = None
            try:
                steps = self.kairos.plan(state, self.dead.forbidden, self.until)
            except OutOfTime:
                if self.is_over(self.until):
                    raise Interrupted from None
                self.dead.is_certain = False
            if steps is None:
                self._doomed.add(state)
            else:
                self.keep(state, steps)
        for action, part in self._forbidden_here.pop(state, ()):
            self.dead.allow(action, part)
        return None

    def _forbid_here(self, action: PolicyAction, state: int, after: int) -> None:
        """Forbid an action that leads to a dead end, wherever it does so as it does here.

        If it is none for good, in this very state, as long as that is no dead end itself.
        """
        end, condition = next((end for end in self.dead.ends if end.holds(after)), None), action.condition_in(state)
        if end is not None and condition is not None:
            outcome = next(outcome for outcome in action.outcomes if outcome.after(state) == after)
            self.dead.forbid(action, condition.joined(outcome.before(end, state)))
            return
        part = self.dead.exactly(state)
        self.dead.forbid(action, part)
        self._forbidden_here[state].append((action, part))

    def _known(self, state: int) -> PolicyAction | None:
        chosen = self._chosen.get(state)
        if chosen is not None and not self.dead.is_forbidden(chosen, state):
            return chosen
        if state in self._avoided:
            return None
        return next((kept.action for kept in self._fitting(state)), None)

    def _fitting(self, state: int) -> Iterator[KeptStep]:
        """Yield the steps of plans that can be used in the state, the nearest to the goal first."""
        return (kept for kept in self._plans if kept.need.holds(state) and not self.dead.is_forbidden(kept.action, state))

    def _onward(self, state: int) -> tuple[int, PartialState] | None:
        """Return how many steps it takes to the goal with luck, and what has to hold for that; None if no way is known."""
        if (entry := self.settled(state)) is not None:
            return (int(entry.distance), entry.need) if entry.risk < 1.0 else None
        return next(((kept.distance, kept.need) for kept in self._fitting(state)), None)

    def _nearest(self, state: int) -> Step | None:
        """Return a step that leads, with luck, to where there is a way already, the shortest such way; None if there is none."""
        found: list[tuple[int, int, Step]] = []
        for action in self.task.usable(state):
            if not self.dead.is_forbidden(action, state):
                for number, outcome in enumerate(action.outcomes):
                    after = outcome.after(state)
                    if after != state and after not in self._doomed and (onward := self._onward(after)) is not None:
                        found.append((onward[0], len(found), (action, number)))
        steps = (step for _, _, step in sorted(found))
        return next((step for step in steps if self._leads_on(step[0].outcomes[step[1]].after(state))), None)

    def _leads_on(self, state: int) -> bool:
        """Return whether the actions that are known by now lead, with luck, from the state to the goal or to an entry."""
        seen, waiting = {state}, [state]
        while waiting:
            at = waiting.pop()
            if (entry := self.settled(at)) is not None and entry.risk < 1.0:
                return True
            action = self._known(at)
            for after in (outcome.after(at) for outcome in action.outcomes) if action is not None else ():
                if after not in seen and after not in self._doomed:
                    seen.add(after)
                    waiting.append(after)
        return False

    def _is_dead(self, state: int) -> bool:
        """Return whether the state is a dead end even if nothing is undone; note that it is."""
        if part := self.dead.explained(state):
            self.dead.add(part)
        return part is not None

    def keep(self, state: int, steps: list[Step]) -> None:
        """Keep a plan, unless an outcome on its way is a dead end; that is noted.

        What is kept: its actions for the states on its way, and what has to hold before each for whatever other states fit.
        """
        way: list[tuple[int, Step]] = []
        last = reduce(lambda at, step: step[0].outcomes[step[1]].after(at), steps, state)
        ahead = [next((kept.ahead for kept in self._fitting(last)), 0)]
        for action, number in reversed(steps):
            ahead.append(reduce(or_, (change.add for change in action.outcomes[number].changes), ahead[-1]))
        is_safe = True
        for step in steps:
            if self.task.goal_in(state) or step[0].condition_in(state) is None:
                break
            hoped = step[0].outcomes[step[1]].after(state)
            for taken in self.siblings(state, step, ahead[len(steps) - len(way)]):
                action = taken[0]
                for after in (outcome.after(state) for outcome in action.outcomes):
                    is_new = after not in self._looked_at and after != hoped  # from there the plan goes on
                    self._looked_at.add(after)
                    is_dead = after in self._doomed or (is_new and not self.settled(after) and self._is_dead(after))
                    if is_dead and not self.dead.is_forbidden(action, state):
                        self._forbid_here(action, state, after)
                if not self.dead.is_forbidden(action, state):
                    break
            else:
                is_safe = False
            way.append((state, taken))
            state = hoped
        if not is_safe:
            return
        left, need = self._onward(state) or (0, None)
        if need is None and not way:  # Kairos, which does not round numbers, has a plan where there is none
            self._doomed.add(state)
            self.dead.is_certain = False
        for distance, (state, (action, number)) in enumerate(reversed(way), 1):
            if need is None:
                break
            condition = action.condition_in(state)
            assert condition is not None, f"{action} can be used"
            need = self.task.closed(condition.joined(action.outcomes[number].before(need, state)))
            if (need, action) not in self._kept:
                self._kept.add((need, action))
                insort(self._plans, KeptStep(left + distance, len(self._kept), need, action, ahead[len(ahead) - len(way) - 1 + distance]))
        for state, (action, _) in way:
            if (chosen := self._chosen.get(state)) is not None and not self.dead.is_forbidden(chosen, state):
                break
            self._chosen[state] = action

    def siblings(self, state: int, step: Step, ahead: int) -> list[Step]:
        """Return a step and others that hope for the same, those first of which more that is ahead is to be expected."""
        if len(step[0].outcomes) == 1:
            return [step]
        hoped, found = step[0].outcomes[step[1]].after(state), {step[0]: step[1]}
        for action in self.task.usable(state):
            for number, outcome in enumerate(action.outcomes):
                if outcome.after(state) == hoped:
                    found.setdefault(action, number)

        def gain(step: Step) -> float:
            return sum(outcome.chance * (outcome.after(state) & ~state & ahead).bit_count() for outcome in step[0].outcomes)

        return sorted(found.items(), key=gain, reverse=True)

    # --- a component ---

    def _settle(self, component: list[int]) -> bool:
        """Make entries of the states of a component, all successors of which are settled or in it; return whether it was possible.

        It is not if an action was forbidden since, or nothing leads out.
        """
        actions = {state: self._chosen[state] for state in component}
        if any(self.dead.is_forbidden(action, state) for state, action in actions.items()):
            return False
        before: dict[int, list[tuple[int, PolicyOutcome]]] = defaultdict(list)
        """For each state of the component, how others in it lead there."""
        ends: dict[int, list[tuple[PolicyOutcome, SettledPart]]] = defaultdict(list)
        for state, action in actions.items():
            for outcome in action.outcomes:
                after = outcome.after(state)
                if after in actions:
                    before[after].append((state, outcome))
                else:
                    entry = self.settled(after)
                    assert entry is not None, "what a component leads to is settled before it"
                    ends[state].append((outcome, entry))
        distance = {state: 1 + min(entry.distance for _, entry in found) for state, found in ends.items()}
        waiting = deque(sorted(distance, key=distance.__getitem__))
        while waiting:
            after = waiting.popleft()
            for state, _ in before[after]:
                if distance.get(state, inf) > distance[after] + 1:
                    distance[state] = distance[after] + 1
                    waiting.append(state)
        if len(distance) < len(actions):
            self._avoided.update(component)
            for state in component:
                del self._chosen[state]
            return False
        needs: dict[int, PartialState] = {}
        for state, action in actions.items():
            need = action.condition_in(state)
            assert need is not None, f"{action} can be used"
            for outcome, entry in ends[state]:
                need = need.joined(outcome.before(entry.need, state))
            needs[state] = need
        waiting.extend(needs)
        while waiting:
            after = waiting.popleft()
            for state, outcome in before[after]:
                need = needs[state].joined(outcome.before(needs[after], state))
                if need != needs[state]:
                    needs[state] = need
                    waiting.append(state)
        rows = []
        for state in sorted(component, key=distance.__getitem__):
            chances: dict[int, float] = defaultdict(float)
            for outcome in actions[state].outcomes:
                chances[outcome.after(state)] += outcome.chance
            stays = chances.pop(state, 0.0)
            rows.append((state, max(1.0 - stays, LEAST_CHANCE), [(after, chance) for after, chance in chances.items() if after in actions]))
        risk = {state: sum(outcome.chance * entry.risk for outcome, entry in ends[state]) for state in component}
        expected = {
            state: actions[state].cost + sum(outcome.chance * entry.expected for outcome, entry in ends[state]) for state in component
        }
        for values in (risk, expected):
            _solve(rows, values)
        # what is not solved to the end must not look better than the way out, or it would be preferred to it, for good
        least = min(entry.risk for found in ends.values() for _, entry in found)
        new: list[SettledPart] = []
        for state in component:
            need, its = self.task.closed(self.task.rules.stored(needs[state], state)), max(least, round(risk[state], 6))
            entry = SettledPart(its, expected[state], distance[state], need, len(self.entries) + len(new), actions[state])
            if not (_has_as_good(self.entries, entry) or _has_as_good(new, entry)):
                new.append(entry)
        self.entries += new  # at once, because another search may take them over meanwhile
        self._followed.update(component)
        return True


def _has_as_good(entries: list[SettledPart], entry: SettledPart) -> bool:
    """Return whether one of the entries is as good, for all states of this one. It is asked thousands of times of thousands."""
    risk, expected, _, (true, false), *_ = entry
    fitting = (other for other in entries if not (other[3][0] & ~true or other[3][1] & ~false))
    return any(other[0] < risk or (other[0] == risk and other[1] <= expected) for other in fitting)


def _solve(rows: list[tuple[int, float, list[tuple[int, float]]]], values: dict[int, float]) -> None:
    """Add to each value those of the states that follow, with their chances, until rounding hides the rest (Gauss-Seidel iteration)."""
    fixed, change = dict(values), inf if any(values.values()) else 0.0
    while change > _EXACT:
        change = 0.0
        for state, goes, others in rows:
            value = (fixed[state] + sum([chance * values[after] for after, chance in others])) / goes
            change = max(change, abs(value - values[state]) / (value or 1.0))
            values[state] = value


class _NoPolicy(Exception):
    """The first state is a dead end."""
