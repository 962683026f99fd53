"""Plans as steps: nested blocks where their order is series-parallel, ``after`` lists where it is not.

Temporal plans have more than orderings of whole calls: a call starts or ends after the start of another, after a
delay, or not before a time. Then all steps stand in one list, and each has all it waits for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from math import inf
from typing import Final, assert_never

from planner_bridge.model.problem import Domain
from planner_bridge.pddl.expressions import number_text
from planner_bridge.yaml.emitter import Bare, Entry, Mapping, Sequence, Value, items
from planner_bridge.yaml.series_parallel import Block, Mesh, Parallel, Series, blocks, reduced
from pnm.core.machine.plan_graph import Moment, Ordering, PlanEvent, PlanGraph
from pnm.errors import InputError

_NO_PLAN: Final = Entry(Sequence(), "plan", apart=True)


def plan_entries(graph: PlanGraph, domain: Domain) -> list[Entry]:
    """Return the keys of a file with a plan that a planner has made."""
    if not graph.calls:
        return [_NO_PLAN]
    writer = _StepWriter(graph, domain)
    return [Entry(Sequence(tuple([Entry(step) for step in writer.steps()])), "plan", apart=True)]


@dataclass(frozen=True)
class _StepWriter:
    graph: PlanGraph
    domain: Domain

    def steps(self) -> list[Mapping]:
        order = self.graph.order
        places = {event: place for place, event in enumerate(order)}
        own = [(places[PlanEvent(call.index, Moment.START)], places[PlanEvent(call.index, Moment.END)]) for call in self.graph.calls]
        edges = [(places[ordering.before], places[ordering.after]) for ordering in self.graph.orderings]
        before = reduced(len(order), [*own, *edges])
        # only those that do not follow from others
        orderings = [ordering for ordering, (i, j) in zip(self.graph.orderings, edges, strict=True) if ordering.delay or i in before[j]]
        simple = all(
            ordering.before.moment is Moment.END and ordering.after.moment is Moment.START and not ordering.delay for ordering in orderings
        )
        if simple and not any(call.release or min(call.latest_start, call.deadline) < inf for call in self.graph.calls):
            return self._in_blocks(orderings)
        return self._explicit(orderings)

    # --- blocks ---

    def _in_blocks(self, orderings: Iterable[Ordering]) -> list[Mapping]:
        order = list(dict.fromkeys(event.call for event in self.graph.order))
        places = {call: place for place, call in enumerate(order)}
        edges = [(places[ordering.before.call], places[ordering.after.call]) for ordering in orderings]
        match blocks(reduced(len(order), edges)):
            case Series(parts):
                return [self._block(part, order) for part in parts]
            case Mesh(before):
                waits = {order[step]: tuple(order[other] for other in others) for step, others in before.items()}
                return self._mesh(waits, in_sequence=True)
            case whole:
                return [self._block(whole, order)]

    def _block(self, block: Block, order: list[int]) -> Mapping:
        match block:
            case int():
                return Mapping((self._call(order[block]),))
            case Series(parts):
                return _listed("sequence", [self._block(part, order) for part in parts])
            case Parallel(parts):
                return _listed("concurrent_actions", [self._block(part, order) for part in parts])
            case Mesh(before):
                waits = {order[step]: tuple(order[other] for other in others) for step, others in before.items()}
                return _listed("concurrent_actions", self._mesh(waits, in_sequence=False))
            case _:
                assert_never(block)

    def _mesh(self, before: dict[int, tuple[int, ...]], *, in_sequence: bool) -> list[Mapping]:
        """Write steps with what they wait for, where that is not what a step of such a list waits for anyway."""
        named = self._names({other for others in before.values() for other in others})
        steps: list[Mapping] = []
        usual: set[int] = set()
        for call, others in before.items():
            after = [] if usual == {*others} else [Entry(items((named[other] for other in others), short=True), "after")]
            steps.append(_step(self._call(call), *_id(named, call), *after))
            usual = {*usual, call}.difference(others) if in_sequence else usual
        return steps

    # --- events ---

    def _explicit(self, orderings: list[Ordering]) -> list[Mapping]:
        named = self._names({ordering.before.call for ordering in orderings})
        steps: list[Mapping] = []
        for call in sorted(self.graph.calls, key=lambda call: call.planned):
            waits = {moment: [ordering for ordering in orderings if ordering.after == PlanEvent(call.index, moment)] for moment in Moment}
            options = [
                Entry(items((_event(ordering, named) for ordering in waits[moment]), short=True), key)
                for moment, key in ((Moment.START, "after"), (Moment.END, "end_after"))
                if moment is Moment.START or waits[moment]
            ]
            fixed = any(bound.operation == "=" for bound in self.domain.actions[call.action.name].duration or ())
            times = [
                ("duration", None if fixed else call.action.duration),
                ("release", call.release or None),
                ("latest_start", call.latest_start if call.latest_start < inf else None),
                ("deadline", call.deadline if call.deadline < inf else None),
            ]
            options += [Entry(Bare(number_text(seconds)), key) for key, seconds in times if seconds is not None]
            steps.append(_step(self._call(call.index), *_id(named, call.index), *options))
        return steps

    # --- calls ---

    def _call(self, index: int) -> Entry:
        action = self.graph.calls[index].action
        arguments = zip(action.parameters, action.arguments, strict=True)
        return Entry(Mapping(tuple([Entry(argument, name) for name, argument in arguments]), short=True), action.name)

    def _names(self, calls: Iterable[int]) -> dict[int, str]:
        """Return names for calls: their action, and a number if it is called several times."""
        often = Counter(call.action.name for call in self.graph.calls)
        seen: Counter[str] = Counter()
        names: dict[int, str] = {}
        for call in self.graph.calls:
            seen[call.action.name] += 1
            names[call.index] = f"{call.action.name}_{seen[call.action.name]}" if often[call.action.name] > 1 else call.action.name
        wanted = set(calls)
        return {index: name for index, name in names.items() if index in wanted}


def _listed(key: str, steps: list[Mapping]) -> Mapping:
    return Mapping((Entry(Sequence(tuple([Entry(step) for step in steps])), key),))


def _step(call: Entry, *options: Entry) -> Mapping:
    if call.key in [option.key for option in options]:
        raise InputError(f"this plan needs {call.key!r} as a word of the language; an action cannot be called so, expected another name")
    return Mapping((call, *options))


def _id(named: dict[int, str], call: int) -> tuple[Entry, ...]:
    return (Entry(named[call], "id"),) if call in named else ()


def _event(ordering: Ordering, named: dict[int, str]) -> Value:
    """Name what comes before: a step for its end, a mapping for its start or for a later time."""
    name, moment = named[ordering.before.call], ordering.before.moment
    if moment is Moment.END and not ordering.delay:
        return name
    delay = [Entry(Bare(number_text(ordering.delay)), "delay")] if ordering.delay else []
    return Mapping((Entry(name, moment.value), *delay), short=True)
