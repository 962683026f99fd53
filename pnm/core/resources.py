"""Resources that several runs share: the claims granted, and those that wait in line.

A claim gets all that it names at once, or nothing; a request that has resources waits for no others. In line stand
higher priorities first, then earlier claims, and a claim takes nothing that one ahead of it waits for. So no claim is
overtaken for ever by equals, and as long as resources are given back, every claim is granted in the end.
A claim in line is told when its turn has come, and no other: what that costs does not grow with the line.

A request that was given up keeps what it has: its server may still be at work. It is *withheld* until the server reports
the end of the request, or is gone; so waits for it have a limit.

`RunClaims` are the claims of one run. It decides nothing: `pnm.core.execution.run` decides when.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections import defaultdict
from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, KeysView, Mapping
from dataclasses import dataclass
from datetime import datetime
from math import inf
from operator import itemgetter
from typing import Any, Final, Generic, TypeAlias, TypeVar
from uuid import UUID

from pnm.core.kept_state import KeptState
from pnm.errors import PnmError, RunError, counted

Place = TypeVar("Place", bound=Hashable)
_Rank: TypeAlias = tuple[int, float, UUID]
"""The position of a claim in line, the least in front: higher priorities, then earlier claims; with its request."""

_ONE_EACH: Final[Mapping[str, int]] = {}


class CapacityError(PnmError):
    """A resource is for no request at all."""


def check_capacity(name: str, capacity: int) -> None:
    """Refuse a resource that no call could ever have; raise `CapacityError`."""
    if capacity < 1:
        raise CapacityError(f"{capacity} calls may have {name} at the same time; expected 1 at least")


@dataclass(frozen=True, slots=True)
class Claim:
    """Claim of a request to resources."""

    task: UUID
    """Whose request it is."""
    request: UUID
    priority: int
    names: tuple[str, ...]


class Resources(KeptState):
    """Resources with their capacities, the requests that hold some, and the queue of those that wait.

    A resource whose capacity is not given has one of 1. The mutable state is what the constructor sets under "state". Raises a
    `CapacityError` if a resource is for no request at all.
    """

    KEPT = ("_held", "_withheld", "_line", "_told", "_joined")

    def __init__(self, capacities: Mapping[str, int] = _ONE_EACH) -> None:
        self._capacities = dict(capacities)
        for name, capacity in capacities.items():
            check_capacity(name, capacity)
        # state
        self._held: dict[UUID, Claim] = {}
        self._withheld: dict[UUID, str] = {}
        """Of those that have some, the requests that were given up, and what people know them by."""
        self._holders: defaultdict[str, dict[UUID, Claim]] = defaultdict(dict)
        """For every resource, the claims of those that have it."""
        self._line: dict[UUID, tuple[_Rank, Claim]] = {}
        """By request, the claims that wait, and how each stands in line."""
        self._lines: dict[str, list[_Rank]] = {}
        """For every resource, how those stand in line that wait for it, in order."""
        self._told: set[UUID] = set()
        """Of those in line, the requests that were told that their turn has come, or that what they wait for is withheld."""
        self._joined = 0
        """The number of claims so far."""
        self._listeners: defaultdict[UUID | None, list[Callable[[], None]]] = defaultdict(list)
        """By task, those that listen to its claims; None for all."""

    def restore(self, values: Mapping[str, Any]) -> None:
        """Take a state back, where nothing is claimed yet."""
        super().restore(values)
        for claim in self.held:
            self._hold(claim)
        for rank, claim in self._line.values():
            for name in claim.names:
                insort(self._lines.setdefault(name, []), rank)

    @property
    def held(self) -> tuple[Claim, ...]:
        """The claims that have been granted and not been given back."""
        return tuple(self._held.values())

    @property
    def line(self) -> tuple[Claim, ...]:
        """The claims that wait, those that are served first in front."""
        return tuple(claim for _, claim in sorted(self._line.values(), key=itemgetter(0)))

    def capacity(self, name: str) -> int:
        """Return the number of requests that may share the resource."""
        return self._capacities.get(name, 1)

    @property
    def capacities(self) -> Mapping[str, int]:
        """The capacities given; one for resources not listed."""
        return self._capacities

    def check_capacities(self, capacities: Mapping[str, int]) -> None:
        """Raise a `RunError` for a machine made for other capacities: what is free for a call must be free in its net."""
        for name, capacity in capacities.items():
            if capacity != self.capacity(name):
                raise RunError(f"the machine was generated for {counted(capacity, 'call')} with {name}; {self.capacity(name)} may have it")

    def is_free(self, claim: Claim) -> bool:
        """Return whether the claim would be granted now."""
        # A claim that is not in line yet is judged as if it had joined: behind its equals, before lower priorities.
        rank = behind_equals = (-claim.priority, inf, claim.request)
        standing, earlier = self._line.get(claim.request, (behind_equals, None))
        if earlier == claim:
            rank = standing
        for name in claim.names:
            line = self._lines.get(name, ())
            # What those ahead wait for counts as taken, even if it is free now: or small claims would overtake a large one for ever.
            ahead = bisect_left(line, rank)
            if earlier is not None and standing < rank and name in earlier.names:  # an earlier claim of the request itself
                ahead -= 1
            if self._used(name) + ahead >= self.capacity(name):
                return False
        return True

    def _used(self, name: str) -> int:
        return len(self._holders[name]) if name in self._holders else 0

    def take(self, claim: Claim) -> bool:
        """Grant the claim and return True, or keep it in line, once."""
        if claim.request in self._held:
            return True
        is_free = self.is_free(claim)
        if not is_free and claim.request in self._line and self._line[claim.request][1] == claim:
            return False
        # An earlier claim of the same request may have had other names, if the values of its parameters have changed since.
        earlier = self._leave(claim.request)
        if is_free:
            self._hold(claim)
        else:
            self._joined += 1
            rank = -claim.priority, self._joined, claim.request  # behind its equals
            self._line[claim.request] = rank, claim
            for name in claim.names:
                insort(self._lines.setdefault(name, []), rank)
            if any(self.outranking(claim.names)):  # nothing has become free, but those who hold what this one needs may be preempted
                self._call(None)
        if earlier is not None and earlier.names != claim.names:
            self._tell_served(earlier.names)
        return is_free

    def keep(self, claim: Claim) -> None:
        """Grant what a request already holds elsewhere, whatever is free; a claim granted before stays as it is."""
        if claim.request not in self._held:  # the run that hands it over has the claim in the same pool: it must not be counted twice
            self._hold(claim)

    def give(self, request: UUID) -> None:
        """Take back what the request has."""
        self._withheld.pop(request, None)
        claim = self._held.pop(request, None)
        if claim is not None:
            for name in claim.names:
                del self._holders[name][request]
                if not self._holders[name]:
                    del self._holders[name]
            self._tell_served(claim.names)

    def withhold(self, request: UUID, name: str) -> None:
        """Keep the resources of a request that was given up, and that people know by a name, until its end is confirmed."""
        if request in self._held:
            self._withheld[request] = name
            # Those in line have been waiting for a call to end; from now on their limit for withheld resources counts.
            self._tell(rank for name in self.withheld_from(self._held[request].names) for rank in self._lines.get(name, ()))

    def confirm(self, request: UUID) -> None:
        """Release what a request that was given up has kept: its server has confirmed the end."""
        if request in self._withheld:
            self.give(request)

    @property
    def given_up(self) -> tuple[UUID, ...]:
        """The requests that were given up, and keep resources until their end is confirmed."""
        return tuple(self._withheld)

    @property
    def withheld(self) -> Mapping[str, str]:
        """The resources of which all units are withheld, with the names of the requests."""
        return self.withheld_from(dict.fromkeys(name for request in self._withheld for name in self._held[request].names))

    def withheld_from(self, names: Iterable[str]) -> Mapping[str, str]:
        """Return which of the names are withheld altogether, and by whom."""
        keepers: dict[str, str] = {}
        for name in names if self._withheld else ():
            by = [known for request, known in self._withheld.items() if name in self._held[request].names]
            # With a unit left that is not withheld, the claim will be granted when that one is given back.
            if len(by) >= self.capacity(name):
                keepers[name] = ", ".join(by)
        return keepers

    def withdraw(self, request: UUID) -> None:
        """Take the claim of the request out of the line."""
        if (left := self._leave(request)) is not None:
            self._tell_served(left.names)

    def outranking(self, names: Iterable[str] | None = None) -> Iterator[tuple[Claim, Claim]]:
        """Yield claims in line, each with one of a lower priority that has what it needs: any resource, or one of these."""
        for name in self._lines if names is None else names:
            if self._used(name) < self.capacity(name):
                continue
            for held in self._holders[name].values():
                for _, _, request in self._lines.get(name, ()) if self.gives(held) else ():
                    claim = self._line[request][1]
                    if claim.priority <= held.priority:
                        break
                    if claim.task != held.task:
                        yield claim, held

    def gives(self, claim: Claim) -> bool:
        """Return False if the request of the claim was given up: what it holds may never be released."""
        return claim.request not in self._withheld

    def concerned(self, requests: KeysView[UUID]) -> list[UUID]:
        """Return those of the requests in line that were told something which is still so, those in front first."""
        claims = (self._line[request][1] for _, _, request in sorted(self._line[request][0] for request in requests & self._told))
        return [claim.request for claim in claims if self.is_free(claim) or self.withheld_from(claim.names)]

    def listen(self, listener: Callable[[], None], task: UUID | None = None) -> Callable[[], None]:
        """Call the listener when a claim in line would be granted if it were made again, and when what one waits for is withheld.

        Without a task it is called for the claims of all, and for one that comes and outranks who has it. Returns what stops that.
        """
        self._listeners[task].append(listener)

        def stop() -> None:
            self._listeners[task].remove(listener)
            if not self._listeners[task]:
                del self._listeners[task]

        return stop

    def __repr__(self) -> str:
        return f"<Resources, in use: {', '.join(sorted(self._holders)) or 'none'}; {len(self._line)} in line>"

    def _hold(self, claim: Claim) -> None:
        self._held[claim.request] = claim
        for name in claim.names:
            self._holders[name][claim.request] = claim

    def _tell_served(self, names: Iterable[str]) -> None:
        """Tell those in line whose turn has come, of whom there is less in use, or in line, of these resources."""
        # Only those in front, as many as there are units, can have them; whether they can have the rest as well is another question.
        units = ((self._lines.get(name, ()), max(0, self.capacity(name) - self._used(name))) for name in names)
        front = {rank for line, free in units for rank in line[:free]}
        self._tell(rank for rank in sorted(front) if self.is_free(self._line[rank[2]][1]))

    def _tell(self, ranks: Iterable[_Rank]) -> None:
        """Tell the tasks of claims in line, those in front first, and the listeners to all."""
        requests = [request for _, _, request in ranks]
        self._told.update(requests)
        tasks = dict.fromkeys(self._line[request][1].task for request in requests)
        for task in (*tasks, None) if tasks else ():
            self._call(task)

    def _call(self, task: UUID | None) -> None:
        for listener in tuple(self._listeners.get(task, ())):  # a copy, because listeners may come and go while they are called
            listener()

    def _leave(self, request: UUID) -> Claim | None:
        """Take the claim of a request out of line; return it if there was one."""
        if request not in self._line:
            return None
        rank, claim = self._line.pop(request)
        self._told.discard(request)
        for name in claim.names:
            line = self._lines[name]
            del line[bisect_left(line, rank)]
            if not line:
                del self._lines[name]
        return claim


def who_keeps(withheld: Mapping[str, str]) -> str:
    """Return as text which requests keep which resources; empty when none is withheld."""
    return "; ".join(f"{name} is kept by {by}, which has not confirmed that it is over" for name, by in withheld.items())


@dataclass(frozen=True, slots=True)
class Hand:
    """A robot, or another object or resource, in the hands of a person.

    Args:
        since: the time of day in seconds.
        by: who has it; empty if nobody has said so.
    """

    name: str
    since: float
    reason: str = ""
    by: str = ""

    @property
    def words(self) -> str:
        """Whose hands it is in, since when, and why."""
        by, at = f"the hands of {self.by}" if self.by else "a person's hands", datetime.fromtimestamp(self.since).astimezone()
        return f"in {by} since {at:%H:%M}{f': {self.reason}' if self.reason else ''}"

    def __str__(self) -> str:
        return f"{self.name} is {self.words}"


class Hands:
    """The robots, and other objects and resources, that people have in their hands: no run has anything sent to them.

    The mutable state is these, by name; how often that has changed; and who listens to it.
    """

    def __init__(self) -> None:
        self.taken: dict[str, Hand] = {}
        self.changes = 0
        self._listeners: list[Callable[[], object]] = []

    @property
    def names(self) -> tuple[str, ...]:
        """The names of what people have, the first taken in front."""
        return tuple(self.taken)

    def put(self, hand: Hand, *, is_taken: bool) -> None:
        """Note that a person has taken something, or has given it back."""
        if is_taken:
            self.taken[hand.name] = hand
        else:
            self.taken.pop(hand.name, None)
        self.changes += 1
        for listener in tuple(self._listeners):
            listener()

    def listen(self, listener: Callable[[], object]) -> Callable[[], None]:
        """Call the listener at every change from now on; return what stops that."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)


class RunClaims(KeptState, Generic[Place]):
    """The claims of one run, on behalf of a task, to resources that it shares with others; its places are known by number or by name.

    The mutable state is what the constructor sets under "state".
    """

    KEPT = ("waiting", "_places", "_had")

    def __init__(self, resources: Resources, task: UUID, priority: int) -> None:
        self.resources = resources
        self._task = task
        self._priority = priority
        # state
        self.waiting: dict[Place, UUID] = {}
        """By place, the requests that stand in line."""
        self._places: dict[UUID, Place] = {}
        """By request, where it is waited for."""
        self._had: dict[int, UUID] = {}
        """For every call that has resources, the request that has them."""

    def claim(self, request: UUID, names: tuple[str, ...]) -> Claim:
        """Return the claims of the request."""
        return Claim(self._task, request, self._priority, names)

    def are_free(self, place: Place, claim: Claim) -> bool:
        """Return whether the claim would be granted; if not, it stands in line, and the place waits for it."""
        if self.resources.is_free(claim):
            return True
        self.resources.take(claim)
        self.waiting[place], self._places[claim.request] = claim.request, place
        return False

    def take(self, call: int, claim: Claim) -> None:
        """Hold the resources of a claim that is free."""
        granted = self.resources.take(claim)
        assert granted, "what is not free opens nothing"
        self._had[call] = claim.request

    def keep(self, call: int, claim: Claim) -> None:
        """Hold the resources that the request of the call was granted before."""
        self.resources.keep(claim)
        self._had[call] = claim.request

    def give(self, call: int) -> None:
        """Give back what the call has."""
        self.resources.give(self._had.pop(call))

    def withhold(self, call: int, name: str) -> tuple[str, ...]:
        """Let the request of the call, which was given up, keep its resources; return their names."""
        request = self._had.pop(call)
        self.resources.withhold(request, f"{name} of task {self._task.hex[:8]}")
        return next((claim.names for claim in self.resources.held if claim.request == request), ())

    def leave(self, place: Place) -> bool:
        """No longer wait at the place; return whether it did."""
        if place not in self.waiting:
            return False
        request = self.waiting.pop(place)
        self._places.pop(request, None)
        self.resources.withdraw(request)
        return True

    def served(self) -> list[Place]:
        """Return the places that wait and where the claim may be granted now, or has come to wait for what is withheld."""
        return [self._places[request] for request in self.resources.concerned(self._places.keys())] if self.waiting else []

    def end(self, kept: Collection[UUID], open_calls: Mapping[UUID, str]) -> None:
        """Wait for nothing, and give everything back but what these requests have; those that are open keep what they have."""
        for place in [*self.waiting]:
            self.leave(place)
        for call, request in [*self._had.items()]:
            if request in kept:
                continue
            if request in open_calls:
                self.withhold(call, open_calls[request])
            else:
                self.give(call)
