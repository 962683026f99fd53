"""The node that takes goals: what it refuses at its start, its life cycle, and its clients; its tasks do as their goals say."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.e2e.command_line import pnm
from tests.support.e2e.plan_deployment import ABORTED, SUCCEEDED, PlanDeployment
from tests.support.e2e.plan_files import FILES
from tests.support.e2e.task_node import DOMAIN, PROBLEM, goals, serve, transitions
from tests.support.files import written

# --- what is refused -------------------------------------------------------------------------

TWO_WORLDS = {**FILES, "world.yaml": "a: {recipes: [plans.yaml]}\nb: {recipes: [plans.yaml]}\n"}
NO_NAME = {**FILES, "plans.yaml": "1st: {plan: []}"}
NO_TYPE = {**FILES, "domain.yaml": "actions: {go: {ros_type: my_msgs/action/Go}}", "plans.yaml": "tour: {plan: [go: {}]}"}
NO_YAML = {"robot.yaml": "/**:\n  ros__parameters: {domain: a\n"}


@pytest.mark.parametrize(
    ("files", "arguments", "status", "said"),
    [
        ({}, [], 2, "there is nothing to serve; expected a domain and a problem, or a world of plans, or both"),
        ({}, [DOMAIN], 2, "a domain and a problem belong together"),
        ({}, [DOMAIN, "nowhere.pddl"], 2, "nowhere.pddl: there is no such file"),
        ({}, [DOMAIN, PROBLEM, "--ros-args", "-p", "planner:=kairoos"], 2, "did you mean 'kairos'?"),
        ({}, ["--world", "w.yaml", "--goals", "g.yaml"], 2, "named goals need a domain and a problem; expected both, or no goals"),
        ({}, [DOMAIN, PROBLEM, "--ros-args", "--spam"], 1, "--spam"),
        ({}, [DOMAIN, PROBLEM, "--spam", "--ros-args"], 2, "No such option"),
        ({}, ["--params-file", "nowhere.yaml"], 2, "nowhere.yaml: there is no such file"),
        (NO_YAML, ["--params-file", "robot.yaml"], 2, "robot.yaml:"),
        (TWO_WORLDS, ["--world", "world.yaml", "--name", "c"], 2, "1:1: there is no world 'c' here; expected one of: a, b"),
        (NO_NAME, ["--world", "world.yaml"], 2, "not a name for an action server: '1st'"),
        (NO_TYPE, ["--world", "world.yaml"], 2, "the ROS type my_msgs/action/Go is not installed"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_and_nothing_is_served(
    deployment: PlanDeployment, monkeypatch: pytest.MonkeyPatch, files: dict[str, str], arguments: list[str], status: int, said: str
) -> None:
    for name, value in deployment.environment.items():
        monkeypatch.setenv(name, value)
    deployment.write(files)
    done = pnm("serve", *arguments, cwd=deployment.folder)
    assert (done.returncode, said in done.stderr, "ready" in done.stdout) == (status, True, False), done.output


def test_a_file_of_parameters_is_read_but_an_option_comes_first(deployment: PlanDeployment) -> None:
    lines = f"domain: {DOMAIN}", f"problem: {PROBLEM}", "planner_timeout: 5", "planer: race", "max_queue: 7"
    file = written(deployment.folder / "robot.yaml", "\n    ".join(("/**:\n  ros__parameters:", *lines)))
    serving = serve(deployment, "--planner-timeout", "5", "--params-file", str(file)).ready()
    assert "there is no parameter planer; it is ignored; did you mean 'planner'?" in serving.err
    serving.stop()


def test_a_second_node_of_the_same_name_offers_nothing(deployment: PlanDeployment) -> None:
    serving = serve(deployment, DOMAIN, PROBLEM).ready()
    second = serve(deployment, DOMAIN, PROBLEM, "--journal", "none")
    elsewhere = serve(deployment, DOMAIN, PROBLEM, "--ros-args", "-r", "__ns:=/r1").ready()
    assert second.ended() == 1
    assert "there is an action server /achieve_goal already" in "\n".join(second.err)
    assert "ready: 4 action servers: /r1/achieve_goal, /r1/propose_goal, /r1/execute_plan, /r1/plan" in elsewhere.out
    for one in (serving, elsewhere):
        one.stop()


# --- its life cycle ---------------------------------------------------------------------------


def test_a_node_is_led_through_its_states_by_others_and_answers_all_goals(deployment: PlanDeployment) -> None:
    world = Path(deployment.folder / "world.yaml")
    serving = serve(deployment, DOMAIN, PROBLEM, "--world", str(world), "--no-autostart")
    serving.until(lambda: "unconfigured: waits for its transitions" in serving.out)
    assert transitions(deployment, "activate", "configure") == [False, False]
    assert any("world.yaml: there is no such file" in line for line in serving.err), str(serving)
    deployment.write(FILES)  # by which it is mended
    assert transitions(deployment, "configure", "activate") == [True, True]
    client = goals(deployment, "running", *["goal_reached", "no_plan"] * 50)
    client.hears("feedback", goal=0, state=2)
    assert transitions(deployment, "deactivate", "activate", "deactivate", "cleanup") == [True] * 4
    client.hears("feedback", goal=0, state=5)
    first, *others = client.results()
    assert first["reason"] == "cancelled"
    assert [one["status"] for one in others] == [SUCCEEDED, ABORTED] * 50
    assert transitions(deployment, "configure", "activate") == [True, True]
    assert deployment.client("empty").result()["status"] == SUCCEEDED, "plans are offered beside goals"
    assert transitions(deployment, "shutdown") == [True]
    assert serving.ended() == 0
