"""A node that is killed while robots drive, and has no journal; `tests/e2e/kills` has the others."""

from __future__ import annotations

from tests.support.e2e.deployment import SimulationProgram
from tests.support.e2e.plan_deployment import PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PROBLEM, goals
from tests.support.processes import LIMIT, Program


def killed(serving: Serving) -> None:
    """End a node as a crash would."""
    serving.process.kill()
    serving.process.wait(LIMIT)


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
