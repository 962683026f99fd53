"""The neutral plan: steps, and which event of which step must wait for which.

A step is a call of an action, or holds steps itself: a loop, a choice. It has two events, its start and its end. An ordering makes one
event come after another and names the facts that the order protects. Any partial order can be expressed this way, sequential and
time-triggered plans included. Planners make plans of calls alone; people write the rest. Knows nothing of PDDL or of nets.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from math import inf
from typing import Final, NamedTuple, Self, TypeAlias

from pnm.core import notebook
from pnm.core.logic.computed_values import Data, KnowledgeOperation
from pnm.core.logic.conditions import TRUE, Condition, ground, names
from pnm.core.logic.domain import ActionSchema
from pnm.core.logic.effects import Alternative, Effects, ground_effects, has_outcomes, names_written, outcomes
from pnm.core.logic.expressions import DURATION, Environment, Fluent, State, fluent_text
from pnm.core.logic.rules import NO_RULES, Rules
from pnm.core.machine.failure_causes import Cause
from pnm.core.net.net import reduced, topological_order
from pnm.core.resources import check_capacity
from pnm.errors import InputError, PnmError


class PlanGraphError(PnmError):
    """The orderings of a plan contradict each other, or it names a step that is not there."""


@dataclass(frozen=True, slots=True)
class GroundAction:
    """An action with objects for its parameters: what must hold, what it changes, how long it takes.

    An instantaneous PDDL action has no duration here; its precondition must hold at the start
    and its effects are there at the end, however long the robot takes.
    """

    name: str
    arguments: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    """The names of the arguments, without ``?``."""
    precondition: Condition = TRUE
    """Must hold when the action starts."""
    invariant: Condition = TRUE
    """Must hold all the time between start and end."""
    end_condition: Condition = TRUE
    """Must hold just before the end effects."""
    start_effects: Effects = ()
    end_effects: Effects = ()
    duration: float | None = None
    """Planned seconds from start to end; None when nothing is known about it."""
    expected: Condition = TRUE
    """Holds once the action is done; where it holds before, there is nothing to do. Effects are what is written besides."""
    given: tuple[tuple[str, Data], ...] = ()
    """Goal fields whose values the plan gives. An argument that begins with ``?`` has no value before the call starts."""
    operation: KnowledgeOperation | None = None
    """The operation on knowledge; no server is needed then."""
    resources: tuple[str, ...] = ()
    """Resources that the action has for itself while it is under way, such as an arm; ``{robot}`` stands for an argument."""
    returns: tuple[tuple[str, Data], ...] = ()
    """The answer of a simulated server: result fields, computed from the goal and from the world at the end."""
    outcomes: tuple[Alternative, ...] = ()
    """Every way in which it may turn out, with all effects of its end; empty if there is only one."""
    outcome: str = ""
    """The name of the one that the plan expects, whose effects are the end effects."""

    @property
    def possible_effects(self) -> Effects:
        """All effects that its end may have: those of every outcome."""
        return tuple([effect for way in self.outcomes for effect in way.effects]) if self.outcomes else self.end_effects

    def __str__(self) -> str:
        return f"{self.name}({', '.join(self.arguments)})"


def ground_schema(
    schema: ActionSchema, arguments: tuple[str, ...], env: Environment, state: State, duration: float | None = None, outcome: str = ""
) -> GroundAction:
    """Substitute values for the parameters of a schema; those without a value in `env`, by parameter with ``?``, stay.

    The arguments say how the values are written. Outcomes may differ for the objects of the state; the first one is expected, or the one
    of this name. Raises an `InputError` if there is no such outcome, or there are too many.
    """
    if duration is not None:
        env = {**env, DURATION[0]: duration}
    end_effects = ground_effects(schema.end_effects, env)
    ways = outcomes(end_effects, state) if has_outcomes(end_effects) else ()
    expected = next((way for way in ways if not outcome or way.name == outcome), None)
    if outcome and expected is None:
        raise InputError(f"{schema.name} has no outcome {outcome!r}; it has {', '.join(way.name for way in ways) or 'only one'}")
    return GroundAction(
        name=schema.name,
        arguments=arguments,
        parameters=schema.names,
        precondition=ground(schema.precondition, env),
        invariant=ground(schema.invariant, env),
        end_condition=ground(schema.end_condition, env),
        start_effects=ground_effects(schema.start_effects, env),
        end_effects=expected.effects if expected else end_effects,
        duration=duration,
        expected=ground(schema.expected, env),
        outcomes=ways if len(ways) > 1 else (),
        outcome=expected.name if expected and len(ways) > 1 else "",
    )


class Then(Enum):
    """The end of a recovery."""

    RETRY = "retry"
    """The call begins anew, with all of its checks."""
    CONTINUE = "continue"
    """As if the request had succeeded: effects are checked."""
    SKIP = "skip_action"
    """The call is done, whatever its effects."""
    FAIL = "fail"
    REPLAN = "replan"
    """The call fails, and a planner shall find another way."""
    RESTART_PLAN = "restart_plan"
    """Everything else is brought to an end, then the plan begins anew."""

    def is_last(self, *, chain: bool) -> bool:
        """Return whether no other recovery for its cause can come after one that ends so, with or without a chain."""
        return self in (Then.SKIP, Then.FAIL, Then.REPLAN) or (self is Then.CONTINUE and not chain)


@dataclass(frozen=True, slots=True)
class Recovery:
    """Recovery from some causes: a chain of steps, and how to go on after them."""

    causes: frozenset[Cause]
    then: Then
    chain: Flow
    times: int = 1
    """The number of uses each time the call is reached; after that the call fails."""
    when: Condition = TRUE
    """For `Cause.BEFORE` and `Cause.AFTER`."""


@dataclass(frozen=True, slots=True)
class ActionCall:
    """One occurrence of a ground action in a plan, named by its number."""

    index: int
    action: GroundAction
    planned: float = 0.0
    """Seconds after the moment the plan starts from at which its planner had the call start."""
    release: float = 0.0
    """Seconds after that moment before which the call must not start."""
    latest_start: float = inf
    """Seconds after that moment by which the call must have been sent."""
    deadline: float = inf
    """Seconds after that moment by which the call must have ended."""
    lasting: frozenset[Fluent] = frozenset()
    """Fluents written at the start that are still the action's own doing when it ends."""
    recoveries: tuple[Recovery, ...] = ()
    """Those for a cause are used in their order; without any, the call is tried again as often as it may be."""
    timeout: float | None = None
    """In place of the binding's."""
    retries: int | None = None
    """In place of the binding's."""
    store: tuple[tuple[str, str], ...] = ()
    """Result fields and the variables they are stored in, or the fluents that they set, where this differs from the binding."""
    under_way: bool = False
    """Its request has been sent by another run, and was accepted; it is taken over as it is."""

    @property
    def earliest(self) -> float:
        """Seconds after that moment before which its start waits; a call that is under way has started."""
        return 0.0 if self.under_way else self.release

    @property
    def held(self) -> tuple[Held, ...]:
        """The chains of its recoveries."""
        return tuple(
            [
                Held(one.chain, f"after {', '.join(sorted(one.causes))}; then {one.then.value}", is_repeated=one.times > 1)
                for one in self.recoveries
            ]
        )

    def renumbered(self, index: int, flows: Sequence[Flow]) -> ActionCall:
        """Return the same with another number, and with these flows in place of those that it holds."""
        recoveries = zip(self.recoveries, flows, strict=True)
        return replace(self, index=index, recoveries=tuple([replace(one, chain=chain) for one, chain in recoveries]))

    def __str__(self) -> str:
        return f"{self.action}#{self.index}"


class Held(NamedTuple):
    """Steps that a step holds."""

    flow: Flow
    when: str
    """The condition for carrying them out, in words."""
    is_repeated: bool = False
    """They may be entered again although the step is not."""


@dataclass(frozen=True, slots=True)
class Loop:
    """Steps that are repeated as long as a condition holds."""

    index: int
    condition: Condition
    body: Flow
    limit: int
    """Rounds at most, each time the loop is reached; it fails when the condition still holds then."""

    @property
    def held(self) -> tuple[Held, ...]:
        """Its body."""
        return (Held(self.body, f"is repeated while {self.condition}, {self.limit} times at most", is_repeated=True),)

    @property
    def ways(self) -> Mapping[bool, Flow]:
        """The steps that are entered for each truth of its condition."""
        return {False: EMPTY}

    def renumbered(self, index: int, flows: Sequence[Flow]) -> Loop:
        """Return the same with another number, and with these flows in place of those that it holds."""
        (body,) = flows
        return replace(self, index=index, body=body)

    def __str__(self) -> str:
        return f"while({self.condition})#{self.index}"


@dataclass(frozen=True, slots=True)
class Choice:
    """Steps that are done if a condition holds, and others that are done if not."""

    index: int
    condition: Condition
    then: Flow
    otherwise: Flow

    @property
    def held(self) -> tuple[Held, ...]:
        """Both branches."""
        return Held(self.then, f"if {self.condition}"), Held(self.otherwise, "otherwise")

    @property
    def ways(self) -> Mapping[bool, Flow]:
        """The steps that are entered for each truth of its condition."""
        return {True: self.then, False: self.otherwise}

    def renumbered(self, index: int, flows: Sequence[Flow]) -> Choice:
        """Return the same with another number, and with these flows in place of those that it holds."""
        then, otherwise = flows
        return replace(self, index=index, then=then, otherwise=otherwise)

    def __str__(self) -> str:
        return f"if({self.condition})#{self.index}"


@dataclass(frozen=True, slots=True)
class _Plain:
    """A step that holds no others."""

    index: int

    @property
    def held(self) -> tuple[Held, ...]:
        """Nothing."""
        return ()

    def renumbered(self, index: int, flows: Sequence[Flow]) -> Self:
        """Return the same with another number."""
        return replace(self, index=index)


@dataclass(frozen=True, slots=True)
class WaitUntil(_Plain):
    """Nothing is done until a condition holds."""

    condition: Condition
    limit: float
    """Seconds after which the step fails if the condition does not hold."""

    @property
    def ways(self) -> Mapping[bool, Flow]:
        """The steps that are entered for each truth of its condition."""
        return {True: EMPTY}

    def __str__(self) -> str:
        return f"wait_until({self.condition})#{self.index}"


@dataclass(frozen=True, slots=True)
class Junction(_Plain):
    """Nothing to do: where several branches meet before several others begin."""

    def __str__(self) -> str:
        return f"meet#{self.index}"


Conditional: TypeAlias = Loop | Choice | WaitUntil
"""Steps that are carried out in a way that their condition decides."""
Step: TypeAlias = ActionCall | Conditional | Junction


def step_words(step: Step) -> str:
    """Return a step in words, a call without its number."""
    return str(step.action if isinstance(step, ActionCall) else step)


@dataclass(frozen=True, slots=True)
class Flow:
    """Steps, and orderings between their events."""

    steps: tuple[Step, ...] = ()
    orderings: tuple[Ordering, ...] = ()

    def __str__(self) -> str:
        return f"{len(self.steps)} steps, {len(self.orderings)} orderings"


EMPTY: Final = Flow()


def flows(step: Step) -> tuple[Flow, ...]:
    """Return the contents of the step."""
    return tuple([held.flow for held in step.held])


def every_step(steps: Iterable[Step]) -> Iterator[Step]:
    """Yield the steps and all that they hold, outer ones first."""
    waiting = [*steps]
    waiting.reverse()
    while waiting:
        step = waiting.pop()
        yield step
        waiting += reversed([inner for flow in flows(step) for inner in flow.steps])


class Moment(Enum):
    """The two events of a step."""

    START = "start"
    END = "end"

    __hash__ = object.__hash__  # each is there once; plans are walked through by their events all the time


class PlanEvent(NamedTuple):
    """The start or the end of a step."""

    call: int
    """The number of the step, which most often is a call."""
    moment: Moment

    def __str__(self) -> str:
        return f"{self.moment.value} of #{self.call}"


@dataclass(frozen=True, slots=True)
class Ordering:
    """`after` waits for `before`."""

    before: PlanEvent
    after: PlanEvent
    protects: tuple[Fluent, ...] = ()
    """The facts for whose sake the order must be kept."""
    delay: float = 0.0
    """Seconds that `after`, which is then a start, must come later than `before`, at least."""

    def __str__(self) -> str:
        reason = f" ({', '.join(map(fluent_text, self.protects))})" if self.protects else ""
        delay = f" + {self.delay:g} s" if self.delay else ""
        return f"{self.before}{delay} < {self.after}{reason}"


@dataclass(frozen=True)
class PlanGraph:
    """Steps, orderings between their events, and the goal that holds after all of them.

    All calls, those inside other steps included, are numbered from 0 in the order in which they stand; all other
    steps have the numbers after that.

    Raises:
        PlanGraphError: the numbers are not so, an ordering names a step that does not stand beside its own, the
            orderings form a cycle, what others wait for cannot be said of such a step, or a wait is not finite.
        CapacityError: a resource is for no call at all.
    """

    steps: tuple[Step, ...]
    orderings: tuple[Ordering, ...] = ()
    goal: Condition = TRUE
    rules: Rules = NO_RULES
    """The rules for derived facts in its conditions."""
    due: float = 0.0
    """Seconds after the moment the plan starts from before which the goal is not looked at: time itself does the last part."""
    capacities: Mapping[str, int] = field(default_factory=dict)
    """The number of calls that may share a resource; one for those not listed."""
    restarts: int | None = None
    """The number of times that it may begin anew by any recovery; by default that of the recovery that may ask most often."""

    def __post_init__(self) -> None:
        outermost, waiting = {step.index for step in self.steps}, {ordering.after for ordering in self.orderings}
        for position, call in enumerate(self.calls):
            if call.index != position:
                raise PlanGraphError(f"{call} stands at position {position}")
            if not (0.0 <= call.release < inf and 0.0 <= (call.timeout or 0.0) < inf):
                raise PlanGraphError(f"{call} would wait for {call.release} or {call.timeout} seconds; expected numbers from 0")
            if call.under_way and (PlanEvent(position, Moment.START) in waiting or position not in outermost):
                raise PlanGraphError(f"{call} is under way: it cannot wait for others, or be part of another step")
        if not 0.0 <= self.due < inf:
            raise PlanGraphError(f"the goal would wait for {self.due} seconds; expected a number from 0")
        for name, capacity in self.capacities.items():
            check_capacity(name, capacity)
        others = [step.index for step in self.every_step if not isinstance(step, ActionCall)]
        if sorted(others) != [*range(len(self.calls), len(self.calls) + len(others))]:
            raise PlanGraphError("the steps that are not calls are numbered after the calls, each once")
        _check_orderings(self.flow)
        self.order  # noqa: B018  (worked out now, for it raises what is wrong)
        for flow in (inner for step in self.every_step for inner in flows(step)):
            _check_orderings(flow)
            in_order(flow)

    @property
    def flow(self) -> Flow:
        """The outermost steps and their orderings."""
        return Flow(self.steps, self.orderings)

    @cached_property
    def every_step(self) -> tuple[Step, ...]:
        """All steps, those inside others included."""
        return tuple(every_step(self.steps))

    @cached_property
    def restart_limit(self) -> int:
        """The number of times that it may begin anew; 0 if no recovery asks for that."""
        recoveries = (recovery for call in self.calls for recovery in call.recoveries if recovery.then is Then.RESTART_PLAN)
        most = max((recovery.times for recovery in recoveries), default=0)
        return most if self.restarts is None else min(most, 1) * self.restarts

    @cached_property
    def calls(self) -> tuple[ActionCall, ...]:
        """All calls, by number."""
        return tuple(step for step in self.every_step if isinstance(step, ActionCall))

    @cached_property
    def waits_for(self) -> tuple[tuple[int, ...], ...]:
        """For every call, the calls that it directly waits for with its start or its end."""
        found: list[dict[int, None]] = [{} for _ in self.calls]
        for before, after in ((ordering.before.call, ordering.after.call) for ordering in self.orderings):
            if max(before, after) < len(found):
                found[after][before] = None
        return tuple(map(tuple, found))

    @cached_property
    def used_by(self) -> dict[str, set[int]]:
        """For predicates and functions, the numbers of the calls that read or write them; the goal counts as one more call.

        In place of derived ones stand those they follow from.
        """
        used: dict[str, set[int]] = {}
        for call in self.calls:
            action = call.action
            read = names(action.precondition) | names(action.invariant) | names(action.end_condition)
            for name in self.rules.base(read) | names_written((*action.start_effects, *action.possible_effects)):
                used.setdefault(name, set()).add(call.index)
        for name in self.rules.base(names(self.goal)):
            used.setdefault(name, set()).add(len(self.calls))
        return used

    @cached_property
    def order(self) -> tuple[PlanEvent, ...]:
        """All outermost events in an order that keeps every start before its end and every ordering."""
        return in_order(self.flow)

    def _repr_svg_(self) -> str | None:
        return notebook.PLAN.draw(self)

    def __repr__(self) -> str:
        return f"<PlanGraph {len(self.calls)} calls, {len(self.orderings)} orderings>"


def necessary(flow: Flow) -> tuple[Ordering, ...]:
    """Return the orderings that do not follow from others; all that have a delay are among them."""
    position = {event: number for number, event in enumerate(in_order(flow))}
    own = {(position[PlanEvent(step.index, Moment.START)], position[PlanEvent(step.index, Moment.END)]) for step in flow.steps}
    pairs = [(position[ordering.before], position[ordering.after]) for ordering in flow.orderings]
    directly = reduced(len(position), [*own, *pairs])
    known = own | {pair for ordering, pair in zip(flow.orderings, pairs, strict=True) if ordering.delay}
    found: list[Ordering] = []
    for ordering, (first, second) in zip(flow.orderings, pairs, strict=True):
        if ordering.delay or (first in directly[second] and (first, second) not in known):
            known.add((first, second))
            found.append(ordering)
    return tuple(found)


def _check_orderings(flow: Flow) -> None:
    beside = {step.index: step for step in flow.steps}
    for ordering in flow.orderings:
        for event, special in ((ordering.before, Moment.START), (ordering.after, Moment.END)):
            if (step := beside.get(event.call)) is None:
                raise PlanGraphError(f"{ordering} names a step that is not in the plan, or not beside the other")
            if event.moment is special and (not isinstance(step, ActionCall) or step.recoveries):
                raise PlanGraphError(f"{ordering} speaks of the {special.value} of a step that is no call, or has recoveries of its own")
        if not 0.0 <= ordering.delay < inf:
            raise PlanGraphError(f"{ordering} would wait for {ordering.delay} seconds; expected a number from 0")
        if ordering.delay and ordering.after.moment is Moment.END:
            raise PlanGraphError(f"{ordering} would delay an end, which comes when the action's time is up")


def in_order(flow: Flow) -> tuple[PlanEvent, ...]:
    """Return the events of the steps in an order that keeps starts before ends and all orderings; `PlanGraphError` if there is none."""
    events = [PlanEvent(step.index, moment) for step in flow.steps for moment in (Moment.START, Moment.END)]
    starts = {step.index: 2 * number for number, step in enumerate(flow.steps)}
    before: list[list[int]] = [[number - 1] if number % 2 else [] for number in range(len(events))]
    for ordering in flow.orderings:
        (earlier, moment), (later, its_moment) = ordering.before, ordering.after
        before[starts[later] + (its_moment is Moment.END)].append(starts[earlier] + (moment is Moment.END))
    found = topological_order(before)
    if len(found) < len(events):
        try:
            TopologicalSorter({events[number]: [events[one] for one in earlier] for number, earlier in enumerate(before)}).prepare()
        except CycleError as error:
            raise PlanGraphError(f"the orderings form a cycle: {' < '.join(map(str, error.args[1]))}") from error
    return tuple([events[number] for number in found])
