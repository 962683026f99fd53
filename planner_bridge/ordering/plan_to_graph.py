"""Plan → plan graph: a deordering of the plan, by its causal links.

The happenings of the plan are added to the causal links in the order of time (`planner_bridge.ordering.causal_links`);
then actions that enclose others get their delays (`planner_bridge.ordering.causal_links`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise
from typing import Final, NamedTuple, TypeAlias

from planner_bridge.model.grounding import dynamic_names, initial_knowledge
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Domain, Problem, once_per_domain
from planner_bridge.model.progression import Happening, calls_of, foreseen, happenings
from planner_bridge.ordering.causal_links import CausalLinks, OrderKept, delay_enclosing_starts
from planner_bridge.ordering.partial_order import NEAR, PartialOrder, Writers
from pnm.core.knowledge_base import KnowledgeBase, statement_text
from pnm.core.logic.conditions import TRUE, Condition, evaluate, fluents, names
from pnm.core.logic.effects import Effects, Set, TimedChange, When, changes, decided, every_effect
from pnm.core.logic.expressions import UNKNOWN, Fluent, Unknown, Value, expression_fluents, same_value
from pnm.core.logic.trajectory import instances, names_in
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, PlanEvent, PlanGraph, PlanGraphError
from pnm.core.net.no_collection import no_collection
from pnm.errors import check_kinds

# --- threats --------------------------------------------------------------------------------------
# Threats to the causal links of a plan graph: orders that it allows, and in which a reader finds a value that the plan does not have.
#
# The plan is carried through once, in an order that the graph allows, and every value that a happening reads or writes is noted. A
# reader of a fluent is *threatened* if a writer of another value may come before it, and no writer of the value that it needs must
# lie between the two; the initial state is a writer before all others. A condition over a time is read just after its start, and no
# writer may lie within that makes it false. If nothing is threatened, every order reads the same and so writes the same, event by
# event: all orders are as good as the one that was carried through.
#
# For conjunctions of facts and unconditional effects that is exact: where a reader is threatened, some order that the graph allows
# brings the wrong value (Chapman 1987, *Planning for Conjunctive Goals*, on necessary truth). For numbers and other conditions it is
# on the safe side: another value counts as wrong even where it would do.
#
# What the plan has before a timed change is taken to come before it: being late is noticed in the run.


_Value: TypeAlias = Value | Unknown | None


class _Need(NamedTuple):
    """A happening needs a value: just before its own effects, or just after them."""

    reader: int
    fluent: Fluent
    value: _Value
    afterwards: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class _Span:
    """Part of a condition that must hold from just after one event until just before another."""

    first: int
    last: int
    condition: Condition
    fluents: frozenset[Fluent]


@dataclass(frozen=True, slots=True)
class _Intrusion:
    """A write that some order has within a span."""

    span: _Span
    writer: int
    others: tuple[_Need, ...]
    """The other conditions that decide whether the condition holds."""
    leaves_true: bool


@dataclass
class _Trace:
    """All reads and writes of a plan, noted while its happenings are carried through. What has a default changes."""

    graph: PlanGraph
    order: PartialOrder
    links: CausalLinks
    state: KnowledgeBase
    projected: bool
    """Whether the state is the one after all calls that are under way, and not the one before their ends."""
    needs: list[_Need] = field(default_factory=list)
    changed: list[Mapping[Fluent, _Value]] = field(default_factory=list)
    """The fluents that every happening writes."""
    writers: dict[Fluent, Writers[_Value]] = field(default_factory=dict)
    spans: dict[int, list[_Span]] = field(default_factory=dict)
    """By the happening with which they begin."""
    begun: dict[_Span, tuple[_Need, ...]] = field(default_factory=dict)
    """The needs of each span when it begins."""
    end_effects: dict[int, Effects] = field(default_factory=dict)
    """Of calls that have started, with their early conditions decided."""

    def __post_init__(self) -> None:
        for call in self.graph.calls:
            first, last = (self.order.number(call.index, moment) for moment in (Moment.START, Moment.END))
            for part, mentioned in self.links.throughout[call.index]:
                if mentioned:
                    self.spans.setdefault(first, []).append(_Span(first, last, part, mentioned))
            if call.under_way:
                self.end_effects[call.index] = decided(call.action.end_effects, self.state)
        for number, happening in enumerate(self.order.happenings):
            if isinstance(happening, PlanEvent):
                call = self.graph.calls[happening.call]
                self._read(number, self.links.reads[happening])
                if happening.moment is Moment.START:
                    self.end_effects[call.index] = decided(call.action.end_effects, self.state)
                    self._write(number, changes(call.action.start_effects, self.state))
                elif self.projected and call.under_way:  # the state has these effects already
                    self._write(number, {fluent: self.state.value(fluent) for fluent in self.links.writes[happening]}, before=UNKNOWN)
                else:
                    self._write(number, changes(self.end_effects[call.index], self.state))
            elif happening is not None:
                self._write(number, happening.changes)
            elif number:
                self._read(number, self.links.relevant_of(fluents(self.graph.goal, self.links.knowledge)))
            else:
                self._write(number, {})

    def _read(self, reader: int, mentioned: frozenset[Fluent]) -> None:
        if mentioned:
            self.needs += self._needs(reader, mentioned)

    def _needs(self, reader: int, mentioned: Collection[Fluent], *, afterwards: bool = False) -> list[_Need]:
        return [_Need(reader, fluent, self.state.value(fluent), afterwards) for fluent in sorted(mentioned)]

    def _write(self, writer: int, changed: Mapping[Fluent, _Value], before: _Value = None) -> None:
        for fluent, value in changed.items():
            writers = self.writers.get(fluent)
            if writers is None:
                writers = self.writers[fluent] = Writers(self.order, self.state.value(fluent) if before is None else before)
            writers.add(writer, value)
        self.changed.append(changed)
        record(self.state, changed)
        for span in self.spans.get(writer, ()):
            self.begun[span] = tuple(self._needs(writer, span.fluents, afterwards=True))
            self.needs += self.begun[span] if writer else ()

    def intrusions(self, state: KnowledgeBase) -> Iterator[_Intrusion]:
        """Yield all intrusions, while the happenings are carried through once more from this state on."""
        intruding: dict[int, dict[_Span, None]] = {}
        for span in chain.from_iterable(self.spans.values()):
            for writers in (self.writers[fluent] for fluent in span.fluents if fluent in self.writers):
                for writer in writers.between(span.first, span.last):
                    intruding.setdefault(writer, {})[span] = None
        for writer, changed in enumerate(self.changed if intruding else ()):
            record(state, changed)
            for span in intruding.get(writer, ()):
                others = tuple(_Need(writer, fluent, state.value(fluent)) for fluent in sorted(span.fluents - changed.keys()))
                yield _Intrusion(span, writer, others, evaluate(span.condition, state) is True)


def record(state: KnowledgeBase, changed: Mapping[Fluent, _Value]) -> None:
    """Record what a happening writes."""
    if changed:
        state.record({fluent: False if value is None else value for fluent, value in changed.items()})


def wrong_writer(trace: _Trace, need: _Need) -> int | None:
    """Return a writer of another value that some order has last before the reader; None if the need is met in every order."""
    writers, order, reader = trace.writers.get(need.fluent), trace.order, need.reader
    if writers is None:
        return None
    last, loose = writers.before(reader, itself=need.afterwards)
    # Just after the reader its own effects count; what may come later is judged as an intrusion.
    candidates = last if need.afterwards else [*last, *loose, *writers.not_after(reader)]
    wrong = [writers.numbers[one] for one in candidates if not _is_same(writers.values[one], need.value)]
    if not wrong:
        return None
    right = [writers.numbers[one] for one in last if _is_same(writers.values[one], need.value)]
    for writer in wrong:
        covered = any(order.comes_before(writer, one) or order.is_ahead(writer, one) for one in right)
        if not covered and not order.is_ahead(reader, writer):
            return writer
    return None


def _is_same(value: _Value, needed: _Value) -> bool:
    return value is needed or same_value(value, needed)


def is_harmless(trace: _Trace, intrusion: _Intrusion) -> bool:
    """Return whether the condition holds all the same, wherever in its span the write comes."""
    span, writer, order = intrusion.span, intrusion.writer, trace.order
    change = order.happenings[writer]
    if isinstance(change, TimedChange) and order.time(order.happenings[span.last]) <= change.time + NEAR:
        return True
    begun, changed = trace.begun[span], trace.changed[writer]
    if all(need.fluent in changed and same_value(changed[need.fluent], need.value) for need in begun):
        return True
    begins_before = order.comes_before(span.first, writer) or order.is_ahead(span.first, writer)
    return begins_before and intrusion.leaves_true and all(wrong_writer(trace, need) is None for need in intrusion.others)


def threats(graph: PlanGraph, order: PartialOrder, problem: Problem, links: CausalLinks, *, projected: bool) -> Iterator[str]:
    """Yield the conflicts in any order that the graph allows.

    Args:
        problem: its initial state is the one that the plan starts from.
        links: what counts as read: the objects, the rules, the fluents that can order anything, and orders that must be kept.
        projected: whether the initial state is the one after all calls that are under way, and not the one before their ends.
    """
    trace = _Trace(graph, order, links, initial_knowledge(problem), projected)

    def named(number: int) -> str:
        match order.happenings[number]:
            case PlanEvent(index, moment):
                return f"the {moment.value} of {graph.calls[index]}"
            case TimedChange(time):
                return f"the change at {time:g} s"
            case None:
                return "the goal" if number else "the initial state"

    for intrusion in trace.intrusions(initial_knowledge(problem)):
        if not is_harmless(trace, intrusion):
            span = intrusion.span
            yield f"{named(intrusion.writer)} may come between {named(span.first)} and {named(span.last)}, which needs {span.condition}"
    for need in trace.needs:
        if (writer := wrong_writer(trace, need)) is not None:
            needed = "no value" if need.value is None else statement_text(need.fluent, need.value)
            yield f"{named(need.reader)} needs {needed}, but {named(writer)} may be the last that writes it before"
    for kept in links.kept:
        points = sorted(points_kept(graph, order, kept, links))
        for (_, first), (second, _) in pairwise(points):
            if not order.comes_before(first, second):
                yield f"{named(second)} may come before {named(first)}, which does not keep {kept.token[0]}"


def points_kept(graph: PlanGraph, order: PartialOrder, kept: OrderKept, links: CausalLinks) -> Iterator[tuple[int, int]]:
    """Yield the events that must keep their order: what of each waits for others, and what others wait for."""
    for call in graph.calls:
        start, end = (PlanEvent(call.index, moment) for moment in (Moment.START, Moment.END))
        for first, last in ((start, end),) if call.action.duration is None else ((start, start), (end, end)):
            waits, leads = order.number(*first), order.number(*last)
            if waits and (kept.fluents is None or kept.fluents & links.writes[last]):
                yield waits, leads


# --- plan to graph --------------------------------------------------------------------------------


_BEGUN: Final = -2.0
_OVER: Final = -1.0
"""The times, on the clock of the plan, at which running calls begin and end as far as their order to the others matters."""

_NETWORK: Final[Fluent] = ("order of tasks",)
_NATURE: Final[Fluent] = ("processes and events",)
"""Stand for fluents that every event writes."""


@no_collection()
def plan_graph(problem: Problem, plan: Plan, under_way: Sequence[ActionCall] = ()) -> PlanGraph:
    """Return the calls of the plan with the orderings that its causal links demand.

    What processes and events do beside it comes at its times. Where calls of an earlier plan are still under way, the problem begins
    with the state after their ends.
    """
    check_kinds("plan_graph", {"problem": (problem, Problem), "plan": (plan, Plan)})
    problem = foreseen(problem, plan)
    running = [replace(call, index=index, planned=0.0, under_way=True) for index, call in enumerate(under_way)]
    steps = calls_of(problem, plan, len(running))
    calls = [*running, *steps]
    links = causal_links(problem, [call.action for call in calls])
    # Running calls come first, as if they ended just before the plan begins: its calls then wait for what they write.
    begun = [Happening(_BEGUN, (), tuple(links.starts[: len(running)])), Happening(_OVER, (), tuple(links.ends[: len(running)]))]
    _add(links, [*begun, *happenings(problem, plan, len(running))])
    graph = _checked(problem, calls, links, projected=True)
    if not problem.domain.nature:
        return graph
    times = {PlanEvent(call.index, Moment.START): call.planned for call in calls}
    times |= {PlanEvent(call.index, Moment.END): call.planned + (call.action.duration or 0.0) for call in calls}
    apart = (
        replace(one, delay=max(one.delay, round(times[one.after] - times[one.before], 6))) if one.after.moment is Moment.START else one
        for one in graph.orderings
    )  # who comes after a late call is as late: a process needs its time
    return replace(graph, orderings=tuple(apart), due=plan.makespan)


def stretch_graph(problem: Problem, plan: Plan, under_way: Sequence[ActionCall] = ()) -> PlanGraph:
    """Return the same for a plan that ends with an action of several outcomes: what comes after it is decided when it has ended."""
    is_last = not any(call.action.outcomes for call in calls_of(problem, plan))
    return plan_graph(problem if is_last else replace(problem, goal=TRUE), plan, under_way)


@no_collection()
def deordered(problem: Problem, calls: tuple[ActionCall, ...], order: Iterable[PlanEvent]) -> PlanGraph:
    """Return the calls with the orderings that their causal links demand, given one executable order of their events."""
    links = causal_links(problem, [call.action for call in calls])
    # The positions in the order stand for times: only before and after matter to causal links.
    _add(links, [Happening(float(position), (), (event,)) for position, event in enumerate(order)])
    return _checked(problem, calls, links, projected=False)


def _add(links: CausalLinks, course: Sequence[Happening]) -> None:
    """Add happenings in their order: an over-all condition is read from just after the happening of the start until that of the end."""
    ends = {event.call: happening.time for happening in course for event in happening.events if event.moment is Moment.END}
    for happening in course:
        for change in happening.timed:
            links.add_timed_change(change.time, change.changes)
        for event in happening.events:
            links.add_event(event, happening.time)
        for event in happening.events:
            if event.moment is Moment.START:
                links.begin_reading(event.call, happening.time, ends[event.call])


def _checked(problem: Problem, calls: Sequence[ActionCall], links: CausalLinks, *, projected: bool) -> PlanGraph:
    """Return the plan graph, every order of which is as good as the plan."""
    calls, orderings = delay_enclosing_starts(links.timed_calls(calls), links.strongest())
    due = links.due(problem.goal)
    order = PartialOrder(calls, orderings, problem.timed, due)
    graph = PlanGraph(_with_lasting_effects(calls, order, links), tuple(orderings), problem.goal, links.knowledge.rules, due)
    check_order(graph, order, problem, links, projected=projected)
    return graph


def check_order(graph: PlanGraph, order: PartialOrder, problem: Problem, links: CausalLinks, *, projected: bool) -> None:
    """Raise a `PlanGraphError` unless every order of a graph is as good as the plan, and no reader gets a wrong value; see `threats`."""
    for threat in threats(graph, order, problem, links, projected=projected):
        raise PlanGraphError(f"an ordering is missing: {threat}")


def _with_lasting_effects(calls: Sequence[ActionCall], order: PartialOrder, links: CausalLinks) -> tuple[ActionCall, ...]:
    """Return the calls with what is expected at the end of each call of its start effects: those that nothing else can overwrite before."""
    begun = {call.index: started for call in calls if (started := links.writes[links.starts[call.index]])}
    if not begun:
        return tuple(calls)
    writers = {fluent: Writers[None](order, None) for started in begun.values() for fluent in started}
    for number, happening in enumerate(order.happenings):
        changed = happening.changes if isinstance(happening, TimedChange) else links.writes[happening] if happening else ()
        for fluent in changed:
            if fluent in writers:
                writers[fluent].add(number, None)
    lasting: dict[int, frozenset[Fluent]] = {}
    for index, started in begun.items():
        start, end = (order.number(index, moment) for moment in (Moment.START, Moment.END))
        lasting[index] = frozenset(fluent for fluent in started if not writers[fluent].between(start, end))
    return tuple([replace(call, lasting=lasting[call.index]) if lasting.get(call.index) else call for call in calls])


def causal_links(problem: Problem, actions: Sequence[GroundAction]) -> CausalLinks:
    """Return the causal links of a plan of these calls, without any happening."""
    knowledge = initial_knowledge(problem)
    asked = _asked_by_domain(problem.domain).union(names(problem.goal), *map(names_in, problem.constraints))
    asked |= {fluent[0] for change in problem.timed for fluent in change.changes}
    read = frozenset(problem.domain.predicates) | problem.domain.rules.base(asked)  # by something besides the metric
    links = CausalLinks(knowledge, (dynamic_names(problem) & read) - problem.domain.moved, actions, problem.timed)
    # A network of tasks fixes the order of its steps in ways that reads and writes do not show.
    if problem.network:
        links.kept.append(OrderKept(_NETWORK))
    if problem.domain.nature:  # numbers that change all the time are read by all, and right only at the times of the plan
        links.kept.append(OrderKept(_NATURE, timed=True))
    for constraint in (*problem.domain.constraints, *problem.constraints):
        for ground in instances(constraint, knowledge):
            mentioned = frozenset().union(*(fluents(condition, knowledge) for condition in ground.conditions))
            is_timed = problem.is_timed and bool(ground.times) and ground.operator != "within"
            links.kept.append(OrderKept((str(ground)[1:-1],), links.relevant_of(mentioned), is_timed))
    return links


@once_per_domain
def _asked_by_domain(domain: Domain) -> frozenset[str]:
    """Return the names of fluents that actions, processes, events and constraints of the domain read."""
    asked = {name for constraint in domain.constraints for name in names_in(constraint)}
    for schema in domain.schemas:
        for condition in (schema.precondition, schema.invariant, schema.end_condition):
            asked |= names(condition)
        for constraint in schema.duration or ():
            asked |= {fluent[0] for fluent in expression_fluents(constraint.bound)}
        for effect in every_effect((*schema.start_effects, *schema.end_effects)):
            match effect:
                case Set(fluent, value, operation):
                    asked |= {part[0] for part in expression_fluents(value)}
                    if operation not in ("increase", "decrease"):  # a number's own increase is not read
                        asked.add(fluent[0])
                case When(condition):
                    asked |= names(condition)
    return frozenset(asked)
