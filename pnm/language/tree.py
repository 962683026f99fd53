"""Plans as they are written: a tree of steps that says the same as the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from typing import TypeAlias

from pnm.conditions import Condition
from pnm.errors import Position
from pnm.language.actions import LanguageAction
from pnm.plan_graph import Cause, Moment, Then
from pnm.queries import Data, KnowledgeOperation


@dataclass(frozen=True, slots=True)
class Wait:
    """What a step waits for: the end, or the start, of another step of the same list."""

    id: str
    position: Position
    moment: Moment = Moment.END
    delay: float = 0.0
    """Seconds that must pass besides."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a step stands."""

    position: Position
    id: str | None = None
    after: tuple[Wait, ...] | None = None
    """What its start waits for; None for the step before it."""
    end_after: tuple[Wait, ...] = ()
    """What its end waits for: only a call has one that can wait."""


@dataclass(frozen=True, slots=True)
class Given:
    """What a step says about a parameter."""

    data: Data
    position: Position


@dataclass(frozen=True, slots=True)
class WrittenRecovery:
    """What is done about some causes of failure."""

    position: Position
    causes: frozenset[Cause]
    chain: SequenceStep
    then: Then
    times: int | None = None
    """None if the file does not say."""
    when: Condition | None = None
    """For checks of its own, before or after."""


@dataclass(frozen=True)
class CallStep:
    """An action is called."""

    place: Place
    action: LanguageAction
    given: Mapping[str, Given] = field(default_factory=dict)
    """By parameter, without ``?``."""
    operation: KnowledgeOperation | None = None
    recoveries: tuple[WrittenRecovery, ...] | None = None
    """In place of what the action says; None if the step says nothing."""
    retries: int | None = None
    timeout: float | None = None
    duration: float | None = None
    """Chosen within the bounds that the action gives."""
    release: float = 0.0
    """Seconds after the beginning of the plan before which it must not start."""
    deadline: float = inf
    """Seconds after the beginning of the plan by which it must have ended."""
    resources: tuple[str, ...] = ()
    """Besides those of the action."""
    store: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class SequenceStep:
    """Steps one after the other, or in the order that their ``after`` says."""

    place: Place
    steps: tuple[WrittenStep, ...]


@dataclass(frozen=True, slots=True)
class ConcurrentStep:
    """Steps at the same time."""

    place: Place
    branches: tuple[WrittenStep, ...]


@dataclass(frozen=True, slots=True)
class LoopStep:
    """Steps that are repeated as long as a condition holds."""

    place: Place
    condition: Condition
    body: SequenceStep
    limit: int


@dataclass(frozen=True, slots=True)
class ChoiceStep:
    """Steps that are done if a condition holds, and others that are done if not."""

    place: Place
    condition: Condition
    then: SequenceStep
    otherwise: SequenceStep


WrittenStep: TypeAlias = CallStep | SequenceStep | ConcurrentStep | LoopStep | ChoiceStep
