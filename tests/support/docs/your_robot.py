"""Do what docs/your-robot.md shows, with the robot that it is about: write its files, run its commands in its terminals.

A block ``console terminal 2`` is what a person sees in that terminal; commands that go on until Ctrl-C do so until the next command
of the same terminal, and a block without a command is what has come since. Times and ids of tasks differ from run to run.

usage: python -m tests.support.docs.your_robot      (puts what is really printed into the page, where it differs)
"""

from __future__ import annotations

import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

from tests.support.docs.language_reference import Shown
from tests.support.e2e.deployment import RosDomain
from tests.support.files import ROOT
from tests.support.processes import LIMIT, Program, ros_domain

PAGE = ROOT / "docs" / "your-robot.md"
BLOCK = re.compile(r"```(?P<kind>console|pddl|yaml) ?(?P<name>[^\n]*)\n(?P<body>.*?)```", re.DOTALL)
GOING_ON = ("simulate", "serve", "watch")
"""Commands that go on until they are interrupted."""
TRAILING = re.compile(r" +$", re.MULTILINE)
VARYING = (
    (re.compile(r" *\d+\.\d+ s\b"), " TIME"),
    (re.compile(r"\b[0-9a-f]{8}\b"), "TASK"),
    (TRAILING, ""),
    (re.compile(r"^machine .*", re.MULTILINE), "MACHINE"),
    (re.compile(r"^journal: .*", re.MULTILINE), "JOURNAL"),
)


@dataclass(frozen=True)
class Step(Shown):
    """A command of the page and what it prints; without a command, what one that goes on has printed since."""

    terminal: str = ""

    def agrees(self, printed: str) -> bool:
        """Tell whether it is printed, but for what differs from run to run."""
        return Shown(self.command, normal(self.output)).agrees(normal(printed))

    def as_printed(self, printed: str) -> str:
        """Return the lines for the page: those that it has, if they agree with what is really printed."""
        command = f"$ {self.command}\n" if self.command else ""
        return command + (self.output if self.agrees(printed) else TRAILING.sub("", printed))


def normal(text: str) -> str:
    """Return a text without what differs from run to run."""
    for pattern, word in VARYING:
        text = pattern.sub(word, text)
    return text


def steps_of(terminal: str, body: str) -> Iterator[Step]:
    """Yield the steps of a block."""
    first, *rest = re.split(r"^\$ ", body, flags=re.MULTILINE)
    if first:
        yield Step("", first, terminal)
    for part in rest:
        command, _, output = part.partition("\n")
        yield Step(command, output, terminal)


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


def follow(page: str, walk: Walk) -> Iterator[tuple[re.Match[str], list[tuple[Step, str]]]]:
    """Follow the page; yield its blocks, each with its steps and what they have printed."""
    for block in BLOCK.finditer(page):
        if block["kind"] == "console":
            yield block, [(step, walk.printed(step)) for step in steps_of(block["name"], block["body"])]
        elif block["name"]:
            (walk.folder / block["name"]).write_text(block["body"], encoding="utf-8")


def main() -> None:
    page = PAGE.read_text(encoding="utf-8")
    real = page
    with TemporaryDirectory() as folder, newcomer(Path(folder)) as (walk, _):
        for block, steps in follow(page, walk):
            body = "".join(step.as_printed(text) for step, text in steps)
            real = real.replace(block[0], f"```{block['kind']} {block['name']}".rstrip() + f"\n{body}```", 1)
    PAGE.write_text(real, encoding="utf-8")


if __name__ == "__main__":
    main()
