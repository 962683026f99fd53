"""State of a run besides its marking: the time, stop and pause, and what is to be asked."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from itertools import compress, count
from math import inf
from typing import Any, ClassVar, Final
from uuid import UUID

from pnm.core.execution.call_results import CallResults
from pnm.core.execution.events import InHands, Pause, Resume, Settled, SingleStep, Stop
from pnm.core.execution.handover import UnderWay
from pnm.core.execution.machine_index import MachineIndex
from pnm.core.kept_state import KeptState
from pnm.core.knowledge_base import Layered, Readers
from pnm.core.logic.expressions import Fluent
from pnm.core.logic.rules import Rules
from pnm.core.machine.machine import OnFailure
from pnm.core.net.block_net import Engine
from pnm.errors import RunError

_LEFT: Final = 16
"""How many timers of places that tokens have left are kept at most, beside one for each of the others."""


class Agenda(KeptState):
    """Places to be asked, in their order, and those that are *undecided*: nothing is open there yet, so they are asked again.

    The mutable state is what the constructor sets under "state".
    """

    KEPT = ("undecided", "_count", "_asked", "_timers", "_set", "_wake")

    def __init__(self, index: MachineIndex, knowledge: Layered) -> None:
        self._index = index
        self._world, self._local = knowledge.world, knowledge.local
        # state
        self.begins_to_listen: Callable[[], object] = lambda: None
        """Called when the first of them begins to wait for facts to change."""
        self.places: deque[int] = deque()
        """Those to be asked."""
        self.undecided: dict[int, int] = {}
        """Those to be asked again, in this order, which they are numbered by."""
        self._count = 0
        self._readers = Readers[int]()
        """Those of them that are asked again when facts change."""
        self._read_by(knowledge.world.rules)
        self._asked = (knowledge.world.changes, knowledge.local.changes)
        """The number of changes when they were asked last."""
        self._timers: list[tuple[float, int]] = []
        """A queue of the times at which places are asked again."""
        self._set: dict[int, float] = {}
        """By undecided place, the earliest of them."""
        self._wake = inf
        """The time that was asked for last."""

    def values(self) -> dict[str, Any]:
        """Return the state, without the changes that concern nothing in it."""
        return {**super().values(), "_asked": self.asked()}

    def restore(self, values: Mapping[str, Any]) -> None:
        """Take a state back; what is read at undecided places follows from the machine."""
        super().restore(values)
        for place in self.undecided:
            if self._index.decision(place).listens:
                self._readers.add(place, self._reads[place])

    def asked(self) -> tuple[int, int]:
        """Return the number of changes of the world, and of the knowledge of the run, since which some may concern an undecided place."""
        world, local = self._world.changed_since(self._asked[0]), self._local.changes - self._asked[1]
        if not self.listens or (world is not None and not local and not (world and self._readers.concerned(world))):
            self._asked = self._world.changes, self._local.changes
        return self._asked

    def wait(self, place: int, *, listens: bool) -> None:
        """Have a place asked again: it is undecided; if it `listens`, also when facts change."""
        if place not in self.undecided:
            self.undecided[place] = self._count
            self._count += 1
            if listens:
                self._readers.add(place, self._reads[place])
                if len(self._readers.reads) == 1:  # it was decided just now
                    self._asked = self._world.changes, self._local.changes
                    self.begins_to_listen()

    def wait_until(self, place: int, time: float) -> None:
        """Have a place asked again at a time, if at no other."""
        self.wait(place, listens=False)
        if time < inf:
            self.set_timer(place, time)

    def leave(self, place: int) -> None:
        """Do not ask a place again, if it was undecided."""
        self._set.pop(place, None)
        if self.undecided.pop(place, None) is not None and place in self._readers.reads:
            self._readers.remove(place)

    def set_timer(self, place: int, time: float) -> None:
        """Set the time at which the place is asked again, if it is not asked earlier: then it is set anew, if need be."""
        if time < self._set.get(place, inf):
            self._set[place] = time
            heappush(self._timers, (time, place))
            if len(self._timers) > _LEFT + 2 * len(self._set):
                self._timers = [entry for entry in self._timers if self._set.get(entry[1]) == entry[0]]
                heapify(self._timers)

    def ask_undecided(self) -> None:
        """Ask all undecided places again."""
        self.places.extend(self.undecided)

    @property
    def listens(self) -> bool:
        """Whether places are asked again when facts change."""
        return bool(self._readers.reads)

    def hears_of(self, changed: Collection[Fluent]) -> bool:
        """Return whether places are asked again when these facts change, or, if there are none, something else that is known."""
        if not self.listens:
            return False
        return not changed or self._world.rules is not self._rules or bool(self._readers.concerned(changed))

    def ask_about_knowledge(self, now: float, *, of_all: bool = False) -> None:
        """Ask those places again, in their order, whose decision may be another one since they were asked last.

        With `of_all`, the run may have begun to end meanwhile: all that listen are asked, since each has an exit for that.
        """
        if not self._readers:
            return
        if self._world.rules is not self._rules:  # the world has begun anew
            self._read_by(self._world.rules)
        world, local = self._world.changed_since(self._asked[0]), self._local.changed_since(self._asked[1])
        self._asked = self._world.changes, self._local.changes
        is_due = self._timers and self._timers[0][0] <= now  # then time may have decided as well, whatever has changed
        if world is None or local is None or is_due or of_all:
            self.places.extend([place for place in self.undecided if self._index.decision(place).listens])
        elif concerned := self._readers.concerned(world):
            self.places.extend(sorted(concerned, key=self.undecided.__getitem__))

    def _read_by(self, rules: Rules) -> None:
        """Note the fluents read at places where the world derives facts by these rules: the plan may know only some, or equal ones."""
        self._rules, self._reads = rules, self._index.reads[rules]
        listening, self._readers = self._readers.reads, Readers[int]()
        for place in listening:
            self._readers.add(place, self._reads[place])

    def ask_due(self, now: float) -> None:
        """Ask the places again whose time has come."""
        self.ask_for_timer_anew()
        while self._timers and self._timers[0][0] <= now:
            time, place = heappop(self._timers)
            if self._set.get(place) == time:
                del self._set[place]
                self.places.append(place)

    def ask_for_timer_anew(self) -> None:
        """Note that no timer is set outside any more: the next one has to be asked for even if it is not earlier."""
        self._wake = inf

    @property
    def awaits_time(self) -> bool:
        """Whether a place is asked again at some time; timers of places that tokens have left do not count."""
        return bool(self._set)

    def next_timer(self) -> float | None:
        """Return the time of a timer that has to be asked for. A later one than the last needs none: after that it is asked for anew."""
        while self._timers and self._set.get(self._timers[0][1]) != self._timers[0][0]:
            heappop(self._timers)  # of a place that a token has left
        if self._timers and self._timers[0][0] < self._wake:
            self._wake = self._timers[0][0]
            return self._wake
        return None


@dataclass
class RunState(KeptState):
    """State of a run that guards read besides knowledge. The mutable state is what has a default."""

    KEPT: ClassVar = ("origin", "has_begun", "now", "stop", "pause", "hands", "is_stepping", "ending", "settled", "adopted")

    engine: Engine
    index: MachineIndex
    results: CallResults
    origin: float | None = None
    """The time from which releases count."""
    has_begun: bool = False
    now: float = -inf
    stop: Stop | None = None
    """The request to stop, if there was one."""
    pause: Pause | None = None
    """The request to pause, until the run is resumed."""
    hands: tuple[str, ...] = ()
    """The robots, and other objects and resources, that people have in their hands."""
    is_stepping: bool = False
    """Whether one call may send its request although the run is paused."""
    ending: bool = False
    """Whether nothing more is started."""
    settled: dict[UUID, Settled] = field(default_factory=dict)
    """By request that is under way, how a person says that it ends."""
    adopted: dict[int, UnderWay] = field(default_factory=dict)
    """Requests of another run that are still to be taken over, by call."""
    marked_at: list[float] = field(init=False)
    """The time at which places were marked last."""

    def __post_init__(self) -> None:
        self.marked_at = [self.now] * len(self.engine.tokens)

    def restore(self, values: Mapping[str, Any]) -> None:
        """Take a state back; that of an older journal knows of no hands."""
        super().restore({"hands": (), **values})

    def begin(self) -> list[int]:
        """Begin the run; return the places that are marked at first, and at which something is decided."""
        if self.has_begun:
            raise RunError("the run has begun already")
        self.has_begun = True
        self.origin = self.now if self.origin is None else self.origin
        marked = compress(count(), self.engine.tokens)
        first = [place for place in marked if place not in self.index.records]
        for place in first:
            self.marked_at[place] = self.now
        return first

    def follow(self, asked: Stop | Pause | Resume | InHands | SingleStep) -> None:
        """Stop, pause, go on, or leave to people what they have; a stop, and a pause, may become stricter, but never milder."""
        match asked:
            case Stop():
                self.stop = asked if self.stop is None or asked.cancel else self.stop
            case Pause(at_once):
                self.pause = Pause(at_once or self.suspends)
            case Resume():
                self.pause = None
            case InHands(names):
                self.hands = names
            case SingleStep() if self.pause is not None:
                self.pause, self.is_stepping = Pause(), True
            case SingleStep():
                pass
        self.turn()

    def turn(self) -> bool:
        """Find out whether the run is ending now; return whether that is news."""
        was_ending, restarts, tokens = self.ending, self.index.restarts, self.engine.tokens
        self.ending = self.failing or any(tokens[place] for place in restarts)
        return self.ending and not was_ending

    @property
    def passed(self) -> float:
        """The seconds since the plan's start."""
        return self.now - (self.origin or 0.0)

    @property
    def over(self) -> bool:
        """Whether the goal place or the failed place is marked."""
        return bool(self.engine.tokens[self.index.goal] or self.engine.tokens[self.index.failed])

    @property
    def failing(self) -> bool:
        """Whether the run can no longer succeed."""
        return bool(self.results.failures) or self.stop is not None

    @property
    def cancels(self) -> bool:
        """Whether running calls shall be cancelled."""
        cancelled = self.stop is not None and self.stop.cancel
        return cancelled or (self.ending and self.index.on_failure is OnFailure.CANCEL)

    @property
    def suspends(self) -> bool:
        """Whether running calls shall be cancelled, to begin anew later."""
        return self.pause is not None and self.pause.at_once

    @property
    def idle(self) -> bool:
        """Whether no call is under way."""
        return not any(self.engine.tokens[place] for place in self.index.alive)
