"""A walk through every state that a part of a machine can reach: what goes wrong in one of them, and which transitions never fire."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence, Set
from dataclasses import dataclass
from operator import gt
from typing import Final, NamedTuple, TypeAlias

from pnm.core.machine import guards
from pnm.core.machine.requests import BEFORE_ACCEPTANCE, CallOutcome, OutcomeKind, TransitionAction
from pnm.core.machine.verification.moves import AGAIN, FROM_OUTSIDE, SETTLED, Life, Moves, PartState
from pnm.core.machine.verification.part import Inside, Part, PartStep, Unsound, in_each_case, without_twins

# --- faults of a state: what must not be so in any that a part of a machine can reach -----------------


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
        if not any(asks_the_world(step.guard) for step in steps) or guards.Always() in alone:
            return False
        return any(isinstance(guard, guards.Ends) for guard in others) or bool(missing_exit(list(filter(asks_the_world, alone))))

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


# --- exits of a place: which are open, and does one open in finite time, whatever the world answers? ----------

_ANY: Final = frozenset(OutcomeKind)


def asks_the_world(guard: guards.Guard | Inside) -> bool:
    """Return whether the guard opens because of the world, of a request from outside, or of time."""
    return guard.opened_by is not guards.Opener.TOKENS and guard.open_in(guards.Moods()) is None


def lacking_exit(exits: Collection[guards.Guard | Inside], moods: guards.Moods) -> str:
    """Return for which answer of the world none of the guards at a place opens; empty if one does, or the world is not asked."""
    asking = list(filter(asks_the_world, exits))
    return missing_exit(asking) if asking and not any(guard.open_in(moods) for guard in exits) else ""


def missing_exit(exits: Collection[guards.Guard | Inside]) -> str:
    """Return for which answer of the world none of these guards opens in finite time; empty when one always does."""
    # Ends first: a request that is out may end in any way, whatever other exits there are.
    outcomes = [guard.kinds for guard in exits if isinstance(guard, guards.Ends)]
    if outcomes and (others := _ANY.difference(*outcomes)):
        return f"has no exit for a request that has {'/'.join(sorted(kind.value for kind in others))}"
    # A condition and its complement: one of them opens, if perhaps only after the report delay.
    if any(guard.is_sure or guard.complement in exits for guard in exits):
        return ""
    for guard in exits:
        if guard.closed_for:
            return f"has no exit for when {guard.closed_for}"
    return "has no exit that is sure to open in finite time"


def untaken(steps: Iterable[PartStep]) -> frozenset[OutcomeKind]:
    """Return the ends of a request that is alive which none of the enabled steps takes; such a report would be lost."""
    taken, expected = frozenset[OutcomeKind](), _ANY
    for step in steps:
        if isinstance(step.guard, guards.Ends):
            taken |= step.guard.kinds
        elif isinstance(step.guard, guards.Accepts):
            expected = BEFORE_ACCEPTANCE  # any other is taken once the acceptance is
    return expected - taken


# --- what the exploration takes for granted -------------------------------------------------------


def check_steps(part: Part) -> None:
    """Check what the exploration of a part takes for granted about its steps.

    A report moves the one token of its call; what is marked as failed or as the end stays so; there is as much of every resource as
    any step takes; delays count from what is taken; the outcome that a call has after a step is what has happened.
    """
    for step in part.steps:
        inputs, guard = step.inputs, step.guard
        is_report = guard.opened_by is guards.Opener.REPORT
        if is_report and (len(inputs) != 1 or set(inputs.values()) != {1} or not part.records.isdisjoint(inputs)):
            raise Unsound(f"{step.name} is opened by a report, and does not take just the one token of its call")
        if isinstance(guard, guards.EffectsSeen) and not part.settling.issuperset(inputs):
            raise Unsound(f"{step.name} looks for effects at a place that is not said to be one for that")
        if isinstance(guard, guards.Due) and not inputs.keys() >= dict(guard.since).keys():
            raise Unsound(f"{step.name} counts from the marking of {', '.join(dict(guard.since))}, which it does not take from")
        for place, weight in inputs.items():
            if place in part.failures or place in part.finals:
                raise Unsound(f"{step.name} takes from {place}, which stays as it is")
            if place in part.resources and weight > part.initial.get(place, 0):
                raise Unsound(f"{step.name} takes {weight} of {place}, and there is {part.initial.get(place, 0)}")
    for step in part.steps:
        match step.outcome:
            case CallOutcome.WAITING if step.call is not None:  # it is reached from outside, by nothing of its own
                is_so = not any(step.call == other.call and not step.inputs.keys().isdisjoint(other.outputs) for other in part.steps)
            case CallOutcome.RUNNING:
                is_so = step.action is TransitionAction.SEND
            case CallOutcome.SKIPPED:
                is_so = isinstance(step.guard, guards.Ending)
            case CallOutcome.ALREADY_TRUE:
                is_so = isinstance(step.guard, guards.AlreadyTrue)
            case CallOutcome.SUCCEEDED:
                is_so = isinstance(step.guard, guards.EffectsSeen)
            case CallOutcome.CANCELED:
                is_so = isinstance(step.guard, guards.Ends | guards.EffectsMissing)
            case CallOutcome.UNCONFIRMED:
                is_so = step.gives_up
            case outcome:
                is_so = outcome not in (CallOutcome.FAILED, CallOutcome.HANDED_OVER)
        if not is_so:
            raise Unsound(f"{step.name} makes its call {step.outcome}, whatever has become of it")


# --- the walk ---------------------------------------------------------------------------------


MAX_STATES: Final = 2_000_000

_Trace: TypeAlias = "tuple[_Trace, str] | None"
"""Trace to a state: the last step, and the trace before it."""
_Reached: TypeAlias = tuple[PartState, _Trace]


@dataclass(frozen=True, slots=True, eq=False)
class Exploration:
    """The findings in all states of a part, which are those of all parts of its shape."""

    states: int
    """The number of states."""
    unfired: tuple[int, ...]
    """The numbers of the steps that never happen."""


def explore_part(part: Part) -> Exploration:
    """Walk through every state of the part.

    Raises:
        Unsound: some state is wrong, something can go round for ever, or there are too many states.
    """
    if confusing := [step.name for step in part.steps if step.name in FROM_OUTSIDE]:
        raise Unsound(f"a step is called {confusing[0]!r}, as is what happens from outside")
    check_steps(part)
    moves = Moves(without_twins(part))
    faults = StateFaults(moves)
    # Pauses and entries come from outside, as often as they like: what follows from there is walked through apart. A cycle through
    # them is no error: pauses are assumed to be finitely many, and entries are counted by whatever holds the block. So is what is
    # counted: `successors` makes sure that it comes to an end.
    apart = {step.name for step in part.steps if isinstance(step.guard, guards.PauseAsked) or step.counted} | {AGAIN}
    roots: list[_Reached] = [(moves.start(), None)]
    seen: set[PartState] = set()
    while roots:
        root = roots.pop()
        if root[0] not in seen:
            roots += _walk(moves, faults, root, seen, apart)
    return Exploration(len(seen), tuple(number for number in range(len(part.steps)) if number not in moves.fired))


def _walk(moves: Moves, faults: StateFaults, root: _Reached, seen: set[PartState], apart: Set[str]) -> list[_Reached]:
    """Walk through every state that is reached from the root but by some steps; return what those lead to."""
    # An explicit stack: plans may be deeper than Python's recursion limit.
    path: list[tuple[_Reached, Iterator[tuple[str, PartState]]]] = []
    on_path: set[PartState] = set()
    left: dict[PartState, _Reached] = {}

    def enter(reached: _Reached) -> None:
        state, trace = reached
        possible = moves.possible(state)
        stuck = moves.is_stuck(state, possible)
        try:
            nexts = list(moves.successors(state, possible, stuck))
        except Unsound as error:
            raise Unsound(str(error), _names(trace)) from error
        if wrong := faults.of(state, possible, stuck=stuck):
            raise Unsound(wrong, _names(trace))
        if len(seen) > MAX_STATES:
            raise Unsound(f"more than {MAX_STATES} states")
        seen.add(state)
        on_path.add(state)
        path.append((reached, iter(nexts)))

    enter(root)
    while path:
        (state, trace), nexts = path[-1]
        successor = next(nexts, None)
        if successor is None:
            path.pop()
            on_path.remove(state)
            continue
        name, following = successor
        if name in apart:
            if following not in seen:
                left.setdefault(following, (following, (trace, name)))
        # A state on the current path is a cycle that the machine goes through without help from outside: it would not terminate.
        elif following in on_path:
            raise Unsound("it can go round for ever", _names((trace, name)))
        elif following not in seen:
            enter((following, (trace, name)))
    return list(left.values())


def _names(trace: _Trace) -> list[str]:
    names: list[str] = []
    while trace is not None:
        trace, name = trace
        names.append(name)
    return names[::-1]


class NeverFires(NamedTuple):
    """A transition that can never fire, and the reason."""

    transition: str
    reason: str

    def __str__(self) -> str:
        return f"{self.transition}: {self.reason}"


def never_fire(part: Part, explored: Exploration) -> list[NeverFires]:
    """Return the transitions of the part that never fire."""
    if not explored.unfired:
        return []
    unfired = {part.steps[number].name for number in explored.unfired}
    marked = {place for together in part.supplies for place in together}.union(part.initial)
    marked.update(place for step in part.steps if step.name not in unfired for place in step.outputs)
    steps = (part.steps[number] for number in explored.unfired)
    return [NeverFires(step.name, _reason(part, step, marked)) for step in steps if not isinstance(step.guard, Inside)]


def _reason(part: Part, step: PartStep, marked: Collection[str]) -> str:
    if unmarked := [place for place in step.inputs if place not in marked]:
        return f"nothing marks {unmarked[0]}"
    if isinstance(step.guard, guards.Ends) and step.guard.kinds.isdisjoint(BEFORE_ACCEPTANCE):
        for other in part.steps:
            if isinstance(other.guard, guards.Accepts) and other.inputs.keys() == step.inputs.keys():
                return f"such an end implies that the request was accepted, and {other.name} goes first"
    before = part.steps[: part.steps.index(step)]
    earlier = [other.name for other in before if not other.inputs.keys().isdisjoint(step.inputs)]
    return f"where it could, one before it goes first ({', '.join(earlier)})" if earlier else "its places are never marked together"
