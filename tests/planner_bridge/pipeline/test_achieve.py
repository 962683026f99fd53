"""`achieve` from Python: who performs the actions is what the caller said, or an error."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from math import inf, nan
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline.achieve import achieve, carry_out
from planner_bridge.planning.solve import solve
from planner_bridge.tasks.control import Watchdog
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, ActionClient, Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.errors import InputError
from pnm.knowledge.sensor_model import Sensing
from tests.support.files import ROOT
from tests.support.tasks.rooms import ring

TWO_STEPS = "actions: {go: {params: [place]}}\nplan: [{go: {place: a}}, {go: {place: b}}]\n"


class Robot:
    """An action client that notes what it is sent; the first request fails."""

    def __init__(self) -> None:
        self.sent: list[str] = []

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return None

    def send(self, request: Request, report: Reporter, /) -> None:
        self.sent.append(str(request.action))
        outcome = OutcomeKind.ABORTED if len(self.sent) == 1 else OutcomeKind.SUCCEEDED
        loop = asyncio.get_running_loop()
        loop.call_soon(report, Accepted(request.id))
        loop.call_soon(report, Ended(request.id, Outcome(outcome)))

    def cancel(self, request: UUID, /) -> None:
        pass


def test_an_action_client_carries_out_the_plan_and_what_follows_a_failure() -> None:
    robot = Robot()
    assert isinstance(robot, ActionClient)
    result = achieve(None, ring(), actions=robot, settings=Settings())
    assert result.goal_reached
    assert (str(result.code), int(result.code)) == ("goal_reached", 0)
    assert robot.sent == ["move(r1, a, b)", "move(r1, a, b)", "move(r1, b, c)"]
    assert result.as_json()["calls"][0]["assumed"]  # type: ignore[index]


class Unplugged(Robot):
    """An action client that raises for one action, and when it is to cancel something."""

    def __init__(self, broken: str, *, raises: int) -> None:
        super().__init__()
        self.broken, self.raises, self.raised = broken, raises, 0

    def send(self, request: Request, report: Reporter, /) -> None:
        self.sent.append(str(request.action))
        if str(request.action) == self.broken and self.raised < self.raises:
            self.raised += 1
            raise ConnectionError("robot 2 is not reachable")
        loop = asyncio.get_running_loop()
        loop.call_soon(report, Accepted(request.id))
        loop.call_later(2.0, report, Ended(request.id, Outcome(OutcomeKind.SUCCEEDED)))

    def cancel(self, request: UUID, /) -> None:
        raise ConnectionError("nor can it be stopped")


LAMPS = """(define (domain lamps) (:requirements :typing :negative-preconditions) (:types lamp) (:predicates (lit ?l - lamp))
 (:action on :parameters (?l - lamp) :precondition (not (lit ?l)) :effect (lit ?l)))"""
BOTH = "(define (problem b) (:domain lamps) (:objects hall stairs - lamp) (:init) (:goal (and (lit hall) (lit stairs))))"


@pytest.mark.parametrize("raises", [1, 100])
@pytest.mark.parametrize("on_failure", OnFailure)
def test_a_client_that_raises_fails_that_call_and_the_others_go_on(on_failure: OnFailure, raises: int) -> None:
    robot = Unplugged("on(stairs)", raises=raises)
    result = achieve(None, parse_problem(BOTH, parse_domain(LAMPS)), actions=robot, settings=Settings(on_failure=on_failure))
    assert result.goal_reached is (raises == 1)
    assert robot.sent.count("on(hall)") == 1
    if raises > 1:
        assert "unavailable: it cannot be sent: ConnectionError: robot 2 is not reachable" in result.reason
        assert "on(hall)" in [str(call.call.action) for call in result.calls if call.is_done]


def test_an_action_client_carries_out_a_hand_written_plan(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text(TWO_STEPS.replace("[place]}", "[place], retries: 1}"))
    robot = Robot()
    assert carry_out(tmp_path / "p.yaml", actions=robot).goal_reached
    assert robot.sent == ["go(a)", "go(a)", "go(b)"]
    with pytest.raises(InputError, match="expected actions 'simulated', 'ros2' or an ActionClient, found 'ros'; did you mean 'ros2'"):
        carry_out(tmp_path / "p.yaml", actions="ros")


@pytest.mark.parametrize("other", ["{}", "{duration: 3}", "{duration: 0.5}"])
def test_an_action_without_a_duration_takes_a_second_whatever_others_take(tmp_path: Path, other: str) -> None:
    (tmp_path / "p.yaml").write_text(f"actions: {{unknown: {{}}, other: {other}}}\nplan: [unknown:, other:]\n")
    first = carry_out(tmp_path / "p.yaml").calls[0]
    assert (first.started, first.ended) == (0.0, 1.0)


def test_a_rehearsal_jumps_over_years_in_which_nothing_happens(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[Watchdog] = []
    look = Watchdog._look
    monkeypatch.setattr(Watchdog, "_look", lambda watchdog: [looks.append(watchdog), look(watchdog)])
    (tmp_path / "p.yaml").write_text("actions: {grow: {duration: 1.0e+7}}\nplan: [grow:, grow:]\n")
    assert carry_out(tmp_path / "p.yaml").goal_reached
    assert len(looks) < 500


def test_what_would_be_ignored_is_refused() -> None:
    robot = Robot()
    with pytest.raises(InputError, match="faults belong to simulated robots"):
        achieve(None, ring(), actions=robot, faults=Faults((Fault("move", FaultKind.ABORT),)))
    with pytest.raises(InputError, match="sensing is about topics and services of ROS 2"):
        achieve(None, ring(), settings=Settings(sensing=Sensing(stale=1.0)))
    assert robot.sent == []


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Settings(on_failure="cancel"), "settings: expected OnFailure for on_failure, found 'cancel'"),
        (lambda: Settings(on_change="eager"), "settings: expected OnChange for on_change, found 'eager'"),
        (lambda: Settings(limits={"replans": 3}), "settings: expected Limits for limits, found {'replans': 3}"),
        (lambda: Settings(planner_timeout=nan), "the search for a plan waits for nan seconds; expected a finite number from 0"),
        (lambda: Limits(replans=-1), "limits: expected a whole number from 0 for replans, found -1"),
        (lambda: Limits(seconds=nan), "a task waits for nan seconds; expected a finite number from 0"),
        (lambda: Binding("/move", retries=1.5), "the binding of /move: expected a whole number from 0 for retries, found 1.5"),
        (lambda: Bindings({"move": {"server": "/move"}}), "bindings: expected Binding for move, found {'server': '/move'}"),
        (lambda: solve(ring(), timeout=inf), "the search for a plan waits for inf seconds; expected a finite number from 0"),
        (lambda: achieve(None, ring(), actions=Robot), f"expected actions 'simulated', 'ros2' or an ActionClient, found {Robot}"),
        (
            lambda: achieve(None, ring(), settings=Settings(bindings=Bindings({"moev": Binding()}))),
            "there is no action 'moev' in the domain, but the bindings name it; did you mean 'move'?",
        ),
    ],
)
def test_values_that_would_be_ignored_or_misunderstood_are_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError) as error:
        make()
    assert str(error.value) == message


def test_a_limit_that_the_clock_of_the_planner_cannot_count_is_no_time_out() -> None:
    assert solve(ring(), timeout=1e300).plan


def test_bindings_beside_the_domain_are_read_as_the_command_reads_them(tmp_path: Path) -> None:
    (tmp_path / "domain.pddl").write_text((ROOT / "domains/delivery/domain.pddl").read_text())
    (tmp_path / "bindings.yaml").write_text("actions: {mvoe: {server: /x}}\n")
    with pytest.raises(InputError, match=r"bindings.yaml:1:17: there is no action 'mvoe' in the domain"):
        achieve(tmp_path / "domain.pddl", ROOT / "problems/delivery/p01.pddl")
