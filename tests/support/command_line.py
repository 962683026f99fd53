"""The `pnm` command as a process, and the JSON that it prints."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.support.files import ROOT


def pnm(*arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    done = subprocess.run([sys.executable, "-m", "planner_bridge", *arguments], capture_output=True, text=True, cwd=cwd, timeout=120)
    assert "Traceback" not in done.stdout + done.stderr
    return done


def result(done: subprocess.CompletedProcess[str]) -> dict[str, object]:
    return json.loads(done.stdout.splitlines()[-1])
