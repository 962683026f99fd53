"""Plans as they are written: the syntax tree of their steps, and of the recoveries in them.

What is done when a call fails, as it is written: ``before``, ``during`` and ``after``, each with chains of steps.

A chain is a list of steps that ends in a command. In its long form, ``{when: condition, do: chain, times: n}``, it has
a condition of its own and a limit of how often it may be used; there may be a list of these.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Final, TypeAlias

from pnm.core.logic.computed_values import Data, KnowledgeOperation
from pnm.core.logic.conditions import Condition
from pnm.core.machine.failure_causes import Cause, Phase, causes_in
from pnm.core.machine.plan_graph import Moment, Step, Then
from pnm.errors import InputError, Position
from pnm.files.yaml_nodes import Node
from pnm.language.actions import LanguageAction
from pnm.language.formulas.conditions import read_condition
from pnm.language.formulas.scope import FormulaScope, unknown
from pnm.language.grammar import COMMANDS, Chain, ConditionalChain, RecoveryKeys


@dataclass(frozen=True, slots=True)
class Wait:
    """A condition for a step: the end, or the start, of another step of the same list."""

    id: str
    position: Position
    moment: Moment = Moment.END
    delay: float = 0.0
    """Seconds that must pass besides."""


@dataclass(frozen=True, slots=True)
class StepPlacement:
    """The position of a step."""

    position: Position
    id: str | None = None
    after: tuple[Wait, ...] | None = None
    """The conditions for its start; None for the step before it."""
    end_after: tuple[Wait, ...] = ()
    """The conditions for its end: only a call has one that can wait."""


@dataclass(frozen=True, slots=True)
class GivenValue:
    """The value that a step gives a parameter."""

    data: Data
    position: Position


@dataclass(frozen=True, slots=True)
class WrittenRecovery:
    """The reactions to some causes of failure."""

    position: Position
    causes: frozenset[Cause]
    chain: SequenceStep
    then: Then
    times: int | None = None
    """None if the file gives no number."""
    when: Condition | None = None
    """For checks of its own, before or after."""


@dataclass(frozen=True)
class CallStep:
    """An action is called."""

    place: StepPlacement
    action: LanguageAction
    given: Mapping[str, GivenValue] = field(default_factory=dict)
    """By parameter, without ``?``."""
    operation: KnowledgeOperation | None = None
    recoveries: tuple[WrittenRecovery, ...] | None = None
    """In place of those of the action; None if the step has none of its own."""
    retries: int | None = None
    timeout: float | None = None
    duration: float | None = None
    """Chosen within the bounds that the action gives."""
    release: float = 0.0
    """Seconds after the beginning of the plan before which it must not start."""
    latest_start: float = inf
    """Seconds after the beginning of the plan by which it must have been sent."""
    deadline: float = inf
    """Seconds after the beginning of the plan by which it must have ended."""
    resources: tuple[str, ...] = ()
    """Besides those of the action."""
    store: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SequenceStep:
    """Steps one after the other, or in the partial order that their ``after`` gives."""

    place: StepPlacement
    steps: tuple[WrittenStep, ...]


@dataclass(frozen=True, slots=True)
class ConcurrentStep:
    """Steps at the same time."""

    place: StepPlacement
    branches: tuple[WrittenStep, ...]


@dataclass(frozen=True, slots=True)
class LeafStep:
    """A step that holds no others: it is written as it stands in the plan."""

    place: StepPlacement
    step: Step
    """Its number does not count."""


@dataclass(frozen=True, slots=True)
class LoopStep:
    """Steps that are repeated as long as a condition holds."""

    place: StepPlacement
    condition: Condition
    body: SequenceStep
    limit: int


@dataclass(frozen=True, slots=True)
class ChoiceStep:
    """Steps that are done if a condition holds, and others that are done if not."""

    place: StepPlacement
    condition: Condition
    then: SequenceStep
    otherwise: SequenceStep


WrittenStep: TypeAlias = CallStep | SequenceStep | ConcurrentStep | LeafStep | LoopStep | ChoiceStep


_DURING: Final = {"preempted" if cause is Cause.CANCELED else cause.value: cause for cause in Cause if cause.phase is Phase.DURING}

ReadSteps: TypeAlias = Callable[[tuple[Node, ...], Position], SequenceStep]
"""Reads steps that follow each other."""


def read_recoveries(node: Node, scope: FormulaScope, read_steps: ReadSteps) -> tuple[WrittenRecovery, ...]:
    """Read the reactions to a failure of a call: ``before``, ``during`` and ``after``; the scope has the parameters of the call."""
    if node.is_null:
        return ()
    keys = RecoveryKeys(node.mapped())
    recoveries = [_recovery(long, causes_in(Phase.BEFORE), Cause.BEFORE, scope, read_steps) for long in _each(keys.before)]
    for outcome, _, chains in keys.during.entry.entries():
        recoveries += [_recovery(long, frozenset({_DURING[outcome]}), None, scope, read_steps) for long in _each(chains)]
    recoveries += [_recovery(long, causes_in(Phase.AFTER), Cause.AFTER, scope, read_steps) for long in _each(keys.after)]
    always = dict[Cause, Then]()
    for recovery in recoveries:
        if recovery.causes <= always.keys():
            before = always[next(iter(recovery.causes))].value
            raise InputError(f"this can never happen: the recovery before it ends with {before}, and is always possible", recovery.position)
        if recovery.when is None and recovery.then.is_last(chain=bool(recovery.chain.steps)):
            always |= dict.fromkeys(recovery.causes, recovery.then)
    return tuple(recoveries)


def _each(node: Node | None) -> tuple[Node, ...]:
    """Return the recoveries of a list of long forms, or the only one."""
    if node is None or node.is_null:
        return ()
    if node.items and all(_is_long(item) for item in node.items):
        return node.items
    return (node,)


def _is_long(node: Node) -> bool:
    return node.is_mapping and "do" in node.mapped().nodes


def _recovery(node: Node, usual: frozenset[Cause], own: Cause | None, scope: FormulaScope, read_steps: ReadSteps) -> WrittenRecovery:
    keys = (Chain if own is None else ConditionalChain)(node.mapped()) if _is_long(node) else None
    when: Condition | None = None
    if isinstance(keys, ConditionalChain) and keys.when is not None:
        when = read_condition(keys.when, scope)
    times = None if keys is None else keys.times
    causes = usual if when is None or own is None else frozenset({own})
    whole = node if keys is None else keys.do
    items = (whole,) if whole.items is None else whole.items
    if not items or items[-1].text is None:
        raise (items[-1] if items else whole).wrong(f"expected a command at the end of the chain: {', '.join(COMMANDS)}")
    *steps, command = items
    if command.text not in COMMANDS:
        raise unknown("command", command.text or "", COMMANDS, command.position)
    for step in steps:
        if step.text in COMMANDS:
            raise step.wrong(f"{step.text} ends the chain; nothing may come after it")
    chain, then = read_steps(tuple(steps), whole.position), COMMANDS[command.text]
    if then is Then.CONTINUE and not causes <= causes_in(Phase.DURING):
        raise node.wrong("only a call whose request has ended can continue; expected another command, such as skip_action")
    return WrittenRecovery(node.position, causes, chain, then, times, when)
