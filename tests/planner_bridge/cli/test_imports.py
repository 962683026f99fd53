"""What a command imports: libraries that take long only where they are used."""

from __future__ import annotations

import subprocess
import sys

import pytest

from tests.support.files import ROOT

FILES = [str(ROOT / path) for path in ("domains/delivery/domain.pddl", "problems/delivery/p01.pddl")]


@pytest.mark.parametrize("command", [["plan"], ["run", "--improve", "0"]], ids=lambda command: command[0])
def test_a_command_without_a_database_does_not_import_what_postgresql_needs(command: list[str]) -> None:
    python = [sys.executable, "-X", "importtime", "-m", "planner_bridge", *command, *FILES]
    done = subprocess.run(python, capture_output=True, text=True, cwd=ROOT, timeout=120.0, check=True)
    imported = {line.rpartition("|")[2].strip().partition(".")[0] for line in done.stderr.splitlines() if line.startswith("import time:")}
    assert "click" in imported
    assert "pg8000" not in imported
