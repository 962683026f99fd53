"""Blocks of one shape share what is known of their transitions; names are made only when they are asked for; not too much is kept."""

from __future__ import annotations

import pytest

from pnm.core.execution.machine_index import index_of
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.machine.generate import generate
from pnm.core.machine.verification.verify import verify
from pnm.core.net.block_net import Remembered
from tests.support.benchmarks.workloads import in_a_row, inline
from tests.support.runs.commands import RUN


def test_what_is_known_of_a_shape_does_not_grow_with_its_calls() -> None:
    machine = generate(in_a_row(100))
    inline(Run(machine, Layered(KnowledgeBase()), id=RUN))
    shapes = {id(site.shape): site.shape for site in index_of(machine).sites}
    made = sum(len(shape.firings) for shape in shapes.values())
    assert len(shapes) == 3, "of all calls, of the frame before them, and of the frame after them"
    assert made < 40


def test_a_machine_is_proved_and_executed_without_its_names() -> None:
    machine = generate(in_a_row(3))
    verify(machine)
    inline(Run(machine, Layered(KnowledgeBase()), id=RUN))
    assert vars(machine).keys().isdisjoint(("net", "rules", "initial"))
    assert machine.rules is machine.rules
    with pytest.raises(AttributeError, match="a machine has no 'ruels'"):
        assert machine.ruels  # type: ignore[attr-defined]


def test_the_first_value_of_a_key_stays_until_there_are_too_many() -> None:
    remembered = Remembered[str, list[int]](limit=2)
    first = [1]
    assert remembered.keep("a", first) is first
    assert remembered.keep("a", [1]) is remembered.get("a") is first
    remembered.keep("b", [2])
    assert remembered.keep("c", [3]) == [3]
    assert [*map(remembered.get, "abc")] == [None, None, [3]]
