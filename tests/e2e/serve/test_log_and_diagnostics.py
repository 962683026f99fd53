"""What rqt_console and rqt_robot_monitor see of the node, of `pnm run` and of simulated robots: `/rosout` and `/diagnostics`."""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping
from socket import gethostname
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import Log

from pnm.ros.tasks.executor_topics import Level
from tests.support.e2e.deployment import SimulationProgram
from tests.support.e2e.plan_deployment import ClientProgram, PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PROBLEM
from tests.support.files import written
from tests.support.processes import Program

INFO, WARN, ERROR = (level[0] if isinstance(level, bytes) else level for level in (Log.INFO, Log.WARN, Log.ERROR))
FAULTS = """faults:
  - {call: "move(r2, hall, kitchen)", do: abort, times: 1}
  - {call: "move(r1, store, hall)", do: abort, times: 99}
  - {call: "move(r1, store, yard)", do: abort, times: 99}
"""
SENSING = """sensors:
  - topic: /{robot}/beat
    for: {robot: robot}
    type: std_msgs/msg/Float64
    variables: [{name: "{robot}_beat", field: data}]
"""


class Heard:
    """What the listener has heard so far."""

    def __init__(self, listener: ClientProgram) -> None:
        self.listener = listener

    def log(self, name: str, level: int, text: str) -> dict[str, Any]:
        """Wait for a line of the log that has this text."""

        def found() -> dict[str, Any] | None:
            lines = (one for one in self.listener.objects() if one["event"] == "log" and (one["name"], one["level"]) == (name, level))
            return next((one for one in lines if text in one["text"]), None)

        return self.listener.until(found) or {}

    def diagnosis(self, name: str, level: Level, message: str = "", **values: str) -> dict[str, Any]:
        """Wait until a part is so in the latest diagnosis of it."""

        def found() -> Mapping[str, Any] | None:
            latest = {one["name"]: one for one in self.listener.objects() if one["event"] == "diagnosis"}
            these = (latest[full] for full in fnmatch.filter(latest, f"pnm: {name}"))
            fits = (one for one in these if one["level"] == level and message in one["message"] and values.items() <= one["values"].items())
            return next(fits, None)

        return dict(self.listener.until(found) or {})


def test_the_levels_are_those_of_the_messages():
    levels = (DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR, DiagnosticStatus.STALE)
    assert [level[0] for level in levels] == [*Level]
    assert (INFO, WARN, ERROR) == (20, 30, 40)


def listening(deployment: PlanDeployment) -> Heard:
    listener = deployment.module(ClientProgram, "tests.support.e2e.programs.listener")
    listener.until(lambda: "ready" in listener.out)
    return Heard(listener)


@pytest.fixture(scope="module")
def heard(deployment_of_module: PlanDeployment) -> Heard:
    """A listener."""
    return listening(deployment_of_module)


@pytest.fixture(scope="module")
def robots(deployment_of_module: PlanDeployment, heard: Heard) -> SimulationProgram:
    faults = written(deployment_of_module.folder / "faults.yaml", FAULTS)
    return deployment_of_module.pnm(SimulationProgram, "simulate", DOMAIN, PROBLEM, "--speed", "2", "--faults", str(faults)).ready()


@pytest.fixture(scope="module")
def node(deployment_of_module: PlanDeployment, robots: SimulationProgram) -> Serving:
    sensing = written(deployment_of_module.folder / "sensing.yaml", SENSING)
    return deployment_of_module.pnm(Serving, "serve", DOMAIN, PROBLEM, "--sensing", str(sensing)).ready()


def test_what_happens_is_on_rosout_with_its_severity(deployment_of_module, heard, node):
    client = deployment_of_module.pnm(Program, "goal", "(at r2 kitchen)")
    assert client.ended() == 0, str(client)
    heard.log("robots", INFO, "ready: ")
    heard.log("robots", WARN, "end move(r2, hall, kitchen): aborted")
    heard.log("pnm", INFO, "active: goals are accepted by /achieve_goal")
    heard.log("pnm", INFO, "goal: (at r2 kitchen)")
    sent = heard.log("pnm", INFO, "sent: move(r2, hall, kitchen)")
    ended = heard.log("pnm", WARN, "ended: move(r2, hall, kitchen): aborted")
    heard.log("pnm", INFO, "ended: move(r2, hall, kitchen): succeeded")
    over = heard.log("pnm", INFO, "over: goal_reached")
    assert 1_600_000_000 < sent["stamp"] <= ended["stamp"] <= over["stamp"], "the time of the wall"


def test_what_fails_is_an_error(deployment_of_module, heard, node):
    client = deployment_of_module.pnm(Program, "goal", "(at r1 yard)")
    assert client.ended() == 1, str(client)
    heard.log("pnm", ERROR, "failed: move(r1, store, yard)")
    heard.log("pnm", WARN, "replanned: ")
    heard.log("pnm", ERROR, "over: ")
    assert client.out[-1].startswith("goal     not reached: ")
    failed = heard.diagnosis("tasks", Level.ERROR, "the last one failed: ")
    assert any(value.startswith("goal_reached") for value in failed["values"].values()), failed


def test_diagnostics_of_node_tasks_and_action_servers(deployment_of_module, heard, node):
    assert heard.diagnosis("node", Level.OK, "active", planner="kairos")["hardware"] == "/pnm"
    heard.diagnosis("action move (/r1/move)", Level.OK, "is there", type="pnm_interfaces/action/GroundAction")
    heard.diagnosis("journal", Level.OK, "can be written")
    heard.diagnosis("sensor *at* (/knowledge/sensed)", Level.OK, "is heard")
    heard.diagnosis("sensor r1_beat (/r1/beat)", Level.ERROR, "there is no topic /r1/beat")


def test_what_a_run_says_is_on_rosout(deployment_of_module, heard, robots):
    run = deployment_of_module.pnm(Program, "run", DOMAIN, PROBLEM, "--actions", "ros2")
    run.ended()
    heard.log("pnm_run", INFO, " goal")
    heard.log("pnm_run", INFO, "sent: ")
    assert not run.err, "nothing of it is printed twice"


def test_servers_that_are_gone_are_errors(heard, node, robots):
    robots.stop()
    heard.diagnosis("sensor *at* (/knowledge/sensed)", Level.STALE, "nothing reports about at")
    heard.diagnosis("action move (/r1/move)", Level.ERROR, "there is no action server /r1/move")


def test_diagnostics_show_a_pair_of_nodes_that_has_become_a_single_one(deployment, postgres):
    heard, journal = listening(deployment), postgres.database()

    def serving() -> Serving:
        return deployment.pnm(Serving, "serve", DOMAIN, PROBLEM, "--journal", journal)

    serving().ready()
    heard.diagnosis("journal", Level.OK, "can be written")
    second = serving()
    heard.diagnosis("journal", Level.OK, f"pid {second.process.pid} stands by")
    second.process.kill()
    heard.diagnosis("journal", Level.WARN, f"no other node stands by any more; the last one was {gethostname()} pid {second.process.pid}")
    heard.log("pnm", WARN, "no other node stands by any more")
