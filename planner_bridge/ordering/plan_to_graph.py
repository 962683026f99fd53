"""Plan → plan graph: a deordering of the plan, by its causal links.

The happenings of the plan are added to the causal links in the order of time (`planner_bridge.ordering.causal_links`);
then actions that enclose others get their delays (`planner_bridge.ordering.causal_links`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Final

from planner_bridge.model.grounding import dynamic_names, initial_knowledge
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Domain, Problem, once_per_domain
from planner_bridge.model.progression import Happening, calls_of, happenings
from planner_bridge.ordering.causal_links import CausalLinks, OrderKept, delay_enclosing_starts
from planner_bridge.ordering.partial_order import PartialOrder, Writers
from planner_bridge.ordering.threats import threats
from pnm.core.logic.conditions import fluents, names
from pnm.core.logic.effects import Set, TimedChange, When, every_effect
from pnm.core.logic.expressions import Fluent, expression_fluents
from pnm.core.logic.trajectory import instances, names_in
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, PlanEvent, PlanGraph, PlanGraphError
from pnm.core.net.no_collection import no_collection
from pnm.errors import check_kinds

_BEGUN: Final = -2.0
_OVER: Final = -1.0
"""The times, on the clock of the plan, at which running calls begin and end as far as their order to the others matters."""

_NETWORK: Final[Fluent] = ("order of tasks",)
"""Stands for a fluent that every event writes."""


@no_collection()
def plan_graph(problem: Problem, plan: Plan, under_way: Sequence[ActionCall] = ()) -> PlanGraph:
    """Return the calls of the plan with the orderings that its causal links demand.

    Where calls of an earlier plan are still under way, the problem begins with the state after their ends.
    """
    check_kinds("plan_graph", {"problem": (problem, Problem), "plan": (plan, Plan)})
    running = [replace(call, index=index, planned=0.0, under_way=True) for index, call in enumerate(under_way)]
    steps = calls_of(problem, plan, len(running))
    calls = [*running, *steps]
    links = causal_links(problem, [call.action for call in calls])
    # Running calls come first, as if they ended just before the plan begins: its calls then wait for what they write.
    begun = [Happening(_BEGUN, (), tuple(links.starts[: len(running)])), Happening(_OVER, (), tuple(links.ends[: len(running)]))]
    _add(links, [*begun, *happenings(problem, plan, len(running))])
    return _checked(problem, calls, links, projected=True)


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
    """Check that every order of a graph is as good as the plan; see `threats` for what is given.

    Raises:
        PlanGraphError: some order brings a wrong value to a reader.
    """
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
    links = CausalLinks(knowledge, _relevant(problem), actions, problem.timed)
    # A network of tasks fixes the order of its steps in ways that reads and writes do not show.
    if problem.network:
        links.kept.append(OrderKept(_NETWORK))
    for constraint in (*problem.domain.constraints, *problem.constraints):
        for ground in instances(constraint, knowledge):
            mentioned = frozenset().union(*(fluents(condition, knowledge) for condition in ground.conditions))
            is_timed = problem.is_timed and bool(ground.times) and ground.operator != "within"
            links.kept.append(OrderKept((str(ground)[1:-1],), links.relevant_of(mentioned), is_timed))
    return links


def _relevant(problem: Problem) -> frozenset[str]:
    """Return the names of fluents that can change and that something besides the metric reads."""
    asked = _asked_by_domain(problem.domain).union(names(problem.goal), *map(names_in, problem.constraints))
    asked |= {fluent[0] for change in problem.timed for fluent in change.changes}
    predicates = frozenset(problem.domain.predicates)
    return dynamic_names(problem) & (predicates | problem.domain.rules.base(asked))


@once_per_domain
def _asked_by_domain(domain: Domain) -> frozenset[str]:
    """Return the names of fluents that actions and constraints of the domain read."""
    asked = {name for constraint in domain.constraints for name in names_in(constraint)}
    for schema in domain.actions.values():
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
