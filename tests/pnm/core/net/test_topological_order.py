"""A topological order is that of graphlib, and with ranks that which always has the least of those that may be next."""

from __future__ import annotations

from graphlib import TopologicalSorter

from hypothesis import given, strategies as st

from pnm.core.net.orders import topological_order

pairs = st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), max_size=20)


def preceding_of(drawn: list[tuple[int, int]]) -> list[list[int]]:
    """Ten numbers in any order of their own, each preceded by some that come before it there."""
    found: list[list[int]] = [[] for _ in range(10)]
    for one, other in drawn:
        if one != other:
            found[max(one, other) * 7 % 10].append(min(one, other) * 7 % 10)
    return found


@given(pairs)
def test_without_ranks_it_is_the_order_of_graphlib(drawn: list[tuple[int, int]]) -> None:
    preceding = [[*dict.fromkeys(one)] for one in preceding_of(drawn)]
    assert topological_order(preceding) == [*TopologicalSorter(dict(enumerate(preceding))).static_order()]


@given(pairs, st.lists(st.integers(0, 3), min_size=10, max_size=10))
def test_with_ranks_the_least_of_those_that_may_be_next_comes_first(drawn: list[tuple[int, int]], ranks: list[int]) -> None:
    preceding, left = preceding_of(drawn), set(range(10))
    for found in topological_order(preceding, ranks.__getitem__):
        assert found == min((one for one in left if left.isdisjoint(preceding[one])), key=lambda one: (ranks[one], one))
        left.remove(found)
    assert not left


def test_what_precedes_itself_is_left_out_with_all_that_comes_after_it() -> None:
    assert topological_order([[], [2], [1, 0], [2], [0]]) == [0, 4]
