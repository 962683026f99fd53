"""The project as others get it: built into an sdist, that into a wheel, and this installed outside of the source tree."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from tests.support.files import ROOT
from tests.support.processes import LIMIT


@dataclass(frozen=True)
class Installed:
    """The `pnm` of a wheel, in a folder of its own; what the project depends on is that of this environment."""

    packages: Path
    folder: Path
    """Where its commands are given."""

    def pnm(self, *arguments: str, environment: Mapping[str, str] | None = None) -> subprocess.CompletedProcess[str]:
        """Give a command, and wait for its end."""
        own = {"PYTHONPATH": str(self.packages), "CC": "/bin/false", "CXX": "/bin/false"}
        command = [sys.executable, str(self.packages / "bin" / "pnm"), *arguments]
        ways = {**os.environ, **own, **(environment or {})}
        return subprocess.run(command, cwd=self.folder, env=ways, text=True, capture_output=True, timeout=LIMIT, check=False)


def installed(folder: Path) -> Installed:
    """Build and install in a folder, which is outside of the source tree; nothing is loaded down."""

    def done(*command: str) -> None:
        ended = subprocess.run([sys.executable, "-m", *command], cwd=folder, text=True, capture_output=True, check=False)
        assert ended.returncode == 0, ended.stdout + ended.stderr

    dist, packages, mine = (folder / name for name in ("dist", "packages", "mine"))
    mine.mkdir()
    done("build", "-q", "--no-isolation", "--outdir", str(dist), str(ROOT))  # the wheel of the sdist
    assert len([*dist.glob("*.tar.gz")]) == 1
    done("pip", "install", "-q", "--no-deps", "--no-index", "--target", str(packages), *map(str, dist.glob("*.whl")))
    return Installed(packages, mine)
