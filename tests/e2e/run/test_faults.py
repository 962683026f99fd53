"""What goes wrong at the servers or in the world is found, named and got over; the world itself says so."""

from __future__ import annotations

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


def test_robots_killed_and_restarted_are_noticed_and_the_goal_is_reached_from_what_is_then_sensed(deploy):
    deployment = deploy("patrol/p01", speed="5")
    killed = deployment.simulate().ready()
    run = deployment.run()
    killed.happens("start", "move", 2)
    killed.kill()
    finished = deployment.finish(run, deployment.simulate())
    assert finished.result["goal_reached"]
    assert finished.result["replans"] >= 1
    first = next(event["action"] for event in killed.objects() if event["event"] == "start")
    assert first in [event["action"] for event in finished.events if event["event"] == "start"], "the new world starts from the beginning"
