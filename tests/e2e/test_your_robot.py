"""A newcomer's way from two action servers of somebody else to goals all day: everything that the tutorial shows, as it shows it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.support.docs.page import Step, follow
from tests.support.docs.your_robot import PAGE, newcomer

WET, DONE = 1, 0
COMMANDS = {"init", "check", "plan", "simulate", "run", "serve", "facts", "goal", "watch", "status"}


@pytest.fixture(scope="module")
def walked(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[list[tuple[Step, str]], list[dict[str, Any]]]]:
    """All steps of the page with what they have printed, and what the robot has truly done."""
    folder: Path = tmp_path_factory.mktemp("newcomer")
    with newcomer(folder) as (walk, porter):
        steps = [step for _, steps in follow(PAGE.read_text(encoding="utf-8"), walk) for step in steps]
        yield steps, porter.objects()


def test_every_command_prints_what_the_page_shows(walked) -> None:
    steps, _ = walked
    different = [f"$ {step.command}\n{printed}--- shown:\n{step.output}" for step, printed in steps if not step.agrees(printed)]
    assert not different, "\n".join(different)


def test_the_page_shows_the_whole_way_and_no_python(walked) -> None:
    steps, _ = walked
    assert {step.command.split()[1] for step, _ in steps if step.command.startswith("pnm ")} == COMMANDS
    assert "```python" not in PAGE.read_text(encoding="utf-8")


def test_the_robot_has_truly_done_what_was_said(walked) -> None:
    _, events = walked
    grips = [(event["object"], event["close"], event["code"]) for event in events if "object" in event]
    slips = [("red_cup", True, WET)] * 4
    there, back = ([("green_cup", True, DONE), ("green_cup", False, DONE)] for _ in range(2))
    assert grips == [*slips, *there, *back, *slips]
    assert all(event["reached"] and event["frame"] == "map" for event in events if "drive" in event)
    assert events[-1]["things"] == {"red_cup": [2.0, 1.0], "green_cup": [4.0, -1.0]}
