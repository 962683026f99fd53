"""What is kept for a while: the first value of a key, and not too many."""

from __future__ import annotations

from pnm.core.net.block_net import Remembered


def test_the_first_value_of_a_key_stays() -> None:
    remembered = Remembered[str, list[int]]()
    first, second = [1], [1]
    assert remembered.keep("a", first) is first
    assert remembered.keep("a", second) is first
    assert remembered.get("a") is first
    assert remembered.get("b") is None


def test_when_there_are_too_many_all_are_forgotten() -> None:
    remembered = Remembered[int, int](limit=3)
    for number in range(3):
        remembered.keep(number, number)
    assert [remembered.get(number) for number in range(3)] == [0, 1, 2]
    assert remembered.keep(3, 3) == 3
    assert [remembered.get(number) for number in range(4)] == [None, None, None, 3]
    remembered.forget()
    assert remembered.get(3) is None
