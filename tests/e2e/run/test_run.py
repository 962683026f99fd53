"""A run over ROS 2 that is cancelled by a signal while two robots are at work; their process knows what became of it."""

from __future__ import annotations

import json
import signal

import pytest

from tests.support.e2e.command_line import pnm
from tests.support.pddl.problems import ROOMS

IN_BACKGROUND = ("sh", "-c", 'trap "" INT; exec "$@"', "sh")
TWICE = (signal.SIGTERM, signal.SIGTERM)  # as some supervisors send it: to the process and to its group


@pytest.mark.parametrize(
    ("signals", "within"), [((signal.SIGINT,), IN_BACKGROUND), (TWICE, ())], ids=["INT in the background", "TERM twice at once"]
)
def test_every_signal_cancels_what_runs_and_still_tells_how_it_went_also_in_the_journal(deploy, signals, within):
    deployment = deploy("delivery/p01", speed="0.1")
    simulation = deployment.simulate().ready()
    journal = str(deployment.folder / "run.journal")
    run = deployment.run("--journal", journal, within=within)
    simulation.until(lambda: len([one for one in simulation.objects() if one["event"] == "start"]) == 2)
    for number in signals:
        run.process.send_signal(number)
    finished = deployment.finish(run, simulation)
    assert (finished.status, finished.result["reason"]) == (1, "cancelled")
    assert [event["outcome"] for event in finished.events if event["event"] == "end"] == ["canceled", "canceled"]
    assert [call["outcome"] for call in finished.result["calls"] if call["attempts"]] == ["canceled", "canceled"]
    assert finished.result["failures"] == []
    (task,) = map(json.loads, pnm("history", journal, "--json").stdout.splitlines())
    assert task["code"] == "cancelled"
    assert pnm("resume", journal).returncode == 1


def test_actions_have_hyphens_in_their_names_and_servers_none(deploy):
    domain = ROOMS.replace("(:action move", "(:action go-to")
    assert domain != ROOMS
    problem = """(define (problem p) (:domain rooms) (:objects r1 - robot a b - room)
     (:init (at r1 a) (way a b) (= (total-cost) 0)) (:goal (at r1 b)))"""
    finished = deploy("rooms", texts=(domain, problem), quick=True).execute()
    assert (finished.status, finished.result["plans"]) == (0, 1), finished.result
