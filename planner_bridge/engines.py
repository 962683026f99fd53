"""The planners that come with the extra `planners`: what they are good for, and whether they are there.

Any other engine of unified-planning can be named as well; of those nothing is known here.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Final

from planner_bridge.features import Feature
from pnm.errors import InputError


@dataclass(frozen=True, slots=True)
class Engine:
    """An engine of unified-planning."""

    name: str
    package: str
    """Brings it, on PyPI."""
    takes: frozenset[Feature]
    program: str = ""
    """Which must be there to start it."""
    proves: bool = False
    """Whether there is no plan when it says so."""
    undeclared: frozenset[str] = frozenset()
    """What it can do although it does not tell unified-planning so, in the words of unified-planning."""

    @property
    def is_there(self) -> bool:
        """Whether its package is installed, and the program that it needs."""
        return _is_installed(self.package) and (not self.program or shutil.which(self.program) is not None)


ENGINES: Final = {
    engine.name: engine
    for engine in (
        Engine(
            "fast-downward",
            "up-fast-downward",
            frozenset({Feature.QUANTIFIERS, Feature.CONDITIONAL_EFFECTS}),
            proves=True,
            undeclared=frozenset({"UNDEFINED_INITIAL_NUMERIC"}),  # the costs of actions that are never applicable
        ),
        Engine("aries", "up-aries", frozenset({Feature.TIME, Feature.NUMBERS, Feature.OBJECT_FLUENTS, Feature.TASKS})),
        Engine(  # ends without a plan, and unified-planning takes that for a proof
            "enhsp",
            "up-enhsp",
            frozenset({Feature.QUANTIFIERS, Feature.CONDITIONAL_EFFECTS, Feature.NUMBERS, Feature.FRACTIONS}),
            program="java",
        ),
    )
}


def require(name: str) -> None:
    """See to it that the engine is there, as far as that can be told without starting it.

    Raises:
        InputError: something has to be installed first.
    """
    engine = ENGINES.get(name)
    if engine is None or engine.is_there:
        return
    if not _is_installed(engine.package):
        raise InputError(f"the planner {name} is not installed: pip install {engine.package}, or 'petri-net-machines[planners]'")
    raise InputError(f"the planner {name} needs {engine.program}, which is not installed")


def _is_installed(package: str) -> bool:
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True
