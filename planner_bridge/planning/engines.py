"""Planners other than Kairos: engines of unified-planning, which problem suits which, and the process in which one searches.

Any engine can be named besides those that come with the extra `planners`; of those nothing is known here.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from enum import Enum
from importlib.metadata import PackageNotFoundError, version
from operator import attrgetter
from pathlib import Path
from typing import Any, Final

from planner_bridge.model.grounding import conditions_of
from planner_bridge.model.plan import CancelToken, Plan, PlanningResult, PlanningStatus, SpelledNames
from planner_bridge.model.problem import Problem
from planner_bridge.pddl.writer import write_domain, write_problem
from planner_bridge.planning.normal_form import action_assignments, functions_in_use, is_whole
from pnm.core.logic.conditions import Exists, ForAll, every_part
from pnm.errors import InputError, installation
from pnm.files.process import own_environment, own_python


class Feature(Enum):
    """Something a problem may use that not every planner can handle, besides instantaneous actions that change facts."""

    TIME = "actions that last, or facts that change by themselves"
    NUMBERS = "numeric functions"
    FRACTIONS = "numbers that are not whole"
    OBJECT_FLUENTS = "functions whose values are objects"
    QUANTIFIERS = "quantifiers"
    CONDITIONAL_EFFECTS = "conditional effects"
    DERIVED = "derived predicates"
    CONSTRAINTS = "trajectory constraints"
    PREFERENCES = "preferences"
    TASKS = "task networks"
    NATURE = "processes and events"


def problem_kind(problem: Problem) -> frozenset[Feature]:
    """Return the features that a planner must support for a plan, whatever the metric (unified-planning's `ProblemKind`)."""
    problem = replace(problem, metric=None)
    domain = problem.domain
    used = functions_in_use(problem)
    changes = action_assignments(domain)
    conditions = (*conditions_of(problem), *(change.condition for change in changes))
    relevant = (change for change in changes if change.fluent[0] in domain.predicates or change.fluent[0] in used)
    present = {
        Feature.TIME: problem.is_timed,
        Feature.NUMBERS: any(not domain.functions[name].values for name in used),
        Feature.FRACTIONS: not is_whole(problem, used),
        Feature.OBJECT_FLUENTS: any(domain.functions[name].values for name in used),
        Feature.QUANTIFIERS: any(isinstance(part, ForAll | Exists) for one in conditions for part in every_part(one)),
        Feature.CONDITIONAL_EFFECTS: not all(change.is_plain for change in relevant),
        Feature.DERIVED: bool(domain.rules),
        Feature.CONSTRAINTS: bool(domain.constraints or problem.constraints),
        Feature.PREFERENCES: problem.has_preferences,
        Feature.TASKS: problem.has_tasks,
        Feature.NATURE: bool(domain.nature),
    }
    return frozenset(feature for feature, is_present in present.items() if is_present)


@dataclass(frozen=True, slots=True)
class PlanningEngine:
    """An engine of unified-planning, and the features it handles."""

    name: str
    package: str
    """The PyPI package that brings it."""
    supports: frozenset[Feature]
    program: str = ""
    """A program that must be installed to start it."""
    proves_unsolvability: bool = False
    """Whether its answer that there is no plan is a proof."""
    undeclared: frozenset[str] = frozenset()
    """Features, in unified-planning's words, that it handles although it does not declare them there."""

    @property
    def is_installed(self) -> bool:
        """Whether its package is installed, and the program that it needs."""
        return _has_package(self.package) and (not self.program or shutil.which(self.program) is not None)


ENGINES: Final = {
    engine.name: engine
    for engine in (
        PlanningEngine(
            "fast-downward",
            "up-fast-downward",
            frozenset({Feature.QUANTIFIERS, Feature.CONDITIONAL_EFFECTS}),
            proves_unsolvability=True,
            undeclared=frozenset({"UNDEFINED_INITIAL_NUMERIC"}),  # the costs of actions that are never applicable
        ),
        PlanningEngine("aries", "up-aries", frozenset({Feature.TIME, Feature.NUMBERS, Feature.OBJECT_FLUENTS, Feature.TASKS})),
        PlanningEngine(  # ends without a plan, and unified-planning takes that for a proof
            "enhsp",
            "up-enhsp",
            frozenset({Feature.QUANTIFIERS, Feature.CONDITIONAL_EFFECTS, Feature.NUMBERS, Feature.FRACTIONS}),
            program="java",
        ),
    )
}


def require_installed(name: str) -> None:
    """Refuse one of `ENGINES` that is not installed, as far as that shows without starting it."""
    engine = ENGINES.get(name)
    if engine is None or engine.is_installed:
        return
    if not _has_package(engine.package):
        raise InputError(f"the planner {name} is not installed: pip install {engine.package}, or {installation('planners')}")
    raise InputError(f"the planner {name} needs {engine.program}, which is not installed")


def _has_package(package: str) -> bool:
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True


# --- processes ------------------------------------------------------------------------------------
# Another planner in a process of its own, with its own folder and its own process group.
#
# An engine of unified-planning may write files into its working directory, ignore its time limit,
# print freely and leave children behind, also such that have left the process group; here it
# can do all that without harm. Every process that it starts has our folder as its `TMPDIR`, and
# that is how all of them are found again and ended.


START_LIMIT: Final = 30.0
"""Seconds that a process may take to begin: it loads unified-planning first."""
_GRACE: Final = 1.0
"""Seconds that an engine gets to report itself that its time is over."""
BEGAN: Final = "began"
"""The file that appears when the engine's time begins."""
ANSWER: Final = "answer.json"
_OUTPUT: Final = "output.txt"
_POLL: Final = 0.02
_TMPDIR: Final = "TMPDIR"


def search_with_engine(problem: Problem, engine: str, timeout: float, cancel: CancelToken) -> PlanningResult:
    """Search with an engine of unified-planning, at most `timeout` seconds besides the time to load it."""
    require_installed(engine)
    files = {"domain.pddl": write_domain(problem.domain), "problem.pddl": write_problem(problem)}
    ended = _run([engine, str(timeout)], files, timeout, cancel)
    if ended.answer is not None:
        _refuse_unknown(ended.answer)
        status, message = PlanningStatus[ended.answer["status"]], ended.answer["message"]
        if status is not PlanningStatus.SOLVED:
            return PlanningResult(status, message=message)
        names = SpelledNames(problem)  # engines may change the case of names
        try:
            steps = [names.step(*step) for step in ended.answer["steps"]]
        except (KeyError, TypeError, ValueError) as error:
            return PlanningResult(PlanningStatus.CRASHED, message=f"the plan makes no sense: {error!r}")
        plan = Plan(tuple(sorted(steps, key=attrgetter("start"))), temporal=problem.is_timed)
        return PlanningResult(PlanningStatus.SOLVED, plan, message)
    if cancel.is_set():  # an answer that came all the same was used above; only a search without one counts as cancelled
        return PlanningResult(PlanningStatus.CANCELLED)
    if ended.status is None:
        late = f"was stopped after {timeout:g} s" if ended.began else f"did not begin within {START_LIMIT:g} s"
        return PlanningResult(PlanningStatus.TIMED_OUT, message=f"{engine} {late}")
    if ended.status == -signal.SIGKILL:  # we have not killed it (the status would be None), so it was the kernel, for want of memory
        return PlanningResult(PlanningStatus.OUT_OF_MEMORY, message=f"the system killed {engine}, which it does for want of memory")
    return PlanningResult(PlanningStatus.CRASHED, message=f"{engine}: {ended.output or f'exit status {ended.status}'}")


def check_engine(engine: str, cancel: CancelToken) -> None:
    """Refuse an engine that does not exist; one that is not among `ENGINES` is looked up in a process with unified-planning."""
    if engine in ENGINES:
        require_installed(engine)
        return
    ended = _run([engine], {}, START_LIMIT, cancel)
    if ended.answer is not None:
        _refuse_unknown(ended.answer)
    elif not cancel.is_set():
        raise InputError(f"unified-planning does not say whether there is a planner {engine!r}: {ended.output or 'no answer'}")


@dataclass(frozen=True, slots=True)
class _Ended:
    """The remains of an engine process."""

    answer: dict[str, Any] | None
    status: int | None
    """The exit status; None if it had to be ended."""
    began: bool
    output: str
    """The end of what it printed, on one line."""


def _run(arguments: list[str], files: Mapping[str, str], timeout: float, cancel: CancelToken) -> _Ended:
    """Run an engine process in a new folder with these files until it has answered, ended, or is out of time."""
    with tempfile.TemporaryDirectory(prefix="pnm-", ignore_cleanup_errors=True) as name:
        folder = Path(name).resolve()  # resolved, because processes are found by comparing this text with their environment
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
        with _process_group(own_python("-m", "planner_bridge.planning.engine_process", *arguments), folder) as process:
            # First for loading the engine, which does not count; then anew for the search itself.
            deadline, began = time.monotonic() + START_LIMIT, False
            while process.poll() is None and time.monotonic() < deadline and not cancel.is_set() and not (folder / ANSWER).exists():
                if not began and (folder / BEGAN).exists():
                    deadline, began = time.monotonic() + timeout + _GRACE, True
                with suppress(subprocess.TimeoutExpired):
                    process.wait(timeout=_POLL)
            status = process.poll()  # before the process group is ended: afterwards the status would be that of our own signal
        answer = folder / ANSWER
        return _Ended(
            json.loads(answer.read_text(encoding="utf-8")) if answer.exists() else None,
            status,
            (folder / BEGAN).exists(),
            " ".join((folder / _OUTPUT).read_text(errors="replace").split())[-300:],
        )


@contextmanager
def _process_group(command: list[str], folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Start the command as the leader of a process group; on leaving, end it and everything it started."""
    with (folder / _OUTPUT).open("wb") as output:
        process = subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.PIPE,  # closes when we end, however we end: see `die_with_parent`
            stdout=output,
            stderr=output,
            start_new_session=True,
            env=own_environment(**{"PYTHONUTF8": "1", _TMPDIR: str(folder), "no_grpc_proxy": "127.0.0.1"}),
        )
        try:
            yield process
        finally:
            for number in (signal.SIGTERM, signal.SIGKILL):  # asked first, so that engines can remove what they have outside of our folder
                _signal_all(number, process.pid, folder)
                with suppress(subprocess.TimeoutExpired):
                    process.wait(timeout=1.0)
            if process.stdin:
                process.stdin.close()
            killed = time.monotonic()  # a process that is not our own child is gone a moment later
            while _processes_of(folder) and time.monotonic() < killed + 1.0:
                time.sleep(_POLL)


def _signal_all(number: signal.Signals, group: int, folder: Path) -> None:
    """Send a signal to the group, and to those that have left it but still have the folder as their `TMPDIR`."""
    for pid in _processes_of(folder):
        with suppress(ProcessLookupError):
            os.kill(pid, number)
    with suppress(ProcessLookupError):
        os.killpg(group, number)


def _processes_of(folder: Path) -> list[int]:
    """Return the processes that have the folder as their `TMPDIR`, this one left out."""
    mark = f"{_TMPDIR}={folder}".encode()
    pids: list[int] = []
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with suppress(OSError):  # a process may end between the listing and the reading, or belong to another user
            if mark in environment.read_bytes().split(b"\0"):
                pids.append(int(environment.parent.name))
    return [pid for pid in pids if pid != os.getpid()]


def die_with_parent() -> None:
    """In the engine process: end everything as soon as the process that started us is gone; to be called once, at the beginning."""
    parent = os.dup(0)
    # Children of the engine would otherwise inherit the pipe as their input, and might read from it.
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)

    def wait() -> None:
        os.read(parent, 1)  # nothing is ever written: this returns at the end of the parent, even if that was killed
        _signal_all(signal.SIGKILL, os.getpgrp(), Path(os.environ[_TMPDIR]))

    threading.Thread(target=wait, daemon=True).start()


def _refuse_unknown(answer: dict[str, Any]) -> None:
    if "unknown" in answer:
        raise InputError(answer["unknown"])
