"""A simulated world in one process, runs in others, and what was true in the world in the end."""

from __future__ import annotations

import signal
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.pipeline.loading import load
from pnm.core.knowledge_base import KnowledgeBase, parse_statement
from pnm.core.logic.conditions import evaluate
from tests.support.files import ROOT, written
from tests.support.processes import LIMIT, Deployment, P, Program
from tests.support.ros.middleware import middleware


@dataclass(frozen=True)
class Finished:
    """A run that has ended, and the world after it."""

    status: int
    result: dict[str, Any]
    events: list[dict[str, Any]]
    truth: KnowledgeBase


class Serving(Program):
    """`pnm serve`, or another program that goes on until it is told to end."""

    def stop(self, number: int = signal.SIGTERM) -> None:
        """End it in order."""
        self.process.send_signal(number)
        assert self.ended() == 0, str(self)


class SimulationProgram(Serving):
    """`pnm simulate`, which logs what truly happens to its standard output."""

    def happens(self, event: str, action: str, times: int = 1) -> None:
        """Wait until an action of this name has started or ended so often."""
        self.until(lambda: [one for one in self.objects() if one["event"] == event and one["action"].startswith(f"{action}(")][times - 1 :])


class RunProgram(Program):
    """`pnm run --json`."""

    def result(self, limit: float = LIMIT) -> tuple[int, dict[str, Any]]:
        """Wait for its end; return its exit status and the JSON object of its last line."""
        status = self.ended(limit)
        assert self.out, str(self)
        assert self.objects()[-1:] == self.objects(), f"more than one line: {self}"
        return status, self.objects()[-1]


class RosDomain(Deployment):
    """A ROS domain of its own, and the processes in it.

    Args:
        folder: for the files of the deployment.
        ros_domain: its number.
        quick: have processes look out for each other more often than every 3 s, which is the default.
        lease: seconds after which a process that is not heard is taken for gone; 20 by default.
    """

    def __init__(self, folder: Path, ros_domain: int, *, quick: bool = False, lease: int | None = None) -> None:
        # journals of nodes, with which no other deployment is to go on
        super().__init__(folder, {**middleware(folder, ros_domain, lease=lease, is_quick=quick), "XDG_STATE_HOME": str(folder / "state")})

    def pnm(self, kind: type[P], *arguments: str, within: Sequence[str] = ()) -> P:
        """Start `pnm` with these arguments, by the command it is within if any."""
        return self.module(kind, "planner_bridge", *arguments, within=within)

    def module(self, kind: type[P], name: str, *arguments: str, within: Sequence[str] = ()) -> P:
        """Start a module of Python."""
        return self.start(kind(["-m", name, *arguments], self.environment, within))


class ProblemDeployment(RosDomain):
    """A problem that is executed in a ROS domain of its own.

    Args:
        name: one of the project's own problems, such as ``delivery/p01``.
        folder: for the files of the deployment.
        ros_domain: its number.
        faults: text of a faults file; by default nothing goes wrong.
        bindings: text of a bindings file; by default the domain's own.
        speed: how many times faster than real time the robots are.
        quick: have processes look out for each other more often than every 3 s, which is the default.
        lease: seconds after which a process that is not heard is taken for gone; 20 by default.
        texts: of a domain and a problem, in place of the project's own.
    """

    def __init__(
        self,
        name: str,
        folder: Path,
        ros_domain: int,
        *,
        faults: str = "",
        bindings: str = "",
        speed: str = "20",
        quick: bool = False,
        lease: int | None = None,
        texts: tuple[str, str] | None = None,
    ) -> None:
        super().__init__(folder, ros_domain, quick=quick, lease=lease)
        if texts:
            self.files = [str(written(folder / "domain.pddl", texts[0])), str(written(folder / "problem.pddl", texts[1]))]
        else:
            domain, number = name.split("/")
            self.files = [str(ROOT / "domains" / domain / "domain.pddl"), str(ROOT / "problems" / domain / f"{number}.pddl")]
        self._faults = ["--faults", str(written(folder / "faults.yaml", faults))] if faults else []
        self._bindings = ["--bindings", str(written(folder / "bindings.yaml", bindings))] if bindings else []
        self._speed = ["--speed", speed]

    @cached_property
    def problem(self) -> Problem:
        """The problem as it is at first."""
        return load(Path(self.files[0]), Path(self.files[1]))

    def simulate(self, program: str = "planner_bridge") -> SimulationProgram:
        """Start the robots, with a module in place of `pnm` if there is one."""
        options = [*self._bindings, *self._faults, *self._speed, "--log", "/dev/stdout"]
        return self.module(SimulationProgram, program, "simulate", *self.files, *options)

    def run(self, *options: str, within: Sequence[str] = (), program: str = "planner_bridge") -> RunProgram:
        """Start a run, by the command it is within if any, with a module in place of `pnm` if there is one."""
        options = ("--actions", "ros2", "--json", *self._bindings, *options)
        return self.module(RunProgram, program, "run", *self.files, *options, within=within)

    def execute(self, *options: str) -> Finished:
        """Start the robots and a run, and wait for its end; the verdict must be true."""
        simulation = self.simulate().ready()
        return self.finish(self.run(*options), simulation)

    @property
    def journal(self) -> str:
        """The journal of runs that are killed."""
        return str(self.folder / "journal")

    def execute_killed(self, action: str, *options: str) -> Finished:
        """Kill a run once an action of this name has started, have another process go on with it, and wait for the end."""
        simulation = self.simulate().ready()
        run = self.run("--journal", self.journal, *options)
        simulation.happens("start", action)
        run.kill()
        return self.finish(self.pnm(RunProgram, "resume", self.journal), simulation)

    def finish(self, run: RunProgram, simulation: SimulationProgram, limit: float = LIMIT) -> Finished:
        """Wait for the end of the run and stop the robots; the verdict must be what is true in their world."""
        status, result = run.result(limit)
        simulation.stop()
        truth = self.truth(simulation)
        assert result["goal_reached"] is (evaluate(self.problem.goal, truth) is True), f"{run}\n{simulation}"
        assert status == (0 if result["goal_reached"] else 1)
        return Finished(status, result, simulation.objects(), truth)

    def truth(self, simulation: SimulationProgram) -> KnowledgeBase:
        """Return the world that is left: the initial state and all changes in the log."""
        world = initial_knowledge(self.problem)
        for event in simulation.objects():
            if event["event"] == "change":
                world.update(dict(map(parse_statement, event["facts"])))
            elif event["event"] == "state":
                assert dict(map(parse_statement, event["facts"])) == world.facts()
        return world
