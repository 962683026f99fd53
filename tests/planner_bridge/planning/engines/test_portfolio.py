"""Planners race here and on a cluster: the first valid plan counts, and the others are stopped."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from planner_bridge.cli.commands import app
from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.pipeline.achieve import achieve
from planner_bridge.planning.kairos import validate
from planner_bridge.planning.portfolio import solve_with_portfolio, suitable_planners
from planner_bridge.tasks.settings import Settings
from tests.support.pddl.problems import hard, matches, rooms, tanks
from tests.support.processes import LIMIT, until, working_in

MOVE = PlanStep("move", ("r1", "a", "b"))
LATE = PlanningResult(PlanningStatus.SOLVED, Plan((PlanStep("move", ("r1", "b", "c")), MOVE)))
GOOD = PlanningResult(PlanningStatus.SOLVED, Plan((MOVE,)))


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where races and planners get their folders, in this process and in those it starts."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    return tmp_path


class Elsewhere(Executor):
    """Somewhere far away, from where these answers come, in this order."""

    def __init__(self, answers: Mapping[str, PlanningResult | Exception]) -> None:
        self.answers = answers

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future = Future[Any]()
        answer = self.answers[args[2]]
        if isinstance(answer, Exception):
            future.set_exception(answer)
        else:
            future.set_result(answer)
        return future


def started_portfolio(
    folder: Path, planners: tuple[str, ...], timeout: float, cancel: threading.Event | None = None, executor: Executor | None = None
) -> Future[PlanningResult]:
    """Start a race on a hard problem in which Aries takes part, and wait until it is at work."""
    pool = ThreadPoolExecutor(1)
    found = pool.submit(solve_with_portfolio, hard(), planners=planners, timeout=timeout, cancel=cancel, executor=executor)
    pool.shutdown(wait=False)
    until(lambda: working_in(folder, "up-aries_") or found.done())
    if found.done() and timeout < 60:  # a busy machine has not even begun by then
        return started_portfolio(folder, planners, 4 * timeout, cancel, executor)
    assert not found.done(), found.result().reason
    return found


# --- where it runs -------------------------------------------------------------------------


def test_by_default_every_engine_has_a_process_which_is_gone_afterwards(folder: Path) -> None:
    found = solve_with_portfolio(rooms(), timeout=60)
    assert found.plan is not None, found.reason
    assert found.planner in suitable_planners(rooms())
    assert validate(rooms(), found.plan) == ""
    assert not working_in(folder)
    assert os.listdir(folder) == []


def test_a_cluster_will_do(folder: Path) -> None:
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=1, processes=True, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
        client.get_executor() as executor,
    ):
        found = solve_with_portfolio(rooms(), planners=("kairos", "fast-downward"), timeout=60, executor=executor)
        assert found.plan is not None, found.reason
        cancel = threading.Event()
        racing = started_portfolio(folder, ("aries",), 60, cancel, executor)
        cancel.set()
        assert racing.result(LIMIT).status is PlanningStatus.CANCELLED
        until(lambda: not working_in(folder, "up-aries_"))


def test_a_task_can_be_given_an_executor() -> None:
    with ThreadPoolExecutor(1) as threads:
        result = achieve(None, rooms(), settings=Settings("race:kairos", executor=threads))
    assert result.goal_reached, result.reason


# --- who wins ------------------------------------------------------------------------------


def test_a_plan_that_is_not_valid_does_not_win() -> None:
    problem = rooms(goal="(at r1 b)")
    found = solve_with_portfolio(problem, planners=("aries", "kairos"), executor=Elsewhere({"aries": LATE, "kairos": GOOD}))
    assert found.plan == GOOD.plan
    assert found.planner == "kairos"
    assert found.message.startswith("aries: plan not valid: ")


def test_a_proof_that_there_is_no_plan_ends_the_race() -> None:
    found = solve_with_portfolio(rooms(ways="ba"), planners=("kairos", "aries"), timeout=60)
    assert (found.status, found.planner) == (PlanningStatus.UNSOLVABLE, "kairos")


@pytest.mark.parametrize(
    ("aries", "expected"),
    [
        (PlanningResult(PlanningStatus.TIMED_OUT), PlanningStatus.TIMED_OUT),
        (PlanningResult(PlanningStatus.INVALID), PlanningStatus.CRASHED),
        (PlanningResult(PlanningStatus.DISAGREEMENT), PlanningStatus.DISAGREEMENT),
        (LATE, PlanningStatus.INVALID_PLAN),
        (OSError("no such host"), PlanningStatus.CRASHED),
    ],
)
def test_without_a_winner_the_most_telling_reason_counts_and_all_are_told(
    aries: PlanningResult | Exception, expected: PlanningStatus
) -> None:
    answers = {
        "kairos": PlanningResult(PlanningStatus.UNSUPPORTED, message="too hard"),
        "aries": aries,
        "enhsp": BrokenProcessPool("a process died"),
    }
    found = solve_with_portfolio(rooms(goal="(at r1 b)"), planners=tuple(answers), executor=Elsewhere(answers))
    assert found.status is expected
    assert found.planner == "kairos, aries, enhsp"
    for told in ("kairos: unsupported: too hard", "aries: ", "enhsp: planner crashed: BrokenProcessPool: a process died"):
        assert told in found.message


def test_an_executor_that_is_closed_is_no_reason_to_wait() -> None:
    threads = ThreadPoolExecutor(1)
    threads.shutdown()
    found = solve_with_portfolio(rooms(), planners=("kairos",), executor=threads)
    assert found.status is PlanningStatus.CRASHED
    assert "cannot schedule new futures" in found.message


def test_the_command_says_who_won(root: Path) -> None:
    command = ["plan", str(root / "domains/delivery/domain.pddl"), str(root / "problems/delivery/p01.pddl"), "--planner", "race:kairos"]
    assert CliRunner().invoke(app, command).stdout.endswith("\nplanner  kairos\n")
    found = json.loads(CliRunner().invoke(app, [*command, "--json"]).stdout)
    assert (found["status"], found["planner"]) == ("solved", "kairos")


# --- who takes part ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("problem", "expected"),
    [
        (rooms(), {"kairos", "fast-downward", "aries", "enhsp"}),
        (matches(), {"kairos", "aries"}),
        (tanks(), {"kairos", "aries", "enhsp"}),
        (tanks("4.5"), {"kairos", "enhsp"}),
    ],
)
def test_those_take_part_that_are_there_and_suit_the_problem(
    problem: Problem, expected: set[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    assert set(suitable_planners(problem)) in (expected, expected - {"enhsp"})
    monkeypatch.setenv("PATH", str(tmp_path))
    assert set(suitable_planners(problem)) == expected - {"enhsp"}


# --- how it is stopped ---------------------------------------------------------------------


def test_a_race_can_be_cancelled(folder: Path) -> None:
    cancel = threading.Event()
    found = started_portfolio(folder, ("kairos", "aries"), 60, cancel)
    cancel.set()
    assert found.result(LIMIT).status is PlanningStatus.CANCELLED
    assert not working_in(folder)
    assert os.listdir(folder) == []


def test_a_process_that_dies_takes_nobody_with_it(folder: Path) -> None:
    found = started_portfolio(folder, ("kairos", "aries"), 3)
    (engine,) = working_in(folder, "planner_bridge.planning.engine_process")
    os.kill(engine, signal.SIGKILL)
    result = found.result(LIMIT)
    assert result.status is PlanningStatus.TIMED_OUT
    assert "kairos: time-out" in result.message
    assert "the system killed aries" in result.message
    until(lambda: not working_in(folder))


def test_when_we_are_killed_everybody_goes_with_us(folder: Path, root: Path) -> None:
    code = (
        "from planner_bridge.planning.portfolio import solve_with_portfolio; from tests.support.pddl.problems import hard; "
        "solve_with_portfolio(hard(), planners=('kairos', 'aries'), timeout=600)"
    )
    us = subprocess.Popen([sys.executable, "-c", code], cwd=root)
    until(lambda: working_in(folder, "up-aries_"))
    us.kill()
    us.wait()
    until(lambda: not working_in(folder))
