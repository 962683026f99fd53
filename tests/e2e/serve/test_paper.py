"""Listings 1 and 2 of the paper, as they are printed, on plain action servers in another process."""

from __future__ import annotations

from tests.support.e2e.plan_deployment import SUCCEEDED
from tests.support.yaml.examples import PAPER_DOMAIN, PAPER_PLAN


def test_one_action_and_then_four_at_once_two_with_the_time_it_returned(deployment):
    deployment.write(
        {"listing1.yaml": PAPER_DOMAIN, "listing2.yaml": PAPER_PLAN, "world.yaml": "domain: listing1.yaml\nplans: [listing2.yaml]"}
    )
    workers = deployment.workers("dummy_server", "four_waits").ready()
    serving = deployment.serve().ready()
    result = deployment.client("listing2").result()
    assert (result["status"], result["success"], result["reason"]) == (SUCCEEDED, True, "goal"), f"{result} {serving}"
    events = [(one["event"], one["server"], one["value"]) for one in workers.objects()]
    assert events[:2] == [("start", "dummy_server", 3), ("end", "dummy_server", 3)]
    assert sorted(events[2:6]) == [("start", "wait", time) for time in (3.0, 3.0, 5.0, 6.0)]
    assert sorted(events[6:]) == [("end", "wait", time) for time in (3.0, 3.0, 5.0, 6.0)]
    assert any("'...' at the beginning is left out" in line for line in serving.err)
