"""Content of the calls: does the net of each call do what its action, its binding and its plan ask of it?

That a machine is sound says nothing of what it asks before it sends, of what it watches, of what it holds and of how often it tries. Here
the net of every call is compared with its `CallTerms`. Nothing is taken from the block that the net was made by, or from what templates
are kept by: the places of a call are told apart by what happens at them (`CallNet`). A request is sent at a *ready* place; it is then
*unanswered*, *under way* from its acceptance on, and *being cancelled* wherever it may be alive else.

Who designs the block of a call keeps the rules `CallRule`. Each is a row of `WATCHES` or one of `traits`, and is named when it is broken.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile
from math import inf, isfinite
from typing import Any, Final, NamedTuple, TypeAlias

from pnm.core.logic.conditions import TRUE
from pnm.core.machine import guards
from pnm.core.machine.bindings import WhenLost
from pnm.core.machine.call_block import CallTerms, is_direct
from pnm.core.machine.failure_causes import ASKED, Cause
from pnm.core.machine.guards import Guard, Rule
from pnm.core.machine.machine import PetriNetMachine, Region
from pnm.core.machine.plan_graph import ActionCall, Moment, PlanGraph, Recovery, Step, Then, flows, necessary
from pnm.core.machine.requests import OutcomeKind, TransitionAction
from pnm.core.machine.step_block import PORTS, Context, Port
from pnm.core.machine.verification.part import CallRule, Unsound
from pnm.core.net.net import Weights

RESOURCES: Final = PORTS.index(Port.RESOURCES)
_NOWHERE: Final = frozenset[str]()
_ASIDE: Final = (guards.Ending, guards.Failing, guards.Withheld)
"""Guards of ways out that are there whatever a recovery says."""


# --- what is asked ---------------------------------------------------------------------------


class Asked(CallTerms):
    """All that is asked of one call: its terms, and what the orderings of the plan make of it."""

    def __init__(self, context: Context, call: ActionCall, *, announces: bool, awaited: bool, delayed: bool) -> None:
        super().__init__(context, call, ())
        self.announces, self.awaited, self.delayed = announces, awaited, delayed
        """Whether others wait for its start, its end waits for others, and its start must come later than others, by some time."""

    @property
    def is_timed(self) -> bool:
        """Whether its start waits for a time."""
        return self.delayed or self.step.earliest > 0

    @cached_property
    def is_made(self) -> bool:
        """Whether it is made even if there is nothing to do."""
        return self.must_happen(relied_on=self.announces or self.awaited)

    @cached_property
    def resources(self) -> tuple[str, ...]:
        """The resources that it has for itself."""
        return self.context.bindings.resources(self.step.action)

    @property
    def kind(self) -> Hashable:
        """All of it but times, names, steps that it holds, and conditions, apart from those of recoveries.

        Calls of one kind are asked the same, but for the guards of `WATCHES`.
        """
        step, binding = self.step, self.binding
        return (
            *(self.announces, self.awaited, self.is_timed, self.is_made, bool(self.resources)),
            *(step.under_way, step.latest_start < inf, step.deadline < inf, step.action.invariant != TRUE),
            *(self.asks_at_its_end, self.may_turn_out, self.retries, binding.accept, binding.cancel, binding.when_lost),
            *(self.context.repeated, self.context.starts_anew),
            *((one.causes, one.then, one.times, one.when, bool(one.chain.steps)) for one in step.recoveries),
        )

    @cached_property
    def recoveries(self) -> Mapping[Cause, object]:
        """For each cause that the plan has recoveries for, how the call goes on, as `CallNet.course` says it."""
        lists: dict[Cause, list[Recovery]] = {}
        for recovery in self.step.recoveries:
            for cause in recovery.causes:
                lists.setdefault(cause, []).append(recovery)
        return {
            cause: [(guards.ConditionTrue(one.when), _asked_course(found[number:])) for number, one in enumerate(found)]
            if cause in ASKED
            else _asked_course(found)
            for cause, found in lists.items()
        }


def _asked_course(recoveries: Sequence[Recovery]) -> object:
    """Return the continuation of a call with these recoveries, in turn."""
    if is_direct(recoveries[0]):
        return recoveries[0].then
    options = [(one.when if number else TRUE, one) for number, one in enumerate(recoveries)]  # the first is used without asking
    return tuple(
        (when, 0, None, one.then) if is_direct(one) else (when, one.times, frozenset(step.index for step in one.chain.steps), one.then)
        for when, one in options
    )


class AskedOf:
    """The requirements of the calls of a machine."""

    def __init__(self, machine: PetriNetMachine) -> None:
        plan, bindings = machine.plan, machine.bindings
        starts_anew = plan.restart_limit > 0
        self._once, self._often = (Context(plan, bindings, starts_anew, repeated) for repeated in (starts_anew, True))
        self._again = frozenset[int]() if starts_anew else frozenset(_reached_again(plan))
        orderings = [one for flow in (plan.flow, *(flow for step in plan.every_step for flow in flows(step))) for one in necessary(flow)]
        self._announce = {one.before.call for one in orderings if one.before.moment is Moment.START}
        self._delay = {one.after.call for one in orderings if one.delay}
        self._await = {one.after.call for one in orderings if one.after.moment is Moment.END}

    def __call__(self, call: ActionCall) -> Asked:
        """Return the requirements of a call."""
        number = call.index
        context = self._often if number in self._again else self._once
        announces, awaited, delayed = (number in some for some in (self._announce, self._await, self._delay))
        return Asked(context, call, announces=announces, awaited=awaited, delayed=delayed)


def _reached_again(plan: PlanGraph) -> Iterator[int]:
    """Yield the steps that may be reached again after they were left: in loops, and in chains that are used more than once."""
    waiting: list[tuple[Step, bool]] = [(step, False) for step in plan.steps]
    while waiting:
        step, again = waiting.pop()
        if again:
            yield step.index
        waiting += [(inner, again or held.is_repeated) for held in step.held for inner in held.flow.steps]


# --- what is there ----------------------------------------------------------------------------


_Compared: TypeAlias = tuple[CallRule, object, object]
"""A rule, the requirement, and the finding."""


@dataclass(frozen=True, kw_only=True)
class CallNet:
    """The net of one call, whose places are told apart by what happens at them."""

    names: Sequence[str]
    """Of its transitions, in their order."""
    rules: Sequence[Rule]
    inputs: Sequence[Weights]
    outputs: Sequence[Weights]
    failures: Collection[str]
    restarts: Collection[str]
    counters: Mapping[str, int]
    """Its counters, and the tokens that they begin with."""
    resources: Mapping[str, str]
    """All resources that it takes or gives, or may."""
    between: Collection[str]
    """Places between it and other steps."""
    alive_places: Collection[str]
    """Those that are said to be places of a call that is under way."""
    held: Sequence[Region]
    """Around the chains of its recoveries."""

    # --- the token of the call ------------------------------------------------------------------

    @cached_property
    def sources(self) -> list[frozenset[str]]:
        """The places at which each transition finds the token of the call."""
        return [*map(self.own, self.inputs)]

    @cached_property
    def targets(self) -> list[frozenset[str]]:
        """The places at which each transition puts the token of the call."""
        return [*map(self.own, self.outputs)]

    @cached_property
    def exits(self) -> Mapping[str, list[int]]:
        """For every place of the token, the transitions that take it from there, in their order."""
        found: dict[str, list[int]] = {}
        for number, places in enumerate(self.sources):
            for place in places:
                found.setdefault(place, []).append(number)
        return found

    def own(self, places: Iterable[str]) -> frozenset[str]:
        """Return those of some places that are for the token of the call."""
        others = self.failures, self.restarts, self.counters, self.resources, self.between
        return frozenset(place for place in places if not any(place in some for some in others))

    def where(self, is_one: Callable[[Rule], bool]) -> list[int]:
        """Return the transitions with some rule."""
        return [number for number, rule in enumerate(self.rules) if is_one(rule)]

    def after(self, numbers: Iterable[int]) -> frozenset[str]:
        """Return where the token is after one of these transitions."""
        return _NOWHERE.union(*(self.targets[number] for number in numbers))

    def fails(self, number: int) -> bool:
        """Return whether a transition marks a failure."""
        return any(place in self.failures for place in self.outputs[number])

    def counts(self, number: int) -> Mapping[str, int]:
        """Return the counters that a transition moves a token between, and the tokens that they begin with."""
        taken, given = ([place for place in arcs[number] if place in self.counters] for arcs in (self.inputs, self.outputs))
        return {place: self.counters[place] for place in (*taken, *given)} if given else {}

    def counted(self, number: int) -> int:
        """Return the number of times that the transition may fire by its counter; 0 if it counts nothing."""
        return sum(self.counts(number).values())

    # --- the life of its request ----------------------------------------------------------------

    @cached_property
    def ready(self) -> frozenset[str]:
        """The places where a request is sent."""
        return _NOWHERE.union(*(self.sources[number] for number in self.where(_sends)))

    @cached_property
    def unanswered(self) -> frozenset[str]:
        """The places where it was sent, and its server has not answered."""
        return self.after(self.where(_sends))

    @cached_property
    def under_way(self) -> frozenset[str]:
        """The places where it was accepted."""
        return self.after(self.where(_is(guards.Accepts, guards.Adopted)))

    @cached_property
    def alive(self) -> frozenset[str]:
        """The places where it may be alive: until its end is reported or it is given up."""
        found, waiting = set[str](), [*self.unanswered, *self.under_way]
        while waiting:
            if (place := waiting.pop()) not in found:
                found.add(place)
                goes_on = (one for one in self.exits.get(place, ()) if not (self.rules[one].gives_up or _ends(self.rules[one])))
                waiting += self.after(goes_on)
        return frozenset(found)

    @cached_property
    def cancelled(self) -> frozenset[str]:
        """The places where it is being cancelled."""
        return self.alive - self.unanswered - self.under_way

    @cached_property
    def looking(self) -> frozenset[str]:
        """The places where the effects of a success are awaited."""
        return _NOWHERE.union(*(self.sources[number] for number in self.where(_is(guards.EffectsSeen))))

    @cached_property
    def late(self) -> frozenset[str]:
        """The places of the token once its end has waited for others, whose places were looked at."""
        return self.after(
            number for number, arcs in enumerate(self.inputs) if any(one in self.between and one in self.outputs[number] for one in arcs)
        )

    def before_sending(self) -> list[list[int]]:
        """Return for each ready place its exits that are asked before what sends."""
        return [[*takewhile(lambda number: not _sends(self.rules[number]), self.exits[place])] for place in self.ready]

    # --- recoveries -----------------------------------------------------------------------------

    def course(self, outputs: Iterable[str]) -> object:
        """Return the continuation of the call where these places are marked: its end and recoveries, or None for another attempt."""
        places = [*outputs]
        if any(place in self.restarts for place in places):
            return Then.RESTART_PLAN
        (place, *others), is_failed = self.own(places) or ("",), any(place in self.failures for place in places)
        exits = self.exits.get(place, ())
        if place in self.ready:
            return Then.RETRY
        if is_failed or others or not exits:
            return Then.FAIL
        if place in self.looking or any(self.rules[number].action is TransitionAction.FINISH for number in exits):
            return Then.CONTINUE
        ways = [number for number in exits if not isinstance(self.rules[number].guard, _ASIDE)]
        options = [number for number in ways if self.entered(number) or not any(one in self.counters for one in self.inputs[number])]
        if any(map(self.entered, options)):
            return tuple(map(self._option, options))
        return None if all(self.targets[number] for number in ways) else Then.SKIP

    def entered(self, number: int) -> list[Region]:
        """Return the chains that a transition leads into."""
        return [chain for chain in self.held if self.outputs[number].keys() >= {*chain.first}]

    def _option(self, number: int) -> object:
        guard = self.rules[number].guard
        condition = guard.condition if isinstance(guard, guards.ConditionTrue) else TRUE
        for chain in self.entered(number):
            return condition, self.counted(number), chain.steps, self.ends_of(chain)
        return condition, 0, None, self.course(self.outputs[number])

    def ends_of(self, chain: Region) -> object:
        """Return the continuation of the call after a chain."""
        taking = (number for number, arcs in enumerate(self.inputs) if arcs.keys() >= {*chain.last})
        exits = (number for place in self.after(taking) for number in self.exits.get(place, ()))
        ways = [number for number in exits if not isinstance(self.rules[number].guard, _ASIDE)]
        found = [Then.REPLAN if self.rules[number].replans else self.course(self.outputs[number]) for number in ways]
        return found[0] if len(found) == 1 else found


def _is(*kinds: type[Any]) -> Callable[[Rule], bool]:
    return lambda rule: isinstance(rule.guard, kinds)


def _sends(rule: Rule) -> bool:
    return rule.action is TransitionAction.SEND


_ends: Final = _is(guards.Ends)


def _ends_lost(rule: Rule) -> bool:
    return isinstance(rule.guard, guards.Ends) and OutcomeKind.LOST in rule.guard.kinds


# --- the rules --------------------------------------------------------------------------------


class WatchedPlaces(NamedTuple):
    """A guard that is asked at all places of a kind, and may differ from call to call."""

    rule: CallRule
    exits: Callable[[CallNet], Iterable[list[int]]]
    """For each of the places, the exits among which it is."""
    is_one: Callable[[Rule], bool]
    asked: Callable[[Asked], Guard | None]
    """The guard; None if there is none."""
    does: Callable[[Rule, bool], bool] = lambda rule, fails: True
    """Whether a rule does what it must, given whether it marks a failure."""

    def is_kept(self, net: CallNet, number: int) -> bool:
        """Return whether a transition with the guard waits for nothing else, but for resources, and does what it must."""
        waits_for = sum(place not in net.resources for place in net.inputs[number])
        return waits_for == 1 and self.does(net.rules[number], net.fails(number))


def _at(places: Callable[[CallNet], Iterable[str]]) -> Callable[[CallNet], Iterable[list[int]]]:
    return lambda net: [net.exits.get(place, []) for place in places(net)]


def _due(seconds: float) -> Guard | None:
    return guards.Due(seconds) if isfinite(seconds) else None


def _cancels(rule: Rule, fails: bool) -> bool:
    return rule.action is TransitionAction.CANCEL and not fails


def _cancels_and_fails(rule: Rule, fails: bool) -> bool:
    return rule.action is TransitionAction.CANCEL and fails


_UNDER_WAY: Final = _at(lambda net: net.under_way)
_IS_AFTER: Final = _is(guards.After)
WATCHES: Final = (
    WatchedPlaces(CallRule.DATA, CallNet.before_sending, _is(guards.DataMissing), lambda call: guards.DataMissing(call.step.index)),
    WatchedPlaces(CallRule.LATEST_START, CallNet.before_sending, _is(guards.Due), lambda call: _due(call.latest)),
    WatchedPlaces(CallRule.PRECONDITION, _at(lambda net: net.ready), _sends, lambda call: guards.ConditionTrue(call.may_start)),
    WatchedPlaces(CallRule.ANSWER, _at(lambda net: net.unanswered), _IS_AFTER, lambda call: guards.After(call.binding.accept), _cancels),
    WatchedPlaces(
        CallRule.OVER_ALL,
        _UNDER_WAY,
        _is(guards.InvariantFalse),
        lambda call: None if (over_all := call.step.action.invariant) == TRUE else guards.InvariantFalse(over_all),
        _cancels_and_fails,
    ),
    WatchedPlaces(CallRule.DEADLINE, _UNDER_WAY, _is(guards.Due), lambda call: _due(call.step.deadline), _cancels_and_fails),
    WatchedPlaces(CallRule.TIME_LIMIT, _UNDER_WAY, _IS_AFTER, lambda call: guards.After(call.timeout), _cancels),
    WatchedPlaces(
        CallRule.CANCELLING,
        _at(lambda net: net.cancelled),
        _IS_AFTER,
        lambda call: guards.After(call.binding.cancel),
        lambda rule, fails: rule.gives_up,
    ),
)


def traits(net: CallNet, call: Asked) -> Iterator[_Compared]:
    """Yield what is asked and what is found of a call besides `WATCHES`."""
    yield from _before_its_request(net, call)
    yield from _while_it_may_be_alive(net, call)
    yield from _after_its_request(net, call)


def _before_its_request(net: CallNet, call: Asked) -> Iterator[_Compared]:
    inner = _NOWHERE.union(*(chain.last for chain in net.held))
    entering = [number for number, arcs in enumerate(net.inputs) if not net.sources[number] and inner.isdisjoint(arcs)]
    waits = (net.rules[number].guard for number in entering)
    yield CallRule.TIMES, {call.is_timed}, {isinstance(guard, guards.Due) for guard in waits if not isinstance(guard, guards.Ending)}
    yield CallRule.ATTEMPTS, 2 if call.announces else 1, len(net.ready)
    yield CallRule.ADOPTED, call.step.under_way, bool(net.where(_is(guards.Adopted)))
    is_looked_at = {any(isinstance(net.rules[one].guard, guards.AlreadyTrue) for one in exits) for exits in net.before_sending()}
    yield CallRule.ALREADY_TRUE, {not call.is_made}, is_looked_at


def _while_it_may_be_alive(net: CallNet, call: Asked) -> Iterator[_Compared]:
    watched = net.unanswered | net.under_way
    leaving = {number for place in watched for number in net.exits.get(place, ()) if not net.targets[number].isdisjoint(net.cancelled)}
    yield CallRule.CANCELLING, set(), {net.names[number] for number in leaving if net.rules[number].action is not TransitionAction.CANCEL}
    held = net.alive if call.asks_at_its_end else net.alive | (net.looking - net.late)
    yield CallRule.RESOURCES, held, net.alive_places
    every = dict.fromkeys(call.resources, 1)
    asked: dict[str, object] = {}
    found: dict[str, object] = {}
    for number, name in enumerate(net.names):
        was_held, is_held = (not held.isdisjoint(places[number]) for places in (net.sources, net.targets))
        moved = every if is_held > was_held else {}, every if was_held > is_held else {}
        moves = tuple(
            {net.resources[one]: weight for one, weight in arcs[number].items() if one in net.resources}
            for arcs in (net.inputs, net.outputs)
        )
        if moved != moves:
            asked[name], found[name] = moved, moves
    yield CallRule.RESOURCES, asked, found
    limits = {rule.guard.seconds for rule in net.rules if isinstance(rule.guard, guards.Withheld)}
    yield CallRule.RESOURCES, {call.binding.accept} if call.resources else set(), limits


def _after_its_request(net: CallNet, call: Asked) -> Iterator[_Compared]:
    finish = TransitionAction.FINISH
    # the effects of a call that was stopped are written where they are seen, all the same
    written: set[tuple[type, TransitionAction | None]] = {(guards.Accepts, TransitionAction.BEGIN), (guards.EffectsSeen, finish)}
    if call.awaited and not call.may_turn_out:
        written |= {(guards.EffectsSeen, None), (guards.Always, finish)}
    writing = [rule for rule in net.rules if isinstance(rule.guard, guards.Accepts | guards.EffectsSeen) or rule.action is finish]
    yield CallRule.EFFECTS, written, {(type(rule.guard), rule.action) for rule in writing}
    if Cause.LOST not in call.recoveries:
        lost = {net.course(net.outputs[number]) for exits in _UNDER_WAY(net) for number in exits if _ends_lost(net.rules[number])}
        yield CallRule.LOST, {Then.FAIL if call.binding.when_lost is WhenLost.ABORT else None}, lost
    again = (number for number, places in enumerate(net.targets) if not places.isdisjoint(net.ready))
    yield CallRule.RETRIES, {call.retries} - {0}, {*map(net.counted, again)} - {0}
    entering = [(number, chain) for number in range(len(net.names)) for chain in net.entered(number)]
    kept = {place for number, chain in entering if net.ends_of(chain) is Then.RESTART_PLAN for place in net.counts(number)}
    back = (number for number, places in enumerate(net.sources) if places and places == net.targets[number])
    is_refilled = call.context.repeated and not call.awaited
    restored = {place for number in back for place in net.counts(number)}
    yield CallRule.COUNTERS, net.counters.keys() - kept if is_refilled else set(), restored
    ways_out = {(guards.Failing, True), (guards.Ending, False)} if call.context.starts_anew else {(guards.Ending, True)}
    aside = ((number, rule.guard) for number, rule in enumerate(net.rules) if rule.outcome is None)
    leaving = {(type(guard), net.fails(number)) for number, guard in aside if isinstance(guard, guards.Ending | guards.Failing)}
    yield CallRule.RESTART, ways_out, leaving
    yield CallRule.RECOVERIES, call.recoveries, _recoveries(net, call)


def _recoveries(net: CallNet, call: Asked) -> Mapping[Cause, object]:
    """Return the continuations after causes: those of the plan, and others that are not as without recoveries."""
    found: dict[Cause, object] = {}
    for number, rule in enumerate(net.rules):
        guard, cause = rule.guard, rule.cause
        is_plain = not (rule.gives_up or rule.outcome or isinstance(guard, guards.InvariantFalse | guards.Due | guards.Withheld))
        if cause is None or not is_plain or not net.targets[number].isdisjoint(net.alive):
            continue
        course = net.course(net.outputs[number])
        # without recoveries a false check and an end for good lead to failure, and every other end to another attempt
        is_final = isinstance(guard, guards.Ends) and guard.kinds in ({OutcomeKind.ABORTED_FOR_GOOD}, {OutcomeKind.UNAVAILABLE})
        is_lost = _ends_lost(rule) and net.sources[number] <= net.under_way and call.binding.when_lost is WhenLost.ABORT
        usual = Then.FAIL if is_final or is_lost or guard.is_check else None
        if cause in ASKED:
            found[cause] = [*found.get(cause, []), (guard, course)]  # type: ignore[misc]
        elif cause in call.recoveries or course is not usual:
            found[cause] = course if found.setdefault(cause, course) == course else "several"
    return found


def check_content(net: CallNet, call: Asked) -> Mapping[int, WatchedPlaces]:
    """Check that the net of a call keeps its rules; return the watches by the numbers of their transitions."""
    if not net.ready:
        raise Unsound(f"{call.step} is never sent")
    watched: dict[int, WatchedPlaces] = {}
    for watch in WATCHES:
        guard = watch.asked(call)
        for exits in watch.exits(net):
            numbers = [number for number in exits if watch.is_one(net.rules[number])]
            good = [number for number in numbers if net.rules[number].guard == guard and watch.is_kept(net, number)]
            if good != numbers or bool(good) is (guard is None):
                raise _broken(call, watch.rule, guard, [net.rules[number] for number in numbers])
            watched.update(dict.fromkeys(numbers, watch))
    for rule, asked, found in traits(net, call):
        if asked != found:
            raise _broken(call, rule, asked, found)
    return watched


def check_guard(watch: WatchedPlaces, guard: Guard, call: Asked) -> None:
    """Check a guard of a call that is of the same kind as another, which was looked at."""
    if (asked := watch.asked(call)) != guard:
        raise _broken(call, watch.rule, asked, guard)


def _broken(call: Asked, rule: CallRule, asked: object, found: object) -> Unsound:
    return Unsound(f"{call.step} does not keep the rule of its {rule.value}: {asked} is asked for, and there is {found}", rule=rule)
