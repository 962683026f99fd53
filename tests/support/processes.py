"""Other processes: how long to wait for them, and those that run on this machine, read from /proc."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

LIMIT: Final = 120.0
"""Seconds that anything may take; a busy machine needs many, and only what hangs needs more."""


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
