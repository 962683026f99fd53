"""The benchmark of plan executives: what decides about its numbers; nothing is timed here."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import pytest

from tests.support.benchmarks.executives import calls, gate, plans, tasks
from tests.support.benchmarks.executives.measured import MeasuredRow, Taken, measure
from tests.support.benchmarks.executives.page import BEGIN, END, PAGE, measured_part, put_in
from tests.support.benchmarks.executives.table import ROWS, Row, Subject, peer
from tests.support.benchmarks.peers.__main__ import MEASURES

OURS, RIVAL, FLOOR = Subject("ours", "call-inline"), peer("UP-ESB", "esb-row"), Subject("counters", "counters-chain", does_less=True)
ROW = Row("A call", "What it is.", "µs", "calls", (10,), (OURS, RIVAL, FLOOR), rounds=3)


def taken(ours: tuple[float, ...], rival: tuple[float, ...], floor: tuple[float, ...] = (1.0,)) -> MeasuredRow:
    return MeasuredRow(ROW, 10, (Taken(OURS, ours), Taken(RIVAL, rival, "" if rival else "not installed"), Taken(FLOOR, floor)))


def test_every_subject_has_a_measure_and_every_row_stands_on_the_page() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for row in ROWS:
        assert f"### {row.what}\n" in page, f"{row.what}: python -m tests.benchmarks --write"
        assert not row.subjects[0].is_peer
        for subject in row.subjects:
            assert subject.measure in (MEASURES if subject.is_peer else calls.MEASURES | plans.MEASURES | tasks.MEASURES)


def test_the_gate_names_what_is_too_slow_and_what_has_no_limit() -> None:
    assert json.loads(gate.LIMITS.read_text()).keys() == {f"{name} {size}" for name, size in gate.GATE}
    assert gate.exceeded({"engine 10": 5.0}, {"engine 10": 5.0 * gate.MARGIN}) == []
    assert gate.exceeded({"engine 10": 5.0}, {"engine 10": 16.0}) == ["engine 10 takes 16 turns of a loop, 3.2 times the 5 that are stored"]
    assert gate.exceeded({}, {"engine 10": 1.0}) == ["engine 10 has no limit: --gate --write stores one"]


def test_all_have_their_turn_in_every_round_and_who_cannot_take_part_is_asked_once() -> None:
    asked: list[str] = []

    def ask(subject: Subject, size: int) -> Mapping[str, Any]:
        asked.append(subject.label)
        return {"missing": "not installed"} if subject is RIVAL else {"value": float(len(asked))}

    measured = measure(ROW, 10, ask, rounds=5)
    assert asked == ["ours", "UP-ESB", "counters", "ours", "counters", "ours", "counters"]
    assert [one.values for one in measured.taken] == [(1.0, 4.0, 6.0), (), (3.0, 5.0, 7.0)]
    assert measured.taken[1].absent == "not installed"


@pytest.mark.parametrize(
    ("rival", "says"), [((5.0,), "- A call, 10 calls: ours 2.0 × UP-ESB\n"), ((20.0,), "Nowhere.\n"), ((), "Nowhere.\n")]
)
def test_the_page_says_where_a_rival_is_faster_but_not_where_something_does_less(rival: tuple[float, ...], says: str) -> None:
    part = measured_part([taken((10.0,), rival)], {"cpu": "a processor", "cores": 2, "python": "3", "load": 0.5}, {}, 3)
    assert f"### Where this project is slower\n\n{says}\n### A call" in part
    assert "| 10 | 10.0 µs (10.0 to 10.0) |" in part
    assert put_in(f"before\n{BEGIN}old{END}after\n", part) == f"before\n{BEGIN}\n{part}\n{END}after\n"
