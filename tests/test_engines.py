"""Other planners through unified-planning, each in a process of its own, and its Problems."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import pytest
import unified_planning.shortcuts as up

from planner_bridge.model import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pipeline import achieve
from planner_bridge.plan import PlanningStatus
from planner_bridge.planning import solve, validate
from pnm.errors import InputError
from tests.domains import ROOMS, rooms


def plain() -> Problem:
    """Rooms without numbers, which Aries does not take."""
    text = ROOMS.replace("(:functions (total-cost) (energy ?r - robot))", "").replace("(increase (total-cost) 1)", "")
    things = "(:objects r1 - robot a b c - room) (:init (at r1 a) (way a b) (way b c))"
    return parse_problem(f"(define (problem p) (:domain rooms) {things} (:goal (at r1 c)))", parse_domain(text))


def test_another_engine_finds_a_valid_plan() -> None:
    problem = plain()
    found = solve(problem, planner="aries", timeout=30)
    assert found.plan is not None, found.reason
    assert validate(problem, found.plan) == ""


def test_what_an_engine_cannot_do_is_told_in_its_words() -> None:
    found = solve(rooms(goal="(at r1 c)"), planner="aries", timeout=30)
    assert found.plan is None
    assert "real" in found.reason.lower()


def test_an_unknown_engine_is_an_input_error() -> None:
    with pytest.raises(InputError, match=r"there is no planner 'nobody'; installed: .*aries"):
        solve(rooms(), planner="nobody")


def test_an_engine_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    solve(plain(), planner="aries", timeout=30)
    assert os.listdir(tmp_path) == []


def test_a_search_in_a_child_can_be_cancelled() -> None:
    cancel = threading.Event()
    cancel.set()
    began = time.monotonic()
    found = solve(rooms(), planner="aries", timeout=60, cancel=cancel)
    assert found.status is PlanningStatus.TIMED_OUT
    assert time.monotonic() - began < 30


def test_kairos_can_be_cancelled() -> None:
    cancel = threading.Event()
    cancel.set()
    assert solve(rooms(), cancel=cancel).status in (PlanningStatus.TIMED_OUT, PlanningStatus.SOLVED)


def test_a_problem_of_unified_planning_is_accepted_wherever_files_are() -> None:
    up.get_environment().credits_stream = None
    location = up.UserType("location")
    at = up.Fluent("at", up.BoolType(), place=location)
    move = up.InstantaneousAction("move", here=location, there=location)
    move.add_precondition(at(move.parameter("here")))
    move.add_effect(at(move.parameter("here")), False)
    move.add_effect(at(move.parameter("there")), True)
    problem = up.Problem("trip")
    problem.add_fluent(at, default_initial_value=False)
    problem.add_action(move)
    hall, kitchen = (up.Object(name, location) for name in ("hall", "kitchen"))
    problem.add_objects([hall, kitchen])
    problem.set_initial_value(at(hall), True)
    problem.add_goal(at(kitchen))
    result = achieve(None, problem)
    assert result.goal_reached
    assert [str(call.call.action) for call in result.calls] == ["move(hall, kitchen)"]
