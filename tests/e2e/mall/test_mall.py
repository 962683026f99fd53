"""The experiment of the paper, over ROS 2: visitors who interrupt, chat and answer late, and a robot that brings everything to its end."""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Final

import pytest

from planner_bridge.cli import demo as mall_demo
from planner_bridge.cli.console import SafeConsole
from pnm.errors import installation
from tests.support.e2e.mall.deployment import Mall
from tests.support.processes import Program, ros_domain

PATIENT: Final = 4.0
"""Seconds for an answer: no machine is so busy that one that was given takes longer, which would be another course of events."""

SCRIPTS: Final = (0, 3, 4, 9, 8)
"""Interruptions at every moment, every way of answering, and silence, which takes four seconds, twice; random runs have more.

The visitors take turns: what one of them has heard is forgotten when the other comes.
"""


@pytest.fixture
def mall(tmp_path: Path) -> Iterator[Mall]:
    with ros_domain() as domain, closing(Mall(tmp_path, domain, PATIENT)) as deployment:
        yield deployment


def test_in_all_scripts_the_right_task_is_begun_paused_resumed_and_finished_and_all_answers_reach_their_questions(mall):
    verdict = mall.execute(SCRIPTS)
    assert not verdict.wrong, str(verdict)
    assert verdict.scripts == len(SCRIPTS)
    assert verdict.interrupted, "no script of these interrupts the robot"
    assert verdict.paused


def test_the_demo_tells_who_speaks_and_how_the_tasks_are_doing(mall):
    demo = mall.pnm(Program, "demo", "mall")
    assert demo.ended() == 0, str(demo)
    told = "\n".join(demo.out)
    assert 'ann    "Where is shop_0?"' in told
    assert "shop_0: paused, makes way for" in told
    assert "shop_0: resumed" in told
    assert told.index('"yes"  (about shop_1)') < told.index('"It was nice to talk about films"'), (
        "answers while the robot talks of something else"
    )
    assert demo.out[-1].startswith("3 of 3 tasks reached their goal; ")
    assert demo.out[-1].endswith("; 0 times voice or arm were used by two.")


def test_without_ros_the_demo_says_what_to_install(monkeypatch):
    monkeypatch.setattr(mall_demo, "find_spec", lambda _: None)
    console = SafeConsole(file=io.StringIO(), width=200)
    assert mall_demo.show_mall(console) == 1
    assert f"{installation('ros2')} && pip install ./ros/pnm_interfaces" in console.file.getvalue()
