"""A portfolio of planners on the same problem: the first valid plan counts, and the other searches are stopped.

The planners run in a `concurrent.futures.Executor`: by default threads, from which every engine
gets its process, and any other that the caller supplies, a cluster's as well. What is submitted is
a function of this module with plain data. A stop file ends the searches: jobs that see the same
file system stop at once, any other at its time limit.
"""

from __future__ import annotations

import shutil
import tempfile
import threading
import time
from collections.abc import Mapping
from concurrent.futures import FIRST_COMPLETED, CancelledError, Executor, Future, ThreadPoolExecutor, wait
from dataclasses import replace
from pathlib import Path
from typing import Final

from planner_bridge.model.plan import CancelToken, PlanningResult, PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.pddl.writer import write_domain, write_problem
from planner_bridge.planning.engines import ENGINES, START_LIMIT, Feature, problem_kind, require_installed
from planner_bridge.planning.kairos import DEFAULT_PLANNER, search
from planner_bridge.planning.validate import explained, validated
from pnm.errors import InputError, suggestion

_POLL: Final = 0.05
_HARDLY: Final = 0.001
"""Seconds for which Kairos improves its plan: others wait for it; and not 0, which asks for one search alone."""

_FAILURES: Final = (
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
"""Reasons why there is no plan, the most telling first: the first that one of the planners gives is that of the portfolio."""


def solve_with_portfolio(
    problem: Problem,
    *,
    planners: tuple[str, ...] | None = None,
    timeout: float = 30.0,
    executor: Executor | None = None,
    cancel: CancelToken | None = None,
) -> PlanningResult:
    """Let planners search at the same time, at most `timeout` seconds, and return the first valid plan.

    By default the members are Kairos and the engines of `ENGINES` that are installed and suit the problem. Each engine has
    a process of its own, which is gone when this returns. The time to load a planner does not count.
    """
    names = suitable_planners(problem) if planners is None else _known(planners)
    if not names:
        return PlanningResult(PlanningStatus.UNSUPPORTED, message="no planner that is installed here suits the problem")
    if executor is None:  # with an executor of the caller the planners may be installed elsewhere, so nothing is checked here
        check_members(names)
    texts = write_domain(problem.domain), write_problem(problem)  # PDDL as text: plain data, which any executor can pass to any machine
    folder = Path(tempfile.mkdtemp(prefix="pnm-race-"))
    stop_file = folder / "over"
    pool = executor or ThreadPoolExecutor(len(names))
    searches: dict[Future[PlanningResult], str] = {}
    try:
        for name in names:
            try:
                future = pool.submit(search_in_worker, *texts, name, timeout, str(stop_file))
            except RuntimeError as error:  # an executor that takes no more calls is as bad as one that fails
                future = Future()
                future.set_exception(error)
            searches[future] = name
        # Workers first load their planner, which does not count, hence more time here than for each search.
        return _first_decisive(problem, searches, time.monotonic() + timeout + START_LIMIT, cancel or threading.Event())
    finally:
        stop_file.touch()  # in every case, an error included: workers see the file and end themselves
        for future in searches:
            future.cancel()
        if executor is None:  # the threads are ours; an executor of the caller stays open for other searches
            pool.shutdown()
        # Not before: a worker that begins without the folder would take our file system for one that it does not share.
        going_on = {*searches}

        def ended(future: Future[PlanningResult]) -> None:
            going_on.discard(future)
            if not going_on:
                shutil.rmtree(folder, ignore_errors=True)

        for future in searches:
            future.add_done_callback(ended)


def suitable_planners(problem: Problem) -> tuple[str, ...]:
    """Return the planners that are installed and suit the problem, Kairos first."""
    kind = problem_kind(problem)
    kairos = () if Feature.TASKS in kind else (DEFAULT_PLANNER,)
    return (*kairos, *(engine.name for engine in ENGINES.values() if kind <= engine.supports and engine.is_installed))


def check_members(planners: tuple[str, ...]) -> None:
    """Refuse a portfolio one of whose planners is not known, or is not installed here."""
    for name in _known(planners):
        require_installed(name)


def search_in_worker(domain: str, problem: str, planner: str, timeout: float, stop_file: str) -> PlanningResult:
    """Search with one of the planners, until the stop file appears; the arguments are plain data, so that any executor can pass them."""
    try:
        return search(parse_problem(problem, parse_domain(domain)), planner, timeout, _StopFile(Path(stop_file)), improve=_HARDLY)
    except InputError as error:
        return PlanningResult(PlanningStatus.INVALID, message=str(error))


def _known(planners: tuple[str, ...]) -> tuple[str, ...]:
    """Return the planners, each once; refuse one that is not known."""
    for name in planners:
        if name != DEFAULT_PLANNER and name not in ENGINES:
            known = (
                DEFAULT_PLANNER,
                *(engine.name if engine.is_installed else f"{engine.name} (not installed)" for engine in ENGINES.values()),
            )
            hint = suggestion(name, (DEFAULT_PLANNER, *ENGINES))
            raise InputError(f"{name!r} cannot take part in a race; these can: {', '.join(known)}{f'; {hint}' if hint else ''}")
    return tuple(dict.fromkeys(planners))


def _first_decisive(
    problem: Problem, searches: Mapping[Future[PlanningResult], str], deadline: float, cancel: CancelToken
) -> PlanningResult:
    """Return the first valid plan or proof that there is none; else the reasons of all planners together."""
    failed: list[PlanningResult] = []
    waiting = {*searches}
    while waiting and time.monotonic() < deadline:
        if cancel.is_set():  # looked at between short waits, because a future cannot be waited for together with a token
            return PlanningResult(PlanningStatus.CANCELLED, planner=", ".join(searches.values()))
        ended, waiting = wait(waiting, timeout=_POLL, return_when=FIRST_COMPLETED)
        for future in (future for future in searches if future in ended):
            try:
                answer = future.result()
            except CancelledError:
                answer = PlanningResult(PlanningStatus.CANCELLED, message="by the executor")
            except Exception as error:  # whatever befell the planner or the process it ran in
                answer = PlanningResult(PlanningStatus.CRASHED, message=f"{type(error).__name__}: {error}")
            # A plan is validated here even if the worker trusts it: the first *valid* plan wins, not the first.
            result = explained(problem, validated(problem, replace(answer, planner=searches[future])))
            # A proof that there is no plan is as decisive as a plan; `NO_PLAN` only means that one planner found none.
            if result.plan is not None or result.status is PlanningStatus.UNSOLVABLE:
                return replace(result, message="; ".join(filter(None, (*map(_reason, failed), result.message))))
            failed.append(result)
    failed += (PlanningResult(PlanningStatus.TIMED_OUT, planner=name) for future, name in searches.items() if future in waiting)
    # Not the last failure but the most telling one, whatever the order in which planners gave up.
    status = min((result.status for result in failed), key=_FAILURES.index)
    return PlanningResult(status, message="; ".join(map(_reason, failed)), planner=", ".join(searches.values()))


def _reason(result: PlanningResult) -> str:
    return f"{result.planner}: {result.reason}"


class _StopFile:
    """A cancel token: set once the file exists or its folder is gone; never on a machine that has not seen the folder."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self._is_shared = file.parent.exists()  # looked up once, at the beginning: later a missing folder means that the search is over

    def is_set(self) -> bool:
        return self._is_shared and (self._file.exists() or not self._file.parent.exists())
