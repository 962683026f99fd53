"""Effects that may turn out in several ways, and the outcomes that come of them."""

from __future__ import annotations

import pytest
from hypothesis import assume, given, strategies as st

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Holds
from pnm.core.logic.effects import (
    MAX_OUTCOMES,
    Alternative,
    Effects,
    ForEach,
    OneOf,
    When,
    changes,
    constants,
    decided,
    effects_text,
    ground_effects,
    has_outcomes,
    is_fixed,
    names_written,
    outcomes,
    read,
    written,
)
from pnm.core.logic.expressions import Variable
from pnm.errors import InputError
from tests.support.logic.effects import ROOMS, STATES, UNCERTAIN, add, delete, results, rooms_state, turned_out

P, Q, R = add("p"), add("q"), add("r")


def one_of(*effects: Effects) -> OneOf:
    return OneOf(tuple(map(Alternative, effects)))


def likely(*ways: tuple[float, Effects]) -> OneOf:
    return OneOf(tuple(Alternative(effects, chance) for chance, effects in ways))


ROOM = (Variable("?x", ("room",)),)
CASES: list[tuple[str, Effects, list[tuple[str, float | None, str]]]] = [
    ("none", (P, Q), [("", None, "(and (p) (q))")]),
    ("two", (P, one_of((Q,), (R,))), [("1", None, "(and (p) (q))"), ("2", None, "(and (p) (r))")]),
    ("empty", (one_of((), (P,)),), [("1", None, "(and)"), ("2", None, "(p)")]),
    ("repeated", (one_of((), (P,), ()),), [("1", 2 / 3, "(and)"), ("2", 1 / 3, "(p)")]),
    ("all the same", (one_of((), ()),), [("1", None, "(and)")]),
    ("in another order", (one_of((P, Q), (Q, P)),), [("1", None, "(and (p) (q))")]),
    ("chances", (likely((0.25, (P,)), (0.75, ())),), [("1", 0.25, "(p)"), ("2", 0.75, "(and)")]),
    ("never", (likely((0.0, (P,)), (1.0, (Q,))),), [("2", 1.0, "(q)")]),
    (
        "product",
        (one_of((P,), ()), likely((0.1, (Q,)), (0.9, ()))),
        [("1+1", 0.05, "(and (p) (q))"), ("1+2", 0.45, "(p)"), ("2+1", 0.05, "(q)"), ("2+2", 0.45, "(and)")],
    ),
    ("nested", (one_of((one_of((P,), (Q,)),), (R,)),), [("1+1", 0.25, "(p)"), ("1+2", 0.25, "(q)"), ("2", 0.5, "(r)")]),
    ("when", (When(Holds(("p",)), (one_of((Q,), ()),)),), [("1", None, "(when (p) (q))"), ("2", None, "(and)")]),
    (
        "forall",
        (ForEach(ROOM, (one_of((add("at", "?x"),), ()),)),),
        [("1+1", None, "(and (at hall) (at kitchen))"), ("1+2", None, "(at hall)"), ("2+1", None, "(at kitchen)"), ("2+2", None, "(and)")],
    ),
    ("delete and add", (P, one_of((), (delete("p"),))), [("1", None, "(p)"), ("2", None, "(and (p) (not (p)))")]),
    (
        "names",
        (OneOf((Alternative((), name="missed"), Alternative((), name="slipped"), Alternative((P,)))), one_of((Q,), (R,))),
        [
            *[("missed+1", None, "(q)"), ("missed+2", None, "(r)"), ("slipped+1", None, "(q)"), ("slipped+2", None, "(r)")],
            *[("3+1", None, "(and (p) (q))"), ("3+2", None, "(and (p) (r))")],
        ],
    ),
]


@pytest.mark.parametrize(("effects", "expected"), [case[1:] for case in CASES], ids=[case[0] for case in CASES])
def test_every_way_is_an_outcome(effects: Effects, expected: list[tuple[str, float | None, str]]) -> None:
    found = outcomes(effects, rooms_state())
    assert [(way.name, effects_text(way.effects)) for way in found] == [(name, text) for name, _, text in expected]
    assert [way.chance for way in found] == [None if chance is None else pytest.approx(chance) for _, chance, _ in expected]


@given(st.lists(UNCERTAIN, max_size=3).map(tuple), STATES)
def test_outcomes_are_the_ways_of_choosing(effects: Effects, state: KnowledgeBase) -> None:
    effects = ground_effects(effects, {"?x": "hall"})
    try:
        found = outcomes(effects, state)
    except InputError:
        assume(False)
        return
    assert not any(has_outcomes(way.effects) for way in found)
    even = 1.0 / len(found)
    drawn = [(way.effects, even if way.chance is None else way.chance) for way in found]
    assert sum(chance for _, chance in drawn) == pytest.approx(1.0)
    mine = {way: sum(chance for other, chance in drawn if other == way) for way, _ in drawn}
    assert results(mine, state) == pytest.approx(results(turned_out(effects, state, {}), state))
    assert frozenset().union(*(written(way, state) for way, _ in drawn)) <= written(effects, state)
    assert frozenset().union(*(names_written(way) for way, _ in drawn)) <= names_written(effects)
    assert frozenset().union(*(read(way, state) for way, _ in drawn)) <= read(effects, state)


@pytest.mark.parametrize(("several", "is_refused"), [(6, False), (7, True)])
def test_more_than_64_outcomes_are_refused(several: int, is_refused: bool) -> None:
    effects = ForEach((Variable("?x", ("cup",)),), (one_of((add("full", "?x"),), ()),))
    state = KnowledgeBase(objects={"cup": tuple(f"c{number}" for number in range(several))})
    if is_refused:
        with pytest.raises(InputError, match=f"in more than {MAX_OUTCOMES} ways; expected {MAX_OUTCOMES} at most"):
            outcomes((effects,), state)
    else:
        assert len(outcomes((effects,), state)) == MAX_OUTCOMES


def test_what_nobody_has_chosen_does_not_happen() -> None:
    with pytest.raises(AssertionError, match="one of the outcomes happens, and none was chosen"):
        changes((one_of((P,), ()),), rooms_state())


def test_early_conditions_are_decided_in_every_alternative() -> None:
    early = When(Holds(("q",)), (P,), early=True)
    assert decided((one_of((early,), (R,)),), rooms_state({("q",): True})) == (one_of((P,), (R,)),)
    assert decided((one_of((early,), (R,)),), rooms_state()) == (one_of((), (R,)),)


def test_outcomes_are_nothing_that_is_always_so() -> None:
    assert not is_fixed(one_of((P,)))
    assert constants((one_of((P,)),)) is None


def test_variables_are_replaced_in_every_alternative() -> None:
    assert ground_effects((one_of((add("at", "?x"),), ()),), {"?x": ROOMS[0]}) == (one_of((add("at", ROOMS[0]),), ()),)


@pytest.mark.parametrize(("effect", "text"), [(one_of((P,), ()), "(oneof (p) (and))"), (likely((0.5, (P,))), "(probabilistic 0.5 (p))")])
def test_alternatives_are_written_as_in_pddl(effect: OneOf, text: str) -> None:
    assert str(effect) == text
