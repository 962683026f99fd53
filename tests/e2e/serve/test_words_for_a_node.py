"""The commands that speak to a running node, to `pnm serve` in one process and robots in another."""

from __future__ import annotations

import signal
from typing import Any

import pytest

from planner_bridge.model.rates import Call, Counts, End, Rates
from tests.support.e2e.command_line import pnm, result
from tests.support.e2e.deployment import SimulationProgram
from tests.support.e2e.plan_deployment import PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PROBLEM
from tests.support.processes import Program, until

FAR = "(and (at r1 yard) (at r2 corridor))"


@pytest.fixture(scope="module")
def node(deployment_of_module: PlanDeployment) -> PlanDeployment:
    """The node, and slow robots for it."""
    deployment_of_module.pnm(SimulationProgram, "simulate", DOMAIN, PROBLEM, "--speed", "0.5").ready()
    rates = deployment_of_module.folder / "rates.yaml"
    rates.write_text(Rates({Call("move", "move"): Counts({End.SUCCEEDED: 80, End.ABORTED: 20})}, {"0": 1}).text())
    deployment_of_module.pnm(Serving, "serve", DOMAIN, PROBLEM, "--rates", str(rates)).ready()
    return deployment_of_module


@pytest.fixture
def served(node: PlanDeployment, monkeypatch: pytest.MonkeyPatch) -> PlanDeployment:
    """The node, which commands in this process find as well."""
    for name, value in node.environment.items():
        monkeypatch.setenv(name, value)
    return node


def words(*arguments: str) -> tuple[int, str]:
    """Give a command; return its exit status and all that it prints."""
    done = pnm(*arguments)
    return done.returncode, done.output.rstrip("\n")


def tasks() -> dict[str, str]:
    """Return the state of every task, by the beginning of its id."""
    return {task["id"][:8]: task["state"] for task in result(pnm("status", "--json"))["tasks"]}


def going_on(deployment: PlanDeployment) -> tuple[Program, str]:
    """Send a goal and wait until something of it is under way; return its client, and the beginning of its id."""
    before = tasks().keys()
    client = deployment.pnm(Program, "goal", FAR)
    client.until(lambda: any(" sent " in line for line in client.out))
    (task,) = tasks().keys() - before
    return client, task


# --- what fails ------------------------------------------------------------------------------


@pytest.mark.usefixtures("served")
@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["facts", "-n", "elsewhere"], 1, "is `pnm serve` running, in the namespace /elsewhere and with ROS_DOMAIN_ID="),
        (["pause"], 2, "no task is going on"),
        (["cancel", "zz"], 2, "no task"),
        (["goal", "(at r1 kichen)"], 2, "goal     not reached: goal:1:8: unknown object 'kichen'; did you mean 'kitchen'?"),
        (["facts", "--add", "(at r1 moon)"], 1, "add[0]:1:8: unknown object 'moon'"),
        (["facts", "--add", "(at r1 hall)"], 1, "(at r1 hall)"),  # which is sensed
        (["facts", "(at r1"], 1, "questions[0]:1:7: the text ends here"),
    ],
)
def test_what_cannot_be_is_printed_with_its_reason(arguments: list[str], status: int, said: str) -> None:
    ended, printed = words(*arguments)
    assert (ended, said in printed) == (status, True), printed


# --- what works -------------------------------------------------------------------------------


def test_a_goal_is_reached_and_its_events_are_printed(served: PlanDeployment) -> None:
    status, printed = words("goal", "(at r2 kitchen)", "--deadline", "600", "--policy", "queue", "--priority", "2")
    assert (status, printed.splitlines()[-1]) == (0, "goal     holds"), printed
    assert "sent    move(r2, hall, kitchen)" in printed
    assert "feedback move(r2, hall, kitchen): progress 0." in printed
    assert words("facts", "(at r2 kitchen)") == (0, "(at r2 kitchen)  true")


@pytest.mark.usefixtures("served")
def test_a_goal_is_sent_only_with_the_odds_that_are_asked_for() -> None:
    status, printed = words("goal", FAR, "--odds", "1")
    assert status == 1
    assert "expected 100 % at least" in printed.splitlines()[-1]
    assert "learned from 100 of move: move" in printed
    assert "sent " not in printed
    reached = result(pnm("goal", "(at r1 hall)", "--odds", "0.3", "--json"))
    assert reached["goal_reached"]
    assert 0.3 < reached["odds"]["chance"] < 1.0
    assert words("goal", "(at r1 kichen)", "--odds", "0.3")[0] == 2


def odds_of(task: str) -> Any:
    return next(each["odds"] for each in result(pnm("status", "--json"))["tasks"] if each["id"].startswith(task))


def test_a_task_has_odds_and_is_paused_resumed_and_cancelled_by_the_beginning_of_its_id(served: PlanDeployment) -> None:
    client, task = going_on(served)
    assert words("pause", task[:4], "--at-once") == (0, f"{task}: paused")
    assert tasks()[task] == "paused"
    until(lambda: odds_of(task) is not None)
    odds = odds_of(task)
    assert 0.1 < odds["chance"] < 1.0
    assert "learned from 100 of move: move" in odds["rests_on"]
    assert "most in 90 %" in words("status")[1]
    assert words("resume") == (0, f"{task}: goes on")
    assert words("cancel", task) == (0, f"{task}: cancelled")
    assert client.ended() == 1
    assert client.out[-1].startswith("goal     not reached: ")
    assert tasks()[task] == "over"
    assert odds_of(task) is None


def test_an_interrupted_goal_is_cancelled_and_watched_by_another(served: PlanDeployment) -> None:
    watching = served.pnm(Program, "watch")
    watching.until(lambda: watching.out)
    client, task = going_on(served)
    client.process.send_signal(signal.SIGINT)
    assert client.ended() == 1
    assert client.out[-1].startswith("goal     not reached: ")
    watching.until(lambda: any(f"{task}  state   over: cancelled" in line for line in watching.out))
    watching.process.send_signal(signal.SIGINT)
    assert watching.ended() == 0
