"""What is known: batches that succeed or fail as one, layers, variables, what sensors report, and who reads what has changed."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pytest
from hypothesis import given, strategies as st

from pnm.core.knowledge_base import KnowledgeBase, Layered, Readers
from pnm.core.logic.computed_values import MISSING
from pnm.core.logic.conditions import All, Exists, Holds, Not
from pnm.core.logic.expressions import UNDEFINED, UNKNOWN, Fluent, Unknown, Value, Variable
from pnm.core.logic.rules import NO_RULES, DerivationRule, Rules
from pnm.errors import InputError
from pnm.journal.records import KnowledgeDelta, base_of, change, follow
from tests.support.runs.timing import functions_called

Facts = Mapping[Fluent, Value | Unknown]
P, Q, N = ("p",), ("q", "a"), ("n",)
VALUES = st.sampled_from((True, False, UNKNOWN, 0.0, 1.0, "a"))
FACTS = st.dictionaries(st.sampled_from((P, Q, N)), VALUES)


def heard(knowledge: KnowledgeBase) -> list[Facts]:
    """Return the list that fills with every batch of changes from now on."""
    batches: list[Facts] = []
    knowledge.listen(batches.append)
    return batches


# --- batches and events ---


@pytest.mark.parametrize("malformed", ["p", (), ("p", 1), 7, None])
def test_a_batch_with_a_malformed_fluent_changes_nothing(malformed: object) -> None:
    knowledge = KnowledgeBase({P: True})
    batches = heard(knowledge)
    with pytest.raises(InputError) as caught:
        knowledge.update({Q: True, malformed: True, P: False})  # type: ignore[dict-item]
    assert str(caught.value) == f"not a fluent: {malformed!r}; expected a tuple of names such as ('at', 'r1', 'kitchen')"
    assert (knowledge.facts(), batches) == ({P: True}, [])


@given(FACTS, FACTS)
def test_listeners_hear_of_real_changes_only(first: Facts, then: Facts) -> None:
    knowledge = KnowledgeBase(first)
    batches = heard(knowledge)
    before = {fluent: knowledge.value(fluent) for fluent in then}
    real = knowledge.update(then)
    assert batches == ([real] if real else [])
    assert knowledge.update(then) == {}
    for fluent, value in then.items():
        assert (fluent in real) is (evident(before[fluent]) != evident(value))
        assert evident(knowledge.value(fluent)) == evident(value)


def evident(value: Value | Unknown | None) -> tuple[type, Value | Unknown]:
    """The value and its kind, because True == 1.0; nothing recorded reads as false."""
    return (bool, False) if value is None else (type(value), value)


def test_what_is_false_is_not_listed() -> None:
    knowledge = KnowledgeBase({P: False, N: UNKNOWN})
    assert (knowledge.value(P), knowledge.value(Q), knowledge.facts()) == (False, None, {N: UNKNOWN})


def test_a_listener_may_stop_while_it_listens_and_hears_nothing_more() -> None:
    knowledge, first, stops = KnowledgeBase(), list[Facts](), list[Callable[[], None]]()
    knowledge.listen(first.append)
    stops.append(knowledge.listen(lambda _: stops.pop()()))  # which a second change would fail at
    after = heard(knowledge)
    knowledge.update({P: True})
    knowledge.update({Q: True})
    assert first == after == [{P: True}, {Q: True}]


def test_what_was_given_and_what_is_returned_are_copies() -> None:
    first: dict[Fluent, Value | Unknown] = {P: True}
    knowledge = KnowledgeBase(first)
    first[P] = False
    knowledge.facts().clear()
    knowledge.variables()["x"] = 1
    knowledge.objects_by_type()["room"] = ("hall",)
    assert knowledge.facts() == {P: True}
    assert (knowledge.variable("x"), knowledge.objects(("room",))) == (MISSING, ())


# --- complete reports ---


def test_of_what_a_report_omits_a_number_is_no_longer_known_and_an_object_is_gone() -> None:
    knowledge = KnowledgeBase({("battery", "r1"): 80.0, ("battery", "r2"): 0.0, ("place", "r1"): "hall"})
    changed = knowledge.replace({"battery", "place"}, {("battery", "r1"): 79.0})
    assert changed == {("battery", "r1"): 79.0, ("battery", "r2"): UNKNOWN, ("place", "r1"): UNDEFINED}


@given(FACTS, FACTS, FACTS, FACTS, st.frozensets(st.sampled_from(("p", "q", "n"))))
def test_after_a_report_its_facts_are_all_that_is_so(
    first: Facts, before: Facts, between: Facts, report: Facts, names: frozenset[str]
) -> None:
    knowledge = KnowledgeBase(first)
    knowledge.replace(names, before)
    knowledge.update(between)
    first = knowledge.facts()
    knowledge.replace(iter(names), report)
    about = {fluent for fluent, value in knowledge.facts().items() if fluent[0] in names and value is True}
    assert about == {fluent for fluent, value in report.items() if fluent[0] in names and value is True}
    others = {fluent: value for fluent, value in knowledge.facts().items() if fluent[0] not in names and fluent not in report}
    assert others == {fluent: value for fluent, value in KnowledgeBase(first).facts().items() if fluent in others}


def test_a_report_costs_no_more_for_the_world_or_for_what_was_so_before() -> None:
    def called_by_reports(rooms: int) -> int:
        knowledge = KnowledgeBase({("clean", f"room {number}"): True for number in range(rooms)})
        for number in range(rooms):
            knowledge.replace({"at"}, {("at", f"room {number}"): True})
        with functions_called() as called:
            knowledge.replace({"at"}, {("at", "dock"): True})
        return called()

    assert called_by_reports(400) < 2 * called_by_reports(4)


def test_what_is_reported_stays_in_another_world_and_is_not_what_that_begins_with() -> None:
    knowledge = KnowledgeBase({("at", "hall"): True, ("at", "dock"): False, ("free", "dock"): True, ("n",): 3.0}, sensed={"at": 0.0})
    heard: list[Facts] = []
    knowledge.listen(lambda changes: heard.append(dict(changes)))
    knowledge.begin_anew({("at", "dock"): True, ("at", "lab"): True, ("n",): 4.0}, {"place": ("dock",)}, NO_RULES)
    assert knowledge.facts() == {("at", "hall"): True, ("n",): 4.0}
    assert heard == [{("free", "dock"): False, ("n",): 4.0}]


# --- objects, layers, variables, sensing ---


def test_objects_of_several_types_come_once_and_in_order() -> None:
    knowledge = KnowledgeBase(objects={"room": ("hall", "lab"), "place": ("dock", "hall")})
    assert knowledge.objects(("room",)) == ("hall", "lab")
    assert knowledge.objects(("place", "room", "nothing")) == ("dock", "hall", "lab")
    assert knowledge.objects(()) == ()


def test_a_run_reads_facts_and_objects_of_the_world_and_variables_of_its_own_first() -> None:
    world = KnowledgeBase({P: True, N: 1.0}, objects={"room": ("hall",)}, variables={"pose": 1, "other": 0})
    own = Layered(world, KnowledgeBase({P: False}, objects={"room": ("lab",)}, variables={"pose": None}))
    assert (own.value(P), own.value(N), own.value(("absent",)), own.objects(("room",))) == (True, 1.0, None, ("hall",))
    assert [own.variable(name) for name in ("pose", "other", "absent")] == [None, 0, MISSING], "None is not missing"
    own.local.store({"pose": 2})
    assert (own.variable("pose"), Layered(world).variable("pose"), own.local.variables()) == (2, 1, {"pose": 2})


def test_fluents_are_sensed_by_name_and_late_by_the_slowest() -> None:
    knowledge = KnowledgeBase(sensed={"open": 0.5})
    knowledge.sense(["at", "battery"], lag=2.0)
    knowledge.sense({"battery"})
    assert [knowledge.is_sensed((name, "r1")) for name in ("at", "open", "battery", "holding")] == [True, True, True, False]
    assert knowledge.lag({"open", "at", "holding"}) == 2.0
    assert knowledge.lag({"battery"}) == knowledge.lag({"holding"}) == knowledge.lag(()) == 0.0


X = Variable("?x", ("room",))
LIT = DerivationRule("lit", (X,), All((Holds(("lamp", "?x")), Holds(("power",)))))
DARK = DerivationRule("dark", (), Exists((X,), Not(Holds(("lit", "?x")))))


def lit_rooms(facts: Facts | None = None) -> KnowledgeBase:
    return KnowledgeBase(facts, objects={"room": ("hall", "lab")}, rules=Rules((LIT, DARK)))


def test_why_something_is_unknown_is_told_until_it_is_known_or_unknown_for_no_such_reason() -> None:
    world = KnowledgeBase({P: True, Q: UNKNOWN})
    told: list[object] = []
    world.listen(lambda changes: told.append((changes, world.told_why)))
    world.forget([P, Q], "silent")
    world.forget([P, Q], "silent")
    world.forget([Q], "closed")
    assert told == [({P: UNKNOWN}, {"silent": (P, Q)}), ({}, {"closed": (Q,)})]
    assert (world.because(P), world.because(Q)) == ("(silent)", "(closed)")
    world.update({P: False})
    world.update({P: UNKNOWN})
    assert (world.because(P), world.why_unknown()) == ("", {Q: "closed"})
    world.store({"x": 1})
    assert told[-1] == ({}, {})


@given(st.lists(st.tuples(FACTS, st.sampled_from(("", "silent", "closed")))))
def test_a_base_that_follows_another_knows_what_it_knows(reports: list[tuple[Facts, str]]) -> None:
    world, (first, *others) = KnowledgeBase({P: True}), [*reports, ({}, "")]
    (world.forget(first[0], first[1]) if first[1] else world.update(first[0]))
    deltas: list[KnowledgeDelta] = []
    copy = base_of(follow(0, world, deltas.append))
    for facts, why in others:
        world.forget(facts, why) if why else world.update(facts)
    for delta in deltas:
        change(copy, delta)
    assert (copy.facts(), copy.why_unknown()) == (world.facts(), world.why_unknown())


# --- derived facts ---


def test_derived_facts_follow_from_what_is_recorded_and_are_not_listed() -> None:
    knowledge = lit_rooms({("lamp", "hall"): True})
    batches = heard(knowledge)
    assert (knowledge.value(("lit", "hall")), knowledge.value(("dark",))) == (False, True)
    knowledge.update({("power",): True})
    assert (knowledge.value(("lit", "hall")), knowledge.value(("dark",))) == (True, True)
    knowledge.update({("lamp", "lab"): UNKNOWN})
    assert knowledge.value(("dark",)) is UNKNOWN
    assert Layered(knowledge).value(("dark",)) is UNKNOWN
    assert Layered(knowledge).because(("lit", "hall")) == "because of (lamp hall), (power)"
    assert knowledge.facts() == {("lamp", "hall"): True, ("power",): True, ("lamp", "lab"): UNKNOWN}
    assert batches == [{("power",): True}, {("lamp", "lab"): UNKNOWN}]


def test_a_listener_sees_the_derived_facts_as_they_are_after_the_change() -> None:
    knowledge = lit_rooms({("lamp", "hall"): True})
    seen = [knowledge.value(("lit", "hall"))]
    knowledge.listen(lambda _: seen.append(knowledge.value(("lit", "hall"))))
    knowledge.update({("power",): True})
    knowledge.update({("power",): False})
    assert seen == [False, True, False]


def test_nobody_writes_a_derived_fact() -> None:
    knowledge = lit_rooms({("power",): True})
    for wrong in ({("power",): False, ("lit", "hall"): True}, {("dark",): False}):
        with pytest.raises(InputError, match=r"\((lit hall|dark)\) follows from rules; it is neither set nor reported"):
            knowledge.update(wrong)
    assert knowledge.facts() == {("power",): True}
    with pytest.raises(InputError, match="follows from rules"):
        lit_rooms({("dark",): True})


def test_reports_about_derived_facts_are_left_out() -> None:
    knowledge = lit_rooms({("power",): True})
    report: Facts = {("lit", "lab"): True, ("lamp", "hall"): True}
    assert knowledge.replace(("lit", "lamp", "dark"), report) == {("lamp", "hall"): True}
    assert (knowledge.value(("lit", "lab")), knowledge.value(("dark",))) == (False, True)
    with pytest.raises(InputError, match="not a fluent"):
        knowledge.replace({"p"}, {(): True})


def test_a_derived_fact_is_sensed_if_all_below_it_is_and_as_late_as_that() -> None:
    knowledge = lit_rooms()
    knowledge.sense(("lit", "dark", "lamp"), lag=2.0)
    assert not knowledge.is_sensed(("dark",))
    knowledge.sense(("power",), lag=3.0)
    assert [knowledge.is_sensed(one) for one in (("dark",), ("lit", "lab"), ("lamp", "lab"), ("at", "r1"))] == [True, True, True, False]
    assert (knowledge.lag({"dark"}), knowledge.lag({"lamp"}), knowledge.longest_lag) == (3.0, 2.0, 3.0)


# --- who reads what has changed ---


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
