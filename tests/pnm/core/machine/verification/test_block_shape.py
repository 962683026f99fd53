"""Blocks of one shape are sound or not alike, so that one of them is explored for all."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from hypothesis import given, strategies as st

from pnm.core.logic.conditions import TRUE
from pnm.core.machine.guards import After, Always, CancelAsked, ConditionFalse, ConditionTrue, Ending, Failing, Guard, PauseAsked
from pnm.core.machine.verification.explore import explore_part
from pnm.core.machine.verification.part import Part, PartStep, Unsound, shape_of

GUARDS: tuple[Guard, ...] = (
    Always(),
    ConditionTrue(TRUE),
    ConditionFalse(TRUE),
    After(1.0),
    Ending(),
    Failing(),
    CancelAsked(),
    PauseAsked(),
)
ROLES = ("failures", "records", "counters", "outputs", "finals", "early", "restarts", "resources")


@st.composite
def parts(draw: st.DrawFn) -> Part:
    """A few steps between a few places, each of which may be anything."""
    places = [f"p{number}" for number in range(draw(st.integers(2, 3)))]

    def some(most: int = 4) -> frozenset[str]:
        return draw(st.frozensets(st.sampled_from(places), max_size=min(most, len(places))))

    steps = tuple(
        PartStep(f"t{number}", draw(st.sampled_from(GUARDS)), dict.fromkeys(some(2) or places[:1], 1), dict.fromkeys(some(2), 1))
        for number in range(draw(st.integers(1, 2)))
    )
    records, supplies = some(1), (some(1),)
    finals = (some(1) if draw(st.booleans()) else frozenset()) - records
    outputs = some(2) - records - finals
    return Part(
        places=tuple(places),
        steps=steps,
        initial=dict.fromkeys(some(1), 1),
        supplies=tuple(tuple(sorted(supply)) for supply in supplies if supply),
        failures=records & some(),
        records=records,
        counters=records,
        cancels=draw(st.booleans()),
        outputs=outputs,
        finals=finals,
        early=some(1) & outputs,
        others_restart=draw(st.booleans()),
        repeats=draw(st.booleans()),
        resources=(some(1) if draw(st.booleans()) else frozenset()) - records,
    )


def doubled(part: Part, place: str) -> Part:
    """The same part with two places where there was one."""

    def both(found: Iterable[str]) -> list[str]:
        return [name for one in found for name in ((one, f"{one} too") if one == place else (one,))]

    def all_of(weights: dict[str, int]) -> dict[str, int]:
        return {name: weights[name.removesuffix(" too")] for name in both(weights)}

    return replace(
        part,
        places=tuple(both(part.places)),
        steps=tuple(PartStep(one.name, one.guard, all_of({**one.inputs}), all_of({**one.outputs})) for one in part.steps),
        initial=all_of({**part.initial}),
        supplies=tuple(tuple(both(supply)) for supply in part.supplies),
        **{role: frozenset(both(getattr(part, role))) for role in ROLES},
    )


def is_sound(part: Part) -> bool:
    try:
        return explore_part(part).states > 0
    except Unsound:
        return False


@given(parts(), st.data())
def test_one_place_stands_for_all_that_are_like_it(part: Part, data: st.DataObject) -> None:
    twin = doubled(part, data.draw(st.sampled_from(part.places)))
    if shape_of(part) == shape_of(twin):
        assert is_sound(part) == is_sound(twin)
