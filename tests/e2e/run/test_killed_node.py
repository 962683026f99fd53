"""A node that is killed while robots drive: the next one goes on with its goals; no call is begun twice."""

from __future__ import annotations

import json
from collections import Counter

from tests.support.e2e.deployment import SimulationProgram
from tests.support.e2e.plan_deployment import PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PROBLEM, goals
from tests.support.processes import LIMIT, Program

CALLS = 8
"""Calls of the plan for the goal of the problem."""


def killed(serving: Serving) -> None:
    """End a node as a crash would."""
    serving.process.kill()
    serving.process.wait(LIMIT)


def test_a_goal_goes_on_in_the_next_process_however_often_the_node_is_killed(deployment: PlanDeployment) -> None:
    command = ["-m", "planner_bridge", "simulate", DOMAIN, PROBLEM, "--speed", "4", "--log", "/dev/stdout"]
    robots = deployment.start(SimulationProgram(command, deployment.environment)).ready()
    journal = deployment.folder / "tasks.journal"

    def serve() -> Serving:
        options = ["--journal", str(journal), "--improve", "0"]
        return deployment.start(Serving(["-m", "planner_bridge", "serve", DOMAIN, PROBLEM, *options], deployment.environment)).ready()

    def starts() -> Counter[str]:
        return Counter(event["action"] for event in robots.objects() if event["event"] == "start")

    serving = serve()
    goal = "(and (at parcel1 hall) (at parcel2 kitchen))"
    client = deployment.start(Program(["-m", "planner_bridge", "goal", goal], deployment.environment))
    for count in (1, 3, 5, 7):
        robots.until(lambda count=count: sum(starts().values()) >= count)
        killed(serving)
        serving = serve()
    serving.until(lambda: any("reached the goal holds" in line for line in serving.out))
    assert client.ended() == 0, str(client)
    assert sum(starts().values()) == CALLS, starts()
    assert set(starts().values()) == {1}
    ends = [event["outcome"] for event in robots.objects() if event["event"] == "end"]
    assert ends == ["succeeded"] * CALLS
    serving.stop()
    history = deployment.start(Program(["-m", "planner_bridge", "history", str(journal), "--json"], deployment.environment))
    assert history.ended() == 0
    (task,) = map(json.loads, history.out)
    assert task["code"] == "goal_reached"
    replay = deployment.start(Program(["-m", "planner_bridge", "replay", str(journal)], deployment.environment))
    assert replay.ended() == 0, str(replay)
    assert sum("go on in another process" in line for line in replay.out) >= 1


def test_a_node_without_a_journal_cancels_what_it_has_forgotten_before_it_sends_anything_to_that_robot(deployment: PlanDeployment) -> None:
    faults = deployment.folder / "faults.yaml"
    faults.write_text("faults: [{action: move, do: hang, times: 1}]")
    command = ["-m", "planner_bridge", "simulate", DOMAIN, PROBLEM, "--faults", str(faults), "--speed", "4", "--log", "/dev/stdout"]
    robots = deployment.start(SimulationProgram(command, deployment.environment)).ready()
    goal = "(and (at parcel1 hall) (at parcel2 kitchen))"

    def serve() -> Serving:
        options = ["--journal", "none", "--improve", "0"]
        return deployment.start(Serving(["-m", "planner_bridge", "serve", DOMAIN, PROBLEM, *options], deployment.environment)).ready()

    def drives() -> list[tuple[str, str]]:
        """Return what has happened to drives, and of which robots."""
        moved = (event for event in robots.objects() if event["event"] in ("start", "end") and event["action"].startswith("move("))
        return [(event.get("outcome", "start"), event["action"].split("(")[1][:2]) for event in moved]

    serving = serve()
    goals(deployment, goal)
    robots.until(drives)
    killed(serving)
    serving = serve()
    client = deployment.start(Program(["-m", "planner_bridge", "goal", goal], deployment.environment))
    robots.until(lambda: any(outcome == "canceled" for outcome, _ in drives()))
    assert client.ended() == 0, str(client)
    for robot in ("r1", "r2"):
        mine = [outcome for outcome, whose in drives() if whose == robot]
        assert mine[::2] == ["start"] * len(mine[::2]), "one drive at a time"
    said = "".join((*client.out, *client.err, *serving.out, *serving.err))
    assert "of this node that it knows nothing of; it is cancelled" in said
    assert "unsolvable" not in said
