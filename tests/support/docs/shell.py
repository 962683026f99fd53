"""Shells for the pages whose robots are simulated: commands of this code in this process, or those of an installed `pnm`."""

from __future__ import annotations

import os
import shlex
import subprocess
import time
from contextlib import chdir
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch

from click.testing import CliRunner

from planner_bridge.cli.commands import app
from planner_bridge.planning import kairos
from tests.support.docs.page import Step
from tests.support.files import ROOT

_PROCESSOR = SimpleNamespace(monotonic=time.process_time, process_time=time.process_time)
"""The time for better plans is that of the processor: the plans are the same however busy the machine is."""


@dataclass
class OwnShell:
    """A shell that calls the commands of this code; they see a folder with the examples of the project. The last exit status changes."""

    folder: Path
    status: int = 0

    def printed(self, step: Step) -> str:
        """Carry out a command of `pnm`, or print its exit status."""
        match shlex.split(step.command):
            case ["pnm", *arguments]:
                # As wide as a terminal is by default; knowledge and journals that outlast a process are kept in the folder.
                environment = {"COLUMNS": "80", "XDG_STATE_HOME": str(self.folder)}
                with chdir(self.folder), patch.object(kairos, "time", _PROCESSOR):
                    done = CliRunner(env=environment).invoke(app, arguments, prog_name="pnm")
                self.status = done.exit_code
                return done.output
            case ["echo", _]:
                return f"{self.status}\n"
        return f"not a command that is tried: {step.command}\n"


@dataclass(frozen=True)
class InstalledShell:
    """A shell that runs an installed `pnm`.

    Args:
        folder: where it is run.
        programs: where the program is.
    """

    folder: Path
    programs: Path

    def printed(self, step: Step) -> str:
        """Run a command; return what it prints."""
        environment = {**os.environ, "COLUMNS": "80", "PATH": f"{self.programs}:{os.environ['PATH']}"}
        done = subprocess.run(
            step.command,
            shell=True,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=self.folder,
            env=environment,
            timeout=120,
            check=False,
        )
        return done.stdout


def with_examples(folder: Path) -> Path:
    """Return the folder, in which the examples of the project are as in a clone of it."""
    for name in ("domains", "problems"):
        (folder / name).symlink_to(ROOT / name)
    return folder
