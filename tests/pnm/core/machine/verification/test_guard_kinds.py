"""Every kind of guard has all of its traits, and every part of the program knows it."""

from typing import get_args

import pytest

from pnm.core.execution.guards import OPENS
from pnm.core.machine.guards import (
    Ends,
    Guard,
    GuardKind,
    OfCall,
    Withheld,
)
from pnm.core.machine.requests import OutcomeKind

KINDS: tuple[type[GuardKind], ...] = get_args(Guard)
TRAITS = list(GuardKind.__annotations__)
SAMPLES: list[Guard] = [
    *(kind(7) for kind in KINDS if issubclass(kind, OfCall) and kind not in (Ends, Withheld)),  # type: ignore[call-arg, misc]
    Ends(7, frozenset({OutcomeKind.LOST})),
    Withheld(7, 2.0, None),
]


@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_says_what_opens_it_and_what_it_reads(kind: type[GuardKind]) -> None:
    missing = [name for name in TRAITS if not hasattr(kind, name)]
    assert not missing, f"{kind.__name__} does not say {missing}"
    assert kind in OPENS, f"pnm.core.execution.guards.OPENS does not say when {kind.__name__} opens"


def test_what_opens_is_no_kind_that_there_is_not() -> None:
    assert set(OPENS) == set(KINDS)


@pytest.mark.parametrize("guard", SAMPLES)
def test_about_another_call_a_guard_is_otherwise_the_same(guard: Guard) -> None:
    other = guard.about(3)
    assert isinstance(other, OfCall)
    assert other.call == 3
    assert other.about(7) == guard
    assert other.proved == guard.proved
