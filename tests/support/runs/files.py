"""Files of bindings and faults that are refused, and an action they are about."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from pnm.core.logic.domain import FluentKind, Signature, Vocabulary
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
    {"move": {"robot": ("robot",), "from": ("place",), "to": ("room",)}, "wait": {}},
    frozenset({"at", "battery", "near", "temperature"}),
    frozenset({"r1", "lab"}),
    derived=frozenset({"near"}),
    signatures={"temperature": Signature(FluentKind.NUMBER, (("room",),))},
    types={kind: frozenset({kind, "object"}) for kind in ("robot", "place")} | {"room": frozenset({"room", "place", "object"})},
    types_of={"r1": frozenset({"robot", "object"}), "lab": frozenset({"room", "place", "object"})},
    outcomes={"move": ("there", "slipped")},
)
