"""A node that is stopped for a while, and another one that is started meanwhile with the same journal: only one of them acts."""

from __future__ import annotations

import signal
from collections import Counter

from planner_bridge.tasks.result import TASKS
from pnm.journal.resume import replayed
from pnm.tasks import Code
from tests.support.e2e.deployment import SimulationProgram
from tests.support.e2e.plan_deployment import PlanDeployment, Serving
from tests.support.e2e.task_node import DOMAIN, PROBLEM
from tests.support.processes import LIMIT, Program


def test_a_node_that_was_stopped_goes_on_while_another_one_stands_by(deployment: PlanDeployment) -> None:
    command = ["-m", "planner_bridge", "simulate", DOMAIN, PROBLEM, "--speed", "4", "--log", "/dev/stdout"]
    robots = deployment.start(SimulationProgram(command, deployment.environment)).ready()
    journal = deployment.folder / "tasks.journal"

    def serve() -> Serving:
        options = ["--journal", str(journal), "--improve", "0"]
        return deployment.start(Serving(["-m", "planner_bridge", "serve", DOMAIN, PROBLEM, *options], deployment.environment))

    def starts() -> Counter[str]:
        return Counter(event["action"] for event in robots.objects() if event["event"] == "start")

    first = serve().ready()
    goal = "(and (at parcel1 hall) (at parcel2 kitchen))"
    deployment.start(Program(["-m", "planner_bridge", "goal", goal], deployment.environment))
    robots.until(lambda: starts().total() >= 2)
    first.process.send_signal(signal.SIGSTOP)
    second = serve()
    second.until(lambda: any("pid" in line for line in (*second.out, *second.err)))
    first.process.send_signal(signal.SIGCONT)
    first.until(lambda: any("reached the goal holds" in line for line in first.out))
    done = Counter(event["action"] for event in robots.objects() if event["event"] == "end" and event["outcome"] == "succeeded")
    assert set(done.values()) == {1}, done
    assert not any(line.startswith("ready") for line in second.out)
    first.process.kill()
    first.process.wait(LIMIT)
    second.ready().stop()
    (task,) = replayed(journal, TASKS).tasks.values()
    assert task.ending is not None
    assert task.ending.code is Code.GOAL_REACHED
