"""Plans as they are written: a tree of steps that says the same as the file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from pnm.conditions import Condition
from pnm.errors import Position
from pnm.language.actions import LanguageAction
from pnm.plan_graph import Cause, Then
from pnm.queries import Data, KnowledgeOperation


@dataclass(frozen=True, slots=True)
class Place:
    """Where a step stands."""

    position: Position
    id: str | None = None
    after: tuple[tuple[str, Position], ...] | None = None
    """The steps of the same list it waits for; None for the one before it."""


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
