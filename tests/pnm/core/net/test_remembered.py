"""What is kept for a while: the first value of a key, and not too many."""

from __future__ import annotations

from pnm.core.net.block_net import Remembered


def test_the_first_value_of_a_key_stays_until_there_are_too_many() -> None:
    remembered = Remembered[str, list[int]](limit=2)
    first = [1]
    assert remembered.keep("a", first) is first
    assert remembered.keep("a", [1]) is remembered.get("a") is first
    remembered.keep("b", [2])
    assert remembered.keep("c", [3]) == [3]
    assert [*map(remembered.get, "abc")] == [None, None, [3]]
