"""Records of a journal: everything that reaches runs from outside, in the order in which it did.

A run decides by the events that it handles, the knowledge at that moment, and the resources that it shares; all three follow from
these records. What a run itself writes, fires and wants sent follows as well: it stands beside the event for those who read a
journal without executing it, and a replay compares it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias
from uuid import UUID
from weakref import ref

from pnm.clock import TimeUsed
from pnm.core.execution.call_results import Became, RunResult, Told
from pnm.core.execution.events import Command, Event, KnowledgeChanged, ResourcesChanged, Send, Store, Tick
from pnm.core.execution.handover import UnderWay
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.effects import Changes
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.core.logic.rules import NO_RULES, Rules
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import PlanGraph
from pnm.core.machine.requests import Accepted, CallOutcome, Ended, Feedback, Postponed, Request
from pnm.core.resources import Hand
from pnm.tasks import TaskEnding, TaskState, Wanted

WORLD: Final = 0
"""The number of the knowledge base that all runs share."""


@dataclass(frozen=True, slots=True)
class SharedBegan:
    """The beginning of a segment, with what runs share: nothing from before it is needed to go on.

    Args:
        capacities: how many requests may have a resource at the same time; one for those not listed.
        prefix: the first bytes of the identities of all requests: servers find the process by them that goes on with the runs.
        origin: what the world was made from, as text: another process goes on only if it is the same there.
        began: when the world began, which may have been in an earlier segment, on the clock of the event loop.
        command: what the command line is given, in which folder first, so that another process goes on; empty if it is a node.
        seal: shows that this user has given the command on this computer; see `planner_bridge.cli.options.seal_of`.
        loaded: domain and problem, as PDDL, that were loaded in place of those of the files.
        again: how many of the next records say what goes on: all that is to be known of it without the segments before.
        since: the first record of the segment in which the oldest of that began; this one if nothing goes on, or that is not known.
    """

    capacities: Mapping[str, int]
    prefix: bytes = b""
    origin: str = ""
    began: float = 0.0
    command: tuple[str, ...] = ()
    seal: str = ""
    loaded: tuple[str, ...] = ()
    again: int = 0
    since: int = 0


@dataclass(frozen=True, slots=True)
class KnowledgeBegan:
    """A knowledge base, as it is when the journal begins to follow it, or when it begins anew."""

    base: int
    facts: Mapping[Fluent, Value | Unknown]
    variables: Mapping[str, object] = field(default_factory=dict)
    objects: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    sensed: Mapping[str, float] = field(default_factory=dict)
    rules: Rules = NO_RULES
    unknown: Mapping[str, tuple[Fluent, ...]] = field(default_factory=dict)
    """For each reason that was given, the fluents that are unknown because of it."""
    changes: int = 0
    """How many changes there were before."""
    changed: tuple[Fluent, ...] = ()
    """The fluents that have changed last, as far as runs that go on ask for that."""


@dataclass(frozen=True, slots=True)
class ClaimsBegan:
    """The claims to resources, as they are when a segment begins, and the requests that have or await some, without their goals."""

    state: Mapping[str, object]
    requests: tuple[Request, ...] = ()


@dataclass(frozen=True, slots=True)
class KnowledgeDelta:
    """Changes of a knowledge base."""

    base: int
    facts: Changes = field(default_factory=dict)
    variables: Mapping[str, object] = field(default_factory=dict)
    """Variables and their new values; None for those that were forgotten."""
    sensed: Mapping[str, float] = field(default_factory=dict)
    """The sensed predicates from now on, and their lag in seconds."""
    unknown: Mapping[str, tuple[Fluent, ...]] = field(default_factory=dict)
    """For each reason that was given, the fluents that are unknown because of it from now on: calls that fail tell it."""


@dataclass(frozen=True, slots=True)
class RunMade:
    """A run, with everything that it was made from besides what runs share.

    Args:
        task: on whose behalf it claims resources.
        machine: the key of its `MachineSource`.
        local: its own knowledge base.
        caller: the request of the plan that has called it; None if none has.
        priority: of its claims.
        origin: the time from which releases count; its beginning when None.
        asks: whether questions can be asked outside.
        adopted: the requests that it takes over, by call.
    """

    run: UUID
    task: UUID
    name: str
    machine: str
    local: int
    caller: UUID | None = None
    priority: int = 0
    origin: float | None = None
    asks: bool = False
    adopted: Mapping[int, UnderWay] = field(default_factory=dict)

    def gives_way(self, later: RunMade, *, has_begun: bool) -> bool:
        """Return whether a later run of the task takes its place: its process has died before it began."""
        return not has_begun and self.caller == later.caller


@dataclass(frozen=True, slots=True)
class RunStands:
    """A run of a task that is not over, as it is when a segment begins: as its `values` tell it.

    It has the results of its calls if it is not carried on any more.
    """

    made: RunMade
    state: Mapping[str, Any]
    results: tuple[Became, ...] | None = None


@dataclass(frozen=True, slots=True)
class MachineSource:
    """The source of a machine."""

    plan: PlanGraph
    bindings: Bindings
    on_failure: OnFailure
    capacities: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class Happened:
    """An event that a run has handled, and what followed from it at once.

    Args:
        fields: for actions by their text, the goal fields that their servers were found to have, if that is news.
        fired: the transitions that fired, by number, in their order.
        deltas: what the run changed in knowledge.
        intents: the requests that are sent, and the updates that are made, once this record is kept.
        told: the requests that are sent, and what has hindered steps.
    """

    run: UUID
    event: Event
    fields: Mapping[str, tuple[str, ...] | None] = field(default_factory=dict)
    fired: tuple[int, ...] = ()
    deltas: tuple[KnowledgeDelta, ...] = ()
    intents: tuple[UUID, ...] = ()
    told: tuple[Told, ...] = ()


@dataclass(frozen=True, slots=True)
class RunSucceeded:
    """A run has taken the place of another, whose requests it has taken over; what had become of the calls of that."""

    run: UUID
    successor: UUID
    results: tuple[Became, ...] = ()


@dataclass(frozen=True, slots=True)
class RunRetired:
    """A run is not carried on: it has given back its resources; what has become of its calls."""

    run: UUID
    results: tuple[Became, ...] = ()


@dataclass(frozen=True, slots=True)
class EndConfirmed:
    """The server of a request that was given up has confirmed its end."""

    request: UUID


@dataclass(frozen=True, slots=True)
class TimeCounted:
    """The used part of the limit of a task, or of a run of a plan."""

    of: UUID
    used: TimeUsed


@dataclass(frozen=True, slots=True)
class TaskAccepted:
    """A task that was accepted: it has an end, whatever dies in between.

    Args:
        wanted: what it is about.
        order: tasks are numbered as they come in.
        wall: the time of day, in seconds, from which its deadline counts.
    """

    wanted: Wanted
    order: int
    wall: float


@dataclass(frozen=True, slots=True)
class TaskHeld:
    """An operator has paused a task, or those that are still to come, or has let them go on."""

    task: UUID | None
    is_held: bool


@dataclass(frozen=True, slots=True)
class HandPut:
    """A person has taken a robot, or another object or resource, in hand, or has given it back."""

    hand: Hand
    is_taken: bool


@dataclass(frozen=True, slots=True)
class TaskEntered:
    """A task is in another state, for a reason: whoever tells of a task tells this."""

    task: UUID
    state: TaskState
    reason: str = ""


@dataclass(frozen=True, slots=True)
class TaskNoted:
    """Something that a task needs to know when it goes on in another process; a value of the codec's classes."""

    task: UUID
    note: object


@dataclass(frozen=True, slots=True)
class TaskOver:
    """A task has ended."""

    task: UUID
    ending: TaskEnding


@dataclass(frozen=True, slots=True)
class TaskSummary:
    """A task as it is listed beside the records, also when these have been dropped.

    Args:
        accepted: what it is about, and when it was accepted.
        runs: how many machines it has had, one after the other.
        ending: how it has ended, if it has.
        ended: the time of day when it did.
        seconds: from its acceptance to its end, on the clock of the records: the time of day may be set meanwhile.
    """

    accepted: TaskAccepted
    runs: int = 0
    ending: TaskEnding | None = None
    ended: float | None = None
    seconds: float | None = None

    def as_json(self) -> dict[str, Any]:
        """Return it as programs get it."""
        ending = self.ending
        return {
            "task": str(self.accepted.wanted.id),
            "goal": self.accepted.wanted.text,
            "accepted": self.accepted.wall,
            "ended": self.ended,
            "seconds": self.seconds,
            "runs": self.runs,
            "code": ending.code.word if ending else None,
            "reason": ending.message if ending else None,
        }


def became(result: RunResult, plan: PlanGraph) -> tuple[Became, ...]:
    """Return the results of the calls of a run, the last time that each was reached."""
    last = {one.call.index: one for one in result.calls}
    return tuple([Became.from_result(one, plan) for _, one in sorted(last.items()) if one.kind is not CallOutcome.WAITING])


def base_of(began: KnowledgeBegan) -> KnowledgeBase:
    """Return a knowledge base as it began."""
    base = KnowledgeBase(began.facts, variables=began.variables, objects=began.objects, sensed=began.sensed, rules=began.rules)
    _forget(base, began.unknown)
    base.go_on_from(began.changes, began.changed)
    return base


def change(base: KnowledgeBase, delta: KnowledgeDelta) -> None:
    """Have a knowledge base follow changes."""
    if delta.facts:
        base.update(delta.facts)
    else:
        base.store(delta.variables)
    _forget(base, delta.unknown)
    for name, lag in delta.sensed.items():
        base.sense((name,), lag=lag)


def _forget(base: KnowledgeBase, unknown: Mapping[str, tuple[Fluent, ...]]) -> None:
    for why, fluents in unknown.items():
        base.forget(fluents, why)


def knowledge_now(number: int, base: KnowledgeBase, since: int | None = None) -> KnowledgeBegan:
    """Return the content of a knowledge base now, with what has changed since there were so many changes."""
    changes = base.changes
    changed = base.changed_since(changes if since is None else since)
    unknown: dict[str, tuple[Fluent, ...]] = {}
    for fluent, why in base.why_unknown().items():
        unknown[why] = (*unknown.get(why, ()), fluent)
    facts, variables, objects, sensed = base.facts(), base.variables(), base.objects_by_type(), base.sensed_names()
    return KnowledgeBegan(number, facts, variables, objects, sensed, base.rules, unknown, changes, tuple(changed or ()))


def follow(number: int, base: KnowledgeBase, changed: Callable[[KnowledgeDelta], None]) -> KnowledgeBegan:
    """Return the content of a knowledge base now, and have a function called with every later change."""
    before, sensed_before, known = base.variables(), base.sensed_names(), ref(base)  # which has this listener

    def note(facts: Mapping[Fluent, Value | Unknown]) -> None:
        nonlocal before, sensed_before
        if (base := known()) is None:
            return
        if facts:
            changed(KnowledgeDelta(number, dict(facts), unknown=base.told_why))
            return
        after, sensed = base.variables(), base.sensed_names()
        variables = dict.fromkeys(before.keys() - after.keys())
        variables |= {name: value for name, value in after.items() if name not in before or before[name] != value}
        news = {name: lag for name, lag in sensed.items() if sensed_before.get(name) != lag}
        before, sensed_before = after, sensed
        changed(KnowledgeDelta(number, variables=variables, sensed=news, unknown=base.told_why))

    base.listen(note)
    return knowledge_now(number, base)


Record: TypeAlias = (
    SharedBegan
    | KnowledgeBegan
    | KnowledgeDelta
    | ClaimsBegan
    | RunMade
    | RunStands
    | Happened
    | RunSucceeded
    | RunRetired
    | EndConfirmed
    | TaskAccepted
    | TaskHeld
    | HandPut
    | TaskEntered
    | TaskNoted
    | TaskOver
    | TimeCounted
)


class Repetition:
    """Which records of a journal, in their order, say again what was said in earlier segments. What is left of them is mutable state."""

    def __init__(self) -> None:
        self.left = 0
        """How many follow."""

    def has(self, record: Record) -> bool:
        """Whether the next record does."""
        is_again = self.left > 0
        self.left = record.again if isinstance(record, SharedBegan) else max(0, self.left - 1)
        return is_again


HEARD: Final = (Accepted, Ended, Feedback, Postponed, KnowledgeChanged, ResourcesChanged, Tick)
"""Events that servers, sensors and clocks bring about, and bring about again when they are asked again."""


def intents_of(commands: Iterable[Command]) -> tuple[UUID, ...]:
    """Return the requests that are sent, and the updates that are made."""
    return tuple(
        [command.request.id if isinstance(command, Send) else command.id for command in commands if isinstance(command, (Send, Store))]
    )
