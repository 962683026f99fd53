"""A part of a machine for its exploration: a whole machine, or a block of it with its inputs supplied from outside at any moment.

Counters: pairs of places between which tokens move one at a time, such as retries left and retries spent.

How many tokens there are decides only how often something happens. So the proof looks at three cases, all left, some left and all
spent, and takes a counter to be in any of them at any time. The moves are looked at for themselves: as long as tokens move in one
direction only, they come to an end. So the work does not grow with the tokens, nor with the combinations of counters.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import count
from typing import NamedTuple

from pnm.core.logic.conditions import Condition
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.guards import Due, Guard, GuardKind, InvariantFalse, KnowledgeRead, OfCall, Opener
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import Then
from pnm.core.machine.requests import CallOutcome, TransitionAction
from pnm.core.net.net import Weights
from pnm.errors import PnmError


@dataclass(frozen=True, kw_only=True)
class Part:
    """A part of a machine with what surrounds it: inputs that come once, at any moment."""

    places: tuple[str, ...]
    steps: tuple[PartStep, ...]
    initial: Mapping[str, int]
    supplies: tuple[tuple[str, ...], ...] = ()
    """Sets of places that get their tokens from outside, each set at once."""
    failures: frozenset[str] = frozenset()
    records: frozenset[str] = frozenset()
    """Places that may stay marked."""
    counters: frozenset[str] = frozenset()
    """Those of them from which nothing starts: what takes from them is asked for at other places."""
    cancels: bool = False
    """Whether a failure has running calls cancelled."""
    outputs: frozenset[str] = frozenset()
    """Places that are marked in the end, each once: others take from them."""
    ends: frozenset[str] = frozenset()
    """Those of them that stand for the end: once one is marked, nothing else of the part is, and no request is alive."""
    finals: frozenset[str] = frozenset()
    """Final places: exactly one is marked in the end, if there are any."""
    goal: str = ""
    """The final place that is not marked while the run is ending."""
    early: frozenset[str] = frozenset()
    """Places that must be marked once nothing more can happen without the last supply."""
    restarts: frozenset[str] = frozenset()
    """Places that ask for the plan to begin anew."""
    others_restart: bool = False
    """Whether other parts may ask for that."""
    repeats: bool = False
    """Whether it may be entered again once it was left, with its counters as they then are."""
    resources: frozenset[str] = frozenset()
    """Places that others take from as well: a step that lacks nothing else is waited for, and the rules after it are not asked."""
    alive: frozenset[str] = frozenset()
    """Places of calls that are under way: one is marked for every request that is alive."""
    settling: frozenset[str] = frozenset()
    """Places at which effects of calls are looked for."""
    owed: tuple[int | None, ...] = ()
    """The calls that must have been carried out, or passed over as the plan says, when it ends and the run is not ending; None for a
    loop, a choice or the frame."""


class PartStep(NamedTuple):
    """A transition of a part of a net, or all that happens inside a region."""

    name: str
    guard: Guard | Inside
    inputs: Weights
    outputs: Weights
    call: int | None = None
    """The call whose request its action and its guard are about, if there is one."""
    action: TransitionAction | None = None
    gives_up: bool = False
    """The request of the call is no longer waited for."""
    outcome: CallOutcome | None = None
    """The outcome of the call from then on; None when that stays as it is."""
    finds_cause: bool = False
    """Whether the run knows from then on why the call fails or is passed over, if it is."""
    settles: bool = False
    """Whether the plan may go on from then on: without the call after such a cause, or after the loop, the choice or all of its steps."""
    counted: Count | None = None
    """Its check of a counter, which may be true or false at any time."""


@dataclass(frozen=True, slots=True)
class Inside(GuardKind):
    """In the place of a guard: what happens inside a region, which takes its time but comes to an end."""

    opened_by = Opener.TOKENS
    reads = KnowledgeRead.NOTHING
    is_check = False


def step_of(machine: PetriNetMachine, name: str) -> PartStep:
    """Return a transition with its guard, and with its action if it belongs to a call."""
    rule, inputs, outputs = machine.rules[name], machine.net.inputs[name], machine.net.outputs[name]
    about = rule.guard.call if isinstance(rule.guard, OfCall) else rule.call
    if about != rule.call:
        raise Unsound(f"{name} listens to another call")
    if rule.call is None or rule.call >= len(machine.plan.calls):
        if rule.action is not None or isinstance(rule.guard, InvariantFalse | OfCall):
            raise Unsound(f"{name} is about a request, and belongs to no call")
        return PartStep(name, rule.guard, inputs, outputs, finds_cause=rule.cause is not None and rule.guard.is_check)
    settles, recoveries = False, machine.plan.calls[rule.call].recoveries
    if rule.cause is not None and recoveries:
        # What is withheld before the call is sent is treated as if the server were not there.
        cause = Cause.UNAVAILABLE if rule.cause is Cause.WITHHELD else rule.cause
        settles = any(recovery.then is Then.SKIP and cause in recovery.causes for recovery in recoveries)
    return PartStep(name, rule.guard, inputs, outputs, rule.call, rule.action, rule.gives_up, rule.outcome, rule.cause is not None, settles)


# --- the shape of a block: blocks of one shape behave alike, so that exploring one of them is enough -----


def shape_of(part: Part) -> object:
    """Return everything about a part but names, times and what its conditions say.

    Of every step it is what its guard depends on, and of every place its arcs and its roles.
    """
    conditions: list[Condition] = []
    steps = tuple(
        [
            (
                _kind(step.guard, step.inputs, conditions),
                step.action,
                step.gives_up,
                step.outcome,
                step.finds_cause,
                step.settles,
                step.counted and step.counted[1:],
            )
            for step in part.steps
        ]
    )
    places = frozenset(_arcs_and_roles(part).values())
    owed = tuple([call is None for call in part.owed])
    return steps, len(part.supplies), places, bool(part.finals), part.cancels, part.others_restart, part.repeats, owed


def kinds_of(guards: Iterable[tuple[Guard, Weights]]) -> tuple[object, ...]:
    """Return all that is proved of some guards of a block, each given with what its transition takes."""
    conditions: list[Condition] = []
    return tuple([_kind(guard, inputs, conditions) for guard, inputs in guards])


def without_twins(part: Part) -> Part:
    """Return the part with one place for all that have the same arcs and roles: they always hold the same tokens."""
    kept: dict[object, str] = {}
    for place, alike in _arcs_and_roles(part).items():
        kept.setdefault(alike, place)
    if len(kept) == len(part.places):
        return part
    places = dict.fromkeys(kept.values())

    def of(arcs: Weights) -> Weights:
        return {place: weight for place, weight in arcs.items() if place in places}

    return replace(
        part,
        places=tuple(places),
        steps=tuple(step._replace(inputs=of(step.inputs), outputs=of(step.outputs)) for step in part.steps),
        initial=of(part.initial),
        supplies=tuple(tuple(place for place in together if place in places) for together in part.supplies),
        outputs=part.outputs & places.keys(),
        early=part.early & places.keys(),
        resources=part.resources & places.keys(),
    )


def _arcs_and_roles(part: Part) -> dict[str, object]:
    """Return for every place all that decides which tokens it holds, and what they mean.

    Only records and the final places, of which one must be marked and not two, are told apart.
    """
    arcs: dict[str, list[tuple[int, int]]] = {place: [] for place in part.places}
    for number, step in enumerate(part.steps):
        for place, weight in step.inputs.items():
            arcs[place].append((number, -weight))
        for place, weight in step.outputs.items():
            arcs[place].append((number, weight))
    sets = (
        *(part.records, part.counters, part.failures, part.outputs, part.ends, part.finals),
        *(part.early, part.restarts, part.resources, part.alive, part.settling),
    )
    special = frozenset(part.initial).union(*sets, *part.supplies)
    numbered, numbers, places = part.records | part.finals, count(), dict[str, object]()
    for place, connected in arcs.items():
        roles: object = None
        if place in special:
            memberships = tuple(place in members for members in (*part.supplies, *sets))
            # Records and finals are numbered, because tokens in two of them differ from two tokens in one.
            roles = part.initial.get(place, 0), memberships, next(numbers) if place in numbered else None
        places[place] = (tuple(connected), roles)
    return places


def _kind(guard: Guard | Inside, inputs: Weights, conditions: list[Condition]) -> object:
    """Return the proved part of a guard: its opening, as far as the world does not decide, and which conditions are the same."""
    if (condition := guard.asks) is not None:
        if condition not in conditions:  # only whether two guards have the same condition matters: then exactly one of them opens
            conditions.append(condition)
        return guard.proved, conditions.index(condition)
    return (guard.proved, all(place in inputs for place, _ in guard.since)) if isinstance(guard, Due) else guard.proved


# --- counters -------------------------------------------------------------------------------


class Left(Enum):
    """The rest of a counter."""

    ALL = "all"
    SOME = "some"
    NONE = "none"

    __hash__ = object.__hash__  # each is there once


class Count(NamedTuple):
    """A step's check of a counter: a pair of places that one place stands for."""

    place: str
    cases: frozenset[Left]
    """Those in which the step is enabled."""
    possible: frozenset[Left]
    """All cases of this counter."""
    restores: bool | None
    """Whether the step moves a token back, or on; None if it takes all of them away."""


def without_counts(
    steps: Sequence[PartStep], initial: Mapping[str, int], budgets: frozenset[str]
) -> tuple[tuple[PartStep, ...], dict[str, int], frozenset[str]]:
    """Return steps and tokens in which one place stands for each counter, marked as long as there is one, and those places.

    Raises:
        Unsound: places that count do not count in pairs: a step moves more than one token, or between others, or asks for neither one
            token nor all.
    """
    pairs = dict[str, tuple[str, str]]()
    for step in steps:
        if budgets.isdisjoint(step.outputs):
            continue
        given, taken = ([place for place in arcs if place in budgets] for arcs in (step.outputs, step.inputs))
        if len(given) != 1 or len(taken) != 1 or given == taken or step.inputs[taken[0]] != 1 or step.outputs[given[0]] != 1:
            raise Unsound(f"{step.name} does not move one token from one counter to another")
        pair = (taken[0], given[0]) if initial.get(taken[0]) else (given[0], taken[0])
        if any(pairs.setdefault(place, pair) != pair for place in pair):
            raise Unsound(f"{step.name} mixes counters: {taken[0]} and {given[0]} do not count together")
    for left, spent in pairs.values():
        if initial.get(spent):
            raise Unsound(f"some of the counter {left} is spent from the beginning")

    def abstract(step: PartStep) -> PartStep:
        if budgets.isdisjoint(step.inputs):
            return step
        taken = [place for place in step.inputs if place in budgets]
        left, spent = pairs.get(taken[0], (taken[0], ""))
        total, gives = initial.get(left, 0), any(place in budgets for place in step.outputs)
        if len(taken) > 1 or not (gives or step.inputs[taken[0]] == total):
            raise Unsound(f"{step.name} takes {step.inputs[taken[0]]} of {', '.join(taken)}, which is neither one nor all")
        inputs, outputs = (
            {place: weight for place, weight in arcs.items() if place not in budgets} for arcs in (step.inputs, step.outputs)
        )
        possible = frozenset(Left) if total > 1 else frozenset({Left.ALL, Left.NONE})
        if gives:
            cases = possible - {Left.NONE if taken[0] == left else Left.ALL}
        else:
            cases = frozenset({Left.ALL if taken[0] == left else Left.NONE})
        count = Count(left, cases, possible, (taken[0] == spent) if gives else None)
        return step._replace(inputs={**inputs, left: 1}, outputs={**outputs, left: 1} if gives else outputs, counted=count)

    kept = {place: tokens for place, tokens in initial.items() if place not in budgets}
    counters = frozenset(left for left, _ in pairs.values()) | {place for place in budgets if place not in pairs}
    return tuple(map(abstract, steps)), {**kept, **{place: 1 for place in counters if initial.get(place)}}, counters


def in_each_case(steps: Sequence[PartStep]) -> Iterator[list[list[PartStep]]]:
    """Yield for each counter that the steps ask for, if there is one, which of the steps are enabled in each of its cases.

    Steps that ask for another counter are left out: they may be enabled or not.
    """
    counts = {step.counted.place: step.counted for step in steps if step.counted}
    if not counts:
        yield [[*steps]]
    for place, counter in counts.items():
        own = [step for step in steps if not step.counted or step.counted.place == place]
        yield [[step for step in own if not step.counted or case in step.counted.cases] for case in counter.possible]


# --- what is wrong ----------------------------------------------------------------------------


class CallRule(Enum):
    """Rules that the block of a call keeps, in the words in which a refusal names them."""

    # before the request is sent, at every ready place
    TIMES = "times"
    """Its start waits for times if the plan has some, which are then looked at with its orderings."""
    DATA = "data"
    """It is asked whether a goal field lacks its value."""
    LATEST_START = "latest start"
    """A call with a latest start or a deadline is not sent after it."""
    ALREADY_TRUE = "already true"
    """It is asked whether there is nothing to do, unless the call must happen all the same."""
    PRECONDITION = "precondition"
    """A sending step checks it, and the over-all condition as far as the start does not change that itself."""
    # while it may be alive
    ANSWER = "answer"
    """An unanswered request is cancelled after the binding's `accept`."""
    OVER_ALL = "over-all condition"
    """While it is under way, a broken one cancels it, and the call has failed."""
    DEADLINE = "deadline"
    """While it is under way, a missed one cancels it, and the call has failed."""
    TIME_LIMIT = "time limit"
    """While it is under way, it is cancelled after its timeout."""
    CANCELLING = "cancelling"
    """While it is being cancelled, it is given up after the binding's `cancel`. It comes there by a cancellation only."""
    RESOURCES = "resources"
    """Exactly those of the call are taken, all at once, by what leads to where the request may be alive, and given back by what leads out.

    Effects are looked for with them, unless that must wait for others or may have to ask somebody. `alive_places` are these places.
    Resources that are withheld are waited for as long as `accept` says.
    """
    # after it
    EFFECTS = "effects"
    """Those at the start are written when it is accepted, those at the end with the success, before the end waits for others."""
    LOST = "lost"
    """A request that is lost ends the call for good if the binding says `abort`."""
    RETRIES = "retries"
    """A retry takes one of the tokens of a counter, and there are as many as the plan, or else the binding, says."""
    RECOVERIES = "recoveries"
    """Each cause leads to the recoveries that the plan has for it: in their order, under their conditions, with their chains, as often.

    Without one a false check and an end for good lead to failure, and every other end to another attempt.
    """
    COUNTERS = "counters"
    """Spent retries are given back before the call is left, if it may be reached again and its end waits for no others."""
    RESTART = "restart"
    """While the plan begins anew, a call that recovers is dropped and has not failed; without recoveries that ask for it, none is."""
    ATTEMPTS = "attempts"
    """Attempts after the start was announced have ready places of their own, and there are such only if others wait for the start."""
    ADOPTED = "adopted"
    """A request of another run is taken over if the call is under way already."""


class Unsound(PnmError):
    """The machine can reach a state it must not reach, to which `trace` leads; or the block of a call breaks a `rule`."""

    def __init__(self, what: str, trace: Sequence[str] = (), *, rule: CallRule | None = None) -> None:
        super().__init__(f"{what}{f'; after {chr(32).join(trace)}' if trace else ''}")
        self.trace = tuple(trace)
        self.rule = rule
