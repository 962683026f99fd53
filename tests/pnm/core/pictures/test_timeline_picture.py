"""Pictures of timelines: every call is drawn once or named, bars do not lie over each other, and nothing is said by colours alone.

`--write` with python -m tests.pnm.core.pictures.test_timeline_picture renews the golden picture.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from xml.etree import ElementTree

import pytest
from hypothesis import given, strategies as st

from pnm.core.machine.requests import OutcomeKind
from pnm.core.pictures.timeline import Replan, TimedAttempt, TimedCall, TimedPlan, Timeline, replan, timeline_svg

GOLDEN = Path(__file__).parent / "golden" / "timeline.svg"
SVG = "{http://www.w3.org/2000/svg}"
DONE, FAILED, CANCELED = OutcomeKind.SUCCEEDED, OutcomeKind.ABORTED, OutcomeKind.CANCELED


def example() -> Timeline:
    """A call that fails twice, and a plan that takes the place of the first; one call is still under way."""
    attempts = (TimedAttempt(0.0, 3.0, FAILED, "no <path>"), TimedAttempt(3.5, 6.0, FAILED))
    first = (
        TimedCall(0, "move(r1, hall, kitchen)", "r1", 0.0, 4.0, attempts, "aborted"),
        TimedCall(1, "load(r2, parcel)", "r2", 0.0, 2.0, (TimedAttempt(0.0, 2.5, DONE),), "succeeded", is_done=True),
        TimedCall(2, "unload(r1, parcel)", "r1", 4.0, 2.0, (), "skipped"),
    )
    second = (
        TimedCall(0, "open(r2, door)", "r2", 6.0, 3.0, (TimedAttempt(6.0, 8.0, CANCELED), TimedAttempt(8.0)), "running"),
        TimedCall(1, "unload(r1, parcel)", "r1", 9.0, 2.0, (), "waiting"),
    )
    new = replan("move has failed 2 times", (call.name for call in first if not call.is_done), (call.name for call in second))
    return Timeline("parcels & letters", (TimedPlan(0.0, first, None, ("move: aborted",)), TimedPlan(6.0, second, new)), 9.5)


def test_a_picture_is_drawn_as_it_ever_was() -> None:
    assert timeline_svg(example()) == GOLDEN.read_text(encoding="utf-8")


def texts(svg: str) -> list[str]:
    return [element.text or "" for element in ElementTree.fromstring(svg).iter(f"{SVG}text")]


def test_a_call_that_fails_although_its_request_succeeded_says_so() -> None:
    call = TimedCall(0, "grasp(cup)", "r1", 0.0, 1.0, (TimedAttempt(0.0, 5.0, DONE),), "effects_missing", is_failed=True)
    assert "✗ effects_missing" in texts(timeline_svg(Timeline("g", (TimedPlan(0.0, (call,)),), 5.0)))


def test_what_takes_no_time_and_what_was_never_begun_is_named() -> None:
    svg = timeline_svg(Timeline("g", (TimedPlan(0.0, (TimedCall(0, "note(tea)", "note", 0.0, None, (), "succeeded"),)),), 1.0))
    assert "not drawn 1: note(tea) (succeeded)" in texts(svg)


@pytest.mark.parametrize("seconds", [0.0, 0.004, 1.0, 59.0, 86_400.0, 1e7])
def test_the_axis_has_round_times_that_can_be_read(seconds: float) -> None:
    calls = (TimedCall(0, "wait(r1)", "r1", 0.0, seconds, (TimedAttempt(0.0, seconds, DONE),), "succeeded"),)
    svg = timeline_svg(Timeline("g", (TimedPlan(0.0, calls),), seconds))
    times = [float(text.removesuffix(" s")) for text in texts(svg) if re.fullmatch(r"[\d.e+-]+ s", text)]
    assert times[0] == 0.0
    assert 1 <= len(times) <= 12


TIMES = st.floats(0, 50).map(lambda number: round(number, 1))


@st.composite
def attempts(draw: st.DrawFn) -> tuple[TimedAttempt, ...]:
    moments = sorted(draw(st.lists(TIMES, min_size=2, max_size=6)))
    pairs = list(zip(moments[::2], moments[1::2], strict=False))
    return tuple(TimedAttempt(sent, ended, draw(st.sampled_from(OutcomeKind))) for sent, ended in pairs)


@st.composite
def timelines(draw: st.DrawFn) -> Timeline:
    cuts = sorted(draw(st.lists(TIMES, max_size=3, unique=True)))
    plans = []
    for began in [0.0, *(moment for moment in cuts if moment > 0)]:
        calls = tuple(
            TimedCall(
                number,
                f"a{len(plans)}_{number}",
                draw(st.sampled_from(("r1", "r2"))),
                began + draw(TIMES),
                draw(st.none() | TIMES),
                draw(st.just(()) | attempts()),
                "words",
            )
            for number in range(draw(st.integers(0, 5)))
        )
        plans.append(TimedPlan(began, calls, Replan("why") if began else None))
    return Timeline("goal", tuple(plans), 60.0)


@given(timelines())
def test_every_call_is_drawn_once_or_named_and_no_bars_lie_over_each_other(timeline: Timeline) -> None:
    svg = timeline_svg(timeline)
    root = ElementTree.fromstring(svg)
    drawn = Counter(
        (group.findtext(f"{SVG}title") or "").partition("\n")[0] for group in root.iter(f"{SVG}g") if group.get("class") == "call"
    )
    named = Counter(name for title in texts(svg) if title.startswith("not drawn") for name in re.findall(r"(a\d_\d) \(", title))
    cut_off = sum(text.endswith("…") for text in texts(svg) if text.startswith("not drawn"))
    every = Counter(call.name for plan in timeline.plans for call in plan.calls)
    assert drawn + named == every or cut_off
    assert all(drawn[call.name] for plan in timeline.plans for call in plan.calls if call.attempts)
    bars = [
        tuple(float(rect.get(name, "")) for name in ("x", "y", "width", "height"))
        for group in root.iter(f"{SVG}g")
        if group.get("class") == "call"
        for rect in group.iter(f"{SVG}rect")
    ]
    for (x1, y1, w1, h1), (x2, y2, w2, h2) in combinations(bars, 2):
        assert x1 + w1 <= x2 + 2.001 or x2 + w2 <= x1 + 2.001 or y1 + h1 <= y2 or y2 + h2 <= y1
    assert all(x >= 0 and x + width <= float(root.get("width", "")) for x, _, width, _ in bars)
    assert svg.count('class="cut"') == sum(plan.replan is not None for plan in timeline.plans)


def test_calls_that_are_later_than_planned_keep_their_names_and_each_failure_its_sign() -> None:
    calls = (
        TimedCall(0, "go(r1, a)", "r1", 0.0, 10.0, (TimedAttempt(0.0, 20.0, DONE),), "succeeded"),
        TimedCall(1, "go(r1, b)", "r1", 10.0, 10.0, (TimedAttempt(20.0, 39.0, DONE),), "succeeded"),
        TimedCall(2, "go(r1, c)", "r1", 20.0, 10.0, tuple(TimedAttempt(39.0 + n / 10, 39.1 + n / 10, FAILED) for n in range(3)), "aborted"),
    )
    said = texts(timeline_svg(Timeline("g", (TimedPlan(0.0, calls),), 40.0)))
    assert {call.name for call in calls} <= {*said}
    assert sum(text.startswith("✗") and "failed" not in text for text in said) == 3


def test_several_tasks_stand_below_each_other() -> None:
    one = timeline_svg(example())
    two = timeline_svg(example(), replace(example(), goal="other"))
    height = float(ElementTree.fromstring(one).get("height", ""))
    assert float(ElementTree.fromstring(two).get("height", "")) == 2 * height
    assert "other" in texts(two)


def test_a_picture_grows_as_its_calls_do() -> None:
    def elements(calls: int) -> int:
        chain = tuple(
            TimedCall(n, "go(r1)", "r1", n * 3.0, 3.0, (TimedAttempt(n * 3.0, n * 3.0 + 3.0, DONE),), "succeeded") for n in range(calls)
        )
        svg = timeline_svg(Timeline("g", (TimedPlan(0.0, chain),), calls * 3.0))
        return sum(group.get("class") == "call" for group in ElementTree.fromstring(svg).iter(f"{SVG}g")) + svg.count("<rect")

    hundred, two_hundred, four_hundred = map(elements, (100, 200, 400))
    assert four_hundred - two_hundred == 2 * (two_hundred - hundred)


if __name__ == "__main__" and "--write" in sys.argv:
    GOLDEN.write_text(timeline_svg(example()), encoding="utf-8")
