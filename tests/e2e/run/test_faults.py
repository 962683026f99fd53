"""What goes wrong at the servers or in the world is found, named and got over; the world itself says so."""

from __future__ import annotations

import pytest

from tests.support.files import ROOT

IMPATIENT = """
actions:
  move: {server: "/{robot}/move", timeout: 1, cancel: 1}
  return_home: {server: "/{robot}/move", timeout: 1}
  inspect: {server: "/{robot}/inspect", timeout: 1}
assumed: [effort]
"""


def both_ways(fault: str) -> str:
    """The way between gate and barn fails in either direction, so the ring of patrol/p01 is cut."""
    return f'faults: [{{call: "move(r1, gate, barn)", {fault}}}, {{call: "move(r1, barn, gate)", {fault}}}]'


@pytest.mark.parametrize(
    ("domain", "causes"),
    [("delivery", {"aborted"}), ("patrol", {"aborted", "precondition_false"})],
)
def test_the_faults_that_come_with_a_domain_are_got_over(deploy, domain, causes):
    faults = (ROOT / "problems" / domain / "faults.yaml").read_text(encoding="utf-8")
    finished = deploy(f"{domain}/p01", quick=True, faults=faults).execute()
    assert finished.result["goal_reached"]
    assert causes <= {failure["cause"] for failure in finished.result["failures"]}
    assert finished.result["replans"] >= 1
    assert max(finished.attempts("move")) == 2


def test_rejected_goals_and_success_without_effect_are_retried_then_replanned(deploy):
    faults = both_ways("do: reject").replace("]", ", {action: inspect, do: no_effect, after: 1, times: 3}]")
    finished = deploy("patrol/p01", quick=True, faults=faults).execute()
    assert finished.result["goal_reached"]
    assert finished.causes("move") == {"rejected"}
    assert "/r1/move rejected the goal" in {failure["observed"] for failure in finished.result["failures"]}
    assert max(finished.attempts("move")) == 2
    assert finished.causes("inspect") == {"effects_missing"}
    assert max(finished.attempts("inspect")) == 3
    assert set(finished.outcomes("inspect")) == {"succeeded"}
    assert finished.result["plans"] >= 2


def test_a_fact_changed_behind_the_robots_back_is_found_while_the_action_runs(deploy):
    finished = deploy(
        "delivery/p02",
        quick=True,
        faults="""
            faults: [{action: pass_door, do: hang, times: 1}]
            changes: [{on: start of pass_door, set: ["(not (open door2))"]}]
        """,
    ).execute()
    assert finished.result["goal_reached"]
    assert "invariant_false" in finished.causes("pass_door")
    assert finished.outcomes("pass_door")[0] == "canceled"
    assert finished.result["replans"] >= 1


def test_hung_and_slow_servers_are_cancelled_and_tried_again(deploy):
    faults = "faults: [{action: inspect, do: slow, times: 1}, {action: inspect, do: hang, after: 2, times: 1}]"
    finished = deploy("patrol/p01", quick=True, faults=faults, bindings=IMPATIENT, speed="4").execute()
    assert finished.result["goal_reached"]
    assert finished.attempts("inspect") == [2, 2, 1]
    assert finished.outcomes("inspect") == ["canceled", "succeeded", "canceled", "succeeded", "succeeded"]
    assert finished.result["failures"] == []


def test_a_hung_server_that_ignores_cancelling_is_given_up_and_got_round(deploy):
    finished = deploy("patrol/p01", quick=True, faults=both_ways("do: hang, ignores_cancel: true"), bindings=IMPATIENT).execute()
    assert finished.result["goal_reached"]
    assert finished.causes("move") == {"timed_out"}
    assert {failure["observed"] for failure in finished.result["failures"]} == {"neither"}
    assert finished.result["plans"] >= 2


def test_what_a_lost_server_did_is_done_by_another_robot(deploy):
    faults = "faults: [{action: move, do: lose_server, times: 1}]"
    finished = deploy("delivery/p01", quick=True, faults=faults).execute()
    lost = next(event["action"] for event in finished.events if event["event"] == "end" and event["outcome"] == "lost")
    robot = lost[len("move(") :].split(",")[0]
    gone = [failure for failure in finished.result["failures"] if failure["cause"] in ("lost", "unavailable")]
    assert gone
    assert all(f"/{robot}/move" in failure["observed"] for failure in gone)
    assert finished.result["goal_reached"]
    moved = [event["action"] for event in finished.events if event["event"] == "end" and event["outcome"] == "succeeded"]
    assert not any(action.startswith(f"move({robot},") for action in moved)
