"""Logs for process mining: another reader finds every request of a journal, with its end; a damaged journal is no other log."""

from __future__ import annotations

import shutil
import warnings
from collections import Counter
from pathlib import Path
from random import Random
from types import ModuleType
from typing import Any

import pytest

from planner_bridge.view.story import timelines
from pnm.core.machine.requests import OutcomeKind
from pnm.core.pictures.timeline import TimedAttempt, TimedCall, TimedPlan, Timeline, replan, timelines_xes
from pnm.errors import PnmError
from tests.support.e2e.command_line import pnm
from tests.support.tasks.scenarios.random_scenarios import run_scenario


@pytest.fixture(scope="module")
def pm4py() -> ModuleType:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its licence is AGPL-3.0, which it says
        import pm4py as library
    return library


def read_by(pm4py: ModuleType, text: str, folder: Path) -> list[dict[str, Any]]:
    file = folder / "log.xes"
    file.write_text(text, encoding="utf-8")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        frame = pm4py.read_xes(str(file))
    return frame.to_dict("records")  # type: ignore[no-any-return]


@pytest.mark.parametrize("seed", [3, 8, 21])
def test_another_reader_finds_every_request_and_its_end(pm4py: ModuleType, seed: int, tmp_path: Path) -> None:
    run_scenario(seed, journal=tmp_path / "journal")
    told = timelines(tmp_path / "journal")
    events = read_by(pm4py, timelines_xes(told), tmp_path)
    wanted = Counter[tuple[str, str, str]]()
    for task in told:
        for plan in task.plans:
            wanted[task.id, "new plan", "complete"] += plan.replan is not None
            for call, attempt in ((one, each) for one in plan.calls for each in one.attempts):
                wanted[task.id, call.name, "start"] += 1
                if attempt.outcome is not None:
                    wanted[task.id, call.name, "complete" if attempt.outcome is OutcomeKind.SUCCEEDED else "ate_abort"] += 1
    found = Counter((event["case:concept:name"], event["concept:name"], event["lifecycle:transition"]) for event in events)
    assert +wanted == found
    assert sum(found.values()) > 1


def test_texts_and_times_are_those_of_the_task(pm4py: ModuleType, tmp_path: Path) -> None:
    attempts = TimedAttempt(1.0, 2.5, OutcomeKind.ABORTED, '<"no" & no>\x1b'), TimedAttempt(3.0)
    first = TimedCall(0, "move(r1, äöü)", "r1", 0.0, attempts=attempts)
    plans = TimedPlan(0.0, (first,)), TimedPlan(4.0, (), replan("it failed", [], []))
    events = read_by(pm4py, timelines_xes([Timeline("a goal", plans, id="t", wall=1_700_000_000.25)]), tmp_path)
    assert [event["lifecycle:transition"] for event in events] == ["start", "ate_abort", "start", "complete"]
    assert events[1]["message"] == '<"no" & no>\ufffd'
    assert [event["time:timestamp"].timestamp() - 1_700_000_000 for event in events] == [1.25, 2.75, 3.25, 4.25]
    assert {event["concept:name"] for event in events} == {"move(r1, äöü)", "new plan"}


def log_of(journal: Path) -> str | None:
    try:
        return timelines_xes(timelines(journal))
    except PnmError:
        return None


def test_a_journal_of_which_a_bit_is_another_one_gives_the_same_log_or_none(tmp_path: Path) -> None:
    journal, copy = tmp_path / "journal", tmp_path / "copy"
    run_scenario(3, journal=journal)
    whole, random, verdicts = log_of(journal), Random(7), Counter[bool]()
    for _ in range(60):
        for file in tmp_path.glob("journal*"):
            shutil.copy(file, file.with_name(file.name.replace("journal", "copy", 1)))
        content = bytearray(copy.read_bytes())
        content[random.randrange(len(content))] ^= 1 << random.randrange(8)
        copy.write_bytes(content)
        found = log_of(copy)
        assert found in (whole, None)
        verdicts[found is None] += 1
    assert all(verdicts[refused] for refused in (False, True))


def test_the_command_writes_a_log(tmp_path: Path) -> None:
    journal, file = tmp_path / "journal", tmp_path / "log.xes"
    run_scenario(3, journal=journal)
    done = pnm("history", str(journal), "--format", "xes", "-o", str(file))
    assert done.returncode == 0
    assert file.read_text(encoding="utf-8") == log_of(journal)
    assert pnm("history", str(journal), "--format", "xes", "--json").returncode == 2
