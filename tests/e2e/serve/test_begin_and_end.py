"""How serving plans ends: by signals, with clients and action servers in other processes; and plans of `pnm run` over ROS 2."""

from __future__ import annotations

import signal
from pathlib import Path

from tests.support.e2e.command_line import pnm, result
from tests.support.e2e.deployment import RunProgram
from tests.support.e2e.plan_deployment import ABORTED
from tests.support.e2e.plan_files import DOMAIN, FILES, PLANS, shared


def test_a_terminal_that_is_closed_cancels_what_runs_and_tells_the_clients(deployment):
    deployment.write(FILES)
    workers = deployment.workers("wait").ready()
    serving = deployment.serve().ready()
    client = deployment.client("waits", {"time": 1000}, {"time": 2000})
    for time in (1000, 2000):
        workers.happens("start", "wait", time)
    serving.stop(signal.SIGHUP)
    assert [(result["status"], result["reason"]) for result in client.results()] == [(ABORTED, "cancelled")] * 2
    assert {one["value"] for one in workers.objects() if one["event"] == "cancelled"} == {1000, 2000}
    assert sum("cancelled the node is shut down" in line for line in serving.out) == 2


def test_who_asks_twice_does_not_have_to_wait(deployment):
    deployment.write(
        {**FILES, "plans.yaml": "clings: {plan: [stubborn: {time: 1000}]}", "domain.yaml": "actions: {stubborn: {cancel: 500}}"}
    )
    workers = deployment.workers("stubborn").ready()
    serving = deployment.serve().ready()
    deployment.client("clings")
    workers.happens("start", "stubborn")
    serving.process.send_signal(signal.SIGTERM)
    deployment.cancel_all("stubborn")
    serving.stop()
    assert "clings has not ended; its calls are left alone" in serving.err


def test_a_plan_of_pnm_run_is_in_touch_with_its_action_servers_too(deployment):
    deployment.write({"all.yaml": DOMAIN + PLANS})
    deployment.workers("wait").ready()
    knowing = deployment.workers(script="asking_servers").ready()
    file = str(deployment.folder / "all.yaml")
    options = ["--name", "knows", "--set", "value=7", "--actions", "ros2", "--json", "--knowledge", str(deployment.knowledge)]
    run = deployment.pnm(RunProgram, "run", "--plan", file, *options)
    status, told = run.result()
    assert (status, told["results"]) == (0, {"spam": 7, "eggs": 107, "time": 7})
    assert {"event": "found", "server": "remember", "value": [7, 107]} in knowing.objects()
    assert shared(deployment.knowledge, "eggs") == 107


def test_global_knowledge_of_simulated_runs_is_in_the_file_that_is_named(tmp_path: Path):
    plans = tmp_path / "plans.yaml"
    plans.write_text(
        "actions: {know: {type: kb_action}}\n"
        "tell: {plan: [know: {operation: {RemoteUpdate: [n, 5]}}]}\n"
        "ask: {results: [found], plan: [know: {operation: {LocalUpdate: [found, {RemoteQuery: n}]}}]}\n"
    )
    file = tmp_path / "new" / "n.sqlite"
    told = [result(pnm("run", "--plan", str(plans), "--json", "--knowledge", str(file), "--name", name)) for name in ("tell", "ask")]
    assert [one["results"] for one in told] == [{}, {"found": 5}]
    assert shared(file, "n") == 5
