"""What is wrong with a machine when it is executed: `Run` itself, in a world that answers as it likes."""

from __future__ import annotations

from collections import Counter
from random import Random

from pnm.core.execution.events import Event
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import Moment, Then
from pnm.core.machine.requests import CallOutcome, Ended
from tests.support.runs.commands import RUN
from tests.support.yaml.chaos import Chaos


class WatchedChaos(Chaos):
    """Such a world, which notices that the end of a request that is waited for changes nothing."""

    def _handle(self, event: Event) -> None:
        is_awaited = isinstance(event, Ended) and event.request in self.run.open_calls
        before = self.run.marking
        super()._handle(event)
        assert not is_awaited or self.run.marking != before, f"a report is dropped: {event}"


def fault_of(machine: PetriNetMachine, seeds: range) -> str:
    """Return what goes wrong in one of a few random executions; empty when nothing does."""
    for seed in seeds:
        try:
            _execute(machine, Random(seed))
        except AssertionError as error:
            return f"execution {seed}: {error}"
        except Exception as error:  # whatever it is, a run that was proved does not raise it
            return f"execution {seed}: {type(error).__name__}: {error}"
    return ""


def _execute(machine: PetriNetMachine, random: Random) -> None:
    knowledge = Layered(KnowledgeBase({("powered",): True, ("free",): random.random() < 0.5}), KnowledgeBase())
    run = Run(machine, knowledge, id=RUN, asks=False)
    chaos = WatchedChaos(run, knowledge, random)
    sent: list[str] = []
    was_ending = False
    budget = sum(machine.initial[place] for place in machine.budget_places)
    for _ in chaos.drive(3_000):
        for place, tokens in run.marking.items():
            limit = budget if place in machine.budget_places else machine.initial[place] if place in machine.resource_places else 1
            assert tokens <= limit or place in machine.restart_places, f"{place} holds {tokens} tokens"
        alive = Counter(call.action.name for call in run.open_calls.values())
        assert all(count == 1 for count in alive.values()), f"two requests of one call are alive: {alive}"
        if new := chaos.sent[len(sent) :]:
            assert not was_ending, f"{new} is sent although the run is ending"
            _check_order(machine, new, sent, set(alive))
        sent = [*chaos.sent]
        failed = any(run.marking[place] for place in machine.failure_places)
        was_ending = failed or run.stopped
    left = {place: tokens for place, tokens in run.marking.items() if place not in machine.record_places}
    result = run.result()
    assert left == ({machine.goal_place: 1} if result.goal else {machine.failed_place: 1}), f"it ends in {left}"
    assert not run.open_requests, "it ends while a request is alive"
    assert not (result.goal and (result.failures or run.stopped)), "goal after a failure or a stop"
    # A plan that begins anew is carried out the last time.
    last = {call.call.index: call for call in result.calls}.values() if machine.restart_places else result.calls
    for call in last if result.goal else ():
        if call.kind is CallOutcome.WAITING and call.call not in machine.plan.steps:
            continue  # it stands where the plan need not come by
        is_spared = call.kind is CallOutcome.PASSED_OVER and any(
            recovery.then is Then.SKIP and call.cause in recovery.causes for recovery in call.call.recoveries
        )
        was_sent = call.kind is CallOutcome.SUCCEEDED and call.call.action.name in sent
        assert was_sent or is_spared or call.kind is CallOutcome.ALREADY_TRUE, f"goal, and {call.call} was not carried out: {call.kind}"
    for place in machine.resource_places:
        assert run.marking[place] == machine.initial[place], f"{place} is kept"


def _check_order(machine: PetriNetMachine, new: list[str], sent: list[str], alive: set[str]) -> None:
    """Check that what is sent first now does not come before what the plan has before it."""
    for ordering in machine.plan.orderings:
        first, second = f"a{ordering.before.call}", f"a{ordering.after.call}"
        if ordering.after.moment is Moment.START and ordering.before.moment is Moment.END:
            assert first not in new or second not in sent, f"{first} is sent after {second}: {ordering}"
            assert second not in new or first not in alive, f"{second} is sent while {first} goes on: {ordering}"
