"""The files that commands are given besides those of a problem or of a plan."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from planner_bridge.model import Problem
from pnm.actions.faults import NO_FAULTS, Faults, read_faults
from pnm.bindings import Bindings, read_bindings


@dataclass(frozen=True, slots=True)
class Files:
    """Those that options name."""

    bindings: Path | None = None
    faults: Path | None = None
    knowledge: Path | None = None
    sensing: Path | None = None


def bindings_for(problem: Problem, domain: Path, file: Path | None) -> Bindings:
    """Read bindings from a file, or from ``bindings.yaml`` beside the domain if that is there.

    Raises:
        InputError: the file is wrong, or cannot be read.
    """
    beside = domain.parent / "bindings.yaml"
    if file is None and not beside.is_file():
        return Bindings()
    return read_bindings(file or beside, problem.vocabulary)


def faults_for(problem: Problem, file: Path | None) -> Faults:
    """Read what goes wrong in simulation.

    Raises:
        InputError: the file is wrong, or cannot be read.
    """
    return read_faults(file, problem.vocabulary) if file else NO_FAULTS
