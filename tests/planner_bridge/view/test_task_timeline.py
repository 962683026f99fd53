"""Timelines of tasks: what a journal tells of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from planner_bridge.pipeline.carry_out import carry_out
from planner_bridge.view.story import timelines
from pnm.core.machine.requests import OutcomeKind
from tests.support.files import written


def test_a_timeline_says_what_failed_and_why_there_was_another_plan(delivery: Path) -> None:
    (timeline,) = timelines(delivery)
    assert timeline.ending == "goal_reached: the goal holds"
    first, *later = timeline.plans
    assert first.replan is None
    assert first.failures == ("move(r1, hall, kitchen)#4: aborted: the way is blocked",)
    assert {call.lane for call in first.calls} == {"r1", "r2"}
    assert [plan.replan.why for plan in later if plan.replan] == [
        "the rest of the plan still works: going on with 2 calls in a new machine",
        "a new plan is needed: move(r1, hall, kitchen) has failed 2 times; not again: move(r1, hall, kitchen)",
    ]
    tried = [(attempt.sent, attempt.ended, attempt.outcome, attempt.message) for attempt in first.calls[4].attempts]
    assert tried == [(sent, sent + 2.0, OutcomeKind.ABORTED, "the way is blocked") for sent in (8.0, 10.0)]
    last = later[-1]
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
