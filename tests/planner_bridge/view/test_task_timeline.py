"""Timelines of tasks: what a journal tells of them is what the task itself says."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.pipeline.achieve import achieve
from planner_bridge.pipeline.carry_out import carry_out
from planner_bridge.tasks.settings import TaskObserver
from planner_bridge.view.story import timelines
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.core.machine.plan_graph import ActionCall
from pnm.core.machine.requests import Outcome, OutcomeKind, Request
from pnm.core.pictures.timeline import Timeline
from tests.support.files import ROOT, written

DELIVERY = (ROOT / "domains/delivery/domain.pddl", ROOT / "problems/delivery/p01.pddl")
BLOCKED = Faults((Fault("move(r1, hall, kitchen)", FaultKind.ABORT, message="the way is blocked"),))


class Sent(TaskObserver):
    """Notes what is sent, and how it ends."""

    def __init__(self) -> None:
        self.seen: list[tuple[str, str, float]] = []

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        self.seen.append(("sent", str(call.action), now))

    def ended(self, call: ActionCall, outcome: Outcome, now: float) -> None:
        self.seen.append((outcome.kind.value, str(call.action), now))


def moments(timeline: Timeline) -> list[tuple[str, str, float]]:
    """What a timeline says was sent, and how it ended."""
    found = []
    for call in (call for plan in timeline.plans for call in plan.calls):
        for attempt in call.attempts:
            found.append(("sent", call.name, attempt.sent))
            if attempt.ended is not None and attempt.outcome is not None:
                found.append((attempt.outcome.value, call.name, attempt.ended))
    return found


def rounded(seen: list[tuple[str, str, float]], began: float = 0.0) -> list[tuple[str, str, float]]:
    return sorted((word, name, round(time - began, 4)) for word, name, time in seen)


def test_a_timeline_says_when_everything_was_sent_and_ended_and_why_there_was_another_plan(tmp_path: Path) -> None:
    observer = Sent()
    result = achieve(*DELIVERY, faults=BLOCKED, observer=observer, journal=tmp_path / "j")
    assert result.goal_reached
    (timeline,) = timelines(tmp_path / "j")
    assert rounded(moments(timeline)) == rounded(observer.seen, result.began)
    assert timeline.ending == "goal_reached: the goal holds"
    assert len(timeline.plans) == 1 + result.replans
    first, *later = timeline.plans
    assert first.replan is None
    assert first.failures == (str(result.failures[0]),)
    assert {call.lane for call in first.calls} == {"r1", "r2"}
    assert [plan.replan.why for plan in later if plan.replan] == [
        "the rest of the plan still works: going on with 2 calls in a new machine",
        "a new plan is needed: move(r1, hall, kitchen) has failed 2 times; not again: move(r1, hall, kitchen)",
    ]
    assert all(attempt.message == "the way is blocked" for attempt in first.calls[4].attempts)
    (last,) = later[-1:]
    assert last.replan
    assert last.replan.dropped == ("move(r1, hall, kitchen)",)
    assert [call.planned - last.began for call in last.calls][:2] == pytest.approx([0.0, 0.0], abs=0.02)
    assert all(call.is_done for call in last.calls)


def test_a_plan_by_hand_has_lanes_by_what_its_actions_have_for_themselves(tmp_path: Path) -> None:
    plan = written(
        tmp_path / "plan.yaml",
        "actions:\n  say: {params: [text], resources: [voice]}\n  point: {params: [place], resources: [r1/arm]}\n"
        "plan:\n  - say: {text: Hello you}\n  - point: {place: hall}\n",
    )
    assert carry_out(plan, journal=tmp_path / "j").goal_reached
    (timeline,) = timelines(tmp_path / "j")
    assert [(call.name, call.lane) for call in timeline.plans[0].calls] == [("say(Hello you)", "voice"), ("point(hall)", "r1")]
    assert all(attempt.outcome is OutcomeKind.SUCCEEDED for call in timeline.plans[0].calls for attempt in call.attempts)
