"""The projected state: what calls that are under way, or have just ended, are going to change; and where nobody can say."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.model.progression import NotProjectable, projected_state
from planner_bridge.pipeline.loading import load
from planner_bridge.tasks.result import TASKS
from pnm.core.execution.events import Stop
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Holds
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import UNKNOWN, Constant
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Ended
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps
from tests.support.files import ROOT
from tests.support.runs.commands import accepted, begun
from tests.support.runs.handover import SUCCEEDED
from tests.support.runs.plan_graphs import plan_of
from tests.support.tasks.simulation import reach_with_late_sensors

LIT, DOOR, MOVING, ENERGY = ("lit",), ("door",), ("moving",), ("energy",)
OPEN = GroundAction(
    "open",
    start_effects=(Set(MOVING, Constant(True)),),
    end_effects=(Set(MOVING, Constant(False)), Set(DOOR, Constant(True)), Set(ENERGY, Constant(3.0), "decrease")),
    duration=5.0,
)
SHINE = GroundAction("shine", end_condition=Holds(LIT), duration=9.0)


def test_at_any_time_of_a_run_no_robot_is_nowhere(tmp_path: Path) -> None:
    """While a robot moves it is nowhere, and when it has arrived as well until that is reported."""
    problem = load(ROOT / "domains/delivery/domain.pddl", ROOT / "problems/delivery/p01.pddl")
    reach_with_late_sensors(problem, "(and (at parcel1 hall) (at parcel2 kitchen))", tmp_path / "journal")
    replay, nowhere, has_settled = Replay(), 0, False
    for step in replay_steps(tmp_path / "journal", TASKS, replay):
        if replay.bases:
            runs = [run.run for run in replay.runs.values() if not run.is_over]
            nowhere += _robots(replay.world) < {"r1", "r2"}
            has_settled |= any(run.settling for run in runs)
            assert _robots(projected_state(replay.world, runs)) == {"r1", "r2"}, step
    assert has_settled
    assert nowhere


@pytest.mark.parametrize("orders", [(), ("1e<0e",)], ids=["", "its end waits for another"])
def test_what_has_ended_changes_numbers_once(orders: tuple[str, ...]) -> None:
    world = KnowledgeBase({ENERGY: 10.0, LIT: True}, sensed={"door": 1.0})
    run = accepted(plan_of(OPEN, SHINE, orders=orders), world=world)
    for settling in ([], ["open()#0"]):
        assert [str(call) for call in run.settling] == settling
        state = projected_state(world, (run,))
        assert (bool(state.value(DOOR)), state.value(ENERGY), bool(state.value(MOVING))) == (True, 7.0, False)
        assert not world.value(DOOR)
        run.handle(Ended(run.open_requests[0], SUCCEEDED), 3.0)


def test_nobody_knows_what_becomes_of_a_call_that_is_being_cancelled() -> None:
    world = KnowledgeBase({ENERGY: 10.0, LIT: True})
    run = accepted(plan_of(OPEN, SHINE), world=world)
    run.handle(Stop(cancel=True), 2.0)
    state = projected_state(world, (run,))
    assert [state.value(fluent) for fluent in (DOOR, ENERGY, MOVING, LIT)] == [UNKNOWN, UNKNOWN, UNKNOWN, True]


def test_a_call_that_cannot_end_is_refused_with_the_reason() -> None:
    world = KnowledgeBase({LIT: False})
    with pytest.raises(NotProjectable, match=r"shine\(\) would end although \(lit\)"):
        projected_state(world, (accepted(plan_of(SHINE), world=world),))


def test_a_call_that_has_not_begun_changes_nothing() -> None:
    world = KnowledgeBase({ENERGY: 10.0})
    run, _ = begun(plan_of(OPEN), world=world)
    assert projected_state(world, (run,)).facts() == world.facts()


def _robots(state: KnowledgeBase) -> set[str]:
    """The robots that are somewhere, or of which that is not known."""
    return {fluent[1] for fluent in state.facts() if fluent[0] == "at"} & {"r1", "r2"}
