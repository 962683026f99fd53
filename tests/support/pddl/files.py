"""PDDL files of the project, and of others, where their folder is present beside the project."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

from tests.support.files import ROOT, SHARED

PAIRS: Final = SHARED / "pddl"
REFUSED: Final = {
    "blocks_observe": "domain.pddl:11:4: sensing actions (:observe) are not supported yet;"
    " a contingent planner, which unified-planning lacks, would be needed",
    "rosplan_test_invalid": "problem.pddl:1:2: expected 'define', found 'defie'",
    "simple_3": "problem.pddl:18:4: the text ends here; expected ')', for the '(' in line 1 is not closed",
}
"""Pairs that are not read, and why; none of `ipc` is among them."""
Pair = tuple[Path, Path]
OWN: Final[list[Pair]] = [
    (ROOT / "domains" / path.parent.name / "domain.pddl", path) for path in sorted((ROOT / "problems").glob("*/*.pddl"))
]
"""The domain and the problem of everything in the project."""


def pairs() -> list[Path]:
    manifests = sorted(PAIRS.glob("*/manifest.json"))
    return [manifest.parent / pair["name"] for manifest in manifests for pair in json.loads(manifest.read_text())]


def name_of(pair: Pair) -> str:
    """The name of a pair in tests."""
    return f"{pair[0].parent.name}-{pair[1].stem}"
