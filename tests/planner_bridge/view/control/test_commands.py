"""Commands of the page: what is none of them."""

from __future__ import annotations

import asyncio
from unittest.mock import Mock

import pytest

from planner_bridge.view.serving import Operator, Reply
from pnm.tasks import ServedWorld, TaskCommands, Tasks


def reply_to(command: object) -> Reply:
    """The reply of an operator that must not get so far as to ask for anything."""
    return asyncio.run(Operator(Mock(Tasks), Mock(TaskCommands), Mock(ServedWorld)).reply(command))


@pytest.mark.parametrize(
    "command",
    [
        None,
        [],
        "pause",
        {},
        {"do": "explode"},
        {"do": ["pause"]},
        {"do": "pause", "task": "x"},
        {"do": "pause", "task": 7},
        {"do": "pause", "at_once": "yes"},
        {"do": "step"},
        {"do": "settle", "request": "1", "is_done": True},
        {"do": "settle", "request": "00000000000000000000000000000001"},
        {"do": "tell", "add": "(at r1 hall)"},
        {"do": "tell", "add": [1]},
        {"do": "goal", "goal": 5},
        {"do": "goal", "goal": "x" * 100_001},
        {"do": "goal", "goal": "", "priority": 1.5},
        {"do": "goal", "goal": "", "priority": 2**31},
    ],
)
def test_what_is_no_command_is_refused(command: object) -> None:
    assert reply_to(command).refused.startswith("expected")


@pytest.mark.parametrize("command", [{"do": "goal", "goal": "\ud800"}, {"do": "tell", "add": ["\udcff"]}])
def test_half_a_character_is_no_text(command: object) -> None:
    assert "half of a character" in reply_to(command).refused
