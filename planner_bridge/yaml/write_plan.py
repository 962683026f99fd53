"""Plans as steps: nested blocks where their order is series-parallel, ``after`` lists where it is not.

Temporal plans have more than orderings of whole calls: a call starts or ends after the start of another, after a
delay, or not before a time. Then all steps stand in one list, and each has all it waits for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from math import inf
from typing import TypeAlias, assert_never

from planner_bridge.model.problem import Domain
from planner_bridge.pddl.expressions import number_text
from planner_bridge.yaml.emitter import Bare, Entry, Value, YamlMapping, items, single
from pnm.core.machine.plan_graph import Moment, Ordering, PlanEvent, PlanGraph, necessary
from pnm.core.net.orders import closure, reduced
from pnm.errors import InputError


def plan_entries(graph: PlanGraph, domain: Domain) -> list[Entry]:
    """Return the keys of a file with a plan that a planner has made."""
    return [Entry(items(_StepWriter(graph, domain).steps() if graph.calls else ()), "plan", apart=True)]


@dataclass(frozen=True)
class _StepWriter:
    graph: PlanGraph
    domain: Domain

    def steps(self) -> list[YamlMapping]:
        orderings = necessary(self.graph.flow)
        simple = all(
            ordering.before.moment is Moment.END and ordering.after.moment is Moment.START and not ordering.delay for ordering in orderings
        )
        if not simple or any(call.release or min(call.latest_start, call.deadline) < inf for call in self.graph.calls):
            return self._explicit(orderings)
        calls = list(dict.fromkeys(event.call for event in self.graph.order))
        numbers = {call: number for number, call in enumerate(calls)}
        match blocks(reduced(len(calls), [(numbers[ordering.before.call], numbers[ordering.after.call]) for ordering in orderings])):
            case Series(parts):
                return [self._block(part, calls) for part in parts]
            case Mesh(before_each):
                return self._mesh(before_each, calls, in_sequence=True)
            case whole:
                return [self._block(whole, calls)]

    def _block(self, block: Block, calls: list[int]) -> YamlMapping:
        match block:
            case int():
                return self._step(calls[block], {})
            case Series(parts):
                return single("sequence", items(self._block(part, calls) for part in parts))
            case Parallel(parts):
                return single("concurrent_actions", items(self._block(part, calls) for part in parts))
            case Mesh(before):
                return single("concurrent_actions", items(self._mesh(before, calls, in_sequence=False)))
            case _:
                assert_never(block)

    def _mesh(self, before: Mapping[int, tuple[int, ...]], calls: list[int], *, in_sequence: bool) -> list[YamlMapping]:
        """Write steps with what they wait for, where that is not what a step of such a list waits for anyway."""
        named = self._names({calls[other] for others in before.values() for other in others})
        steps: list[YamlMapping] = []
        usual: set[int] = set()
        for number, others in before.items():
            after = [] if usual == {*others} else [Entry(items((named[calls[other]] for other in others), short=True), "after")]
            steps.append(self._step(calls[number], named, *after))
            usual = {*usual, number}.difference(others) if in_sequence else usual
        return steps

    def _explicit(self, orderings: Sequence[Ordering]) -> list[YamlMapping]:
        """Write all steps in one list, each with all it waits for and its times."""
        named = self._names({ordering.before.call for ordering in orderings})
        steps: list[YamlMapping] = []
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
            steps.append(self._step(call.index, named, *options))
        return steps

    def _step(self, index: int, named: Mapping[int, str], *options: Entry) -> YamlMapping:
        action = self.graph.calls[index].action
        arguments = [Entry(argument, name) for name, argument in zip(action.parameters, action.arguments, strict=True)]
        call = Entry(YamlMapping(tuple(arguments), short=True), action.name)
        expected = [Entry(action.outcome, "outcome")] if action.outcomes and action.outcome != action.outcomes[0].name else []
        whole = (*([Entry(named[index], "id")] if index in named else ()), *expected, *options)
        if call.key in [option.key for option in whole]:
            raise InputError(
                f"this plan needs {call.key!r} as a word of the language; an action cannot be called so, expected another name"
            )
        return YamlMapping((call, *whole))

    def _names(self, wanted: Set[int]) -> dict[int, str]:
        """Return names for calls: their action, and a number if it is called several times."""
        often, seen, names = Counter(call.action.name for call in self.graph.calls), Counter[str](), dict[int, str]()
        for call in self.graph.calls:
            name = call.action.name
            seen[name] += 1
            if call.index in wanted:
                names[call.index] = f"{name}_{seen[name]}" if often[name] > 1 else name
        return names


def _event(ordering: Ordering, named: Mapping[int, str]) -> Value:
    """Name what comes before: a step for its end, a mapping for its start or for a later time."""
    name, moment = named[ordering.before.call], ordering.before.moment
    if moment is Moment.END and not ordering.delay:
        return name
    delay = [Entry(Bare(number_text(ordering.delay)), "delay")] if ordering.delay else []
    return YamlMapping((Entry(name, moment.value), *delay), short=True)


# --- series-parallel orders ----------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Series:
    """One after the other."""

    parts: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Parallel:
    """In no order."""

    parts: tuple[Block, ...]


@dataclass(frozen=True, slots=True)
class Mesh:
    """In an order that is not series-parallel."""

    before: Mapping[int, tuple[int, ...]]
    """For every element, in an order that fits, those directly before it."""


Block: TypeAlias = int | Series | Parallel | Mesh


def blocks(before: Sequence[tuple[int, ...]]) -> Block:
    """Take apart a transitively reduced order of at least one element."""
    earlier = closure(before)
    related = list(earlier)
    for number, ancestors in enumerate(earlier):
        for element in _members(ancestors):
            related[element] |= 1 << number
    return _block((1 << len(before)) - 1, before, earlier, related)


def _block(members: int, before: Sequence[tuple[int, ...]], earlier: Sequence[int], related: Sequence[int]) -> Block:
    if members.bit_count() == 1:
        return members.bit_length() - 1
    beside = _components(members, related)
    if len(beside) > 1:
        return Parallel(tuple([_block(part, before, earlier, related) for part in beside]))
    chained = _components(members, [~neighbours for neighbours in related])
    if len(chained) > 1:
        chained.sort(key=lambda part: (earlier[_lowest(part)] & members & ~part).bit_count())
        return Series(tuple([_block(part, before, earlier, related) for part in chained]))
    return Mesh({element: tuple(other for other in before[element] if members >> other & 1) for element in _members(members)})


def _components(members: int, neighbours: Sequence[int]) -> list[int]:
    """Return the parts of a set that no neighbours connect, by their lowest members."""
    parts: list[int] = []
    left = members
    while left:
        part = frontier = 1 << _lowest(left)
        while frontier:
            reached = 0
            for element in _members(frontier):
                reached |= neighbours[element]
            frontier = reached & left & ~part
            part |= frontier
        parts.append(part)
        left &= ~part
    return parts


def _lowest(members: int) -> int:
    return (members & -members).bit_length() - 1


def _members(members: int) -> Iterator[int]:
    while members:
        lowest = _lowest(members)
        yield lowest
        members ^= 1 << lowest
