"""What may be the last to write before a reader, and what may come between: as it follows from all that comes before what."""

from __future__ import annotations

from functools import cache
from itertools import combinations
from typing import NamedTuple

from hypothesis import given, strategies as st

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Domain, Problem
from planner_bridge.ordering.causal_links import CausalLinks
from planner_bridge.ordering.partial_order import NEAR, PartialOrder, Writers, direct_orderings
from planner_bridge.ordering.plan_to_graph import _Need, _Trace, wrong_writer
from pnm.core.logic.effects import TimedChange
from pnm.core.logic.expressions import Fluent
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from tests.support.pddl.random_problems import Draw

FLUENT: Fluent = ("p",)


class Drawn(NamedTuple):
    """An order, and everything that comes before each of its happenings."""

    order: PartialOrder
    before: dict[int, frozenset[int]]
    graph: PlanGraph


@st.composite
def orders(draw: Draw) -> Drawn:
    """Draw calls with any orderings, few or many, and changes of facts by themselves."""
    moments = st.integers(0, 4).map(float)
    planned = draw(st.lists(moments, min_size=1, max_size=6))
    # some begin at their planned time and no earlier: after the changes that are due by then, in every order
    calls = tuple(
        ActionCall(index, GroundAction("a", duration=1.0), time, release=time if draw(st.booleans()) else 0.0)
        for index, time in enumerate(planned)
    )
    events = [PlanEvent(call.index, moment) for call in calls for moment in Moment]

    def time(event: PlanEvent) -> float:
        return planned[event.call] + (event.moment is Moment.END)

    pairs = [pair for pair in combinations(sorted(events, key=time), 2) if pair[0].call != pair[1].call]
    chosen = draw(st.lists(st.sampled_from(pairs), max_size=12, unique=True)) if pairs else []
    timed = tuple(TimedChange(time, {FLUENT: True}) for time in sorted(draw(st.sets(moments, max_size=2))))
    graph = PlanGraph(calls, tuple(Ordering(*pair) for pair in chosen))
    order = PartialOrder(calls, graph.orderings, timed)
    numbers = {happening: number for number, happening in enumerate(order.happenings) if isinstance(happening, PlanEvent)}
    changes = [number for number, happening in enumerate(order.happenings) if isinstance(happening, TimedChange)]
    direct: dict[int, set[int]] = {number: {0} for number in range(1, len(order.happenings))}
    for first, second in direct_orderings(calls, graph.orderings, timed):
        one, other = (numbers[key] if isinstance(key, PlanEvent) else changes[key] for key in (first, second))
        direct[other].add(one)
    last = len(order.happenings) - 1
    direct[last] |= {*numbers.values(), *(number for number in changes if timed[changes.index(number)].time <= NEAR)}

    @cache
    def closed(number: int) -> frozenset[int]:
        return frozenset().union(direct.get(number, ()), *map(closed, direct.get(number, ())))

    return Drawn(order, {number: closed(number) for number in range(last + 1)}, graph)


@given(orders())
def test_what_comes_before_what_is_all_that_orderings_lead_to(drawn: Drawn) -> None:
    for first in drawn.before:
        for second, before in drawn.before.items():
            assert drawn.order.comes_before(first, second) is (first == second or first in before)


@given(orders(), st.data())
def test_what_may_come_between_is_neither_before_nor_after(drawn: Drawn, data: st.DataObject) -> None:
    writers = Writers[None](drawn.order, None)
    for number in sorted(data.draw(st.sets(st.sampled_from(range(1, len(drawn.before) - 1))))):
        writers.add(number, None)
    call = data.draw(st.sampled_from(drawn.graph.calls))
    first, last = (drawn.order.number(call.index, moment) for moment in Moment)
    outside = {first, last, *drawn.before[first], *(number for number, before in drawn.before.items() if last in before)}
    assert sorted(writers.between(first, last)) == [number for number in writers.numbers if number not in outside]


@given(orders(), st.data())
def test_a_wrong_writer_is_one_that_some_order_has_last(drawn: Drawn, data: st.DataObject) -> None:
    order, before = drawn.order, drawn.before
    written = dict(sorted(data.draw(st.dictionaries(st.sampled_from(range(1, len(before) - 1)), st.booleans())).items()))
    writers = Writers[bool](order, False)
    for number, value in written.items():
        writers.add(number, value)
    reader = data.draw(st.sampled_from([number for number, one in enumerate(order.happenings) if number and not order.is_change(number)]))
    need = _Need(reader, FLUENT, data.draw(st.booleans()), afterwards=data.draw(st.booleans()))
    earlier = before[reader] | {reader} if need.afterwards else before[reader]
    values = {0: False, **written}
    right = {one for one in earlier & values.keys() if values[one] is need.value}

    def ahead(one: int, other: int) -> bool:
        return one in before[other] or order.is_ahead(one, other)

    def may_be_last(one: int) -> bool:
        possible = one in earlier if need.afterwards else one != reader and reader not in before[one]
        return possible and not order.is_ahead(reader, one) and not any(ahead(one, other) for other in right)

    expected = {one for one, value in values.items() if value is not need.value and may_be_last(one)}
    found = wrong_writer(trace_with(drawn, writers), need)
    assert found in expected if expected else found is None


def test_a_writer_that_is_planned_before_a_change_is_not_the_last_where_the_change_is_right() -> None:
    action = GroundAction("a", duration=1.0)
    calls, timed = (ActionCall(0, action), ActionCall(1, action, 2.0, release=2.0)), (TimedChange(1.0, {FLUENT: True}),)
    order = PartialOrder(calls, (), timed)
    writer, reader = (order.number(call, Moment.START) for call in range(2))
    change = next(number for number in range(reader) if order.is_change(number))
    writers = Writers[bool](order, False)
    writers.add(writer, False)
    writers.add(change, True)
    trace = trace_with(Drawn(order, {}, PlanGraph(calls)), writers)
    assert not order.comes_before(writer, change)
    assert wrong_writer(trace, _Need(reader, FLUENT, True)) is None


def trace_with(drawn: Drawn, writers: Writers[bool]) -> _Trace:
    """A trace of calls that read and write nothing, but for these writers."""
    problem = Problem("p", Domain("d"))
    links = CausalLinks(initial_knowledge(problem), frozenset(), [call.action for call in drawn.graph.calls])
    trace = _Trace(drawn.graph, drawn.order, links, initial_knowledge(problem), False)
    trace.writers[FLUENT] = writers  # type: ignore[assignment]
    return trace
