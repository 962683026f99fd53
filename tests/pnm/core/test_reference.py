"""The run does what the definition of a Petri Net Machine says; a run that does not is found out."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest
from hypothesis import given, settings, strategies as st

from pnm.core.execution.call_requests import Calls
from pnm.core.execution.events import Performed
from pnm.core.execution.run import Run
from pnm.core.execution.run_state import Agenda, RunState
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.generate import generate
from tests.support.runs.held_run import HeldRun, Unrest, hold_against_reference
from tests.support.yaml.programs import only_plan, programs


def _hold(numbers: range) -> None:
    for number in numbers:
        hold_against_reference(number)


def test_the_run_is_as_the_reference() -> None:
    _hold(range(50))


@settings(max_examples=15)
@given(programs(), st.integers(0, 2**32))
def test_any_program_runs_as_in_the_reference(text: str, seed: int) -> None:
    found, random = only_plan(text), Random(seed)
    machine = generate(found.graph, found.bindings, on_failure=found.on_failure)
    world = KnowledgeBase(found.facts, objects=found.objects, rules=found.rules)
    knowledge = Layered(world, KnowledgeBase(variables=found.variables))
    run = HeldRun(machine, knowledge, bindings=found.bindings, asks=random.random() < 0.7)
    for _ in Unrest(run, knowledge, random).drive():
        pass


def _nothing(*_: object, **__: object) -> None:
    """Do nothing."""


BROKEN: dict[str, tuple[type, str, Callable[..., object] | property]] = {
    "what has changed is not looked at": (Agenda, "ask_about_knowledge", _nothing),
    "places are asked in another order": (Agenda, "ask_undecided", lambda agenda: agenda.places.extend(reversed(agenda.undecided))),
    "a pause starts calls": (Run, "_is_put_off", lambda run, site, firing, place: False),
    "nothing is ever cancelled": (RunState, "cancels", property(lambda state: False)),
    "a request is numbered twice": (Calls, "_next", lambda calls, call: (1, calls.identity(f"{call}/1"))),
    "actions are not carried out": (Calls, "perform", lambda *_: Performed()),
}


@pytest.mark.parametrize("what", BROKEN)
def test_a_run_that_does_otherwise_is_found_out(what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    owner, name, instead = BROKEN[what]
    monkeypatch.setattr(owner, name, instead)
    with pytest.raises(AssertionError):
        _hold(range(200))
