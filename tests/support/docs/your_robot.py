"""The robot of docs/start/tutorial.md, and the terminals in which a newcomer does what the page shows.

Commands that go on until Ctrl-C do so until the next command of the same terminal.

usage: python -m tests.support.docs.your_robot      (puts what is really printed into the page, where it differs)
"""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.support.docs.page import DOCS, Step, as_it_is, follow
from tests.support.e2e.deployment import RosDomain
from tests.support.files import ROOT
from tests.support.processes import LIMIT, Program, ros_domain

PAGE = DOCS / "start" / "tutorial.md"
GOING_ON = ("simulate", "serve", "watch")
"""Commands that go on until they are interrupted."""


@dataclass
class Terminal:
    """A terminal: its ROS domain, and the program that goes on in it. Both change."""

    environment: dict[str, str]
    program: Program | None = None
    seen: int = 0
    """How many lines of the program were looked at."""

    def interrupt(self) -> None:
        """Press Ctrl-C."""
        if self.program:
            self.program.process.send_signal(signal.SIGINT)
            assert self.program.ended() == 0, str(self.program)
            self.program = None


@dataclass
class Walk:
    """The way through the page, in an empty folder. The terminals change.

    Args:
        robot: the ROS domain of the robot.
        rehearsal: another one, for the numbers that the page gives.
    """

    folder: Path
    robot: RosDomain
    rehearsal: RosDomain
    terminals: dict[str, Terminal] = field(default_factory=dict)

    def printed(self, step: Step) -> str:
        """Do a step and return what is printed; of what goes on, what has come when it agrees, or its limit is over."""
        terminal = self.terminals.setdefault(step.terminal, Terminal(dict(self.robot.environment)))
        words = shlex.split(step.command)
        match words:
            case ["export" | "unset", name]:
                assert name.partition("=")[0] == "ROS_DOMAIN_ID"
                terminal.interrupt()
                terminal.environment = dict((self.rehearsal if words[0] == "export" else self.robot).environment)
                return ""
            case ["pnm", command, *_] if command in GOING_ON:
                terminal.interrupt()
                program = Program(["-m", "planner_bridge", *words[1:]], self._environment(terminal), cwd=self.folder)
                terminal.program, terminal.seen = self.robot.start(program), 0
                return self._come(terminal, step, lambda: len(program.out) >= max(1, len(step.output.splitlines())))
            case []:
                return self._come(terminal, step, lambda: step.agrees(_text(terminal)))
        (self.folder / "bin").mkdir(exist_ok=True)
        script = self.folder / "bin" / "pnm"
        script.write_text(f'#!/bin/sh\nexec {sys.executable} -m planner_bridge "$@"\n')
        script.chmod(0o755)
        environment = {**os.environ, **self._environment(terminal), "PATH": f"{script.parent}:{os.environ['PATH']}"}
        ways: dict[str, object] = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "stdin": subprocess.DEVNULL}
        return subprocess.run(step.command, shell=True, text=True, cwd=self.folder, env=environment, timeout=LIMIT, **ways).stdout  # type: ignore[call-overload, no-any-return]

    def _come(self, terminal: Terminal, step: Step, has_come: Callable[[], bool]) -> str:
        assert terminal.program
        with suppress(AssertionError):  # what has come instead is compared
            terminal.program.until(has_come)
        text = _text(terminal)
        terminal.seen = len(terminal.program.out)
        return text

    def _environment(self, terminal: Terminal) -> dict[str, str]:
        return {
            **terminal.environment,
            "PYTHONPATH": f"{ROOT}:{os.environ.get('PYTHONPATH', '')}",
            "COLUMNS": "120",
            "PYTHONUNBUFFERED": "1",
        }

    def close(self) -> None:
        """Press Ctrl-C in all terminals."""
        for terminal in self.terminals.values():
            terminal.interrupt()


def _text(terminal: Terminal) -> str:
    assert terminal.program
    return "".join(f"{line}\n" for line in terminal.program.out[terminal.seen :])


@contextmanager
def newcomer(folder: Path) -> Iterator[tuple[Walk, Program]]:
    """A newcomer with an empty folder, and the robot of the page."""
    mine = folder / "mine-to-be"
    mine.mkdir()
    with ros_domain() as one, ros_domain() as other:
        robot = RosDomain(folder, one, quick=True)
        try:
            porter = robot.start(Program(["-m", "tests.support.e2e.newcomer.porter"], robot.environment))
            porter.until(lambda: porter.out)
            walk = Walk(mine, robot, RosDomain(folder, other, quick=True))
            yield walk, porter
            walk.close()
        finally:
            robot.close()


def main() -> None:
    page = PAGE.read_text(encoding="utf-8")
    with TemporaryDirectory() as folder, newcomer(Path(folder)) as (walk, _):
        real = as_it_is(page, follow(page, walk))
    PAGE.write_text(real, encoding="utf-8")


if __name__ == "__main__":
    main()
