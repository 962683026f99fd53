"""A world that answers the requests of a program as it likes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from random import Random
from uuid import UUID

from pnm.core.execution.events import (
    Answered,
    Ask,
    Begin,
    Cancel,
    Command,
    Event,
    KnowledgeChanged,
    Send,
    Stop,
    Store,
    Tick,
    Wake,
    Withdraw,
)
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import Layered
from pnm.core.logic.computed_values import MISSING
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Request


@dataclass
class Chaos:
    """Answers everything a run asks for, in any order, at any time, late, twice or not before its limit.

    The mutable state is what has a default.
    """

    run: Run
    knowledge: Layered
    random: Random
    stops: bool = True
    now: float = 0.0
    wake: float | None = None
    requests: dict[UUID, Request] = field(default_factory=dict)
    """Sent, and not ended as far as the run was told, whether or not it has given them up."""
    queues: dict[UUID, list[Event]] = field(default_factory=dict)
    """What will still be said, by who says it."""
    sent: list[str] = field(default_factory=list)

    def drive(self, steps: int = 20_000) -> Iterator[None]:
        """Go on to the end, which must come; yield after every event."""
        self._handle(Begin())
        yield
        for _ in range(steps):
            if self.run.over:
                return
            self._handle(self._next())
            yield
        raise AssertionError(f"it never ends: {self.run.marking}")

    def _next(self) -> Event:
        chance = self.random.random()
        if self.stops and chance < 0.005:
            return Stop(cancel=self.random.random() < 0.7)
        if chance < 0.05:
            fact = self.random.choice([("powered",), ("free",), ("at", "r1", "hall"), ("at", "r1", "kitchen")])
            self.knowledge.world.update({fact: self.random.random() < 0.6})
            return KnowledgeChanged()
        if self.queues and (self.wake is None or chance < 0.9):
            who = self.random.choice(list(self.queues))
            event = self.queues[who].pop(0)
            if not self.queues[who]:
                del self.queues[who]
            self.now += self.random.choice([0.0, 0.0, 0.1, 1.0])
            return event
        assert self.wake is not None, f"it waits for nothing: {self.run.marking}"
        self.now, self.wake = max(self.now, self.wake), None
        return Tick()

    def _handle(self, event: Event) -> None:
        if isinstance(event, Ended):
            self.requests.pop(event.request, None)
        for command in self.run.handle(event, self.now):
            self._do(command)

    def _do(self, command: Command) -> None:
        random = self.random
        match command:
            case Send(request):
                self.requests[request.id] = request
                self.sent.append(request.action.name)
                self.queues[request.id] = self._answers(request)
                if not self.queues[request.id]:
                    del self.queues[request.id]
            case Cancel(request) if random.random() < 0.7:
                self.queues.setdefault(request, []).append(Ended(request, Outcome(OutcomeKind.CANCELED)))
            case Wake(at):
                self.wake = at if self.wake is None else min(at, self.wake)
            case Ask(identity, _):
                self.queues[identity] = [Answered(identity, random.choice([MISSING, None, 0, 1, 2, "text"]))]
            case Withdraw(identity) if random.random() < 0.5:
                self.queues.pop(identity, None)
            case Store(identity):
                self.queues[identity] = [
                    Ended(identity, Outcome(random.choice([OutcomeKind.SUCCEEDED, OutcomeKind.SUCCEEDED, *OutcomeKind])))
                ]
            case _:
                pass

    def _answers(self, request: Request) -> list[Event]:
        random = self.random
        kind = random.choice([OutcomeKind.SUCCEEDED, OutcomeKind.SUCCEEDED, OutcomeKind.SUCCEEDED, *OutcomeKind])
        result = random.choice([{}, {"seen": 1}, {"v": random.randint(0, 2)}, {"w": "text"}])
        accepted: list[Event] = [Accepted(request.id)] if random.random() < 0.8 else []
        declared = random.choice(["", *(way.name for way in request.action.outcomes)]) if request.action.outcomes else ""
        outcome = Outcome(kind, result, declared=declared) if kind is OutcomeKind.SUCCEEDED else Outcome(kind)
        ended: list[Event] = [Ended(request.id, outcome)]
        hangs = random.random() < 0.1
        return accepted + ([] if hangs else ended) + (ended if random.random() < 0.1 else [])


def in_use(requests: Mapping[UUID, Request]) -> Counter[str]:
    """Return how many requests that are not known to be over have each resource."""
    return Counter(name for request in requests.values() for name in request.action.resources)
