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
    from pnm.core.machine.bindings import Bindings

RATES: Final = "rates.yaml"
"""The file of rates beside a domain."""
_SHOWN: Final = 20
"""Warnings about a file that are shown, at most."""


def load(domain: Path | str | Domain | None, problem: Path | str | Problem | Any) -> Problem:
    """Return the problem, read from files where files are named.

    Raises:
        InputError: a file is wrong, cannot be read, or is not named.
    """
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


def bindings_for(domain: Path | None, file: Path | None, known: Vocabulary | None) -> Bindings:
    """Return bindings from a file; without one, from ``bindings.yaml`` beside the domain if that exists.

    Bindings may use only the names in `known`; any, if it is None.
    """
    from pnm.core.machine.bindings import NO_BINDINGS  # here and below, because a search for a plan needs no bindings

    file = file or bindings_beside(domain)
    if file is None:
        return NO_BINDINGS
    from pnm.actions.bindings_file import read_bindings

    return read_bindings(file, known)


def bindings_beside(domain: Path | None) -> Path | None:
    """Return the ``bindings.yaml`` beside the domain, if there is one."""
    beside = domain.parent / "bindings.yaml" if domain else None
    return beside if beside and os.path.isfile(beside) else None  # unlike `Path.is_file` also for names that are too long


def rates_beside(domain: Path | None) -> Path | None:
    """Return the ``rates.yaml`` beside the domain, if there is one."""
    beside = domain.parent / RATES if domain else None
    return beside if beside and os.path.isfile(beside) else None


def rates_for(domain: Path | None, file: Path | None, *, grows: bool = False) -> Rates:
    """Return rates from a file; without one, from ``rates.yaml`` beside the domain if that exists. A file that `grows` may be new."""
    from planner_bridge.model.rates import NO_RATES, read_rates  # here, because most commands need no rates

    chosen = file if file and (not grows or os.path.isfile(file)) else None if file else rates_beside(domain)
    return read_rates(chosen) if chosen else NO_RATES


def warning_lines(warnings: Iterable[Tolerated]) -> Iterator[str]:
    """Yield a line for each warning, and for each file with many of them how many more there are."""
    for file, group in groupby(warnings, key=lambda warning: warning.position.file):
        of_file = list(group)
        yield from map(str, of_file[:_SHOWN])
        if len(of_file) > _SHOWN:
            yield f"{file}: {len(of_file) - _SHOWN} more warnings"
