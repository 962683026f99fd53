"""Processes whose output is read as it comes, so that a test can wait for a line and never for a time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from typing import IO, Any, TypeVar

from tests.support.files import ROOT
from tests.support.processes import LIMIT

T = TypeVar("T")


class Program:
    """A Python program in a process of its own.

    Args:
        arguments: of Python.
        environment: what is added to the environment.
        within: what the command begins with, such as that which runs it on another host.
    """

    def __init__(self, arguments: Sequence[str], environment: Mapping[str, str], within: Sequence[str] = ()) -> None:
        self.arguments = arguments
        self.out: list[str] = []
        self.err: list[str] = []
        self._heard = threading.Condition()
        self.process = subprocess.Popen(
            [*within, sys.executable, *arguments],
            cwd=ROOT,
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

    def ended(self, limit: float = LIMIT) -> int:
        """Wait for the end and return the exit status; there must be no traceback in what was printed."""
        try:
            status = self.process.wait(limit)
        except subprocess.TimeoutExpired as error:
            raise AssertionError(f"it does not end within {limit:g} s: {self}") from error
        self._heard_out()
        return status

    def close(self) -> None:
        """Kill it unless it has ended; either way there must be no traceback in what was printed."""
        self.process.kill()
        self.process.wait(LIMIT)
        self._heard_out()

    def _heard_out(self) -> None:
        for reader in self._readers:
            reader.join(LIMIT)
        assert "Traceback" not in "\n".join((*self.out, *self.err)), str(self)

    def objects(self) -> list[dict[str, Any]]:
        """Return the JSON objects printed so far."""
        return [json.loads(line) for line in tuple(self.out) if line.startswith("{")]

    def __str__(self) -> str:
        return "\n".join((" ".join(self.arguments), "--- out", *self.out[-200:], "--- err", *self.err[-50:]))


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
