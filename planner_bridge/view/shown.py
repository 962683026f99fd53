"""The state that the page shows, after one record of a journal: plain values only, so that it is JSON as it is.

Every part has its things by key; what changes from one moment to the next is told key by key, see `planner_bridge.view.app`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from pnm.core.pictures.timeline import Replan


@dataclass(frozen=True, slots=True)
class TaskShown:
    """A task.

    Args:
        reason: why it is so, or how it has ended.
        priority: higher ones come first.
        accepted: the time of day, in seconds.
        deadline: the time of day by which it has to be done, None for none.
        used: seconds of its limit that are used.
        limit: that limit; None if there is none.
        code: how it has ended, empty while it has not.
        counts: how often what has happened, in words; empty if it has no run here.
    """

    goal: str
    state: str
    reason: str
    priority: int
    accepted: float
    deadline: float | None
    used: float
    limit: float | None
    code: str
    runs: tuple[str, ...]
    order: int
    counts: str


@dataclass(frozen=True, slots=True)
class RunShown:
    """A run: one execution of one machine.

    Args:
        record: with which it was made.
        time: when that was.
        origin: the time from which its plan counts; None until it begins.
        replan: why it followed the run before, and how it differs from that; None for the first one of its task.
    """

    task: str
    name: str
    record: int
    time: float
    origin: float | None
    is_over: bool
    replan: Replan | None


@dataclass(frozen=True, slots=True)
class CallShown:
    """A call of a run.

    Args:
        action: with its arguments, as it was sent last.
        lane: whose it is, on the timeline.
        state: what has become of it so far, in a word.
        outcome: the same in words.
        planned: seconds after the origin of its run at which the planner had it start.
        duration: the seconds that it was planned to take.
        is_assumed: whether some of its effects are believed: nothing reports them.
    """

    run: str
    index: int
    action: str
    lane: str
    state: str
    outcome: str
    attempts: int
    started: float | None
    ended: float | None
    planned: float
    duration: float | None
    is_assumed: bool


@dataclass(frozen=True, slots=True)
class RequestShown:
    """A request: one attempt at a call.

    Args:
        outcome: how, in a word; empty while it is not over.
        message: what the server said about that.
        feedback: what the server has said last while it was at work.
    """

    run: str
    call: int
    action: str
    lane: str
    server: str
    attempt: int
    record: int
    sent: float
    accepted: float | None = None
    ended: float | None = None
    outcome: str = ""
    message: str = ""
    feedback: str = ""


@dataclass(frozen=True, slots=True)
class FactShown:
    """A fact: its value in words, how it is known, and since when."""

    value: str
    source: str
    """``sensed`` or ``assumed``."""
    since: float
    is_initial: bool
    """Whether it has been so from the beginning of what is shown: since then at least."""
    was: str = ""
    """The last known value of an unknown fluent; empty for none."""


@dataclass(frozen=True, slots=True)
class ServerShown:
    """An action server, as far as the journal knows: its actions, and what it is busy with."""

    actions: tuple[str, ...]
    busy: tuple[str, ...]
    failed: int
    """The number of requests that it has not carried out."""


@dataclass(frozen=True, slots=True)
class QuestionShown:
    """A question that is open: who is asked, what, on whose behalf, since when, and the answers to choose from; none for any."""

    who: str
    text: str
    subject: str
    since: float
    choices: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class TroubleShown:
    """A hindrance or a failure of a call.

    Args:
        call: the number of the step.
        is_failure: whether it was given up; else it is tried again, or recovers.
        followed: what came of it.
    """

    run: str
    call: int
    step: str
    is_failure: bool
    cause: str
    expected: str
    observed: str
    time: float
    followed: str = ""


@dataclass(frozen=True, slots=True)
class EventShown:
    """A record in words."""

    time: float
    task: str
    lines: tuple[str, ...]
    mark: str = ""
    """``failure``, ``replan`` or ``end``: what is marked on the way through the records; else empty."""


Shown = TaskShown | RunShown | CallShown | RequestShown | FactShown | ServerShown | QuestionShown | TroubleShown | EventShown


@dataclass(frozen=True, slots=True)
class View:
    """The whole state after a record.

    Args:
        time: of the record, on the clock of its process.
        began: when what is shown began.
        first: the first record of what is shown.
        problem: why no more can be shown; empty if all is well.
        clock: the time of day, in seconds, when that clock was 0; None if it is not known.
    """

    number: int = 0
    time: float = 0.0
    began: float = 0.0
    first: int = 0
    problem: str = ""
    clock: float | None = None
    tasks: Mapping[str, TaskShown] = field(default_factory=dict)
    runs: Mapping[str, RunShown] = field(default_factory=dict)
    calls: Mapping[str, CallShown] = field(default_factory=dict)
    requests: Mapping[str, RequestShown] = field(default_factory=dict)
    facts: Mapping[str, FactShown] = field(default_factory=dict)
    servers: Mapping[str, ServerShown] = field(default_factory=dict)
    questions: Mapping[str, QuestionShown] = field(default_factory=dict)
    troubles: Mapping[str, TroubleShown] = field(default_factory=dict)
    """By record, and their number in it."""
    events: Mapping[str, EventShown] = field(default_factory=dict)
    """By record: the last ones, and all that are marked."""
