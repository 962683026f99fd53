"""The detail of one call: what it waits for, its conditions with what is known of them, and where its token is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from typing import Final

from planner_bridge.explanations.history import RunHistory
from planner_bridge.view.story import Story, value_words
from pnm.core.execution.questions import EvaluationContext
from pnm.core.logic.computed_values import Unanswered
from pnm.core.logic.conditions import Condition, conjuncts, evaluate, fluents, observed
from pnm.core.logic.expressions import Fluent, Unknown, fluent_text
from pnm.core.machine.plan_graph import ActionCall, Ordering, Recovery
from pnm.errors import PnmError

_READ: Final = 6
"""Facts of a condition that are shown one by one."""


@dataclass(frozen=True, slots=True)
class WaitShown:
    """An ordering: of which call which moment is waited for, or waits, for which facts, and whether it has come."""

    call: int
    action: str
    moment: str
    protects: tuple[str, ...]
    has_come: bool


@dataclass(frozen=True, slots=True)
class FactRead:
    """A fact that a condition reads: its value in words, how it is known, and since when; None if that is not known."""

    name: str
    value: str
    source: str
    since: float | None
    is_initial: bool


@dataclass(frozen=True, slots=True)
class Check:
    """A condition of a call: when it is looked at, whether it is true now, what is observed, and how that is known.

    Args:
        reads: the facts in it; of many the first ones.
        others: how many more there are.
    """

    when: str
    text: str
    truth: str
    observed: str
    source: str
    reads: tuple[FactRead, ...]
    others: int


@dataclass(frozen=True, slots=True)
class PlaceShown:
    """A place of the call's block, without the name of the call, and its tokens."""

    name: str
    tokens: int


@dataclass(frozen=True, slots=True)
class TransitionShown:
    """A transition of the call's block, without the name of the call: from which places to which, and whether it has its tokens."""

    name: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    is_enabled: bool


@dataclass(frozen=True, slots=True)
class CallDetail:
    """All that is known of a call.

    Args:
        parameters: names of its parameters, and the arguments.
        server: who carries it out; empty for an operation on knowledge.
        limit: the seconds that it may take from its acceptance; None if there is none.
        accept: the seconds in which its server has to answer a request; None if there is no server.
        resources: what it needs for itself, and which request has it now; empty if none has.
        waits_for: what must have come before it starts, or ends.
        needed_by: what waits for it.
        checks: its conditions.
        effects: what it changes.
        recoveries: what the plan has for when it fails.
        places: of its block, in the order of time.
        transitions: of its block.
    """

    run: str
    index: int
    action: str
    parameters: tuple[tuple[str, str], ...]
    server: str
    limit: float | None
    accept: float | None
    resources: tuple[tuple[str, str], ...]
    waits_for: tuple[WaitShown, ...]
    needed_by: tuple[WaitShown, ...]
    checks: tuple[Check, ...]
    effects: tuple[str, ...]
    recoveries: tuple[str, ...]
    places: tuple[PlaceShown, ...]
    transitions: tuple[TransitionShown, ...]


def detail(story: Story, run: str, index: int) -> CallDetail | None:
    """Return the detail of a call of a run; None if there is none."""
    found = next((each for id, each in story.runs.items() if id.hex == run), None)
    if found is None or not 0 <= index < len(found.source.plan.calls):
        return None
    replayed, call = found.executed().run, found.source.plan.calls[index]
    action = next((open.action for open in replayed.open_calls.values() if open.index == index), call.action)
    limit = replayed.limit(call)
    places, transitions = _block(found, index)
    return CallDetail(
        run,
        index,
        str(action),
        tuple(zip(action.parameters, action.arguments, strict=False)),
        found.server(action),
        limit if limit and isfinite(limit) else None,
        None if action.operation is not None else found.source.bindings.of(action.name).accept,
        tuple((name, _holder(story, name)) for name in found.source.bindings.resources(action)),
        tuple(_wait(found, ordering, is_before=True) for ordering in _orderings(found) if ordering.after.call == index),
        tuple(_wait(found, ordering, is_before=False) for ordering in _orderings(found) if ordering.before.call == index),
        tuple(_checks(story, found, call)),
        tuple(
            f"{when}: {effect}"
            for when, effects in (("at the start", action.start_effects), ("at the end", action.end_effects))
            for effect in effects
        ),
        tuple(map(_recovery, call.recoveries)),
        places,
        transitions,
    )


def _holder(story: Story, resource: str) -> str:
    """Return the action of the request that has a resource."""
    replay = story.execute()
    claims = (claim for claim in replay.resources.held if resource in claim.names)
    requests = (replay.requests[claim.request] for claim in claims if claim.request in replay.requests)
    return ", ".join(str(request.action) for request in requests)


def _orderings(run: RunHistory) -> Iterator[Ordering]:
    """Yield the orderings between calls, each once."""
    yield from (ordering for ordering in run.source.plan.orderings if ordering.before.call != ordering.after.call)


def _wait(run: RunHistory, ordering: Ordering, *, is_before: bool) -> WaitShown:
    event = ordering.before if is_before else ordering.after
    steps = {step.index: step for step in run.source.plan.every_step}
    has_come = run.time_of(ordering.before) is not None
    words = steps[event.call]
    text = str(words.action) if isinstance(words, ActionCall) else str(words)
    return WaitShown(event.call, text, event.moment.value, tuple(map(fluent_text, ordering.protects)), has_come)


def _checks(story: Story, run: RunHistory, call: ActionCall) -> Iterator[Check]:
    action = call.action
    context = EvaluationContext(run.executed().run.knowledge, action, run.source.bindings.of(action.name))
    parts = (
        ("before it starts", action.precondition),
        ("while it runs", action.invariant),
        ("when it ends", action.end_condition),
        ("once it is done", action.expected),
    )
    for when, condition in parts:
        for part in conjuncts(condition):
            yield _check(story, when, part, context)


def _check(story: Story, when: str, condition: Condition, context: EvaluationContext) -> Check:
    try:
        truth = evaluate(condition, context)
        text = "unknown" if isinstance(truth, Unknown) else "true" if truth else "false"
        seen = observed(condition, context)
    except (Unanswered, PnmError) as error:
        text, seen = "unknown", str(error)
    read = fluents(condition, context)
    first = tuple(_read(story, fluent, context) for fluent in sorted(read)[:_READ])
    return Check(when, str(condition), text, seen, _source(read, context), first, len(read) - len(first))


def _read(story: Story, fluent: Fluent, context: EvaluationContext) -> FactRead:
    name, source = fluent_text(fluent), _source(frozenset({fluent}), context)
    if (shown := story.facts.get(name)) is not None:
        return FactRead(name, shown.value, source, shown.since, shown.is_initial)
    return FactRead(name, value_words(context.value(fluent) or False), source, None, is_initial=False)


def _source(read: frozenset[Fluent], context: EvaluationContext) -> str:
    """Return the source of the fluents of a condition."""
    derived = {fluent for fluent in read if fluent[0] in context.world.rules.derived}
    ways = {
        "derived": bool(derived),
        "sensed": any(context.world.is_sensed(fluent) for fluent in read - derived),
        "assumed": any(not context.world.is_sensed(fluent) for fluent in read - derived),
    }
    return ", ".join(way for way, is_so in ways.items() if is_so) or "computed"


def _recovery(recovery: Recovery) -> str:
    chain = ", ".join(str(step.action if isinstance(step, ActionCall) else step) for step in recovery.chain.steps)
    return f"after {', '.join(sorted(recovery.causes))}: {f'{chain}, then ' if chain else ''}{recovery.then.value}"


def _block(run: RunHistory, index: int) -> tuple[tuple[PlaceShown, ...], tuple[TransitionShown, ...]]:
    """Return the places and transitions of a call, by the short names that people know them by."""
    machine, marking = run.executed().run.machine, run.executed().run.marking
    prefix = f"{machine.plan.calls[index]} "
    own = frozenset(machine.blocks[index])
    places = tuple(PlaceShown(place.removeprefix(prefix), marking[place]) for place in machine.blocks[index])
    transitions = []
    for name in machine.net.transitions:
        inputs, outputs = machine.net.inputs[name], machine.net.outputs[name]
        if machine.rules[name].call == index and not own.isdisjoint((*inputs, *outputs)):
            is_enabled = all(marking[place] >= weight for place, weight in inputs.items())
            taken, marked = (tuple(place.removeprefix(prefix) for place in weights if place in own) for weights in (inputs, outputs))
            transitions.append(TransitionShown(name.removeprefix(prefix), taken, marked, is_enabled))
    return places, tuple(transitions)
