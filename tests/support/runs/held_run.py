"""The run held against others: after every event both have fired the same and want the same, and know the same.

The one is the reference; the other is a run that was made from the values of this one, and goes on beside it.
"""

from __future__ import annotations

from abc import abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from random import Random
from typing import Any
from uuid import UUID

from pnm.core.execution.call_data import intention
from pnm.core.execution.call_results import CallResult
from pnm.core.execution.events import Command, Event, InHands, KnowledgeChanged, Pause, Restarted, Resume, Send, SingleStep
from pnm.core.execution.handover import UnderWay
from pnm.core.execution.questions import EvaluationContext
from pnm.core.execution.reference import ReferenceRun
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.conditions import Holds
from pnm.core.logic.effects import Set, When, values_before
from pnm.core.logic.expressions import Constant, Fluent, Unknown, Value
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import OnFailure, PetriNetMachine
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import CallOutcome, Request
from pnm.core.net.net import Marking
from pnm.core.resources import Resources
from pnm.journal.codec import RECORDS, Undecodable
from pnm.journal.records import base_of, knowledge_now
from tests.support.runs.commands import RUN
from tests.support.runs.mutation.machines import random_bindings, random_plan, with_calls_under_way, written_out
from tests.support.yaml.chaos import Chaos

EFFECTS = (
    *(Set((name,), Constant(value)) for name in ("free", "powered") for value in (True, False)),
    When(Holds(("powered",)), (Set(("free",), Constant(False)),)),
    Set(("count",), Constant(1.0), "increase"),
)
"""What calls change."""


class AccompaniedRun(Run):
    """A run with another beside it, which hears the same news from outside. The mutable state is that one, and whether this is at work."""

    def __init__(
        self,
        machine: PetriNetMachine,
        knowledge: Layered,
        *,
        asks: bool = False,
        bindings: Bindings | None = None,
        adopted: Mapping[int, UnderWay] | None = None,
    ) -> None:
        super().__init__(machine, knowledge, id=RUN, asks=asks, bindings=bindings, adopted=adopted or {}, tells=True)
        self.asks_people, self.bound, self.adopted_calls, self.is_at_work = asks, bindings or Bindings(), dict(adopted or {}), False
        self.accompany()
        knowledge.world.listen(lambda changes: None if self.is_at_work else self.hear(changes))

    @abstractmethod
    def accompany(self) -> None:
        """Make the other run."""

    @abstractmethod
    def hear(self, changes: Mapping[Fluent, Value | Unknown]) -> None:
        """Have the other run know what has come from outside."""

    def handle(self, event: Event, now: float) -> list[Command]:
        self.is_at_work = True
        commands = super().handle(event, now)
        self.is_at_work = False
        return commands


class HeldRun(AccompaniedRun):
    """A run, and the reference beside it with a copy of what it knows."""

    def accompany(self) -> None:
        world, local = self.knowledge.world, self.knowledge.local
        things, sensed, variables = world.objects_by_type(), world.sensed_names(), world.variables()
        own = KnowledgeBase(world.facts(), variables=variables, objects=things, sensed=sensed, rules=world.rules)
        self.own = Layered(own, KnowledgeBase(variables=local.variables()))
        self.reference = ReferenceRun(self.machine, self.own, RUN, self.bound, asks=self.asks_people, adopted=self.adopted_calls)

    def hear(self, changes: Mapping[Fluent, Value | Unknown]) -> None:
        self.own.world.update(changes)
        self.own.world.store(self.knowledge.world.variables())

    def handle(self, event: Event, now: float) -> list[Command]:
        assert not isinstance(event, Restarted), "the reference leaves this out"
        before = self.marking
        commands = super().handle(event, now)
        firings, expected = self.reference.delta(event, now)
        names = self.machine.net.transitions
        assert firings == [names[number] for number in self.fired], f"other firings after {event} at {now}"
        assert expected == commands, f"other commands after {event} at {now}"
        assert self.marking == self.reference.marking == self._by_equation(before, firings)
        assert self.own.world.facts() == self.knowledge.world.facts(), f"other facts after {event} at {now}"
        assert self.own.local.variables() == self.knowledge.local.variables()
        assert self.reference.claims.resources.held == self.resources.held
        assert self.reference.claims.resources.line == self.resources.line
        return commands

    def _by_equation(self, marking: Marking, firings: tuple[str, ...]) -> Marking:
        """The marking m' = T̄·D + m, with the firings counted."""
        net, tokens = self.machine.net, Counter(dict(marking))
        for transition, times in Counter(firings).items():
            for place, weight in net.inputs[transition].items():
                tokens[place] -= times * weight
            for place, weight in net.outputs[transition].items():
                tokens[place] += times * weight
        return Marking(tokens)


class Unrest(Chaos):
    """A world that answers as it likes, in which facts change often, and people pause, step and resume, and take robots over."""

    pauses = 6
    takes = 6
    has_stepped = False
    """Whether the last event was a step."""

    def adopt(self, taken: UnderWay) -> None:
        """Answer for a request that another run has sent."""
        self._do(Send(Request(taken.request, taken.call.action, {})))

    def _next(self) -> Event:
        random, chance = self.random, self.random.random()
        self.has_stepped = False
        if self.run.pausing and (chance < 0.3 or not (self.queues or self.wake)):
            self.has_stepped = random.random() < 0.3
            return SingleStep() if self.has_stepped else Resume()
        if self.run.hands and (chance < 0.35 or not (self.queues or self.wake)):
            return InHands(tuple(name for name in self.run.hands if random.random() < 0.3) if self.queues or self.wake else ())
        if self.takes and 0.05 <= chance < 0.1 and (names := self._names()):
            self.takes -= 1
            return InHands(tuple(dict.fromkeys((*self.run.hands, random.choice(names)))))
        if self.pauses and chance < 0.05:
            self.pauses -= 1
            return Pause(at_once=random.random() < 0.6)
        if chance < 0.3:
            self.knowledge.world.update({random.choice([("powered",), ("free",)]): random.random() < 0.6})
            return KnowledgeChanged()
        return super()._next()

    def _names(self) -> list[str]:
        actions = [call.action for call in self.run.machine.plan.calls]
        return sorted({name for action in actions for name in (*action.arguments, *self.run.bindings.resources(action))})


SHORTENED = {("Calls", "_contexts"), ("RunState", "marked_at"), ("CallResults", "_answers")}
"""Attributes that values have not, or not whole: what is cached, is asked for no more, or was returned by servers."""


def attributes(run: Run) -> Iterator[tuple[str, str, str]]:
    """Yield the attributes of the parts of a run that can be written down, those that are not kept among them."""
    for part in run._parts.values():
        for name, value in vars(part).items():
            if (type(part).__name__, name) not in SHORTENED:
                with suppress(Undecodable):
                    yield type(part).__name__, name, RECORDS.text(value)


class KeptRun(AccompaniedRun):
    """A run with another beside it, which is made anew from its values now and then."""

    events = 0

    def accompany(self) -> None:
        """Make a run that knows nothing but what can be written down of this one."""

        def read(value: Any) -> Any:
            return RECORDS.value(RECORDS.text(value))

        world, local = self.asked_since
        knowledge = Layered(
            base_of(read(knowledge_now(0, self.knowledge.world, world))), base_of(read(knowledge_now(1, self.knowledge.local, local)))
        )
        resources = Resources(self.resources.capacities)
        resources.restore(read(self.resources.values()))
        kept = read(self.values())
        self.other = Run(
            self.machine, knowledge, id=RUN, asks=self.asks_people, bindings=self.bound, resources=resources, tells=True, kept=kept
        )
        assert list(attributes(self.other)) == list(attributes(self))

    def hear(self, changes: Mapping[Fluent, Value | Unknown]) -> None:
        if changes:
            self.other.knowledge.world.update(changes)
        else:
            self.other.knowledge.world.store(self.knowledge.world.variables())

    def handle(self, event: Event, now: float) -> list[Command]:
        commands, other = super().handle(event, now), self.other
        assert other.handle(event, now) == commands, f"other commands after {event} at {now}"
        assert (other.fired, other.told) == (self.fired, self.told), f"other firings after {event} at {now}"
        assert other.marking == self.marking
        assert other.knowledge.world.facts() == self.knowledge.world.facts(), f"other facts after {event} at {now}"
        assert other.knowledge.local.variables() == self.knowledge.local.variables()
        assert (other.resources.held, other.resources.line) == (self.resources.held, self.resources.line)
        assert (other.unreported, other.awaits, other.awaits_answers) == (self.unreported, self.awaits, self.awaits_answers)
        assert repr(other.result_so_far()) == repr(self.result_so_far())
        assert RECORDS.text(other.values()) == RECORDS.text(self.values()), f"another state after {event} at {now}"
        self.events += 1
        if self.events % 3:
            self.accompany()
        return commands


def hold_against_reference(number: int, times: int = 3) -> None:
    """Execute the machine of a random plan a few times, in the run and in the reference."""
    for time in range(times):
        drive(Random(f"{number} {time}"), HeldRun)


def hold_against_values(number: int, times: int = 3) -> None:
    """Execute the machine of a random plan a few times, with a run beside it that is made from its values again and again."""
    for time in range(times):
        drive(Random(f"{number} {time}"), KeptRun)


def drive(random: Random, kind: type[AccompaniedRun]) -> AccompaniedRun:
    """Execute the machine of a random plan; return the run."""
    planned = random_plan(random, EFFECTS)
    taken_over = with_calls_under_way(planned, random)
    plan = taken_over if sum(call.under_way and bool(call.action.resources) for call in taken_over.calls) < 2 else planned
    bindings = random_bindings(random)
    machine = generate(plan, bindings, on_failure=random.choice([*OnFailure]))
    machine = written_out(machine) if random.random() < 0.2 else machine
    sensed = {name: random.choice([0.0, 1.5]) for name in ("powered", "free") if random.random() < 0.5}
    knowledge = Layered(
        KnowledgeBase({("powered",): random.random() < 0.8, ("free",): random.random() < 0.5, ("count",): 0.0}, sensed=sensed)
    )
    adopted = {call.index: _under_way(call, knowledge) for call in plan.calls if call.under_way}
    run = kind(machine, knowledge, asks=random.random() < 0.5, bindings=bindings, adopted=adopted)
    unrest = Unrest(run, knowledge, random)
    for taken in adopted.values():
        unrest.adopt(taken)
    for _ in unrest.drive(3_000):
        pass
    return run


def _under_way(call: ActionCall, knowledge: Layered) -> UnderWay:
    """The request of a call that another run has sent."""
    action = call.action
    intended = intention(call, EvaluationContext(knowledge, action))
    result = CallResult(call, CallOutcome.RUNNING, 1, 0.0)
    begun = values_before(intended.start, knowledge.world)
    return UnderWay(call, UUID(int=100 + call.index), 0.0, result, intended, begun, action.resources)
