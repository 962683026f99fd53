"""Readers of knowledge, and what a knowledge base remembers of its changes."""

from __future__ import annotations

from hypothesis import given, strategies as st

from pnm.core.knowledge_base import KnowledgeBase, Readers

FLUENTS = st.tuples(st.sampled_from("pq"), st.sampled_from("ab"))
READS = st.one_of(st.none(), st.frozensets(st.one_of(FLUENTS, st.sampled_from("pq"))))


@given(st.lists(st.tuples(st.integers(0, 3), READS, st.booleans())), st.lists(FLUENTS))
def test_a_change_concerns_those_who_read_it(steps: list, changed: list) -> None:
    readers, reads = Readers[int](), dict[int, frozenset | None]()
    for reader, its, is_added in steps:
        if is_added:
            readers.add(reader, its)
            reads.setdefault(reader, its)
        else:
            readers.remove(reader)
            reads.pop(reader, None)
    news = {*changed, *(name for name, _ in changed)}
    assert readers.concerned(changed) == {reader for reader, its in reads.items() if its is None or its & news}


def test_a_knowledge_base_remembers_what_has_changed_and_when_anything_may_have() -> None:
    world = KnowledgeBase({("p", "a"): True})
    began = world.changes
    world.update({("p", "a"): True, ("p", "b"): True})
    seen = world.changes
    assert world.changed_since(began) == [("p", "b")], "what was so before has not changed"
    assert world.changed_since(seen) == []
    world.store({"x": 1})
    assert world.changed_since(seen) is None
    seen = world.changes
    world.sense(["p"])
    assert world.changed_since(seen) is None
    seen = world.changes
    world.begin_anew({}, {}, world.rules)
    assert world.changed_since(seen) is None
    seen = world.changes
    for number in range(50_000):
        world.update({("q", str(number)): True})
    assert world.changed_since(seen) is None, "it does not remember everything"
    assert world.changed_since(world.changes - 2) == [("q", "49998"), ("q", "49999")]
