"""Runs another planner in a child process with its own folder and its own process group.

An engine of `unified-planning` may write files where it stands, ignore its time limit, print
what it likes and leave children behind; here it can do all that without harm.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from planner_bridge.model import Problem
from planner_bridge.pddl.writer import write_domain, write_problem
from planner_bridge.plan import Plan, PlanningResult, PlanningStatus, PlanStep
from pnm.errors import InputError

GRACE: Final = 5.0
"""Seconds that a child may take besides its limit: it imports unified-planning first."""
_POLL: Final = 0.05


def solve_in_child(problem: Problem, engine: str, timeout: float, cancel: threading.Event) -> PlanningResult:
    """Search with an engine of unified-planning, at most `timeout` seconds and the time to start it.

    Raises:
        InputError: there is no engine of that name.
    """
    with tempfile.TemporaryDirectory(prefix="pnm-") as name:
        folder = Path(name)
        (folder / "domain.pddl").write_text(write_domain(problem.domain))
        (folder / "problem.pddl").write_text(write_problem(problem))
        command = [sys.executable, "-m", "planner_bridge.up", engine, str(timeout)]
        with _group(command, folder) as child:
            ended = _wait(child, time.monotonic() + timeout + GRACE, cancel)
        if not ended:
            return PlanningResult(PlanningStatus.TIMED_OUT, message=f"{engine} was stopped after {timeout:g} s")
        answer = folder / "answer.json"
        if not answer.exists():
            words = " ".join((folder / "output.txt").read_text(errors="replace").split())
            return PlanningResult(PlanningStatus.CRASHED, message=f"{engine}: {words[-300:] or f'exit status {child.returncode}'}")
        return _read(json.loads(answer.read_text()), problem)


@contextmanager
def _group(command: list[str], folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Start the command as the leader of a process group, and end the whole group afterwards."""
    path = os.pathsep.join(filter(None, (str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH"))))
    with (folder / "output.txt").open("wb") as output:
        child = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": path},
        )
        try:
            yield child
        finally:
            _end(child)


def _end(child: subprocess.Popen[bytes]) -> None:
    for number in (signal.SIGTERM, signal.SIGKILL):
        try:
            os.killpg(child.pid, number)
        except ProcessLookupError:
            break
        try:
            child.wait(timeout=1.0)
        except subprocess.TimeoutExpired:
            continue
    child.wait()


def _wait(child: subprocess.Popen[bytes], deadline: float, cancel: threading.Event) -> bool:
    """Wait for the child to end; tell whether it did before the deadline and before being cancelled."""
    while time.monotonic() < deadline and not cancel.is_set():
        try:
            child.wait(timeout=_POLL)
        except subprocess.TimeoutExpired:
            continue
        return True
    return False


def _read(answer: dict[str, object], problem: Problem) -> PlanningResult:
    status = str(answer["status"])
    if status == "unknown engine":
        raise InputError(str(answer["message"]))
    steps = answer.get("steps")
    if not isinstance(steps, list):
        known = PlanningStatus.__members__
        return PlanningResult(known.get(status, PlanningStatus.CRASHED), message=str(answer.get("message", "")))
    try:
        return PlanningResult(PlanningStatus.SOLVED, _plan(steps, problem))
    except (KeyError, TypeError, ValueError) as error:
        return PlanningResult(PlanningStatus.CRASHED, message=f"the plan makes no sense: {error}")


def _plan(steps: list[Any], problem: Problem) -> Plan:
    actions = {name.casefold(): name for name in problem.domain.actions}
    objects = {name.casefold(): name for name in problem.objects}
    found = tuple(
        PlanStep(actions[action.casefold()], tuple(objects[one.casefold()] for one in arguments), start, duration)
        for action, arguments, start, duration in steps
    )
    return Plan(found, temporal=problem.is_timed)
