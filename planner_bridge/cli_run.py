"""What `pnm run` does with DOMAIN and PROBLEM, and what it prints in the end."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from rich.console import Console

from planner_bridge.cli_files import Files, bindings_for, faults_for
from planner_bridge.cli_options import problem_in
from planner_bridge.console import ConsoleObserver, Terminal, print_result
from planner_bridge.pipeline import Where, achieve
from planner_bridge.stopwatch import Stopwatch
from planner_bridge.tasks import Settings, TaskObserver, TaskResult
from pnm.sensing import NO_SENSING
from pnm.sensing_file import read_sensing


def run_problem(domain: Path, problem: Path, files: Files, *, actions: Where, settings: Settings, as_json: bool) -> int:
    """Plan, execute and replan, tell how it went, and return the exit status.

    Raises:
        InputError: a file is wrong; nothing was started.
    """
    console, stopwatch = Terminal(), Stopwatch()
    with stopwatch.of("parse"):
        loaded = problem_in(domain, problem)
        sensors = read_sensing(files.sensing, loaded.vocabulary) if files.sensing else NO_SENSING
        settings = replace(settings, bindings=bindings_for(loaded, domain, files.bindings), sensing=sensors)
        faults = faults_for(loaded, files.faults)
    observer = TaskObserver() if as_json else ConsoleObserver(console)
    result = achieve(None, loaded, actions=actions, faults=faults, settings=settings, observer=observer, stopwatch=stopwatch)
    return print_ending(result, console, result.as_json() if as_json else None)


def print_ending(task: TaskResult, console: Console, told: Mapping[str, object] | None) -> int:
    """Print how a task ended, for people or as one JSON object; return the exit status.

    Args:
        task: what has ended.
        console: where people read.
        told: the object, if it is to be printed in place of words.
    """
    if told is None:
        print_result(console, task)
    else:
        print(json.dumps(told, default=str), flush=True)
    return 0 if task.goal_reached else 1
