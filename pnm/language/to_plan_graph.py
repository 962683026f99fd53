"""From the syntax tree of a plan to a `PlanGraph`: its steps and their partial order.

Every list is walked once; what is inside of blocks that are done in sequence or at the same time ends up in the same
flow, with orderings from the steps that are last in one to those that are first in the next. Where several meet
several others there is a junction, so that orderings do not multiply. The values that a step gives are substituted for the parameters
of its action.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from graphlib import CycleError, TopologicalSorter
from itertools import product
from typing import Final, NamedTuple, assert_never

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.computed_values import Data, KnowledgeOperation, Layer, Literal, Operation, Query, Update, filled, parameters_in, parts
from pnm.core.logic.conditions import TRUE, Condition, ground
from pnm.core.logic.expressions import Environment, ValueOf, is_number, text_of, value_of
from pnm.core.logic.rules import NO_RULES, Rules
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.plan_graph import (
    EMPTY,
    ActionCall,
    Flow,
    GroundAction,
    Junction,
    Moment,
    Ordering,
    PlanEvent,
    PlanGraph,
    Recovery,
    Step,
    Then,
    every_step,
    ground_schema,
)
from pnm.errors import InputError, Position, located
from pnm.language.domain import OPERATION, LanguageAction
from pnm.language.grammar import ActionKind
from pnm.language.steps import BlockStep, CallStep, StepList, WrittenRecovery, WrittenStep


def filled_data(data: Data, values: Mapping[str, Data]) -> Data:
    """Substitute computed values for parameters; in fluents only texts fit."""
    texts = {name: given.value for name, given in values.items() if isinstance(given, Literal) and isinstance(given.value, str)}
    return filled(data, values, texts)


def filled_operation(operation: KnowledgeOperation, values: Mapping[str, Data]) -> KnowledgeOperation:
    """Put computed values in the place of parameters."""
    if isinstance(operation, Update):
        name, value, meta = (filled_data(data, values) for data in (operation.name, operation.value, operation.meta))
        return Update(name, value, operation.layer, meta)
    filled = filled_data(operation, values)
    assert isinstance(filled, Query | Operation)
    return filled


_LONGEST: Final = 1e12
"""Seconds of a duration at most: a clock that shows so much still tells tenths of a millisecond apart."""
EFFECT_RETRIES: Final = 3
"""The default number of repetitions of a call with missing effects."""


def plain_values(values: Mapping[str, Data]) -> Environment:
    """Return the names of objects and the numbers among computed values: what arguments, conditions and effects can have."""
    plain = {name: data.value for name, data in values.items() if isinstance(data, Literal)}
    return {name: value for name, value in plain.items() if is_number(value) or (isinstance(value, str) and value[:1] != "?")}


def ground_action(step: CallStep, outer: Mapping[str, Data], facts: KnowledgeBase) -> GroundAction:
    """Return the action of the step, with its values for the parameters.

    In a chain of recovery, `outer` is what the call that recovers gives its parameters, with ``?``; `facts` are those at the beginning.
    Raises `InputError` if a fact is computed from a parameter that is not known in the plan.
    """
    given = {name: filled_data(value.data, outer) for name, value in step.given.items()}
    for name, data in given.items():
        if left := {parameter for part in parts(data) if isinstance(part, ValueOf) for parameter in parameters_in(part)}:
            message = f"{min(left)} is not known in the plan; a fact in a value needs the name of an object"
            raise InputError(message, step.given[name].position)
    env = plain_values({f"?{name}": data for name, data in given.items()})
    unbound = {name: data for name, data in outer.items() if name not in {variable.name for variable in step.action.schema.parameters}}
    operation = None if step.operation is None else filled_operation(step.operation, unbound)
    names = tuple(step.given) if step.action.is_open else step.action.schema.names
    if operation is not None and not step.action.is_open:  # of an action on knowledge, those that are used or given
        datas = (operation.name, operation.value, operation.meta) if isinstance(operation, Update) else (operation,)
        used = step.action.mentioned.union(*map(parameters_in, datas))
        names = tuple(name for name in names if name != OPERATION and (name in step.given or f"?{name}" in used))
    duration = step.duration
    fixed = next((constraint.bound for constraint in step.action.schema.duration or () if constraint.operation == "="), None)
    if duration is None and fixed is not None:  # by numbers that do not change or hold at the beginning
        seconds = value_of(fixed, facts, env)
        duration = float(seconds) if is_number(seconds) else None
    if duration is not None and not 0.0 <= duration <= _LONGEST:
        raise InputError(f"expected a duration from 0 to {_LONGEST:g} s, found {duration:g}", step.place.position)
    arguments = tuple(text_of(env.get(f"?{name}", f"?{name}")) for name in names)
    with located(step.place.position):
        action = ground_schema(step.action.schema, arguments, env, facts, duration, step.outcome)
    resources = tuple(dict.fromkeys((*step.action.resources, *step.resources)))
    return replace(
        action, parameters=names, given=tuple(given.items()), operation=operation, resources=resources, returns=step.action.returns
    )


def usual_recoveries(action: LanguageAction) -> tuple[Recovery, ...]:
    """Return the default recoveries of a call, for causes that neither the step nor the action handles.

    A call that was preempted counts as done, unless it would be believed to have effects that it may not have had; one whose
    effects are missing is repeated.
    """
    recoveries: list[Recovery] = []
    schema = action.schema
    has_effects = bool(schema.start_effects or schema.end_effects)
    if action.kind is not ActionKind.KB and not has_effects:
        recoveries.append(Recovery(frozenset({Cause.CANCELED}), Then.CONTINUE, EMPTY))
    if schema.expected != TRUE or schema.end_condition != TRUE or has_effects:
        recoveries.append(Recovery(frozenset({Cause.EFFECTS_MISSING}), Then.RETRY, EMPTY, EFFECT_RETRIES))
    return tuple(recoveries)


MAX_STEPS: Final = 10_000
"""Steps of a plan, those in the chains of recoveries included."""
MAX_NESTING: Final = 50


class PartEnds(NamedTuple):
    """The first and the last steps of a part: its sources and sinks."""

    first: tuple[int, ...]
    last: tuple[int, ...]


@dataclass
class _Region:
    """A flow that is being made. The mutable state is both lists."""

    outer: Mapping[str, Data]
    """In a chain of recovery, what the parameters of the call that recovers stand for."""
    depth: int
    recovering: tuple[str, ...]
    """The actions whose chains this is in."""
    steps: list[Step] = field(default_factory=list)
    orderings: list[Ordering] = field(default_factory=list)

    def grounded(self, condition: Condition) -> Condition:
        """Return a condition with the values of the call that recovers, where they are known in the plan."""
        env = plain_values(self.outer)
        return ground(condition, env) if env else condition


@dataclass
class PlanGraphBuilder:
    """Makes the graph of one plan. The mutable state is the number of steps so far, where calls stand, and which have recoveries.

    Recoveries of actions come from the domain, facts are those at the beginning; a plan may begin anew `restarts` times; where that is not
    said, once, or as often as a recovery that asks for it says.
    """

    recoveries: Callable[[LanguageAction], tuple[WrittenRecovery, ...]]
    facts: KnowledgeBase
    restarts: int | None = None
    _made: int = field(init=False, default=0)
    _positions: dict[int, Position] = field(init=False, default_factory=dict)
    _recovering: set[int] = field(init=False, default_factory=set)

    def graph(self, plan: StepList, goal: Condition = TRUE, rules: Rules = NO_RULES) -> PlanGraph:
        """Return the graph of a plan; raise `InputError` if it would be too large, or contradicts itself."""
        flow = self._flow(plan, _Region({}, 0, ()))
        steps = list(every_step(flow.steps))
        calls = [step.index for step in steps if isinstance(step, ActionCall)]
        others = [step.index for step in steps if not isinstance(step, ActionCall)]
        flow = _renumbered(flow, {old: new for new, old in enumerate((*calls, *others))})  # calls in the order in which they stand
        return PlanGraph(flow.steps, flow.orderings, goal, rules, restarts=self.restarts)

    def _flow(self, steps: StepList, region: _Region) -> Flow:
        """Return the flow of steps; a call whose start others wait for, or whose end waits itself, can only be tried again or fail."""
        self._ordered(steps.steps, region, in_sequence=True)
        special = {ordering.before.call for ordering in region.orderings if ordering.before.moment is Moment.START}
        special |= {ordering.after.call for ordering in region.orderings if ordering.after.moment is Moment.END}
        placed: list[Step] = []
        for step in region.steps:
            if step.index in special and isinstance(step, ActionCall) and step.recoveries:
                if step.index in self._recovering:
                    message = "a step with recoveries cannot have others wait for its start, nor its end wait for others"
                    raise InputError(message, self._positions[step.index])
                step = replace(step, recoveries=())
            placed.append(step)
        return Flow(tuple(placed), tuple(region.orderings))

    # --- blocks ---

    def _place(self, step: WrittenStep, region: _Region) -> PartEnds:
        """Put a step into the flow; return where it begins and ends there."""
        position = step.place.position
        if region.depth > MAX_NESTING:
            raise InputError(f"steps are nested deeper than {MAX_NESTING}", position)
        match step:
            case CallStep():
                return self._alone(self._call(step, region), region)
            case StepList(_, steps, is_concurrent):
                return self._ordered(steps, replace(region, depth=region.depth + 1), in_sequence=not is_concurrent)
            case BlockStep(_, condition, held, made):
                number = self._number(position)
                flows = [self._flow(inner, replace(region, depth=region.depth + 1, steps=[], orderings=[])) for inner in held]
                return self._alone(made(number, region.grounded(condition), *flows), region)
            case _:
                assert_never(step)

    def _ordered(self, steps: tuple[WrittenStep, ...], region: _Region, *, in_sequence: bool) -> PartEnds:
        """Put the steps of a list into the flow: in the order that ``after`` gives, or else in sequence or at the same time."""
        parts = [self._place(step, region) for step in steps]
        if any(step.place.after is not None or step.place.end_after for step in steps):
            parts = [part if part.first else self._junction(step.place.position, region) for part, step in zip(parts, steps, strict=True)]
            waits = _waits(steps, in_sequence=in_sequence)
        else:
            parts = [part for part in parts if part.first]
            waits = [(_After(number - 1),) if number and in_sequence else () for number in range(len(parts))]
        for part, before in zip(parts, waits, strict=True):
            plain = [parts[wait.step] for wait in before if wait.is_plain]
            self._link([last for earlier in plain for last in earlier.last], part.first, region)
            for wait in before:
                if not wait.is_plain:
                    earlier = parts[wait.step].last if wait.moment is Moment.END else parts[wait.step].first
                    own = part.first if wait.own is Moment.START else part.last
                    for first, second in product(earlier, own):
                        region.orderings.append(Ordering(PlanEvent(first, wait.moment), PlanEvent(second, wait.own), delay=wait.delay))
        waited = {wait.step for before in waits for wait in before if wait.moment is Moment.END}
        free = [part for part, before in zip(parts, waits, strict=True) if all(after.own is Moment.END for after in before)]
        return PartEnds(
            tuple(first for part in free for first in part.first),
            tuple(last for number, part in enumerate(parts) if number not in waited for last in part.last),
        )

    def _link(self, before: Sequence[int], after: Sequence[int], region: _Region) -> None:
        """Let all of the later steps wait for all of the earlier ones."""
        if len(before) > 1 and len(after) > 1:
            meeting = self._junction(None, region).first
            self._link(before, meeting, region)
            self._link(meeting, after, region)
        else:
            pairs = product(before, after)
            region.orderings += [Ordering(PlanEvent(first, Moment.END), PlanEvent(second, Moment.START)) for first, second in pairs]

    def _junction(self, position: Position | None, region: _Region) -> PartEnds:
        return self._alone(Junction(self._number(position)), region)

    def _alone(self, step: Step, region: _Region) -> PartEnds:
        region.steps.append(step)
        return PartEnds((step.index,), (step.index,))

    def _number(self, position: Position | None) -> int:
        self._made += 1
        if self._made > MAX_STEPS:
            raise InputError(f"the plan has more than {MAX_STEPS} steps, those of recoveries included", position)
        return self._made

    # --- calls ---

    def _call(self, step: CallStep, region: _Region) -> ActionCall:
        number = self._number(step.place.position)
        action = ground_action(step, region.outer, self.facts)
        own = {f"?{name}": data for name, data in action.given}
        written, recovering = step.recoveries, region.recovering
        if written is None:
            written = self.recoveries(step.action)
            if written and step.action.name in recovering:
                chain = ", which uses ".join((*recovering[recovering.index(step.action.name) :], step.action.name))
                message = f"to recover would never end: {chain}; give this step recoveries of its own, or none: 'recoveries: {{}}'"
                raise InputError(message, step.place.position)
            recovering = (*recovering, step.action.name)
        self._positions[number] = step.place.position
        if written:
            self._recovering.add(number)
        handled = frozenset[Cause]().union(*(recovery.causes for recovery in written))
        usual = (recovery for recovery in usual_recoveries(step.action) if handled.isdisjoint(recovery.causes))
        queries = {variable.name: Query(Literal.of(variable.name[1:]), Layer.ALL) for variable in step.action.schema.parameters}
        outer = {**queries, **own}  # the values of parameters in its chains: its own, or those that it will find
        recoveries: list[Recovery] = []
        for recovery in written:
            flow = self._flow(recovery.chain, _Region(outer, region.depth + 1, recovering))
            times = (self.restarts or 1 if recovery.then is Then.RESTART_PLAN else 1) if recovery.times is None else recovery.times
            when = TRUE if recovery.when is None else ground(recovery.when, plain_values(own))
            recoveries.append(Recovery(recovery.causes, recovery.then, flow, times, when))
        return ActionCall(
            number,
            action,
            recoveries=(*recoveries, *usual),
            release=step.release,
            latest_start=step.latest_start,
            deadline=step.deadline,
            timeout=step.timeout,
            retries=step.action.binding.retries if step.retries is None else step.retries,
            store=tuple(step.store.items()),
        )


@dataclass(frozen=True, slots=True)
class _After:
    """An ordering of two steps of a list: one waits for the other."""

    step: int
    moment: Moment = Moment.END
    """Of the other one."""
    delay: float = 0.0
    own: Moment = Moment.START
    """The steps that wait for it."""

    @property
    def is_plain(self) -> bool:
        """Whether its start waits for the end of the other, and for nothing more."""
        return self == _After(self.step)


def _waits(steps: tuple[WrittenStep, ...], *, in_sequence: bool) -> list[tuple[_After, ...]]:
    """Return the conditions of each step: in a sequence, if it names none, all before it that wait for no later one themselves."""
    numbers = {step.place.id: number for number, step in enumerate(steps) if step.place.id is not None}
    written: list[tuple[_After, ...]] = []
    for place in (step.place for step in steps):
        if late := next((wait for wait in place.end_after if wait.delay), None):
            raise InputError("an end cannot be delayed: it comes when the action's time is up", late.position)
        for wait in (*(place.after or ()), *place.end_after):
            if wait.moment is Moment.START and not isinstance(steps[numbers[wait.id]], CallStep):
                raise InputError(f"{wait.id!r} is no call; only the end of such a step can be waited for", wait.position)
        starts = (_After(numbers[wait.id], wait.moment, wait.delay) for wait in place.after or ())
        ends = (_After(numbers[wait.id], wait.moment, wait.delay, Moment.END) for wait in place.end_after)
        written.append(tuple(dict.fromkeys((*starts, *ends))))
    over: dict[int, list[int]] = {number: [] for number in range(len(steps) + 1)}  # the steps that can be over from this one on
    for number, last in enumerate(_last_waited_for(steps, written)):
        over[last + 1].append(number)
    waits: list[tuple[_After, ...]] = []
    unwaited, waited = dict[int, None](), set[int]()  # of these, those for whose end no other waits
    for number, step in enumerate(steps):
        waited.update(wait.step for earlier in over[number] for wait in waits[earlier] if wait.moment is Moment.END)
        unwaited |= dict.fromkeys(over[number])
        for earlier in waited & unwaited.keys():
            del unwaited[earlier]
        usual = map(_After, sorted(unwaited)) if step.place.after is None and in_sequence else ()
        waits.append((*usual, *written[number]))
    return waits


def _last_waited_for(steps: tuple[WrittenStep, ...], waits: Sequence[tuple[_After, ...]]) -> list[int]:
    """Return for each step the last one of the list that its end waits for, itself included; refuse steps that wait for each other."""
    graph: dict[tuple[int, Moment], set[tuple[int, Moment]]] = {}
    for number, before in enumerate(waits):
        graph |= {(number, Moment.START): set(), (number, Moment.END): {(number, Moment.START)}}
        for wait in before:
            graph[number, wait.own].add((wait.step, wait.moment))
    last: dict[tuple[int, Moment], int] = {}
    try:
        for event in TopologicalSorter(graph).static_order():
            last[event] = max((event[0], *(last[awaited] for awaited in graph[event])))
    except CycleError as error:
        cycle = list(dict.fromkeys(step for step, _ in error.args[1]))
        names = " < ".join(steps[n].place.id or f"the step in line {steps[n].place.position.line}" for n in (*cycle, cycle[0]))
        raise InputError(f"steps wait for each other: {names}", steps[cycle[0]].place.position) from error
    return [last[number, Moment.END] for number in range(len(steps))]


def _renumbered(flow: Flow, numbers: Mapping[int, int]) -> Flow:
    def moved(event: PlanEvent) -> PlanEvent:
        return PlanEvent(numbers[event.call], event.moment)

    steps = (step.renumbered(numbers[step.index], [_renumbered(held.flow, numbers) for held in step.held]) for step in flow.steps)
    orderings = (replace(ordering, before=moved(ordering.before), after=moved(ordering.after)) for ordering in flow.orderings)
    return Flow(tuple(steps), tuple(orderings))
