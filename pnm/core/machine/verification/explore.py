"""Every state that a part of a machine can reach, whatever the world answers.

A part is a whole machine, or a block of it with its inputs supplied from outside at any moment.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field
from enum import Enum
from typing import Final, NamedTuple, TypeAlias

from pnm.core.machine.machine import Adopted, After, Always, CancelAsked, Due, Ending, Ends, Failing, Guard, PauseAsked
from pnm.core.machine.verification.exits import missing_exit
from pnm.core.net.net import Weights
from pnm.errors import PnmError

MAX_STATES: Final = 2_000_000


class Unsound(PnmError):
    """The machine can reach a state it must not reach; `trace` leads there."""

    def __init__(self, what: str, trace: Sequence[str] = ()) -> None:
        super().__init__(f"{what}{f'; after {chr(32).join(trace)}' if trace else ''}")
        self.trace = tuple(trace)


@dataclass(frozen=True, slots=True)
class Inside:
    """In the place of a guard: what happens inside a region, which takes its time but comes to an end."""


class Left(Enum):
    """How much of a counter is left."""

    ALL = "all"
    SOME = "some"
    NONE = "none"

    __hash__ = object.__hash__  # each is there once


class Count(NamedTuple):
    """What a step asks of a counter, a pair of places that one place stands for."""

    place: str
    cases: frozenset[Left]
    """Those in which the step is enabled."""
    possible: frozenset[Left]
    """All cases of this counter."""
    restores: bool | None
    """Whether the step moves a token back, or on; None if it takes all of them away."""


class Step(NamedTuple):
    """A transition of a part of a net, or all that happens inside a region."""

    name: str
    guard: Guard | Inside
    inputs: Weights
    outputs: Weights
    counted: Count | None = None
    """What it asks of a counter, which may be so or not at any time."""


Tokens: TypeAlias = tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of a machine with what surrounds it: inputs that come once, at any moment."""

    places: tuple[str, ...]
    steps: tuple[Step, ...]
    initial: Mapping[str, int]
    supplies: tuple[tuple[str, ...], ...] = ()
    """Sets of places that get their tokens from outside, each set at once."""
    failures: frozenset[str] = frozenset()
    records: frozenset[str] = frozenset()
    """Places that may stay marked."""
    counters: frozenset[str] = frozenset()
    """Those of them from which nothing starts: what takes from them is asked for at other places."""
    cancels: bool = False
    """Whether a failure has running calls cancelled."""
    outputs: frozenset[str] = frozenset()
    """Places that are marked in the end, each once: others take from them."""
    finals: frozenset[str] = frozenset()
    """Final places: exactly one is marked in the end, if there are any."""
    early: frozenset[str] = frozenset()
    """Places that must be marked once nothing more can happen without the last supply."""
    restarts: frozenset[str] = frozenset()
    """Places that ask for the plan to begin anew."""
    others_restart: bool = False
    """Whether other parts may ask for that."""
    repeats: bool = False
    """Whether it may be entered again once it was left, with its counters as they then are."""
    resources: frozenset[str] = frozenset()
    """Places that others take from as well: a step that lacks nothing else is waited for, and the rules after it are not asked."""


@dataclass(frozen=True, slots=True)
class _State:
    tokens: Tokens
    stop: int = 0
    """0: going on, 1: another part asks for the plan to begin anew, 2: a stop, 3: a stop that cancels."""
    supplied: int = 0
    """How many of the supplies have come."""
    restored: bool = False
    """Whether something that was counted has come back since the part was entered."""


@dataclass
class _Explorer:
    part: Part
    index: dict[str, int] = field(init=False)
    consumers: list[list[int]] = field(init=False)

    most: list[int] = field(init=False)
    """How many tokens each place may hold."""

    def __post_init__(self) -> None:
        self.index = {place: number for number, place in enumerate(self.part.places)}
        self.consumers = [[] for _ in self.part.places]
        for number, step in enumerate(self.part.steps):
            for place in step.inputs:
                self.consumers[self.index[place]].append(number)
        self.failures = [self.index[place] for place in self.part.failures]
        self.restarts = [self.index[place] for place in self.part.restarts]
        self.counters = {self.index[place] for place in self.part.counters if place in self.index}
        self.resources = {self.index[place]: self.part.initial.get(place, 0) for place in self.part.resources}
        self.records = self.counters | self.resources.keys()
        self.asking = [place for place in range(len(self.part.places)) if place not in self.records and self._may_be_unanswered(place)]
        self.stops = (1, 2, 3) if self.part.others_restart else (2, 3)
        budget = sum(tokens for place, tokens in self.part.initial.items() if place in self.part.records)
        self.most = [budget if place in self.part.records - self.part.failures else 1 for place in self.part.places]

    def successors(self, state: _State) -> Iterator[tuple[str, _State]]:
        """Yield everything that can happen next."""
        for step in self._possible(state):
            tokens = list(state.tokens)
            for place, weight in step.inputs.items():
                tokens[self.index[place]] -= weight
            for place, weight in step.outputs.items():
                tokens[self.index[place]] += weight
            restores = step.counted.restores if step.counted else None
            if state.restored and restores is False:
                raise Unsound(f"{step.name} counts on after something was counted back, which may go on for ever")
            yield step.name, _State(tuple(tokens), state.stop, state.supplied, state.restored or bool(restores))
        if state.supplied < len(self.part.supplies):
            tokens = list(state.tokens)
            for place in self.part.supplies[state.supplied]:
                tokens[self.index[place]] += 1
            yield _SUPPLY, _State(tuple(tokens), state.stop, state.supplied + 1, state.restored)
        elif self.part.repeats and not self._possible(state):
            tokens = [
                (0 if number in self.restarts else state.tokens[number]) if number in self.counters else self.part.initial.get(place, 0)
                for place, number in self.index.items()
            ]
            yield _AGAIN, _State(tuple(tokens), 0 if state.stop == 1 else state.stop)
        for stop in self.stops:
            if stop > state.stop:
                yield _STOPS[stop], _State(state.tokens, stop, state.supplied, state.restored)

    def _moods(self, state: _State) -> tuple[bool, bool, bool]:
        failing = state.stop > 1 or any(state.tokens[place] for place in self.failures)
        ending = failing or state.stop > 0 or any(state.tokens[place] for place in self.restarts)
        return failing, ending, state.stop == 3 or (ending and self.part.cancels)

    def _possible(self, state: _State) -> list[Step]:
        """Return the enabled steps whose guards may be open, as `pnm.core.execution.run` asks them: in order, at each marked place."""
        moods = self._moods(state)
        found: dict[int, None] = {}
        enabled: dict[int, bool] = {}
        for place, tokens in enumerate(state.tokens):
            if tokens and place not in self.records:
                found |= dict.fromkeys(self._exits(place, state, moods, enabled)[0])
        return [self.part.steps[number] for number in found]

    def _exits(self, place: int, state: _State, moods: tuple[bool, bool, bool], enabled: dict[int, bool]) -> tuple[list[int], bool]:
        """Return which steps may be open at a place, and whether those after them wait for resources."""
        found: list[int] = []
        for number in self.consumers[place]:
            step = self.part.steps[number]
            if number not in enabled:
                enabled[number] = self._is_enabled(step, state)
            if not enabled[number]:
                if self._lacks_resources(step, state) and not isinstance(step.guard, Adopted):
                    return found, True
                continue
            is_open = _is_open(step.guard, *moods)
            if is_open is not False:
                found.append(number)
            if is_open is True and not step.counted:
                break
        return found, False

    def _starves(self, state: _State) -> bool:
        """Return whether resources are waited for, and nothing else is sure to happen."""
        moods, waits, enabled = self._moods(state), False, dict[int, bool]()
        for place, tokens in enumerate(state.tokens):
            if tokens and place not in self.records:
                found, waiting = self._exits(place, state, moods, enabled)
                steps = (self.part.steps[number] for number in found)
                if any(
                    not waiting or isinstance(step.guard, After | Due) or _is_open(step.guard, *moods) for step in steps if not step.counted
                ):
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
        return min((max(self._unsure(case, state) for case in cases) for cases in _cases(enabled)), key=len)

    def _unsure(self, steps: Sequence[Step], state: _State) -> str:
        """Return for which answer of the world none of the enabled steps at a place opens; empty if one does, or the world is not asked."""
        guards = [step.guard for step in steps]
        asking = [guard for guard in guards if not isinstance(guard, Inside) and _asks_the_world(guard)]
        if not asking or any(_is_open(guard, *self._moods(state)) for guard in guards):
            return ""
        return missing_exit(asking)

    def is_stuck(self, state: _State) -> bool:
        """Return whether nothing may happen without something from outside, in some case of the counters."""
        possible = self._possible(state)
        if any(not step.counted for step in possible):
            return False
        moods = self._moods(state)
        for place in {place for step in possible for place in step.inputs} - self.part.records:
            enabled = [step for number in self.consumers[self.index[place]] if self._is_enabled(step := self.part.steps[number], state)]
            if any(all(any(_is_open(step.guard, *moods) for step in case) for case in cases) for cases in _cases(enabled)):
                return False
        return True

    def _is_enabled(self, step: Step, state: _State) -> bool:
        return all(state.tokens[self.index[one]] >= weight for one, weight in step.inputs.items())

    def _lacks_resources(self, step: Step, state: _State) -> bool:
        """Return whether the step would be enabled if all resources were free."""
        if self.resources.keys().isdisjoint(self.index[one] for one in step.inputs):
            return False
        own = ((self.index[one], weight) for one, weight in step.inputs.items())
        lacking = {place for place, weight in own if state.tokens[place] < weight}
        return bool(lacking) and lacking <= self.resources.keys()

    def check(self, state: _State, stuck: bool) -> str:
        """Return what is wrong with a state; empty when nothing is."""
        for number, tokens in enumerate(state.tokens):
            if tokens > self.most[number]:
                return f"{self.part.places[number]} holds {tokens} tokens"
        for number in self.asking:
            if state.tokens[number] and (wrong := self._unanswered(number, state)):
                return f"{self.part.places[number]} {wrong}"
        keeps = any(state.tokens[place] < tokens for place, tokens in self.resources.items())
        if keeps and (stuck or any(isinstance(step.guard, Inside) for step in self._possible(state))):
            return "it waits for others while it keeps resources that they may need"
        if self.resources and self._starves(state):
            return "it waits for resources that nobody gives back"
        if not stuck:
            return ""
        missing = len(self.part.supplies) - state.supplied
        if missing == 1 and (late := [place for place in self.part.early if not state.tokens[self.index[place]]]):
            return f"{late[0]} is not marked although only later inputs are missing"
        if missing:
            return ""
        left = {
            place: state.tokens[number] for place, number in self.index.items() if state.tokens[number] and place not in self.part.records
        }
        return self._why_improper(left)

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


def _cases(steps: Sequence[Step]) -> Iterator[list[list[Step]]]:
    """Yield for each counter that the steps ask for, if there is one, which of the steps are enabled in each of its cases.

    Steps that ask for others are left out: they may be enabled or not.
    """
    counts = {step.counted.place: step.counted for step in steps if step.counted}
    if not counts:
        yield [[*steps]]
    for place, count in counts.items():
        own = [step for step in steps if not step.counted or step.counted.place == place]
        yield [[step for step in own if not step.counted or case in step.counted.cases] for case in count.possible]


def _asks_the_world(guard: Guard | Inside) -> bool:
    """Return whether the guard opens because of the world, of a request from outside, or of time."""
    return not isinstance(guard, Inside) and _is_open(guard, False, False, False) is None


def explore_part(part: Part) -> int:
    """Walk through every state of the part and return their number.

    Raises:
        Unsound: some state is wrong, something can go round for ever, or there are too many states.
    """
    if confusing := [step.name for step in part.steps if step.name in _FROM_OUTSIDE]:
        raise Unsound(f"a step is called {confusing[0]!r}, as is what happens from outside")
    explorer = _Explorer(part)
    # pauses and entries come from outside, as often as they like: what follows from there is walked through apart
    # so is what is counted, which comes to an end
    apart = {step.name for step in part.steps if isinstance(step.guard, PauseAsked) or step.counted} | {_AGAIN}
    start = _State(tuple(part.initial.get(place, 0) for place in part.places))
    roots: list[_Reached] = [(start, None)]
    seen: set[_State] = set()
    while roots:
        root = roots.pop()
        if root[0] not in seen:
            roots += _walk(explorer, root, seen, apart)
    return len(seen)


def _walk(explorer: _Explorer, root: _Reached, seen: set[_State], apart: Set[str]) -> list[_Reached]:
    """Walk through every state that is reached from the root but by some steps; return what those lead to."""
    path: list[tuple[_Reached, Iterator[tuple[str, _State]]]] = []
    on_path: set[_State] = set()
    left: dict[_State, _Reached] = {}

    def enter(reached: _Reached) -> None:
        state, trace = reached
        nexts = list(explorer.successors(state))
        stuck = explorer.is_stuck(state)
        if wrong := explorer.check(state, stuck):
            raise Unsound(wrong, _names(trace))
        if len(seen) > MAX_STATES:
            raise Unsound(f"more than {MAX_STATES} states")
        seen.add(state)
        on_path.add(state)
        path.append((reached, iter(nexts)))

    enter(root)
    while path:
        (state, trace), nexts = path[-1]
        found = next(nexts, None)
        if found is None:
            path.pop()
            on_path.remove(state)
            continue
        name, following = found
        if name in apart:
            if following not in seen:
                left.setdefault(following, (following, (trace, name)))
        elif following in on_path:
            raise Unsound("it can go round for ever", _names((trace, name)))
        elif following not in seen:
            enter((following, (trace, name)))
    return list(left.values())


def _names(trace: _Trace) -> list[str]:
    found: list[str] = []
    while trace is not None:
        trace, name = trace
        found.append(name)
    return found[::-1]
