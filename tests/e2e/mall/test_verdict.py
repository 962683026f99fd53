"""The verdict on scripts: what a robot leaves out is complained of."""

from __future__ import annotations

import pytest

from tests.support.e2e.mall.verdict import verdict_on

ONCE = ("point_at", "describe_route")


@pytest.mark.parametrize(
    ("done", "reply", "missing"),
    [
        (ONCE, "yes", []),
        (ONCE[1:], "yes", ["shop_0 had 0 times point_at"]),
        (ONCE, "no", ["shop_0 had 1 times describe_route", "shop_0 had 1 times point_at"]),
        ((*ONCE, "describe_route"), "no", ["shop_0 had 1 times point_at"]),
        ((*ONCE, *ONCE), "no", []),
    ],
)
def test_a_way_is_shown_once_and_again_when_it_was_not_understood(done: tuple[str, ...], reply: str, missing: list[str]) -> None:
    robot = [
        {"event": event, "call": f"{name}(shop_0)", "uses": "", "time": number + late, "outcome": "succeeded"}
        for number, name in enumerate(done)
        for event, late in (("start", 0.0), ("end", 0.5))
    ]
    visitor = [
        {"event": "script", "about": "s", "time": 0.0},
        {"event": "question", "about": "shop_0", "question": "q", "reply": reply, "time": 1.0},
        {"event": "end", "about": "s", "time": 9.0},
    ]
    verdict = verdict_on([{"name": "s", "requests": [{"shop": "shop_0"}]}], robot, visitor)
    assert [
        one.split(": ")[1].split(",")[0] for one in verdict.wrong if f" times {ONCE[0]}" in one or f" times {ONCE[1]}" in one
    ] == missing
