"""Processes that measure: ours with this Python, the peers with that of a virtual environment of their own."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import threading
import venv
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any, Final

from tests.support.benchmarks.executives.table import Subject
from tests.support.files import ROOT

PACKAGES: Final = {"up-esb": "Apache-2.0", "py_trees": "BSD-3-Clause", "snakes": "LGPL", "pm4py": "AGPL-3.0", "smach": "BSD-3-Clause"}
"""The peers and their licences. None is a dependency of this project: each runs in a process of its own, to be measured."""
_LONGEST: Final = 900.0
"""Seconds that one measure, or the installation of one package, may take."""


class Worker:
    """A process that answers which measure takes how long."""

    def __init__(self, python: Path, module: str) -> None:
        self._process = subprocess.Popen(
            [str(python), "-m", module], cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self._process.kill()
        self._process.communicate()

    def ask(self, measure: str, size: int) -> Mapping[str, Any]:
        """Have something measured once; a process that takes longer than the limit is ended, and measures nothing more."""
        assert self._process.stdin
        assert self._process.stdout
        too_late = threading.Timer(_LONGEST, self._process.kill)
        too_late.start()
        try:
            self._process.stdin.write(f"{measure} {size}\n")
            self._process.stdin.flush()
            line = self._process.stdout.readline()
        except BrokenPipeError:
            line = ""
        finally:
            too_late.cancel()
        answer: Mapping[str, Any] = json.loads(line) if line else {"error": "its process has ended"}
        return answer


def value_of(worker: Worker, measure: str, size: int) -> float:
    """Return the value of a measure of ours; exit if it cannot be measured."""
    answer = worker.ask(measure, size)
    if "value" not in answer:
        raise SystemExit(f"{measure} {size} cannot be measured: {answer}")
    return float(answer["value"])


def our_worker() -> Worker:
    return Worker(Path(sys.executable), "tests.support.benchmarks.executives.ours")


def peers_worker(python: Path) -> Worker:
    return Worker(python, "tests.support.benchmarks.peers")


def peers_python(folder: Path) -> Path:
    """Return the Python of the peers' environment in a folder, which is made if it is not there; what cannot be installed is left out."""
    python = folder / "bin" / "python"
    if not python.exists():
        venv.create(folder, with_pip=True)
        for package in PACKAGES:
            install = [str(python), "-m", "pip", "install", "--quiet", package]
            done = subprocess.run(install, capture_output=True, text=True, check=False, timeout=_LONGEST)
            sys.stderr.write(f"{package}: {'installed' if done.returncode == 0 else 'cannot be installed'}\n")
    return python


def asked_of(ours: Worker, peers: Worker | None, subject: Subject, size: int) -> Mapping[str, Any]:
    """Ask the worker of a subject."""
    if not subject.is_peer:
        return ours.ask(subject.measure, size)
    return {"missing": "not installed"} if peers is None else peers.ask(subject.measure, size)


def versions(python: Path | None) -> dict[str, str]:
    """Return the versions of the peers that are installed."""
    if python is None:
        return {}
    code = "import importlib.metadata as m, json; print(json.dumps({d.name.lower(): d.version for d in m.distributions()}))"
    done = subprocess.run([str(python), "-c", code], capture_output=True, text=True, check=True)
    installed: dict[str, str] = json.loads(done.stdout)
    found = {name: installed.get(name.lower(), installed.get(name.lower().replace("-", "_"))) for name in PACKAGES}
    return {name: version for name, version in found.items() if version}


def machine() -> dict[str, Any]:
    """Return what the numbers depend on, without anything that says whose machine it is."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    load = round(os.getloadavg()[0], 1)
    return {"cpu": next(names, platform.machine()), "cores": os.cpu_count(), "python": platform.python_version(), "load": load}
