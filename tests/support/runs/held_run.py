"""The run held against the reference: after every event both have fired the same and want the same, and know the same."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from random import Random

from pnm.core.execution.events import Command, Event, KnowledgeChanged, Pause, Restarted, Resume, SingleStep
from pnm.core.execution.reference import ReferenceRun
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.net.net import Marking
from tests.support.runs.direct import RUN
from tests.support.runs.mutation.machines import random_machine
from tests.support.yaml.chaos import Chaos


class HeldRun(Run):
    """A run, and the reference beside it with a copy of what it knows. The mutable state is both."""

    def __init__(self, machine: PetriNetMachine, knowledge: Layered, *, asks: bool) -> None:
        super().__init__(machine, knowledge, id=RUN, asks=asks)
        world, local = knowledge.world, knowledge.local
        own = KnowledgeBase(world.facts(), sensed=world.sensed_names(), objects=world.objects_by_type(), rules=world.rules)
        self.own = Layered(own, KnowledgeBase(variables=local.variables()))
        self.reference = ReferenceRun(machine, self.own, RUN, asks=asks)
        self._is_at_work = False
        world.listen(self._hear)

    def _hear(self, changes: Mapping[Fluent, Value | Unknown]) -> None:
        if not self._is_at_work:  # it is news from outside, for both
            self.own.world.update(changes)

    def handle(self, event: Event, now: float) -> list[Command]:
        assert not isinstance(event, Restarted), "the reference leaves this out"
        before, self._is_at_work = self.marking, True
        commands = super().handle(event, now)
        self._is_at_work = False
        answer = self.reference.delta(event, now)
        names = self.machine.net.transitions
        assert [*answer.firings] == [names[number] for number in self.fired], f"other firings after {event} at {now}"
        assert [*answer.commands] == commands, f"other commands after {event} at {now}"
        assert self.marking == self.reference.marking == self._by_equation(before, answer.firings)
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
    """A world that answers as it likes, in which facts change often, and people pause, step and resume."""

    pauses = 6

    def _next(self) -> Event:
        random, chance = self.random, self.random.random()
        if self.run.pausing and (chance < 0.3 or not (self.queues or self.wake)):
            return random.choice([SingleStep(), Resume(), Resume()])
        if self.pauses and chance < 0.05:
            self.pauses -= 1
            return Pause(at_once=random.random() < 0.6)
        if chance < 0.3:
            self.knowledge.world.update({random.choice([("powered",), ("free",)]): random.random() < 0.6})
            return KnowledgeChanged()
        return super()._next()


def hold_against_reference(number: int, times: int = 3) -> None:
    """Execute a random machine a few times, in the run and in the reference."""
    machine = random_machine(number)
    for time in range(times):
        random = Random(f"{number} {time}")
        sensed = {name: random.choice([0.0, 1.5]) for name in ("powered", "free") if random.random() < 0.5}
        world = KnowledgeBase({("powered",): random.random() < 0.8, ("free",): random.random() < 0.5}, sensed=sensed)
        knowledge = Layered(world)
        run = HeldRun(machine, knowledge, asks=random.random() < 0.5)
        for _ in Unrest(run, knowledge, random).drive(3_000):
            pass
