"""The `pnm` command. Exit status: 0 the goal holds, 1 it does not, 2 the input is wrong."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from enum import Enum
from functools import wraps
from pathlib import Path
from typing import Annotated, ParamSpec

import typer
from rich.console import Console

from pnm.actions.faults import NO_FAULTS, read_faults
from pnm.bindings import Bindings, read_bindings
from pnm.errors import InputError, PnmError
from pnm.machine import OnFailure

from planner_bridge.replanning import Limits

app = typer.Typer(
    name="pnm",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Run robots from goals: PDDL goal, plan, Petri Net Machine, ROS 2 actions, and a new plan when something fails.",
)

P = ParamSpec("P")

DomainFile = Annotated[Path, typer.Argument(metavar="DOMAIN", help="PDDL domain file")]
ProblemFile = Annotated[Path, typer.Argument(metavar="PROBLEM", help="PDDL problem file")]
PlannerName = Annotated[str, typer.Option("--planner", help="kairos, or any engine of unified-planning")]
PlannerTimeout = Annotated[float, typer.Option("--timeout", min=0.01, help="seconds the planner may take")]
AsJson = Annotated[bool, typer.Option("--json", help="print one JSON object as the last line, and nothing else")]
BindingsFile = Annotated[Path | None, typer.Option("--bindings", help="how actions are bound to servers; by default bindings.yaml beside DOMAIN")]
FaultsFile = Annotated[Path | None, typer.Option("--faults", help="what goes wrong in simulation")]


class ActionsChoice(str, Enum):
    """Where actions are carried out."""

    simulated = "simulated"
    ros2 = "ros2"


class FormatChoice(str, Enum):
    """How a machine is written."""

    json = "json"
    dot = "dot"


def _command(function: Callable[P, int]) -> Callable[P, None]:
    """Turn the returned status into the exit status, and errors into one message without a traceback."""

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> None:
        try:
            status = function(*args, **kwargs)
        except InputError as error:
            print(error, file=sys.stderr)
            status = 2
        except PnmError as error:
            print(error, file=sys.stderr)
            status = 1
        except KeyboardInterrupt:
            print("cancelled", file=sys.stderr)
            status = 1
        raise typer.Exit(status)

    return run


@app.command()
@_command
def plan(domain: DomainFile, problem: ProblemFile, planner: PlannerName = "kairos", timeout: PlannerTimeout = 30.0, as_json: AsJson = False) -> int:
    """Find and print a plan."""
    from planner_bridge.pipeline import load
    from planner_bridge.planning import solve

    found = solve(load(domain, problem), planner=planner, timeout=timeout)
    if as_json:
        steps = [
            {"action": step.action, "arguments": list(step.arguments), "start": step.start, "duration": step.duration}
            for step in (found.plan.steps if found.plan else ())
        ]
        print(json.dumps({"status": found.status.value, "message": found.message, "steps": steps if found.plan else None}))
    elif found.plan:
        from planner_bridge.console import print_plan

        print_plan(Console(), found.plan)
    else:
        print(f"no plan: {found.reason}")
    return 0 if found.plan else 1


@app.command()
@_command
def net(
    domain: DomainFile,
    problem: ProblemFile,
    written_as: Annotated[FormatChoice, typer.Option("--format", help="how the machine is written")] = FormatChoice.json,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="a file; by default the terminal")] = None,
    bindings: BindingsFile = None,
    planner: PlannerName = "kairos",
    timeout: PlannerTimeout = 30.0,
) -> int:
    """Plan, and write the machine."""
    from pnm.export.dot import to_dot
    from pnm.export.json import to_json
    from pnm.generate import generate

    from planner_bridge.pipeline import load
    from planner_bridge.planning import solve
    from planner_bridge.plans import plan_graph

    chosen, loaded = _bindings(bindings, domain), load(domain, problem)
    found = solve(loaded, planner=planner, timeout=timeout)
    if found.plan is None:
        print(f"no plan: {found.reason}", file=sys.stderr)
        return 1
    machine = generate(plan_graph(loaded, found.plan), chosen)
    text = to_json(machine) if written_as is FormatChoice.json else to_dot(machine)
    if output is None:
        print(text, end="")
    else:
        _write(output, text)
    return 0


@app.command()
@_command
def run(
    domain: DomainFile,
    problem: ProblemFile,
    actions: Annotated[ActionsChoice, typer.Option("--actions", help="simulated robots, or the action servers of ROS 2")] = ActionsChoice.simulated,
    bindings: BindingsFile = None,
    faults: FaultsFile = None,
    planner: PlannerName = "kairos",
    timeout: PlannerTimeout = 30.0,
    replans: Annotated[int, typer.Option("--replans", min=0, help="how many new machines may follow the first")] = 10,
    seconds: Annotated[float, typer.Option("--seconds", min=0.0, help="how long the goal is pursued")] = 3600.0,
    on_failure: Annotated[OnFailure, typer.Option("--on-failure", help="what running actions do when one has failed")] = OnFailure.DRAIN,
    as_json: AsJson = False,
) -> int:
    """Plan, execute, and replan until the goal holds."""
    from planner_bridge.console import ConsoleObserver, print_result
    from planner_bridge.pipeline import Settings, TaskObserver, achieve

    if faults and actions is ActionsChoice.ros2:
        raise InputError("--faults belongs to simulated robots; give it to `pnm simulate`")
    settings = Settings(planner, timeout, _bindings(bindings, domain), Limits(replans=replans, seconds=seconds), on_failure)
    console = Console(stderr=as_json)
    result = achieve(
        domain,
        problem,
        actions=actions.value,
        faults=read_faults(faults) if faults else NO_FAULTS,
        settings=settings,
        observer=TaskObserver() if as_json else ConsoleObserver(console),
    )
    if as_json:
        print(json.dumps(result.as_json()), flush=True)
    else:
        print_result(console, result)
    return 0 if result.goal_reached else 1


@app.command()
@_command
def simulate(
    domain: DomainFile,
    problem: ProblemFile,
    bindings: BindingsFile = None,
    faults: FaultsFile = None,
    speed: Annotated[float, typer.Option("--speed", min=0.001, help="how many seconds of the simulation pass in one real second")] = 20.0,
    log: Annotated[Path | None, typer.Option("--log", help="write what truly happens, a JSON object per line")] = None,
) -> int:
    """Play the robots: offer one ROS 2 action server per action, and publish what sensors see."""
    from planner_bridge.simulate import play

    return play(domain, problem, _bindings(bindings, domain), read_faults(faults) if faults else NO_FAULTS, speed, log)


@app.command()
@_command
def demo() -> int:
    """Show the whole story on simulated robots: plan, machine, run, failure, replan, goal."""
    from planner_bridge.demo import show

    return show(Console())


def _bindings(file: Path | None, domain: Path) -> Bindings:
    beside = domain.parent / "bindings.yaml"
    if file is None and not beside.is_file():
        return Bindings()
    return read_bindings(file or beside)


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from error


def main() -> None:
    """Run the command line."""
    app()
