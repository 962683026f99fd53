"""Other processes: programs whose output is read as it comes, how long to wait for them, and what runs on this machine."""

from __future__ import annotations

import fcntl
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Final, Self, TypeVar

from tests.support.files import ROOT

LIMIT: Final = 120.0
"""Seconds that anything may take; a busy machine needs many, and only what hangs needs more."""


_PARTICIPANTS: Final = 40
"""More than ever take part in one domain of the tests."""


@contextmanager
def ros_domain() -> Iterator[int]:
    """Yield a number that nobody else has who asks here, and in which no process is left; the lock ends with the process at the latest."""
    for number in range(101, 0, -1):
        file = (Path(tempfile.gettempdir()) / f"pnm-test-domain-{number}").open("w")
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            file.close()
            continue
        with file:
            if _is_inhabited(number):
                continue
            yield number
            return
    raise RuntimeError("all ROS domains are in use by tests")


def _is_inhabited(domain: int) -> bool:
    """Return whether a process takes part in a ROS domain: each takes the first free port of it (DDSI-RTPS 2.5, section 9.6.2)."""
    for participant in range(_PARTICIPANTS):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
            try:
                receiver.bind(("", 7400 + 250 * domain + 10 + 2 * participant))
            except OSError:
                return True
    return False


def working_in(folder: Path, word: str = "") -> list[int]:
    """The processes that have a folder below this one for their temporary files, and the word in their command line."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            environment, command = (process / "environ").read_bytes(), (process / "cmdline").read_bytes()
        except OSError:
            continue
        if f"TMPDIR={folder}/".encode() in environment and command and word.encode() in command:
            found.append(int(process.name))
    return found


def until(happens: Callable[[], object], seconds: float = LIMIT) -> None:
    """Wait for something that other processes do."""
    deadline = time.monotonic() + seconds
    while not happens():
        assert time.monotonic() < deadline, "it did not happen"
        time.sleep(0.01)


def parent(process: int) -> int:
    """The process that has started this one."""
    return int(Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[1])


T = TypeVar("T")


class Program:
    """A Python program in a process of its own.

    The mutable state is its output.

    Args:
        arguments: of Python.
        environment: what is added to the environment.
        within: what the command begins with, such as that which runs it on another host.
        cwd: the folder that it works in.
    """

    def __init__(self, arguments: Sequence[str], environment: Mapping[str, str], within: Sequence[str] = (), cwd: Path = ROOT) -> None:
        self.arguments = arguments
        self.out: list[str] = []
        self.err: list[str] = []
        self._told: list[dict[str, Any]] = []
        self._lines = 0
        self._heard = threading.Condition()
        self.process = subprocess.Popen(
            [*within, sys.executable, *arguments],
            cwd=cwd,
            env={**os.environ, **environment},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._readers = [self._reader(self.process.stdout, self.out), self._reader(self.process.stderr, self.err)]

    def _reader(self, stream: IO[str] | None, lines: list[str]) -> threading.Thread:
        def read() -> None:
            assert stream is not None
            with stream:
                for line in stream:
                    with self._heard:
                        lines.append(line.rstrip("\n"))
                        self._heard.notify_all()
            with self._heard:
                self._heard.notify_all()

        thread = threading.Thread(target=read, daemon=True)
        thread.start()
        return thread

    def until(self, found: Callable[[], T], limit: float = LIMIT) -> T:
        """Wait until the function returns something true; it is asked after every line of output."""
        with self._heard:
            self._heard.wait_for(lambda: found() or not any(reader.is_alive() for reader in self._readers), limit)
            result = found()
        assert result, f"it never happened: {self}"
        return result

    def ready(self) -> Self:
        """Wait until it says that it is ready."""
        self.until(lambda: any(line.startswith("ready") for line in self.out))
        return self

    def ended(self, limit: float = LIMIT) -> int:
        """Wait for the end and return the exit status; there must be no traceback in what was printed."""
        try:
            status = self.process.wait(limit)
        except subprocess.TimeoutExpired as error:
            raise AssertionError(f"it does not end within {limit:g} s: {self}") from error
        self._heard_out()
        return status

    def kill(self) -> None:
        """End it as a crash would."""
        self.process.kill()
        self.process.wait(LIMIT)

    def close(self) -> None:
        """Kill it unless it has ended; either way there must be no traceback in what was printed."""
        self.kill()
        self._heard_out()

    def _heard_out(self) -> None:
        for reader in self._readers:
            reader.join(LIMIT)
        assert "Traceback" not in "\n".join((*self.out, *self.err)), str(self)

    def objects(self) -> list[dict[str, Any]]:
        """Return the JSON objects printed so far; each line is read once, for who waits asks again and again."""
        with self._heard:
            self._told += [json.loads(line) for line in self.out[self._lines :] if line.startswith("{")]
            self._lines = len(self.out)
            return self._told.copy()

    def __str__(self) -> str:
        return "\n".join((" ".join(self.arguments), "--- out", *self.out[-200:], "--- err", *self.err[-50:]))


P = TypeVar("P", bound=Program)


class Deployment:
    """Processes that end together.

    Args:
        folder: for their files.
        environment: what is added to that of each.
    """

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        self.folder = folder
        self.environment = dict(environment)
        self._programs: list[Program] = []

    def start(self, program: P) -> P:
        """Have a program end with the deployment."""
        self._programs.append(program)
        return program

    def close(self) -> None:
        """End all processes, those that are stopped as well."""
        for program in self._programs:
            program.close()


def overlaps(events: Sequence[Mapping[str, Any]]) -> set[tuple[str, str]]:
    """Return the pairs of actions of which the second started while the first was going on."""
    going_on: list[str] = []
    found: set[tuple[str, str]] = set()
    for event in events:
        if event["event"] == "start":
            found |= {(other, event["action"]) for other in going_on}
            going_on.append(event["action"])
        elif event["event"] == "end" and event["action"] in going_on:
            going_on.remove(event["action"])
    return found


def clashes(events: Sequence[Mapping[str, Any]]) -> set[tuple[str, str]]:
    """Return those of these pairs in which one robot carries out both."""
    return {pair for pair in overlaps(events) if len({action.partition("(")[2].partition(",")[0] for action in pair}) == 1}


def say(line: str) -> None:
    """Print a line that a test is waiting for."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def say_json(value: object) -> None:
    say(json.dumps(value))


def say_event(event: str, **fields: object) -> None:
    say_json({"event": event, **fields})
