"""Processes of ours: what those that we start may import, and what this one may write to its terminal.

A Python process of ours imports what this one would, and nothing that lies in the folder in which it was started.

Python puts the current folder first on the path of ``python -m`` and ``python -c``: a ``json.py`` in a folder that somebody has unpacked
would be executed. Packages that are found otherwise (installed, editable, in `PYTHONPATH`) are still found.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final, TextIO, cast

from pnm.errors import printable_lines

_ROOT: Final = Path(__file__).parents[2]
"""The folder of our packages."""


def own_python(*arguments: str) -> list[str]:
    """Return the command of a Python process with these arguments; its environment is `own_environment`."""
    return [sys.executable, "-P", *arguments]


def own_environment(**added: str) -> Mapping[str, str]:
    """Return the environment of such a process: this one, and what is added; our packages are found also where none is installed."""
    path = [os.environ["PYTHONPATH"]] if os.environ.get("PYTHONPATH") else []
    if _ROOT.name not in ("site-packages", "dist-packages"):  # which come behind the standard library by themselves
        path.insert(0, str(_ROOT))
    return {**os.environ, **({"PYTHONPATH": os.pathsep.join(path)} if path else {}), **added}


# --- standard output and standard error without control characters, whoever writes ---------


class SafeStream:
    """A stream of lines, each of them printable. A terminal's library, `rich`, looks for the stream behind it, for control sequences."""

    def __init__(self, rich_proxied_file: TextIO) -> None:
        self.rich_proxied_file = rich_proxied_file

    def write(self, text: str) -> int:
        """Write a text as it may be shown; return its length."""
        self.rich_proxied_file.write(printable_lines(text))
        return len(text)

    def writelines(self, lines: Iterable[str]) -> None:
        """Write texts."""
        for line in lines:
            self.write(line)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.rich_proxied_file, name)


def make_streams_safe() -> None:
    """Have everything that this process writes to its standard streams be safe; to be called once, at its beginning."""
    sys.stdout = cast(TextIO, SafeStream(sys.stdout))
    sys.stderr = cast(TextIO, SafeStream(sys.stderr))


def own_standard_output() -> None:
    """Have the standard output be ours alone; to be called once, at the beginning of a program.

    What libraries write past Python, as Fast DDS does with its errors, goes to the standard error: between lines of JSON it would be read
    as one of them. A file of ours that is called /dev/stdout is still what our output goes to.
    """
    if sys.stdout and sys.stderr:  # neither of which was closed by who started us
        ours = os.dup(1)
        sys.stdout = open(ours, "w", 1 if sys.stdout.isatty() else -1, sys.stdout.encoding, sys.stdout.errors)  # noqa: SIM115
        os.dup2(2, 1)
        sys.argv = [argument.replace("/dev/stdout", f"/dev/fd/{ours}") for argument in sys.argv]
