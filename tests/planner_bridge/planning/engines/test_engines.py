"""Other planners through unified-planning, each in a process of its own, and its Problems."""

from __future__ import annotations

import os
import re
import shutil
import signal
import sys
import tempfile
import threading
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest
import unified_planning.shortcuts as up

from planner_bridge.model.plan import PlanningResult, PlanningStatus
from planner_bridge.model.problem import Metric, Problem
from planner_bridge.pipeline.achieve import achieve
from planner_bridge.planning.engines import require_installed
from planner_bridge.planning.kairos import validate
from planner_bridge.planning.solve import check_planner, solve
from pnm.core.logic.expressions import ValueOf
from pnm.errors import InputError, installation
from tests.support.pddl.problems import hard, matches, rooms, tanks
from tests.support.processes import LIMIT, until, working_in

needs_java = pytest.mark.skipif(shutil.which("java") is None, reason="enhsp runs in a Java machine, and there is none")
WORKS = {"fast-downward": "downward/builds", "aries": "up-aries_", "enhsp": "java"}
"""For every engine, what is in the command line of the program that searches."""


# --- what they find ------------------------------------------------------------------------


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where children get their folders, and where we are."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize(
    ("engine", "problem"),
    [
        pytest.param("fast-downward", rooms(), id="facts"),
        pytest.param("enhsp", tanks("4.5"), marks=needs_java, id="numbers"),
        pytest.param("aries", matches(2), id="time"),
    ],
)
def test_an_engine_finds_a_valid_plan_and_leaves_nothing_behind(engine: str, problem: Problem, folder: Path) -> None:
    found = solve(problem, planner=engine, timeout=60)
    assert found.plan is not None, found.reason
    assert found.planner == engine
    assert validate(problem, found.plan) == ""
    assert os.listdir(folder) == []


def test_fast_downward_proves_that_there_is_no_plan() -> None:
    assert solve(rooms(ways="ba"), planner="fast-downward").status is PlanningStatus.UNSOLVABLE


@needs_java
def test_what_enhsp_says_is_no_proof() -> None:
    assert solve(rooms(goal="(and (at r1 a) (at r1 b))"), planner="enhsp").status is PlanningStatus.NO_PLAN


def test_what_an_engine_cannot_do_is_named() -> None:
    found = solve(matches(), planner="fast-downward")
    assert found.status is PlanningStatus.UNSUPPORTED
    assert "continuous time" in found.message


def test_a_metric_that_an_engine_cannot_consider_is_left_out_and_that_is_said() -> None:
    problem = replace(rooms(), metric=Metric("minimize", ValueOf(("energy", "r1"))))
    found = solve(problem, planner="fast-downward")
    assert found.status is PlanningStatus.SOLVED, found.reason
    assert "without the metric" in found.message


def test_two_at_once_do_not_disturb_each_other() -> None:
    problems = [rooms(goal="(at r1 b)"), rooms()]
    with ThreadPoolExecutor(len(problems)) as pool:
        found = list(pool.map(lambda problem: solve(problem, planner="fast-downward", timeout=60), problems))
    assert [len(one.plan.steps) if one.plan else one.reason for one in found] == [1, 4]


def test_kairos_names_who_plans_for_tasks() -> None:
    found = solve(replace(rooms(), network=":htn"))
    assert (found.status, found.message) == (PlanningStatus.UNSUPPORTED, "task networks, which aries plans for (--planner aries)")


# --- what they need ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("planner", "said"),
    [
        ("nobody", r"there is no planner 'nobody'; installed: kairos, .*aries.*fast-downward"),
        ("kairoos", r"there is no planner 'kairoos'; installed: kairos, .*; did you mean 'kairos'\?$"),
        ("tamer", r"^the planner tamer is not installed: pip install up-tamer$"),
        ("race:kairos,areis", r"'areis' cannot take part in a race; these can: kairos, .*; did you mean 'aries'\?"),
        ("race:", "'' cannot take part in a race"),
    ],
)
def test_a_planner_that_is_not_there_is_told_of_before_it_is_needed(planner: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        check_planner(planner)


@pytest.mark.parametrize("planner", ["kairos", "race", "race:kairos, aries", "fast-downward-opt"])
def test_a_planner_that_is_there_can_be_chosen(planner: str) -> None:
    check_planner(planner)


def test_nobody_waits_for_an_engine_to_be_looked_for() -> None:
    cancel = threading.Event()
    cancel.set()
    check_planner("nobody", cancel)


def test_a_package_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "path", [])
    with pytest.raises(InputError, match=re.escape(f"aries is not installed: pip install up-aries, or {installation('planners')}")):
        require_installed("aries")
    with pytest.raises(InputError, match="aries is not installed"):
        check_planner("race:kairos,aries")


def test_a_program_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(InputError, match="enhsp needs java, which is not installed"):
        solve(rooms(), planner="enhsp")
    with pytest.raises(InputError, match="enhsp needs java"):
        solve(rooms(), planner="race:kairos,enhsp")


# --- how they are stopped ------------------------------------------------------------------


def started_engine(folder: Path, engine: str, cancel: threading.Event | None = None, timeout: float = 60) -> Future[PlanningResult]:
    """Start on a hard problem, and wait until the engine itself is at work."""
    pool = ThreadPoolExecutor(1)
    found = pool.submit(solve, hard(), planner=engine, timeout=timeout, cancel=cancel)
    pool.shutdown(wait=False)
    until(lambda: working_in(folder, WORKS[engine]) or found.done())
    if found.done() and timeout < 60:  # a busy machine has not even begun by then
        return started_engine(folder, engine, cancel, 4 * timeout)
    assert not found.done(), found.result().reason
    return found


@needs_java
def test_at_its_limit_an_engine_is_stopped(folder: Path) -> None:
    found = started_engine(folder, "enhsp", timeout=2.0).result(LIMIT)
    assert found.status is PlanningStatus.TIMED_OUT
    assert not working_in(folder)
    assert os.listdir(folder) == []


def test_a_search_that_is_cancelled_ends_at_once(folder: Path) -> None:
    cancel = threading.Event()
    searching = started_engine(folder, "fast-downward", cancel)
    cancel.set()
    assert searching.result(LIMIT).status is PlanningStatus.CANCELLED
    assert not working_in(folder)


def test_an_engine_that_the_system_kills_was_out_of_memory(folder: Path) -> None:
    searching = started_engine(folder, "aries")
    (child,) = working_in(folder, "planner_bridge.planning.engine_process")
    os.kill(child, signal.SIGKILL)
    assert searching.result(LIMIT).status is PlanningStatus.OUT_OF_MEMORY
    assert not working_in(folder)


@needs_java
def test_an_engine_that_runs_out_of_memory_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("JAVA_TOOL_OPTIONS", "-Xmx4m")
    assert solve(hard(), planner="enhsp", timeout=60).status is PlanningStatus.OUT_OF_MEMORY


def test_a_limit_that_is_over_is_said_by_kairos_without_advice_about_options_that_are_not_ours() -> None:
    found = solve(hard(), timeout=0.5)
    assert found.status is PlanningStatus.TIMED_OUT
    assert found.message.startswith("no plan within the time limit of 0.5 s")
    assert found.message.endswith("; a longer limit (--planner-timeout) or another planner (--planner race) may find one")
    assert set(re.findall(r"--[\w-]+", found.message)) == {"--planner-timeout", "--planner"}
    assert "SolveOptions" not in found.message


def test_kairos_can_be_cancelled() -> None:
    cancel = threading.Event()
    cancel.set()
    assert solve(hard(), cancel=cancel).status is PlanningStatus.CANCELLED


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
