"""Files of bindings and faults that are refused, and an action they are about."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from pnm.core.logic.domain import Vocabulary
from pnm.core.machine.plan_graph import GroundAction
from pnm.errors import InputError


def error(read: Callable[[Path], object], path: Path) -> str:
    """The message of the refusal, with FILE for the path."""
    with pytest.raises(InputError) as caught:
        read(path)
    assert caught.value.position is not None
    return str(caught.value).replace(str(path), "FILE")


MOVE = GroundAction("move", ("r1", "hall", "lab"), ("robot", "from", "to"), duration=12.0)
WORDS = Vocabulary(
    {"move": dict.fromkeys(MOVE.parameters, ()), "wait": {}},
    frozenset({"at", "battery", "near"}),
    frozenset({"r1", "lab"}),
    derived=frozenset({"near"}),
    outcomes={"move": ("there", "slipped")},
)
