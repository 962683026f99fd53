"""Loading of problems from PDDL files, our own model, or unified-planning; the bindings beside them; warnings as text."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from planner_bridge.model.problem import Domain, Problem
from planner_bridge.pddl import read_domain, read_problem
from pnm.core.logic.domain import Vocabulary
from pnm.errors import InputError, Tolerated

if TYPE_CHECKING:
    from planner_bridge.model.rates import Rates
    from planner_bridge.pipeline.odds import KnownRobots
    from pnm.core.machine.bindings import Bindings

BINDINGS: Final = "bindings.yaml"
RATES: Final = "rates.yaml"
"""The files of bindings and of rates beside a domain."""
_SHOWN: Final = 20
"""Warnings about a file that are shown, at most."""


def load(domain: Path | str | Domain | None, problem: Path | str | Problem | Any) -> Problem:
    """Return the problem, read from files where files are named; raise an `InputError` if one is wrong, cannot be read, or is not named."""
    if isinstance(problem, Problem):
        return problem
    if not isinstance(problem, Path | str):
        if not hasattr(problem, "kind"):
            raise InputError(f"expected a file, a Problem or a Problem of unified-planning for problem, found {problem!r}")
        from planner_bridge.planning.unified_planning import from_unified_planning  # here, because unified-planning takes seconds to import

        return from_unified_planning(problem)
    if not isinstance(domain, Path | str | Domain):
        raise InputError(f"expected a file or a Domain for domain, found {domain!r}")
    for name, given in (("domain", domain), ("problem", problem)):
        if isinstance(given, str) and "\n" in given:
            raise InputError(f"expected the name of a file for {name}, found a text; `parse_{name}` reads one")
    return read_problem(Path(problem), domain if isinstance(domain, Domain) else read_domain(Path(domain)))


def beside(domain: Path | None, name: str) -> Path | None:
    """Return the file of this name beside the domain, if there is one."""
    file = domain.parent / name if domain else None
    return file if file and os.path.isfile(file) else None  # unlike `Path.is_file` also for names that are too long


def bindings_for(domain: Path | None, file: Path | None, known: Vocabulary | None) -> Bindings:
    """Return bindings from a file; without one, from ``bindings.yaml`` beside the domain; empty ones if there is none either.

    Bindings may use only the names in `known`; any, if it is None.
    """
    if chosen := file or beside(domain, BINDINGS):
        from pnm.actions.bindings_file import read_bindings  # here and below, because most searches for a plan have neither

        return read_bindings(chosen, known)
    from pnm.core.machine.bindings import NO_BINDINGS

    return NO_BINDINGS


def rates_for(domain: Path | None, file: Path | None, *, grows: bool = False) -> Rates:
    """Return rates from a file; without one, from ``rates.yaml`` beside the domain; none if there is none either.

    A file that `grows` need not be there yet.
    """
    from planner_bridge.model.rates import NO_RATES, read_rates

    chosen = file or beside(domain, RATES)
    return NO_RATES if chosen is None or (grows and not os.path.isfile(chosen)) else read_rates(chosen)


def known_from(rates: str | None, faults: str | None) -> KnownRobots:
    """Return what is known of robots by files, whose actions may have any name."""
    from planner_bridge.pipeline.odds import NOTHING_KNOWN, KnownRobots
    from pnm.actions.faults import read_faults

    learned = rates_for(None, Path(rates) if rates else None, grows=True)
    declared = read_faults(Path(faults), None) if faults else NOTHING_KNOWN.faults
    return KnownRobots(learned, declared)


def warning_lines(warnings: Iterable[Tolerated]) -> Iterator[str]:
    """Yield a line for each warning, and for each file with many of them how many more there are."""
    for file, group in groupby(warnings, key=lambda warning: warning.position.file):
        of_file = list(group)
        yield from map(str, of_file[:_SHOWN])
        if len(of_file) > _SHOWN:
            yield f"{file}: {len(of_file) - _SHOWN} more warnings"
