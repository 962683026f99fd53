"""Robots on two hosts, and the cable between them pulled out: for less than the lease of DDS, and for longer."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.e2e.hosts.lan import lan, why_not
from tests.support.e2e.hosts.survey import Survey
from tests.support.processes import overlaps

PERSISTENT = """
actions:
  fly:
    params: [robot, from, to]
    server: "/{{robot}}/navigate"
    timeout: 60
    recoveries: {{during: {{lost: {{do: retry, times: {times}}}, unavailable: {{do: retry, times: {times}}}}}}}
initial_knowledge: {{from: base, to: north}}
plan:
  - fly: {{robot: d1}}
"""


ALONE = why_not()
pytestmark = pytest.mark.skipif(bool(ALONE), reason=ALONE)


@pytest.fixture
def survey(tmp_path: Path) -> Iterator[Survey]:
    with lan("rover", "drone") as hosts:
        deployment = Survey(hosts, tmp_path)
        try:
            yield deployment
        finally:
            deployment.close()


def starts(simulation):
    return [event["action"] for event in simulation.objects() if event["event"] == "start"]


def end_outcomes(simulation):
    return [event["outcome"] for event in simulation.objects() if event["event"] == "end"]


def reached(run):
    """The result of a run that reaches its goal; what it said when it does not."""
    status, result = run.result()
    assert (status, result["goal_reached"]) == (0, True), f"{result}\n{run}"
    return result


def assert_lost(failure):
    """Whether the answer to the goal came through before the cut, only the network knows."""
    assert (failure["call"], failure["cause"], failure["observed"]) in (
        ("fly(d1, base, north)#0", "lost", "/d1/navigate went away"),
        ("fly(d1, base, north)#0", "unavailable", "/d1/navigate went away before it answered"),
    )


def test_what_ends_while_the_link_is_cut_is_heard_of_when_it_has_healed(survey):
    drone = survey.robot("drone").ready()
    run = survey.run("(surveyed north)", kinds=["drone"])
    drone.happens("start", "fly")
    survey.lan.cut("drone")
    drone.happens("end", "fly")
    survey.lan.heal("drone")
    assert reached(run)["failures"] == []
    assert starts(drone) == ["fly(d1, base, north)", "look_down(d1, north)"]


def test_when_a_host_is_lost_the_robots_on_the_other_one_do_its_work(survey):
    rover, drone = survey.robot("rover").ready(), survey.robot("drone").ready()
    run = survey.run("(surveyed north)")
    drone.happens("start", "fly")
    survey.lan.cut("drone")
    assert_lost(reached(run)["failures"][0])
    assert starts(rover) == ["drive(r1, base, south)", "drive(r1, south, north)", "look_around(r1, north)"]
    assert starts(drone) == ["fly(d1, base, north)"]


def test_what_was_given_up_is_cancelled_after_the_cut_before_it_is_done_again(survey):
    drone = survey.robot("drone", faults="faults: [{action: fly, do: hang, times: 1}]").ready()
    run = survey.run_plan(PERSISTENT.format(times=5))
    drone.happens("start", "fly")
    survey.lan.cut("drone")
    run.until(lambda: any("/d1/navigate went away" in line for line in run.out))
    survey.lan.heal("drone")
    assert run.ended() == 0
    assert end_outcomes(drone) == ["canceled", "succeeded"]
    assert not overlaps(drone.objects())
