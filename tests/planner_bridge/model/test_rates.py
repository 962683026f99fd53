"""Rates: files that add up, and what is read from them about calls."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from random import Random

import pytest
from hypothesis import given, strategies as st

from planner_bridge.model.rates import ENOUGH, MOST_CALLS, NO_RATES, STEP, Basis, Call, Counts, End, Rates, as_may_be, read_rates
from pnm.core.logic.effects import Alternative
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.errors import InputError

words = st.sampled_from(["r1", "hall", "on", "1e3", "a b", 'say "hi", (x)', "tür", "back\\slash"])
calls = st.builds(Call, st.sampled_from(["/r1/move", "true", "say: it"]), words, st.lists(words, max_size=3).map(tuple))
attempts = st.builds(Counts.of, st.sampled_from(End), st.none() | st.floats(0.0, 1e6), st.sampled_from(["", "1", "no", "held+2"]))
journals = st.lists(st.tuples(calls, attempts), max_size=12)


def rates_of(*kept: list[tuple[Call, Counts]], first: int = 0) -> Rates:
    rates = NO_RATES
    for number, one in enumerate(kept, first):
        rates = rates.grown(f"journal {number}", len(one), one)
    return rates


@given(st.lists(journals, max_size=3))
def test_what_is_written_is_read(tmp_path_factory: pytest.TempPathFactory, kept: list[list[tuple[Call, Counts]]]) -> None:
    file, rates = tmp_path_factory.mktemp("rates") / "rates.yaml", rates_of(*kept)
    file.write_text(rates.text(), encoding="utf-8")
    assert read_rates(file) == rates


@given(st.lists(journals, max_size=3), st.lists(journals, max_size=3))
def test_files_of_different_journals_add_up(one: list[list[tuple[Call, Counts]]], other: list[list[tuple[Call, Counts]]]) -> None:
    mine, others, both = rates_of(*one), rates_of(*other, first=len(one)), rates_of(*one, *other)
    assert mine.merge(others) == others.merge(mine) == both
    assert both.merge(mine) == mine.merge(both) == both.merge(both) == both, "what is counted is counted once"


def test_a_journal_that_both_have_counted_is_not_counted_twice() -> None:
    mine, others = (Rates({}, {"same": 3, own: 1}) for own in ("mine", "other"))
    with pytest.raises(InputError, match="both have counted the journal same"):
        mine.merge(others)
    assert Rates({}, {"same": 3}).merge(Rates({}, {"same": 5})).journals == {"same": 5}, "the longer part has the shorter in it"


@pytest.mark.parametrize("parts", [1, 2, 5])
def test_an_action_with_too_many_calls_is_counted_by_first_arguments_in_whichever_order_they_come(parts: int) -> None:
    rng, one = Random(parts), Counts.of(End.SUCCEEDED, 1.0)
    each = [(Call("s", "move", (f"r{number % 3}", f"a{number}")), one) for number in range(MOST_CALLS + parts)]
    rng.shuffle(each)
    found = NO_RATES
    for part in range(parts):
        found = found.merge(NO_RATES.grown(str(part), 1, each[part::parts]))
    assert {call.arguments for call in found.calls} == {("r0",), ("r1",), ("r2",)}
    assert found.calls == NO_RATES.grown("", 1, each).calls
    assert found.chance(Call("s", "move", ("r1", "a1"))).rests.group == "move(r1, …)"


def test_the_nearest_group_with_enough_attempts_tells_the_chance() -> None:
    good, bad = Counts.of(End.SUCCEEDED, 4.0), Counts.of(End.ABORTED, 1.0)
    easy, hard, rare = (Call("/move", "move", ("r1", place)) for place in ("hall", "closet", "attic"))
    rates = NO_RATES.grown("j", 1, [(easy, good)] * 180 + [(hard, bad)] * 60 + [(rare, bad)] * (ENOUGH - 1))
    assert rates.chance(easy).success > 0.95
    assert rates.chance(hard).success < 0.2
    assert str(rates.chance(hard).rests) == "learned from 60 of move(r1, closet)"
    assert rates.chance(rare).success == rates.chance(Call("/move", "move")).success
    assert rates.chance(Call("/move", "jump")).rests.basis is Basis.ASSUMED


def test_chances_of_outcomes_are_declared_then_learned_then_even() -> None:
    ways, told = ([Alternative((), chance, name) for name in ("held", "fell")] for chance in (None, 0.5))
    held, fell = (Counts.of(End.SUCCEEDED, 1.0, name) for name in ("held", "fell"))
    cup, mug = (Call("/pick", "pick", (what,)) for what in ("cup", "mug"))
    few, many = (NO_RATES.grown("j", 1, [(cup, held)] * 80 + [(mug, fell)] * number) for number in (ENOUGH - 1, ENOUGH))
    assert [rates.outcomes(mug, ways).of("held") for rates in (NO_RATES, few, many)] == [
        0.5,
        pytest.approx(80.5 / 100),
        pytest.approx(ENOUGH * 80.5 / 101 / (2 * ENOUGH)),
    ]
    assert [str(rates.outcomes(mug, one).rests) for rates, one in ((NO_RATES, ways), (few, told), (many, ways))] == [
        "assumed",
        "declared",
        "learned from 20 of pick(mug)",
    ]
    assert few.outcomes(mug, told).of("held") == 0.5
    assert few.outcomes(mug, [*ways, Alternative((), None, "new")]).of("new") == pytest.approx(1 / 300)


def test_a_call_that_is_called_off_says_nothing_about_chances() -> None:
    call, done, off = Call("s", "move"), Counts.of(End.SUCCEEDED, 1.0), Counts.of(End.CANCELED, 0.5)
    with_them, without = (NO_RATES.grown("j", 1, [(call, done)] * 30 + [(call, off)] * many) for many in (50, 0))
    assert with_them.chance(call) == without.chance(call)
    assert with_them.calls[call].ends[End.CANCELED] == 50


def test_seconds_are_learned_then_declared_then_assumed() -> None:
    call = Call("s", "move", ("hall",))
    rates = NO_RATES.grown("j", 1, [(call, Counts.of(End.SUCCEEDED, seconds)) for seconds in (1.0, 2.0, 3.0, 4.0, 10.0)])
    learned = rates.seconds(call, 99.0)
    assert (learned.mean, learned.rests.basis, learned.rests.n) == (4.0, Basis.LEARNED, 5)
    assert learned.quantile(0.5) == pytest.approx(3.0, rel=0.01)
    assert [rates.seconds(Call("s", "jump"), declared).mean for declared in (7.0, None)] == [7.0, 1.0]
    assert rates.seconds(call, succeeded=False) == rates.seconds(call), "nothing else is known of those that fail"


def test_few_measured_times_move_the_expected_seconds_of_a_call_a_little() -> None:
    far, near = (Call("s", "move", ("hall", place)) for place in ("far", "near"))
    rates = NO_RATES.grown("j", 1, [(far, Counts.of(End.SUCCEEDED, 16.0)), *[(near, Counts.of(End.SUCCEEDED, 2.0))] * 13])
    assert [round(rates.mean(Call("s", "move", ("hall", place))), 1) for place in ("far", "near", "elsewhere")] == [7.3, 2.1, 3.0]
    assert rates.mean(Call("s", "jump"), 7.0) == 7.0
    assert rates.mean(far, succeeded=False) == rates.mean(far)


@given(st.lists(st.floats(1.0, 1e5), min_size=5, max_size=60), st.floats(0.01, 1.0))
def test_quantiles_are_within_two_percent_of_what_was_measured_and_means_are_exact(measured: list[float], share: float) -> None:
    call = Call("s", "move")
    rates = NO_RATES.grown("j", 1, [(call, Counts.of(End.SUCCEEDED, seconds)) for seconds in measured])
    left, exact = share * len(measured), sorted(measured)
    seconds = rates.seconds(call)
    near = next(time for number, time in enumerate(exact, 1) if number >= left - 1e-9)
    assert seconds.quantile(share) == pytest.approx(near, rel=STEP - 1.0 + 1e-3)
    assert seconds.mean == pytest.approx(sum(measured) / len(measured), abs=0.0005 + 1e-9 * max(measured))
    assert sum(time * count for time, count in seconds.buckets) == pytest.approx(seconds.mean * len(measured))


def test_intervals_hold_the_true_chance_as_often_as_they_say() -> None:
    rng, call, held, tried = Random(7), Call("s", "move"), 0, 1000
    for _ in range(tried):
        true = rng.uniform(0.3, 0.99)
        ends = [Counts.of(End.SUCCEEDED if rng.random() < true else End.ABORTED, None) for _ in range(rng.choice((20, 50, 100)))]
        low, high = NO_RATES.grown("j", 1, [(call, one) for one in ends]).chance(call).interval(0.95)
        held += low <= true <= high
    assert 0.935 <= held / tried <= 0.975


@pytest.mark.parametrize(
    "draw",
    [
        lambda rng: rng.lognormvariate(2.0, 0.3),
        lambda rng: rng.gauss(20.0, 2.0),
        lambda rng: rng.expovariate(0.1),
        lambda rng: rng.uniform(1.0, 9.0),
        lambda rng: rng.choice((5.0, 12.0)) * rng.lognormvariate(0.0, 0.05),
    ],
    ids=["lognormal", "normal", "exponential", "uniform", "two ways"],
)
@pytest.mark.parametrize("n", [10, 50])
def test_limits_that_fit_cut_off_one_of_a_thousand_at_most(draw: Callable[[Random], float], n: int) -> None:
    rng, call, false, limits = Random(n), Call("s", "move"), 0, 200
    for _ in range(limits):
        limit = NO_RATES.grown("j", 1, [(call, Counts.of(End.SUCCEEDED, draw(rng))) for _ in range(n)]).limit(call)
        assert limit is not None
        false += sum(draw(rng) > limit for _ in range(100))
    assert false / (limits * 100) <= 0.001
    few, quick = ([(call, Counts.of(End.SUCCEEDED, 0.1))] * many for many in (9, 10))
    assert [NO_RATES.grown("j", 1, attempts).limit(call) for attempts in (few, quick)] == [None, 1.0]


@pytest.mark.parametrize(
    ("text", "where", "message"),
    [
        ("journal: {}", ":1:1", "unknown key 'journal'; did you mean 'journals'"),
        ("servers:\n  s:\n    move: {}", ":3:5", "expected a call such as move\\(robot, hall\\), found 'move'"),
        ("servers:\n  s:\n    move(a): {ends: {succeded: 1}}", ":3:22", "unknown key 'succeded'; did you mean 'succeeded'"),
        ("servers:\n  s:\n    move(a): {ends: {lost: -1}}", ":3:28", "expected a number of at least 0 under 'lost', found -1"),
        ("servers:\n  s:\n    move(a): {outcomes: {held: no}}", ":3:32", "expected a number of at least 0 under 'held', found 'no'"),
        ("servers:\n  s:\n    move(a): {took: 9 = 2*long}", ":3:21", "expected a sum of seconds such as 9.1 = 2\\*3.05 1\\*3, found"),
        ("servers:\n  s:\n    move(a): {took: 1 = 1*nan}", ":3:21", "expected a sum of seconds"),
        ("servers:\n  s:\n    move(a): {took: .inf = 1*1}", ":3:21", "expected a sum of seconds"),
        ("servers:\n  s:\n    move(a): {took: 1 = -1*1}", ":3:21", "expected a sum of seconds"),
        ("servers:\n  s:\n    move(a): {took: 4.0}", ":3:21", "expected a sum of seconds"),
        ("servers:\n  s:\n    move(a): {took: []}", ":3:21", "expected a sum of seconds"),
        ("journals: {a: x}", ":1:15", "expected a number of at least 0 under 'a', found 'x'"),
    ],
)
def test_what_is_wrong_is_said_with_its_position(tmp_path: Path, text: str, where: str, message: str) -> None:
    file = tmp_path / "rates.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=message) as error:
        read_rates(file)
    assert str(error.value.position) == f"{file}{where}"


def test_calls_are_named_as_they_are_sent() -> None:
    action = GroundAction("move", ("r1", "hall"), ("robot", "to"))
    assert Call.of(action, Bindings({"move": Binding(server="/{robot}/go")})) == Call("/r1/go", "move", ("r1", "hall"))


@given(
    st.lists(st.sampled_from([0.0, 1e-300, 1e-9, 1e-3, 0.3, 1.0]), min_size=1, max_size=4).filter(any),
    st.sampled_from([0.0, 1e-3, 2.0, 50.0]),
)
def test_chances_that_may_be_are_chances_and_their_mean_is_as_it_is(weights: list[float], total: float) -> None:
    chances = [weight / sum(weights) for weight in weights]
    worlds = as_may_be(chances, total, Random(0), 200)
    for world in worlds:
        assert sum(world) == pytest.approx(1.0)
        assert all(0.0 <= share <= 1.0 and (chance or not share) for share, chance in zip(world, chances, strict=True))
    for chance, shares in zip(chances, zip(*worlds, strict=True), strict=True):
        if chance * total > 1.0:
            assert sum(shares) / len(worlds) == pytest.approx(chance, abs=0.01)
