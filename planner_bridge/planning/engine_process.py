"""Runs another planner in a child process with its own folder and its own process group.

An engine of unified-planning may write files where it stands, ignore its time limit, print
what it likes and leave children behind, also such that have left the process group; here it
can do all that without harm. What it starts has our folder for its temporary files, and that
is how everything is found again that has to end.
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
from contextlib import contextmanager, suppress
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

from planner_bridge.model.plan import Plan, PlanningResult, PlanningStatus, PlanStep, Stop
from planner_bridge.model.problem import Problem
from planner_bridge.pddl.write.writer import write_domain, write_problem
from planner_bridge.planning.engines import ENGINES, require
from pnm.errors import InputError

START: Final = 30.0
"""Seconds that a child may take to begin: it loads unified-planning first."""
GRACE: Final = 1.0
"""Seconds that an engine gets to say itself that its time is over."""
BEGAN: Final = "began"
ANSWER: Final = "answer.json"
_POLL: Final = 0.02
_FOLDER: Final = "TMPDIR"


def solve_in_child(problem: Problem, engine: str, timeout: float, cancel: Stop) -> PlanningResult:
    """Search with an engine of unified-planning, at most `timeout` seconds besides the time to load it.

    Raises:
        InputError: there is no engine of that name, or something has to be installed first.
    """
    require(engine)
    with tempfile.TemporaryDirectory(prefix="pnm-", ignore_cleanup_errors=True) as name:
        folder = Path(name).resolve()
        (folder / "domain.pddl").write_text(write_domain(problem.domain), encoding="utf-8")
        (folder / "problem.pddl").write_text(write_problem(problem), encoding="utf-8")
        with _group([sys.executable, "-m", "planner_bridge.planning.unified_planning", engine, str(timeout)], folder) as child:
            _wait(child, folder, timeout, cancel)
            status = child.poll()
        if (folder / ANSWER).exists():
            return _read(json.loads((folder / ANSWER).read_text(encoding="utf-8")), problem)
        if cancel.is_set():
            return PlanningResult(PlanningStatus.CANCELLED)
        if status is None:
            late = f"was stopped after {timeout:g} s" if (folder / BEGAN).exists() else f"did not begin within {START:g} s"
            return PlanningResult(PlanningStatus.TIMED_OUT, message=f"{engine} {late}")
        if status == -signal.SIGKILL:
            return PlanningResult(PlanningStatus.OUT_OF_MEMORY, message=f"the system killed {engine}, which it does for want of memory")
        words = " ".join((folder / "output.txt").read_text(errors="replace").split())
        return PlanningResult(PlanningStatus.CRASHED, message=f"{engine}: {words[-300:] or f'exit status {status}'}")


def check_engine(engine: str, cancel: Stop) -> None:
    """See to it that there is an engine of that name; one that is not among `ENGINES` is asked for in a child process.

    Raises:
        InputError: there is none, or something has to be installed first.
    """
    if engine in ENGINES:
        require(engine)
        return
    with tempfile.TemporaryDirectory(prefix="pnm-", ignore_cleanup_errors=True) as name:
        folder = Path(name).resolve()
        with _group([sys.executable, "-m", "planner_bridge.planning.unified_planning", engine], folder) as child:
            _wait(child, folder, START, cancel)
        if (folder / ANSWER).exists():
            _known(json.loads((folder / ANSWER).read_text(encoding="utf-8")))
        elif not cancel.is_set():
            words = " ".join((folder / "output.txt").read_text(errors="replace").split())
            raise InputError(f"unified-planning does not say whether there is a planner {engine!r}: {words[-300:] or 'no answer'}")


@contextmanager
def _group(command: list[str], folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Start the command as the leader of a process group, and end whatever came of it afterwards."""
    path = os.pathsep.join(filter(None, (str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH"))))
    with (folder / "output.txt").open("wb") as output:
        child = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.PIPE,  # closes when we end, however we end: see `die_with_parent`
            stdout=output,
            stderr=output,
            start_new_session=True,
            env={**os.environ, "PYTHONPATH": path, "PYTHONUTF8": "1", _FOLDER: str(folder), "no_grpc_proxy": "127.0.0.1"},
        )
        try:
            yield child
        finally:
            _end(child, folder)


def _wait(child: subprocess.Popen[bytes], folder: Path, timeout: float, cancel: Stop) -> None:
    """Wait until the child has answered or ended, its time is over, or nobody wants the answer any more."""
    deadline, began = time.monotonic() + START, False
    while time.monotonic() < deadline and not cancel.is_set() and not (folder / ANSWER).exists():
        if not began and (folder / BEGAN).exists():
            deadline, began = time.monotonic() + timeout + GRACE, True
        with suppress(subprocess.TimeoutExpired):
            child.wait(timeout=_POLL)
            return


def _end(child: subprocess.Popen[bytes], folder: Path) -> None:
    for number in (signal.SIGTERM, signal.SIGKILL):
        _signal(number, child.pid, folder)
        with suppress(subprocess.TimeoutExpired):
            child.wait(timeout=1.0)
    if child.stdin:
        child.stdin.close()
    killed = time.monotonic()  # what is not our own child is gone a moment later
    while _started_in(folder) and time.monotonic() < killed + 1.0:
        time.sleep(_POLL)


def _signal(number: signal.Signals, group: int, folder: Path) -> None:
    """Send a signal to the group, and to those that have left it but still have the folder for their temporary files."""
    for pid in _started_in(folder):
        with suppress(ProcessLookupError):
            os.kill(pid, number)
    with suppress(ProcessLookupError):
        os.killpg(group, number)


def _started_in(folder: Path) -> list[int]:
    """Return the processes that have the folder for their temporary files, this one left out."""
    mark = f"{_FOLDER}={folder}".encode()
    found: list[int] = []
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):
            if mark in environment.read_bytes().split(b"\0"):
                found.append(int(environment.parent.name))
    return [pid for pid in found if pid != os.getpid()]


def die_with_parent() -> None:
    """In the child: end everything as soon as the process that started us is gone; to be called once, at the beginning."""
    line = os.dup(0)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)

    def wait() -> None:
        os.read(line, 1)
        _signal(signal.SIGKILL, os.getpgrp(), Path(os.environ[_FOLDER]))

    threading.Thread(target=wait, daemon=True).start()


# --- the answer ----------------------------------------------------------------------------


def _known(answer: dict[str, Any]) -> None:
    if "unknown" in answer:
        raise InputError(answer["unknown"])


def _read(answer: dict[str, Any], problem: Problem) -> PlanningResult:
    _known(answer)
    status, message = PlanningStatus[answer["status"]], answer["message"]
    if status is not PlanningStatus.SOLVED:
        return PlanningResult(status, message=message)
    try:
        return PlanningResult(PlanningStatus.SOLVED, _plan(answer["steps"], problem), message)
    except (KeyError, TypeError, ValueError) as error:
        return PlanningResult(PlanningStatus.CRASHED, message=f"the plan makes no sense: {error!r}")


def _plan(steps: list[Any], problem: Problem) -> Plan:
    actions = {name.casefold(): name for name in problem.domain.actions}
    objects = {name.casefold(): name for name in problem.objects}
    found = tuple(
        PlanStep(actions[action.casefold()], tuple(objects[one.casefold()] for one in arguments), start, duration)
        for action, arguments, start, duration in steps
    )
    return Plan(tuple(sorted(found, key=attrgetter("start"))), temporal=problem.is_timed)
