"""Faults of a state: what must not be so in any state that a part of a machine can reach."""

from __future__ import annotations

from collections.abc import Sequence
from operator import gt

from pnm.core.machine.guards import Always, Ends
from pnm.core.machine.verification.exits import asks_the_world, lacking_exit, missing_exit
from pnm.core.machine.verification.moves import Moves, PartState
from pnm.core.machine.verification.part import Inside, in_each_case
from pnm.core.machine.verification.request_life import SETTLED, Life, untaken


class StateFaults:
    """Looks for faults in the states of a part."""

    def __init__(self, moves: Moves) -> None:
        self._moves = moves
        self._part = part = moves.part
        self._alive = [moves.index[place] for place in part.alive if place in moves.index]
        self._ends = [moves.index[place] for place in part.ends | part.finals if place in moves.index]
        self._may_rest = {moves.index[place] for place in part.outputs | part.finals if place in moves.index} | moves.records
        # Found once per part: whether a place asks the world depends on its arcs and not on the state.
        self._asking = [place for place in range(len(part.places)) if place not in moves.records and self._may_be_unanswered(place)]
        # Tokens move between counters, so none can hold more than all of them together.
        budget = sum(tokens for place, tokens in part.initial.items() if place in part.records)
        self._most = [budget if place in part.records - part.failures else 1 for place in part.places]

    def of(self, state: PartState, possible: Sequence[int], *, stuck: bool) -> str:
        """Return the fault of a state; empty for none."""
        part, moves = self._part, self._moves
        if any(map(gt, state.tokens, self._most)):
            # Safe places are what makes guards and times meaningful: the time of a marking is one number per place.
            place = next(place for place, tokens in enumerate(state.tokens) if tokens > self._most[place])
            return f"{part.places[place]} holds {state.tokens[place]} tokens"
        for place in self._asking:
            if state.tokens[place] and (wrong := self._unanswered(place, state)):
                return f"{part.places[place]} {wrong}"
        # Hold and wait is one of the conditions of a deadlock; it is excluded here, so that runs cannot block each other.
        keeps = any(state.tokens[place] < tokens for place, tokens in moves.resources.items())
        if keeps and (stuck or any(isinstance(part.steps[number].guard, Inside) for number in possible)):
            return "it waits for others while it keeps resources that they may need"
        if moves.resources and moves.starves(state):
            return "it waits for resources that no call gives back"
        if wrong := self._ends_too_soon(state) or self._loses_reports(state):
            return wrong
        if not stuck:
            return ""
        missing = len(part.supplies) - state.supplied
        # What the start of a block gives must not wait for inputs that only its end needs: neighbours may wait for it.
        if missing == 1 and (late := [place for place in part.early if not state.tokens[moves.index[place]]]):
            return f"{late[0]} is not marked although only later inputs are missing"
        if missing:  # more inputs are to come, so to be at rest is no end yet
            return ""
        left = {place: tokens for place, tokens in zip(part.places, state.tokens, strict=True) if tokens and place not in part.records}
        kept = {place: part.initial[place] for place in part.resources - part.records if place in part.initial}
        ends = [place for place in left if place in part.finals]
        expected = {**kept, **dict.fromkeys(sorted(part.outputs), 1), **dict.fromkeys(ends[:1], 1)}
        if part.finals and (len(ends) != 1 or left != expected):
            return f"it ends in {left}"
        return "" if left == expected else f"it leaves {left} in place of {expected}"

    def _may_be_unanswered(self, place: int) -> bool:
        """Return whether the world is asked at the place, and the exits that need nothing else are not enough."""
        name, steps = self._part.places[place], [self._part.steps[number] for number in self._moves.consumers[place]]
        alone = [step.guard for step in steps if step.inputs == {name: 1} and not isinstance(step.guard, Inside)]
        others = [step.guard for step in steps if step.inputs != {name: 1}]
        if not any(asks_the_world(step.guard) for step in steps) or Always() in alone:
            return False
        return any(isinstance(guard, Ends) for guard in others) or bool(missing_exit(list(filter(asks_the_world, alone))))

    def _unanswered(self, place: int, state: PartState) -> str:
        """Return for which answer of the world no exit opens in finite time, if one is waited for and for no resources."""
        moves = self._moves
        numbers = moves.consumers[place]
        if any(moves.lacks_resources(number, state) for number in numbers):
            return ""
        enabled = [self._part.steps[number] for number in numbers if moves.is_enabled(number, state)]
        moods = moves.moods(state)
        cases_of_each = in_each_case(enabled)
        lacking = (max((lacking_exit([step.guard for step in case], moods) for case in cases), key=len) for cases in cases_of_each)
        return min(lacking, key=len)

    def _ends_too_soon(self, state: PartState) -> str:
        """Return the part that still runs although the end of the part is marked; empty for none, or if it is not."""
        ended = [place for place in self._ends if state.tokens[place]]
        if not ended:
            return ""
        name, places = self._part.places[ended[0]], self._part.places
        if busy := [places[place] for place, tokens in enumerate(state.tokens) if tokens and place not in self._may_rest]:
            return f"{name} is marked although {busy[0]} still is"
        if Life.ALIVE in state.requests or Life.ADOPTABLE in state.requests:
            return f"{name} is marked although a request is alive"
        is_ending, is_goal = self._moves.moods(state).ending, self._part.goal in map(places.__getitem__, ended)
        if is_goal and is_ending:
            return f"{name} is marked although the run is ending"
        if (is_goal or not self._part.finals) and not is_ending:
            for owner in self._part.owed:
                if state.accounts[self._moves.calls[owner]] not in SETTLED:
                    what = "what it is for" if owner is None else f"call {owner}"
                    return f"{name} is marked although {what} was not carried out, and the plan does not pass it over"
        return ""

    def _loses_reports(self, state: PartState) -> str:
        """Return for which request that is alive an end would be lost, or be taken for that of a call at rest."""
        if Life.ALIVE not in state.requests:
            return ""
        alive = [call for call, position in self._moves.calls.items() if state.requests[position] is Life.ALIVE]
        if len(alive) > sum(state.tokens[place] for place in self._alive):
            return "a request is alive, and no place is marked that says so"
        for call in alive:
            if lost := untaken(self._moves.reports_now(call, state)):
                return f"nothing takes the report that a request has {'/'.join(sorted(kind.value for kind in lost))}"
        return ""
