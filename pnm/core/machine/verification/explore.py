"""Every state that a part of a machine can reach, whatever the world answers: tokens, and what became of the requests of its calls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from typing import Final, TypeAlias

from pnm.core.machine.machine import Accepts, Adopted, After, Always, CancelAsked, Due, Ending, Ends, Failing, Guard, PauseAsked
from pnm.core.machine.verification.counters import in_each_case
from pnm.core.machine.verification.exits import missing_exit
from pnm.core.machine.verification.part import Inside, Part, Step, Unsound
from pnm.core.machine.verification.place_roles import check_steps
from pnm.core.machine.verification.request_life import Life, following, may_come, misuse, untaken

MAX_STATES: Final = 2_000_000
Tokens: TypeAlias = tuple[int, ...]


@dataclass(frozen=True, slots=True)
class _State:
    tokens: Tokens
    stop: int = 0
    """0: going on, 1: another part asks for the plan to begin anew, 2: a stop, 3: a stop that cancels."""
    supplied: int = 0
    """How many of the supplies have come."""
    requests: tuple[Life, ...] = ()
    """What became of the last request of each call."""
    restored: bool = False
    """Whether something that was counted has come back since the part was entered."""


@dataclass
class _Explorer:
    part: Part
    index: dict[str, int] = field(init=False)
    consumers: list[list[int]] = field(init=False)

    most: list[int] = field(init=False)
    """How many tokens each place may hold."""
    fired: set[int] = field(default_factory=set)
    """The steps that can happen, as far as is known."""

    def __post_init__(self) -> None:
        part = self.part
        self.index = {place: number for number, place in enumerate(part.places)}
        self.consumers = [[] for _ in part.places]
        for number, step in enumerate(part.steps):
            for place in step.inputs:
                self.consumers[self.index[place]].append(number)
        self.calls = {call: number for number, call in enumerate(dict.fromkeys(one.call for one in part.steps if one.call is not None))}
        adopted = {step.call for step in part.steps if isinstance(step.guard, Adopted)}
        self.requests = tuple(Life.ADOPTABLE if call in adopted else Life.NONE for call in self.calls)
        self.reports = [number for number, step in enumerate(part.steps) if isinstance(step.guard, Accepts | Ends)]
        self.reports_of = {call: [number for number in self.reports if part.steps[number].call == call] for call in self.calls}
        self.accepts = {
            call: [part.steps[number] for number in numbers if isinstance(part.steps[number].guard, Accepts)]
            for call, numbers in self.reports_of.items()
        }
        self.needs = [tuple((self.index[place], weight) for place, weight in step.inputs.items()) for step in part.steps]
        self.number = {id(step): number for number, step in enumerate(part.steps)}
        self.failures = [self.index[place] for place in part.failures]
        self.restarts = [self.index[place] for place in part.restarts]
        # Places without an arc in this part have no index.
        self.counters = {self.index[place] for place in part.counters if place in self.index}
        self.resources = {self.index[place]: part.initial.get(place, 0) for place in part.resources}
        self.records = self.counters | self.resources.keys()
        self.alive = [self.index[place] for place in part.alive if place in self.index]
        self.ends = [self.index[place] for place in part.ends | part.finals if place in self.index]
        self.may_rest = {self.index[place] for place in part.outputs | part.finals if place in self.index} | self.records
        # Found once per part: whether a place asks the world depends on its arcs and not on the state.
        self.asking = [place for place in range(len(part.places)) if place not in self.records and self._may_be_unanswered(place)]
        # Only upwards in `successors`: a stop is never taken back, so the states of a part are finitely many.
        self.stops = (1, 2, 3) if part.others_restart else (2, 3)
        # A place that asks for a restart is emptied before anything begins anew.
        counting = {step.counted.place for step in part.steps if step.counted}
        self.lasting = {self.index[place] for place in part.failures | counting if place in self.index}
        # Tokens move between counters, so none can hold more than all of them together.
        budget = sum(tokens for place, tokens in part.initial.items() if place in part.records)
        self.most = [budget if place in part.records - part.failures else 1 for place in part.places]

    def start(self) -> _State:
        """Return the state that the part begins in."""
        return _State(tuple(self.part.initial.get(place, 0) for place in self.part.places), requests=self.requests)

    def successors(self, state: _State, possible: Sequence[int], is_at_rest: bool) -> Iterator[tuple[str, _State]]:
        """Yield everything that can happen next, given the steps that can."""
        ending = self._moods(state)[1]
        for number in possible:
            step, requests = self.part.steps[number], state.requests
            self.fired.add(number)
            if step.call is not None:
                position = self.calls[step.call]
                before = requests[position]
                if wrong := misuse(step, before, ending=ending):
                    raise Unsound(wrong)
                if (after := following(step, before)) is not before:
                    requests = (*requests[:position], after, *requests[position + 1 :])
            tokens = list(state.tokens)
            for place, weight in step.inputs.items():
                tokens[self.index[place]] -= weight
            for place, weight in step.outputs.items():
                tokens[self.index[place]] += weight
            restores = step.counted.restores if step.counted else None
            if state.restored and restores is False:
                raise Unsound(f"{step.name} counts on after something was counted back, which may go on for ever")
            yield step.name, _State(tuple(tokens), state.stop, state.supplied, requests, state.restored or bool(restores))
        if state.supplied < len(self.part.supplies):
            tokens = list(state.tokens)
            for place in self.part.supplies[state.supplied]:
                tokens[self.index[place]] += 1
            yield _SUPPLY, replace(state, tokens=tuple(tokens), supplied=state.supplied + 1)
        # Entered again only once it has come to rest, and with its counters as they are: that they are full again is to be shown.
        elif self.part.repeats and is_at_rest:
            tokens = [
                state.tokens[number] if number in self.lasting else self.part.initial.get(place, 0) for place, number in self.index.items()
            ]
            yield _AGAIN, _State(tuple(tokens), 0 if state.stop == 1 else state.stop, requests=(Life.NONE,) * len(self.calls))
        if self.part.finals and any(state.tokens[place] for place in self.ends):
            return  # it is over: nobody stops it any more
        for stop in self.stops:
            if stop > state.stop:  # a stop may come at any moment, between any two firings
                yield _STOPS[stop], replace(state, stop=stop)

    def _moods(self, state: _State) -> tuple[bool, bool, bool]:
        failing = state.stop > 1 or any(state.tokens[place] for place in self.failures)
        ending = failing or state.stop > 0 or any(state.tokens[place] for place in self.restarts)
        return failing, ending, state.stop == 3 or (ending and self.part.cancels)

    def possible(self, state: _State) -> list[int]:
        """Return the enabled steps whose guards may be open, as `pnm.core.execution.run` asks them: in order, at each marked place.

        Reports are not asked for at a place: they come when they like as long as their request is alive.
        """
        moods = self._moods(state)
        possible: dict[int, None] = {}
        enabled: dict[int, bool] = {}
        for place, tokens in enumerate(state.tokens):
            if tokens and place not in self.records:
                possible |= dict.fromkeys(self._exits(place, state, moods, enabled)[0])
        if Life.ALIVE in state.requests:
            for call, position in self.calls.items():
                if state.requests[position] is Life.ALIVE:
                    reports = (number for number in self.reports_of[call] if number not in possible)
                    enabled_now = (number for number in reports if self._is_enabled(self.part.steps[number], state))
                    possible |= dict.fromkeys(number for number in enabled_now if self._may_come(self.part.steps[number], state))
        return [*possible]

    def _may_come(self, step: Step, state: _State) -> bool:
        """Return whether a report, or an adoption, may come in this state: as far as the request of the call is concerned."""
        if step.call is None:
            return True
        life = state.requests[self.calls[step.call]]
        accepts = life is Life.ALIVE and any(self._is_enabled(other, state) for other in self.accepts[step.call])
        return may_come(step, life, accepts=accepts)

    def _exits(self, place: int, state: _State, moods: tuple[bool, bool, bool], enabled: dict[int, bool]) -> tuple[list[int], bool]:
        """Return which steps may be open at a place, and whether those after them wait for resources."""
        exits: list[int] = []
        for number in self.consumers[place]:
            step = self.part.steps[number]
            if number not in enabled:
                enabled[number] = self._is_enabled(step, state)
            if not enabled[number]:
                # As in the run: the call stands in line here, and the rules after this one are not asked.
                if self._lacks_resources(step, state) and not isinstance(step.guard, Adopted):
                    return exits, True
                continue
            is_open = _is_open(step.guard, *moods)
            if is_open is None and isinstance(step.guard, Adopted | Accepts | Ends):
                is_open = None if self._may_come(step, state) else False
                if isinstance(step.guard, Adopted) and is_open is None:
                    is_open = True
            if is_open is not False:  # guards that ask the world may go either way, so both are followed
                exits.append(number)
            if is_open is True and not step.counted:  # rules after one that is surely open are never asked
                break
        return exits, False

    def _starves(self, state: _State) -> bool:
        """Return whether resources are waited for, and nothing else is sure to happen."""
        moods, waits, enabled = self._moods(state), False, dict[int, bool]()
        for place, tokens in enumerate(state.tokens):
            if tokens and place not in self.records:
                exits, waiting = self._exits(place, state, moods, enabled)
                steps = (self.part.steps[number] for number in exits)
                sure = (step for step in steps if not step.counted)
                if (not waiting and exits) or any(isinstance(step.guard, After | Due) or _is_open(step.guard, *moods) for step in sure):
                    return False
                waits = waits or waiting
        return waits

    def _may_be_unanswered(self, place: int) -> bool:
        """Return whether the world is asked at the place, and the exits that need nothing else are not enough."""
        name, steps = self.part.places[place], [self.part.steps[number] for number in self.consumers[place]]
        alone = [step.guard for step in steps if step.inputs == {name: 1} and not isinstance(step.guard, Inside)]
        others = [step.guard for step in steps if step.inputs != {name: 1}]
        if not any(_asks_the_world(step.guard) for step in steps) or Always() in alone:
            return False
        return any(isinstance(guard, Ends) for guard in others) or bool(missing_exit(list(filter(_asks_the_world, alone))))

    def _unanswered(self, place: int, state: _State) -> str:
        """Return for which answer of the world no exit opens in finite time, if one is waited for and for no resources."""
        steps = [self.part.steps[number] for number in self.consumers[place]]
        if any(self._lacks_resources(step, state) for step in steps):
            return ""
        enabled = [step for step in steps if self._is_enabled(step, state)]
        moods = self._moods(state)
        return min((max((lacking_exit(case, moods) for case in cases), key=len) for cases in in_each_case(enabled)), key=len)

    def is_stuck(self, state: _State, possible: Sequence[int]) -> bool:
        """Return whether, in some case of the counters, none of the possible steps is: nothing happens without something from outside."""
        steps = [self.part.steps[number] for number in possible]
        if any(not step.counted for step in steps):
            return False
        moods = self._moods(state)
        for place in {self.index[name] for step in steps for name in step.inputs} - self.records:
            enabled = [step for number in self.consumers[place] if self._is_enabled(step := self.part.steps[number], state)]
            if any(all(any(_is_open(step.guard, *moods) for step in case) for case in cases) for cases in in_each_case(enabled)):
                return False
        return True

    def _is_enabled(self, step: Step, state: _State) -> bool:
        tokens = state.tokens
        return all(tokens[place] >= weight for place, weight in self.needs[self.number[id(step)]])

    def _lacks_resources(self, step: Step, state: _State) -> bool:
        """Return whether the step would be enabled if all resources were free."""
        if self.resources.keys().isdisjoint(self.index[name] for name in step.inputs):
            return False
        own = ((self.index[name], weight) for name, weight in step.inputs.items())
        lacking = {place for place, weight in own if state.tokens[place] < weight}
        return bool(lacking) and lacking <= self.resources.keys()

    def check(self, state: _State, possible: Sequence[int], stuck: bool) -> str:
        """Return what is wrong with a state; empty when nothing is."""
        for number, tokens in enumerate(state.tokens):
            # Safe places are what makes guards and times meaningful: the time of a marking is one number per place.
            if tokens > self.most[number]:
                return f"{self.part.places[number]} holds {tokens} tokens"
        for number in self.asking:
            if state.tokens[number] and (wrong := self._unanswered(number, state)):
                return f"{self.part.places[number]} {wrong}"
        # Hold and wait is one of the conditions of a deadlock; it is excluded here, so that runs cannot block each other.
        keeps = any(state.tokens[place] < tokens for place, tokens in self.resources.items())
        if keeps and (stuck or any(isinstance(self.part.steps[number].guard, Inside) for number in possible)):
            return "it waits for others while it keeps resources that they may need"
        if self.resources and self._starves(state):
            return "it waits for resources that no call gives back"
        if wrong := self._ends_too_soon(state) or self._loses_reports(state):
            return wrong
        if not stuck:
            return ""
        missing = len(self.part.supplies) - state.supplied
        # What the start of a block gives must not wait for inputs that only its end needs: neighbours may wait for it.
        if missing == 1 and (late := [place for place in self.part.early if not state.tokens[self.index[place]]]):
            return f"{late[0]} is not marked although only later inputs are missing"
        if missing:  # more inputs are to come, so to be at rest is no end yet
            return ""
        left = {
            place: state.tokens[number] for place, number in self.index.items() if state.tokens[number] and place not in self.part.records
        }
        return self._why_improper(left)

    def _ends_too_soon(self, state: _State) -> str:
        """Return what is still going on although the end of the part is marked; empty when nothing is, or it is not."""
        ended = [place for place in self.ends if state.tokens[place]]
        if not ended:
            return ""
        name, places = self.part.places[ended[0]], self.part.places
        if busy := [places[number] for number, tokens in enumerate(state.tokens) if tokens and number not in self.may_rest]:
            return f"{name} is marked although {busy[0]} still is"
        if Life.ALIVE in state.requests or Life.ADOPTABLE in state.requests:
            return f"{name} is marked although a request is alive"
        if self.part.goal in map(places.__getitem__, ended) and self._moods(state)[1]:
            return f"{name} is marked although the run is ending"
        return ""

    def _loses_reports(self, state: _State) -> str:
        """Return for which request that is alive an end would be lost, or be taken for that of a call at rest."""
        alive = [call for call, position in self.calls.items() if state.requests[position] is Life.ALIVE]
        if not alive:
            return ""
        if len(alive) > sum(state.tokens[place] for place in self.alive):
            return "a request is alive, and no place is marked that says so"
        for call in alive:
            steps = [self.part.steps[number] for number in self.reports_of[call]]
            if lost := untaken([step for step in steps if self._is_enabled(step, state)]):
                return f"nothing takes the report that a request has {'/'.join(sorted(kind.value for kind in lost))}"
        return ""

    def _why_improper(self, left: Mapping[str, int]) -> str:
        """Return what is wrong with a final marking of all but record places; empty when it is proper."""
        part = self.part
        kept = {place: part.initial[place] for place in part.resources - part.records if place in part.initial}
        ends = [place for place in left if place in part.finals]
        expected = {**kept, **dict.fromkeys(part.outputs, 1), **dict.fromkeys(ends[:1], 1)}
        if part.finals and (len(ends) != 1 or left != expected):
            return f"it ends in {dict(left)}"
        return "" if left == expected else f"it leaves {dict(left)} in place of {expected}"


_Trace: TypeAlias = "tuple[_Trace, str] | None"
"""Trace to a state: the last step, and the trace before it."""
_Reached: TypeAlias = tuple[_State, _Trace]

_STOPS: Final = ("", "restart elsewhere", "stop", "cancel")
_AGAIN: Final = "enter again"
_SUPPLY: Final = "supply"
_FROM_OUTSIDE: Final = frozenset((*_STOPS, _AGAIN, _SUPPLY))
"""What happens to a part from outside; no step of its own may be called so."""


def _is_open(guard: Guard | Inside, failing: bool, ending: bool, cancel: bool) -> bool | None:
    """Return whether the guard is open, closed, or either, depending on the world."""
    match guard:
        case Always():
            return True
        case Ending():
            return ending
        case Failing():
            return failing
        case CancelAsked():
            return cancel
        case _:
            return None


def lacking_exit(steps: Sequence[Step], moods: tuple[bool, bool, bool]) -> str:
    """Return for which answer of the world none of the enabled steps at a place opens; empty if one does, or the world is not asked."""
    guards = [step.guard for step in steps]
    asking = [guard for guard in guards if not isinstance(guard, Inside) and _asks_the_world(guard)]
    return missing_exit(asking) if asking and not any(_is_open(guard, *moods) for guard in guards) else ""


def _asks_the_world(guard: Guard | Inside) -> bool:
    """Return whether the guard opens because of the world, of a request from outside, or of time."""
    return not isinstance(guard, Inside) and _is_open(guard, False, False, False) is None


@dataclass(frozen=True, slots=True)
class Exploration:
    """What was found in all states of a part."""

    states: int
    """How many there are."""
    unfired: tuple[int, ...]
    """The numbers of the steps that never happen."""


def explore_part(part: Part) -> Exploration:
    """Walk through every state of the part.

    Raises:
        Unsound: some state is wrong, something can go round for ever, or there are too many states.
    """
    if confusing := [step.name for step in part.steps if step.name in _FROM_OUTSIDE]:
        raise Unsound(f"a step is called {confusing[0]!r}, as is what happens from outside")
    check_steps(part)
    explorer = _Explorer(part)
    # pauses and entries come from outside, as often as they like: what follows from there is walked through apart
    # so is what is counted: `successors` makes sure that it comes to an end
    # A cycle through them is no error: pauses are assumed to be finitely many, and entries are counted by whatever holds the block.
    apart = {step.name for step in part.steps if isinstance(step.guard, PauseAsked) or step.counted} | {_AGAIN}
    roots: list[_Reached] = [(explorer.start(), None)]
    seen: set[_State] = set()
    while roots:
        root = roots.pop()
        if root[0] not in seen:
            roots += _walk(explorer, root, seen, apart)
    return Exploration(len(seen), tuple(number for number in range(len(part.steps)) if number not in explorer.fired))


def _walk(explorer: _Explorer, root: _Reached, seen: set[_State], apart: Set[str]) -> list[_Reached]:
    """Walk through every state that is reached from the root but by some steps; return what those lead to."""
    path: list[tuple[_Reached, Iterator[tuple[str, _State]]]] = []  # an explicit stack: plans may be deeper than Python's recursion limit
    on_path: set[_State] = set()
    left: dict[_State, _Reached] = {}

    def enter(reached: _Reached) -> None:
        state, trace = reached
        possible = explorer.possible(state)
        stuck = explorer.is_stuck(state, possible)
        try:
            nexts = list(explorer.successors(state, possible, stuck))
        except Unsound as error:
            raise Unsound(str(error), _names(trace)) from error
        if wrong := explorer.check(state, possible, stuck):
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
