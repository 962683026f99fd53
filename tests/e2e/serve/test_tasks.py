"""The node that takes goals, in a process of its own: files, parameters, life cycle, clients; its tasks do as their goals say."""

from __future__ import annotations

import signal

import pytest

from tests.support.e2e.plan_deployment import ABORTED, CANCELED, SUCCEEDED, PlanDeployment
from tests.support.e2e.plan_files import FILES
from tests.support.e2e.task_node import DOMAIN, PROBLEM, goals, serve, transitions
from tests.support.files import written

# --- what is refused -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        ([], 2, "there is nothing to serve; expected a domain and a problem, or a world of plans, or both"),
        ([DOMAIN], 2, "a domain and a problem belong together"),
        ([DOMAIN, "nowhere.pddl"], 2, "nowhere.pddl: there is no such file"),
        ([DOMAIN, PROBLEM, "--ros-args", "-p", "on_failure:=canzel"], 2, "did you mean 'cancel'?"),
        (["--world", "world.yaml", "--goals", "goals.yaml"], 2, "named goals need a domain and a problem; expected both, or no goals"),
        ([DOMAIN, PROBLEM, "--ros-args", "--spam"], 1, "--spam"),
        ([DOMAIN, PROBLEM, "--spam", "--ros-args"], 2, "No such option"),
        (["--params-file", "nowhere.yaml"], 2, "nowhere.yaml: there is no such file"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_and_nothing_is_served(deployment, arguments, status, said):
    serving = serve(deployment, *arguments)
    assert serving.ended() == status, str(serving)
    assert said in "\n".join(serving.err), str(serving)
    assert serving.out == []


@pytest.mark.parametrize(("name", "how"), [("/**", ["--params-file"]), ("pnm", ["--ros-args", "--params-file"])])
def test_a_file_of_parameters_is_read(deployment, name, how):
    lines = f"domain: {DOMAIN}", f"problem: {PROBLEM}", "planner_timeout: 5", "planer: race", "max_queue: 7"
    file = written(deployment.folder / "robot.yaml", "\n    ".join((f"{name}:\n  ros__parameters:", *lines)))
    wrong = serve(deployment, *how, str(file))
    assert wrong.ended() == 2, str(wrong)
    assert "the parameter planner_timeout is wrong: " in "\n".join(wrong.err)
    serving = serve(deployment, "--planner-timeout", "5", *how, str(file)).ready()  # an option comes first
    assert "there is no parameter planer; it is ignored; did you mean 'planner'?" in serving.err
    serving.stop()


def test_a_file_of_parameters_that_is_no_yaml_says_where(deployment):
    file = written(deployment.folder / "robot.yaml", "/**:\n  ros__parameters: {domain: a\n")
    serving = serve(deployment, "--params-file", str(file))
    assert serving.ended() == 2
    assert f"{file}:" in "\n".join(serving.err), str(serving)


def test_a_second_node_of_the_same_name_offers_nothing(deployment):
    serving = serve(deployment, DOMAIN, PROBLEM).ready()
    deployment.write(FILES)
    second = serve(deployment, DOMAIN, PROBLEM, "--journal", "none")
    third = serve(deployment, "--world", str(deployment.folder / "world.yaml"), "--journal", "none")
    elsewhere = serve(deployment, DOMAIN, PROBLEM, "--ros-args", "-r", "__ns:=/r1").ready()
    for refused in (second, third):
        assert refused.ended() == 1
        assert "there is an action server /achieve_goal already" in "\n".join(refused.err)
    assert "ready: 3 action servers: /r1/achieve_goal, /r1/execute_plan, /r1/plan" in elsewhere.out
    assert goals(deployment, "goal_reached").result()["status"] == SUCCEEDED
    for one in (serving, elsewhere):
        one.stop()


# --- goals -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def served(deployment_of_module: PlanDeployment) -> PlanDeployment:
    """A node with goals and plans."""
    deployment_of_module.write(FILES)
    serve(deployment_of_module, DOMAIN, PROBLEM, "--world", str(deployment_of_module.folder / "world.yaml"), "--max-queue", "3").ready()
    return deployment_of_module


def test_goals_are_answered(served):
    client = goals(served, "running", "no_plan", "queued", "fly", "planning", "queued", "goal_reached")
    for goal, reason in ((1, "no_plan"), (3, "invalid_goal"), (5, "queue_full"), (6, "goal_reached")):
        assert client.hears("result", goal=goal)["reason"] == reason
    client.hears("feedback", goal=0, state=2)
    served.cancel_all("achieve_goal")
    ended = [(one["status"], one["reason"]) for one in client.results()]
    assert [ended[number] for number in (0, 2, 4, 6)] == [(CANCELED, "cancelled")] * 3 + [(SUCCEEDED, "goal_reached")]


def test_a_hundred_goals_from_another_process_are_all_answered(served):
    client = goals(served, *(["goal_reached", "no_plan"] * 50))
    assert [one["status"] for one in client.results()] == [SUCCEEDED, ABORTED] * 50


def test_plans_of_a_world_are_offered_beside_goals(served):
    assert served.client("empty").result()["status"] == SUCCEEDED


def test_a_client_that_is_killed_leaves_its_goal_behind_until_a_signal_ends_the_node(deployment):
    serving = serve(deployment, DOMAIN, PROBLEM, "--max-queue", "2").ready()
    killed, other = goals(deployment, "running 0"), goals(deployment, "planning")
    killed.hears("feedback", state=2)
    other.hears("feedback", state=1)
    killed.process.kill()
    assert goals(deployment, "queued").result()["reason"] == "queue_full", "the goal goes on"
    serving.stop(signal.SIGINT)
    assert [(one["status"], one["reason"]) for one in other.results()] == [(ABORTED, "cancelled")]
    assert any("running 0" in line and "goal" in line for line in serving.out), str(serving)


# --- life cycle ------------------------------------------------------------------------------


def test_a_node_is_led_through_its_states_by_others(deployment):
    serving = serve(deployment, DOMAIN, PROBLEM, "--no-autostart")
    serving.until(lambda: "unconfigured: waits for its transitions" in serving.out)
    assert transitions(deployment, "activate", "configure") == [False, True]
    assert goals(deployment, "goal_reached").hears("answered") == {"event": "answered", "goal": 0, "accepted": False}
    assert transitions(deployment, "activate") == [True]
    client = goals(deployment, "running")
    client.hears("feedback", state=2)
    assert transitions(deployment, "deactivate") == [True]
    client.hears("feedback", state=5)
    assert transitions(deployment, "activate") == [True]
    assert transitions(deployment, "deactivate", "cleanup") == [True, True]
    assert client.result()["reason"] == "cancelled"
    assert transitions(deployment, "configure", "activate") == [True, True]
    assert goals(deployment, "goal_reached").result()["status"] == SUCCEEDED
    assert transitions(deployment, "shutdown") == [True]
    assert serving.ended() == 0


def test_a_configuration_that_fails_can_be_mended(deployment):
    world = deployment.folder / "world.yaml"
    serving = serve(deployment, "--world", str(world), "--no-autostart")
    serving.until(lambda: "unconfigured: waits for its transitions" in serving.out)
    assert transitions(deployment, "configure") == [False]
    assert any("world.yaml: there is no such file" in line for line in serving.err), str(serving)
    deployment.write(FILES)
    assert transitions(deployment, "configure", "activate") == [True, True]
    assert deployment.client("empty").result()["status"] == SUCCEEDED
    serving.stop()
