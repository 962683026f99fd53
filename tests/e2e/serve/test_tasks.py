"""The node that takes goals, in a process of its own: files, parameters, life cycle, clients; its tasks do as their goals say."""

from __future__ import annotations

import re
import signal

import pytest

from planner_bridge.node.options import PARAMETERS
from tests.support.e2e.plan_files import FILES
from tests.support.e2e.plans import ABORTED, CANCELED, SUCCEEDED, PlanScene
from tests.support.e2e.task_node import DOMAIN, PAGE, PROBLEM, change, goals, serve

# --- what is refused -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        ([], 2, "there is nothing to serve; expected a domain and a problem, or a world of plans, or both"),
        ([DOMAIN], 2, "a domain and a problem belong together"),
        ([DOMAIN, "nowhere.pddl"], 2, "nowhere.pddl:1:1: cannot be read: No such file or directory"),
        ([DOMAIN, PROBLEM, "--ros-args", "-p", "on_failure:=canzel"], 2, "did you mean 'cancel'?"),
        (["--world", "world.yaml", "--goals", "goals.yaml"], 2, "goals with names need a domain and a problem; expected both, or no goals"),
        ([DOMAIN, PROBLEM, "--ros-args", "--spam"], 1, "--spam"),
        ([DOMAIN, PROBLEM, "--spam", "--ros-args"], 2, "No such option"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_and_nothing_is_served(plan_scene, arguments, status, said):
    serving = serve(plan_scene, *arguments)
    assert serving.ended() == status, str(serving)
    assert said in "\n".join(serving.err), str(serving)
    assert serving.out == []


def test_a_second_node_of_the_same_name_offers_nothing(plan_scene):
    serving = serve(plan_scene, DOMAIN, PROBLEM).ready()
    second = serve(plan_scene, DOMAIN, PROBLEM)
    assert second.ended() == 1
    assert "there is an action server /achieve_goal already" in "\n".join(second.err)
    plan_scene.write(FILES)
    third = serve(plan_scene, "--world", str(plan_scene.folder / "world.yaml"))
    assert third.ended() == 1
    assert "there is an action server /achieve_goal already" in "\n".join(third.err)
    fourth = serve(plan_scene, DOMAIN, PROBLEM, "--ros-args", "-r", "__ns:=/r1").ready()
    assert "ready: 3 action servers: /r1/achieve_goal, /r1/execute_plan, /r1/plan" in fourth.out
    assert goals(plan_scene, "goal_reached").result()["status"] == SUCCEEDED
    for one in (serving, fourth):
        one.stop()


# --- goals -----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def served(plan_scene_of_module: PlanScene) -> PlanScene:
    """A node with goals and plans."""
    plan_scene_of_module.write(FILES)
    serve(plan_scene_of_module, DOMAIN, PROBLEM, "--world", str(plan_scene_of_module.folder / "world.yaml"), "--max-queue", "3").ready()
    return plan_scene_of_module


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


def test_a_client_that_is_killed_leaves_its_goal_behind_until_a_signal_ends_the_node(plan_scene):
    serving = serve(plan_scene, DOMAIN, PROBLEM, "--max-queue", "2").ready()
    killed, other = goals(plan_scene, "running 0"), goals(plan_scene, "planning")
    killed.hears("feedback", state=2)
    other.hears("feedback", state=1)
    killed.process.kill()
    assert goals(plan_scene, "queued").result()["reason"] == "queue_full", "the goal goes on"
    serving.stop(signal.SIGINT)
    assert [(one["status"], one["reason"]) for one in other.results()] == [(ABORTED, "cancelled")]
    assert any("running 0" in line and "goal" in line for line in serving.out), str(serving)


# --- life cycle ------------------------------------------------------------------------------


def test_a_node_is_led_through_its_states_by_others(plan_scene):
    serving = serve(plan_scene, DOMAIN, PROBLEM, "--no-autostart")
    serving.until(lambda: "unconfigured: waits for its transitions" in serving.out)
    assert change(plan_scene, "activate", "configure") == [False, True]
    assert goals(plan_scene, "goal_reached").hears("answered") == {"event": "answered", "goal": 0, "accepted": False}
    assert change(plan_scene, "activate") == [True]
    client = goals(plan_scene, "running")
    client.hears("feedback", state=2)
    assert change(plan_scene, "deactivate") == [True]
    client.hears("feedback", state=5)
    assert change(plan_scene, "activate") == [True]
    assert change(plan_scene, "deactivate", "cleanup") == [True, True]
    assert client.result()["reason"] == "cancelled"
    assert change(plan_scene, "configure", "activate") == [True, True]
    assert goals(plan_scene, "goal_reached").result()["status"] == SUCCEEDED
    assert change(plan_scene, "shutdown") == [True]
    assert serving.ended() == 0


def test_plans_of_a_world_are_paused_while_the_node_is_inactive(plan_scene):
    plan_scene.write(FILES)
    workers = plan_scene.workers("wait").ready()
    serving = serve(plan_scene, "--world", str(plan_scene.folder / "world.yaml")).ready()
    client = plan_scene.client("waits", {"time": 0.5}, {"time": 1000})
    workers.happens("end", "wait", 0.5)
    assert change(plan_scene, "deactivate") == [True]
    workers.happens("cancelled", "wait", 1000)
    assert plan_scene.client("empty").hears("answered") == {"event": "answered", "goal": 0, "accepted": False}
    assert change(plan_scene, "activate") == [True]
    workers.until(lambda: workers.starts("wait").count(1000) == 2)
    serving.stop()
    assert [one["reason"] for one in client.results()] == ["goal", "cancelled"]


def test_a_configuration_that_fails_can_be_mended(plan_scene):
    world = plan_scene.folder / "world.yaml"
    serving = serve(plan_scene, "--world", str(world), "--no-autostart")
    serving.until(lambda: "unconfigured: waits for its transitions" in serving.out)
    assert change(plan_scene, "configure") == [False]
    assert any("world.yaml:1:1: cannot be read" in line for line in serving.err), str(serving)
    plan_scene.write(FILES)
    assert change(plan_scene, "configure", "activate") == [True, True]
    assert plan_scene.client("empty").result()["status"] == SUCCEEDED
    serving.stop()


# --- what the page says ----------------------------------------------------------------------


def test_the_page_lists_the_parameters():
    rows = dict(re.findall(r"^\| `(\w+)` \| (?:`(.*)`)? ?\| ", PAGE, re.MULTILINE))
    assert {one.name: str(one.default).lower() for one in PARAMETERS}.items() <= rows.items()
