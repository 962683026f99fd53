"""Several planners at once on the same problem: the first valid plan counts, and the others are stopped.

The planners run in a `concurrent.futures.Executor`: by default processes of this machine, and
any other that the caller supplies, a cluster's as well. What is submitted is a function of this
module with plain data. That a race is over is written in a file: jobs that see the same file
system stop at once, any other at its time limit.
"""

from __future__ import annotations

import multiprocessing
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from planner_bridge.model.plan import PlanningResult, PlanningStatus, Stop
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pddl.write.writer import write_domain, write_problem
from planner_bridge.planning.engine_process import START
from planner_bridge.planning.engines import ENGINES, Feature, features, require
from planner_bridge.planning.kairos import DEFAULT_PLANNER
from planner_bridge.planning.search import search
from planner_bridge.planning.validate import validated
from pnm.errors import InputError, suggestion

_GRACE: Final = 2.0
"""Seconds that a process gets to end by itself when the race is over."""
_POLL: Final = 0.05

_TELLING: Final = (
    PlanningStatus.DISAGREEMENT,
    PlanningStatus.TIMED_OUT,
    PlanningStatus.OUT_OF_MEMORY,
    PlanningStatus.NO_PLAN,
    PlanningStatus.INVALID_PLAN,
    PlanningStatus.CRASHED,
    PlanningStatus.INVALID,
    PlanningStatus.UNSUPPORTED,
    PlanningStatus.CANCELLED,
)
"""Reasons why there is no plan; the first that one of the planners gives is that of the race."""


def race(
    problem: Problem,
    *,
    planners: tuple[str, ...] | None = None,
    timeout: float = 30.0,
    executor: Executor | None = None,
    cancel: Stop | None = None,
) -> PlanningResult:
    """Let planners search at the same time, at most `timeout` seconds, and return the first valid plan.

    Args:
        problem: what is to be solved.
        planners: who takes part; by default Kairos and the engines of `ENGINES` that are there and suit the problem.
        timeout: seconds that each may search, besides the time to load it.
        executor: runs them; by default each gets a process of its own, which is gone when this returns.
        cancel: set from elsewhere when nobody wants the plan any more.

    Raises:
        InputError: a planner is not known, or is not installed here and would run here.
    """
    names = entrants(problem) if planners is None else _known(planners)
    if not names:
        return PlanningResult(PlanningStatus.UNSUPPORTED, message="no planner that is installed here suits the problem")
    if executor is None:
        check_entrants(names)
    texts = write_domain(problem.domain), write_problem(problem)
    folder = Path(tempfile.mkdtemp(prefix="pnm-race-"))
    over = folder / "over"
    pool = executor or _Processes(over)
    running: dict[Future[PlanningResult], str] = {}
    try:
        for name in names:
            running[_submitted(pool, compete, *texts, name, timeout, str(over))] = name
        return _first(problem, running, time.monotonic() + timeout + START, cancel or threading.Event())
    finally:
        over.touch()
        for future in running:
            future.cancel()
        if executor is None:
            pool.shutdown()
        _when_all_have_ended({*running}, lambda: shutil.rmtree(folder, ignore_errors=True))


def entrants(problem: Problem) -> tuple[str, ...]:
    """Return the planners that are there and suit the problem, Kairos first."""
    asked = features(problem)
    kairos = () if Feature.TASKS in asked else (DEFAULT_PLANNER,)
    return (*kairos, *(engine.name for engine in ENGINES.values() if asked <= engine.takes and engine.is_there))


def check_entrants(planners: tuple[str, ...]) -> None:
    """See to it that these planners can take part in a race here.

    Raises:
        InputError: one of them is not known, or is not installed here.
    """
    for name in _known(planners):
        require(name)


def compete(domain: str, problem: str, planner: str, timeout: float, over: str) -> PlanningResult:
    """Search with one of the planners, until the file appears that says that the race is over."""
    try:
        return search(parse_problem(problem, parse_domain(domain)), planner, timeout, _Over(Path(over)))
    except InputError as error:
        return PlanningResult(PlanningStatus.INVALID, message=str(error))


# --- the course of a race ------------------------------------------------------------------


def _first(problem: Problem, running: Mapping[Future[PlanningResult], str], deadline: float, cancel: Stop) -> PlanningResult:
    """Return the first result that decides the race, or what all results together say."""
    results: list[PlanningResult] = []
    waiting = {*running}
    while waiting and time.monotonic() < deadline:
        if cancel.is_set():
            return PlanningResult(PlanningStatus.CANCELLED, planner=", ".join(running.values()))
        ended, waiting = wait(waiting, timeout=_POLL, return_when=FIRST_COMPLETED)
        for future in (one for one in running if one in ended):
            result = validated(problem, replace(_result(future), planner=running[future]))
            if result.plan is not None or result.status is PlanningStatus.UNSOLVABLE:
                return replace(result, message="; ".join(filter(None, (*map(_told, results), result.message))))
            results.append(result)
    results += (PlanningResult(PlanningStatus.TIMED_OUT, planner=name) for future, name in running.items() if future in waiting)
    status = min((result.status for result in results), key=_TELLING.index)
    return PlanningResult(status, message="; ".join(map(_told, results)), planner=", ".join(running.values()))


def _result(future: Future[PlanningResult]) -> PlanningResult:
    try:
        return future.result()
    except CancelledError:
        return PlanningResult(PlanningStatus.CANCELLED, message="by the executor")
    except Exception as error:  # whatever befell the planner or the process it ran in
        return PlanningResult(PlanningStatus.CRASHED, message=f"{type(error).__name__}: {error}")


def _told(result: PlanningResult) -> str:
    return f"{result.planner}: {result.reason}"


def _known(planners: tuple[str, ...]) -> tuple[str, ...]:
    """Return the planners, each once.

    Raises:
        InputError: one of them is not known.
    """
    for name in planners:
        if name != DEFAULT_PLANNER and name not in ENGINES:
            able = (DEFAULT_PLANNER, *ENGINES)
            hint = suggestion(name, able)
            raise InputError(f"{name!r} cannot take part in a race; these can: {', '.join(able)}{f'; {hint}' if hint else ''}")
    return tuple(dict.fromkeys(planners))


# --- processes -----------------------------------------------------------------------------


class _Over:
    """Set as soon as the file is there, or its folder gone; never on a machine that has not seen the folder."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._sees = file.parent.exists()

    def is_set(self) -> bool:
        return self._sees and (self._file.exists() or not self._file.parent.exists())


class _Processes(Executor):
    """A new process for every job, so that one that crashes takes no other with it.

    A process is ended from within when the race is over or our process is gone, whatever its job does.
    """

    def __init__(self, over: Path) -> None:
        self._over = over
        self._pools: list[ProcessPoolExecutor] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        spawn = multiprocessing.get_context("spawn")  # we may have threads, which do not survive a fork
        pool = ProcessPoolExecutor(1, mp_context=spawn, initializer=_begin, initargs=(str(self._over),))
        self._pools.append(pool)
        with _no_main_module():
            return pool.submit(fn, *args, **kwargs)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        for pool in self._pools:
            pool.shutdown(wait, cancel_futures=cancel_futures)


@contextmanager
def _no_main_module() -> Iterator[None]:
    """Keep new processes from running the caller's script again, as they would to find what is defined in it."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main


def _begin(over: str) -> None:
    """Begin a process: leave Ctrl-C to the parent, and see to it that this process ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end, args=(Path(over),), daemon=True).start()


def _end(over: Path) -> None:
    parent = multiprocessing.parent_process()
    while parent and parent.is_alive() and not over.exists():
        parent.join(_POLL)
    if parent:
        parent.join(_GRACE)
    os._exit(1)


def _submitted(pool: Executor, *call: Any) -> Future[PlanningResult]:
    """Submit a call; an executor that takes none any more is as bad as one that fails."""
    try:
        return pool.submit(*call)
    except RuntimeError as error:
        failed = Future[PlanningResult]()
        failed.set_exception(error)
        return failed


def _when_all_have_ended(futures: set[Future[PlanningResult]], then: Callable[[], None]) -> None:
    def ended(future: Future[PlanningResult]) -> None:
        futures.discard(future)
        if not futures:
            then()

    for future in tuple(futures):
        future.add_done_callback(ended)
