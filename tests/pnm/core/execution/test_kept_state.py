"""Values of a run between two events: a run that is made from them goes on as it does, and nothing that changes is forgotten."""

from __future__ import annotations

from random import Random
from typing import Final

import pytest

from pnm.core.execution.events import Begin, Command, KnowledgeChanged, Send
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import PlanGraph
from pnm.core.machine.requests import Accepted
from pnm.journal.records import base_of, knowledge_now
from tests.support.runs.commands import RUN
from tests.support.runs.held_run import KeptRun, drive, hold_against_values
from tests.support.runs.plan_graphs import call

FOLLOWS: Final = {
    "Agenda": {"_index", "_local", "_readers", "_reads", "_rules", "_world", "begins_to_listen", "places"},
    "Questions": set[str](),
    "Calls": {"_closed", "_contexts", "_goal_fields", "_knowledge", "_plan", "asks", "bindings", "identity", "world"},
    "CallResults": {"_calls", "_plan"},
    "RunState": {"engine", "index", "marked_at", "results"},
    "RunClaims": {"_priority", "_task", "resources"},
    "Guards": {"_calls", "_claims", "_questions", "state"},
    "Resources": {"_capacities", "_holders", "_lines", "_listeners"},
}
"""The attributes of the parts of a run that follow from others, or that it is made with."""


@pytest.mark.parametrize("number", range(60))
def test_a_run_that_is_made_from_its_values_goes_on_as_it_does(number: int) -> None:
    hold_against_values(number)


def test_every_attribute_is_kept_or_follows_from_others() -> None:
    run = drive(Random(1), KeptRun)
    for part in (run.resources, *run._parts.values()):
        name, attributes = type(part).__name__, vars(part).keys() - {"__orig_class__"}
        assert attributes == FOLLOWS[name] | set(part.KEPT), name


def test_of_changes_that_were_not_heard_of_yet_those_are_kept_that_are_waited_for() -> None:
    world, machine = KnowledgeBase({("ok",): True}), generate(PlanGraph((call(0, invariant=True),)))
    run = Run(machine, Layered(world), id=RUN)
    commands: list[Command] = run.handle(Begin(), 0.0)
    (request,) = (command.request.id for command in commands if isinstance(command, Send))
    run.handle(Accepted(request), 1.0)
    for number in range(100):
        world.update({("seen", f"a{number}"): True})
    assert knowledge_now(0, world, run.asked_since[0]).changed == (), "nothing waits for these"
    world.update({("ok",): False})
    again = base_of(knowledge_now(0, world, run.asked_since[0]))
    other = Run(machine, Layered(again), id=RUN, kept=run.values())
    wanted = run.handle(KnowledgeChanged(), 2.0)
    assert wanted, "the call is no longer as it should be"
    assert other.handle(KnowledgeChanged(), 2.0) == wanted
