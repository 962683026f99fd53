"""The interface of a task manager, and of the world that its tasks share; knows nothing of planners or of ROS 2.

A *task* is a goal that is pursued with as many plans as it takes, or one plan that is carried out. All tasks of a
process share the knowledge of the world and the resources of its robots.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Final, Protocol, TypeAlias
from uuid import UUID

from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.net.net import Marking
from pnm.core.resources import Hand

PROPOSED: Final = "propose_goal"
"""The action whose goals are pursued only after a person's yes."""
EVENTS: Final = logging.getLogger("pnm.events")
"""The log of tasks and of their node, for handlers here: `/rosout`, by `pnm.ros.node.ros_thread`."""
EVENTS.propagate = False  # commands print it in their own way
EVENTS.addHandler(logging.NullHandler())  # else Python prints warnings that have no handler

SHORT: Final = 1000
"""Characters of a text that is read at once; a longer one is read in a thread, while the event loop goes on."""
REMEMBERED: Final = 20
"""Tasks that are over and still known: they are listed, and their clients may ask for their results, also in the next process."""
SHOWN: Final = 200
"""Characters of a goal, of parameters or of results that a line shows."""


class NumberedWord(IntEnum):
    """A word for people and programs with its number in messages."""

    @property
    def word(self) -> str:
        """The word."""
        return self.name.lower()

    def __str__(self) -> str:
        return self.word


class Code(NumberedWord):
    """The end of a task; the numbers are those of ``pnm_interfaces/action/AchieveGoal``."""

    GOAL_REACHED = 0
    INVALID_GOAL = 1
    NO_PLAN = 2
    PLANNER_TIMEOUT = 3
    PLANNER_ERROR = 4
    ACTION_FAILED = 5
    CONDITION_LOST = 6
    TIMED_OUT = 7
    SERVER_UNAVAILABLE = 8
    REPLAN_LIMIT = 9
    CANCELLED = 10
    DEADLINE_MISSED = 11
    CONFLICT = 12
    QUEUE_FULL = 13
    CONSTRAINT_VIOLATED = 14
    ERROR = 15


class TaskState(NumberedWord):
    """The state of a task; the numbers are those of ``pnm_interfaces/msg/TaskStatus``."""

    QUEUED = 0
    PLANNING = 1
    RUNNING = 2
    REPLANNING = 3
    PAUSING = 4
    PAUSED = 5
    CANCELLING = 6
    OVER = 7


class StepState(NumberedWord):
    """The progress of a call of a plan; the numbers are those of ``pnm_interfaces/msg/PlanStep``."""

    WAITING = 0
    RUNNING = 1
    DONE = 2
    FAILED = 3
    SKIPPED = 4


class OnConflict(NumberedWord):
    """The treatment of a goal in conflict with others; the numbers are those of ``pnm_interfaces/action/AchieveGoal``."""

    DEFAULT = 0
    """As the task manager has it."""
    PLAN_AROUND = 1
    """Look for a plan that leaves the others alone; wait if there is none."""
    QUEUE = 2
    REFUSE = 3


class TraceKind(NumberedWord):
    """The kind of an event of a task; the numbers are those of ``pnm_interfaces/msg/TraceEvent``."""

    GOAL = 0
    STATE = 1
    PLANNED = 2
    UNPLANNED = 3
    BLOCKED = 4
    SENT = 5
    FEEDBACK = 6
    ENDED = 7
    WITHHELD = 8
    FAILED = 9
    REPLANNED = 10
    CONFLICT = 11
    FIRED = 12

    @property
    def is_frequent(self) -> bool:
        """Whether so much of it happens that it is neither kept nor printed."""
        return self in (TraceKind.FEEDBACK, TraceKind.FIRED)


@dataclass(frozen=True, slots=True)
class Wanted:
    """A task as its client wants it, with an id that the client has chosen."""

    id: UUID
    text: str
    """A condition in PDDL or the name of a goal; or the name or the text of a plan."""
    priority: int = 0
    """Higher ones come first."""
    deadline: float | None = None
    """Seconds from the beginning of the task, None for none."""
    on_conflict: OnConflict = OnConflict.DEFAULT
    parameters: Mapping[str, object] = field(default_factory=dict)
    """Those of a plan that is loaded."""
    is_plan: bool = False
    """Whether `text` is a plan, which is carried out as it is."""
    server: str = ""
    """The action by which it came, without namespaces; empty for none."""

    @property
    def needs_yes(self) -> bool:
        """Whether it is only proposed: a person decides whether it is pursued."""
        return self.server == PROPOSED

    @property
    def words(self) -> str:
        """Its text; words for one without."""
        return self.text or "the goal of the problem"


def percent(chance: float) -> str:
    """Return a chance in words, with as many places as tell it from 0 and from 1."""
    written = (f"{100.0 * chance:.{places}f}" for places in range(1, 5))
    return f"{next((text for text in written if 0.0 < float(text) < 100.0), f'{100.0 * chance:g}')} %"


@dataclass(frozen=True, slots=True)
class TaskOdds:
    """The odds of a goal, if nothing is planned anew: its chance; seconds to it in half of the runs that reach it, and in nine of ten."""

    chance: float
    median: float
    ninety_percent: float
    rests: str
    """What they rest on, in words, such as "learned from 41 of move: move; assumed: grasp"."""

    def after(self, seconds: float) -> TaskOdds:
        """Return them some seconds later."""
        return replace(self, median=max(0.0, self.median - seconds), ninety_percent=max(0.0, self.ninety_percent - seconds))

    def as_json(self) -> dict[str, object]:
        """Return them as programs get them."""
        seconds = {"median": self.median, "ninety_percent": self.ninety_percent}
        return {"chance": self.chance, "seconds": seconds, "rests_on": self.rests}

    def __str__(self) -> str:
        lasts = f", {self.median:.1f} s, {self.ninety_percent:.1f} s at most in 90 % of the runs" if self.chance else ""
        return f"{percent(self.chance)}{lasts}"


@dataclass(frozen=True, slots=True)
class TaskStatus:
    """The status of a task now."""

    id: UUID
    goal: str
    priority: int
    state: TaskState
    reason: str = ""
    running: tuple[str, ...] = ()
    ended: int = 0
    replans: int = 0
    restarts: int = 0
    """The number of times that a loaded plan was begun anew."""
    parameters: Mapping[str, object] = field(default_factory=dict)
    """The parameters of a loaded plan."""
    feedback: tuple[str, ...] = ()
    """The last feedback of the server of each running call, on one line; empty for none."""
    code: Code | None = None
    """Its end; None while it is not over."""
    odds: TaskOdds | None = None
    """Those of what is left of its plan; None where they are not known."""

    @property
    def title(self) -> str:
        """The goal with its parameters on one line, cut off where lines end."""
        given = (
            f"{name}: {value if isinstance(value, str) else json.dumps(value, ensure_ascii=False, default=str)}"
            for name, value in self.parameters.items()
        )
        return shortened(f"{self.goal}({', '.join(given)})" if self.parameters else self.goal)


def shortened(text: str) -> str:
    """Return a text on one line, cut off where lines end."""
    text = " ".join(text.split())
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 1]}…"


def results_text(results: Mapping[str, object]) -> str:
    """Return the variables that a plan gives back, on one line, such as ``worst: 31, shop: bakery``."""
    return ", ".join(f"{name}: {value if isinstance(value, str) else json.dumps(value, default=str)}" for name, value in results.items())


@dataclass(frozen=True, slots=True)
class TaskStep:
    """One call of a plan and how far it has come."""

    action: str
    arguments: tuple[str, ...]
    start: float
    duration: float
    state: StepState
    after: tuple[int, ...] = ()
    """The positions of the calls that must have started or ended before."""
    started: float | None = None
    """The time at which it was sent first, on the clock of the event loop; None if it was not."""
    ended: float | None = None
    attempts: int = 0
    limit: float = 0.0
    """Seconds from its acceptance after which it is cancelled; 0 for what is no action of a server."""
    cause: Cause | None = None
    """Why it has failed or was passed over."""

    def __str__(self) -> str:
        return f"{self.action}({', '.join(self.arguments)})"


@dataclass(frozen=True, slots=True)
class TraceEvent:
    """One thing that has happened to a task, at a time on the clock of the event loop."""

    task: UUID
    time: float
    kind: TraceKind
    subject: str = ""
    """The call or transition that it is about."""
    text: str = ""
    level: int = logging.INFO
    """That of `logging`; a warning is what would not happen if all went well."""


@dataclass(frozen=True, slots=True)
class TaskEnding:
    """The end of a task."""

    code: Code
    message: str
    replans: int = 0
    trace: tuple[TraceEvent, ...] = ()
    results: Mapping[str, object] = field(default_factory=dict)
    """The variables that a plan gives back."""
    cause: str = ""
    """Of a plan that is loaded: why it has failed, in one word, such as ``aborted`` or ``goal_false``."""


@dataclass(frozen=True, slots=True)
class MadePlan:
    """The result of a plan request: a plan that is not carried out."""

    code: Code
    """`GOAL_REACHED` when there is a plan."""
    message: str
    goal: str = ""
    """The goal that was planned for, in PDDL."""
    steps: tuple[TaskStep, ...] = ()
    odds: TaskOdds | None = None
    """Those of the plan; None where they are not known."""


KeptTasks: TypeAlias = Iterable[tuple[Wanted, TaskEnding | None]]
"""Tasks that another process has accepted, and how they have ended; None for those that go on."""


class TaskListener:
    """Listens to all tasks, on the event loop's thread: one empty method per moment. Must not raise, and must not block."""

    def changed(self, task: UUID) -> None:
        """Note that the status of a task is another one, or that it is there now."""

    def planned(self, task: UUID) -> None:
        """Note that a task has another plan and another net."""

    def happened(self, moment: TraceEvent) -> None:
        """Note that an event of a task has happened."""

    def moved(self, task: UUID, moment: Callable[[], TraceEvent]) -> None:
        """Note that tokens of its net have moved; a function returns the event, which is not made for others: so many happen."""

    def ended(self, task: UUID, ending: TaskEnding) -> None:
        """Note that a task is over. Comes once for every task, and after everything else about it."""


class TaskRefused(Exception):
    """A task cannot be begun, paused, resumed, stepped or cancelled: there is none of this id, or it is not in a state for that."""


class TaskCommands(Protocol):
    """The orders for a task of a process, or for all if it is None, on the event loop's thread; each may raise `TaskRefused`."""

    def begin(self, wanted: Wanted, /) -> None:
        """Begin a task. Whatever is wrong with it ends it, with a code and a reason."""

    async def pause(self, task: UUID | None, /, *, at_once: bool) -> None:
        """Start nothing more of it, nor, if it is None, of later ones; cancel what runs if `at_once`. Returns when nothing is under way."""

    async def resume(self, task: UUID | None, /) -> None:
        """Let a task that was paused go on."""

    async def cancel(self, task: UUID | None, /) -> None:
        """End it; return when what was under way has confirmed that, or the limit for it has passed."""

    async def take(self, name: str, /, *, reason: str = "", by: str = "") -> str:
        """Leave a robot, or another object or resource, to a person: what needs it is cancelled, and nothing more is sent to it.

        Returns when that is confirmed, or the limit for it has passed: then what may still be at work, in words. Raises `TaskRefused`
        for a name that nothing has, and if a person has it already.
        """

    async def give(self, name: str, /) -> None:
        """Use again what a person has had, with what sensors say by then; raise `TaskRefused` if nobody has it."""


class Tasks(TaskCommands, Protocol):
    """A task manager: carries out several tasks at once."""

    async def pause(self, task: UUID | None, /, *, at_once: bool, why: str = "paused on request", is_kept: bool = True) -> None:
        """Pause, for a reason for people, in the next process as well if `is_kept`."""

    async def resume(self, task: UUID | None, /, *, but: Collection[UUID] = ()) -> None:
        """Resume a task, or all but these."""

    async def cancel(self, task: UUID | None, /, *, why: str = "cancelled on request") -> None:
        """Cancel, for a reason for people."""

    def hands(self) -> tuple[Hand, ...]:
        """Return what people have in their hands."""

    async def step(self, task: UUID, /) -> None:
        """Let one request of a paused task leave; return when nothing of it is under way any more."""

    def settle(self, request: UUID, /, *, is_done: bool) -> None:
        """Have a request count as succeeded or failed, because a person says so; raise `TaskRefused` if it is not under way.

        Its server is told to cancel it, and it counts so as soon as the server is done with it; until then nothing changes.
        """

    def answer(self, question: UUID, text: str, /) -> None:
        """Answer a question to a person; raise `TaskRefused` if nobody waits for that, `SourceError` if the text is no answer to it."""

    def answer_of(self, task: UUID, name: str, text: str, /) -> None:
        """Answer the question of a task, of this name unless it is empty; raise as `answer`, and if not just one is open."""

    def status(self) -> tuple[TaskStatus, ...]:
        """Return the status of all tasks that are not over, in the order in which they are served, and of those that ended last."""

    def plans(self) -> Mapping[str, Mapping[str, object]]:
        """Return the hand-written plans that are loaded, with their parameters and the values that these have at first; None for none."""

    def plan(self, task: UUID, /) -> tuple[int, tuple[TaskStep, ...]]:
        """Return the number of plans that the task has had before, and the steps of its plan; none when it has none."""

    def net(self, task: UUID, /) -> tuple[int, PetriNetMachine, Marking] | None:
        """Return the number of nets that the task has had before, the net that it has now, and its marking."""

    def listen(self, listener: TaskListener, /) -> Callable[[], None]:
        """Have a listener listen from now on; return what stops that."""


class ServedWorld(Protocol):
    """Knowledge and problem of a process. To be used on the event loop's thread; what is wrong is an `InputError`."""

    async def query(self, questions: Sequence[str], /) -> Sequence[tuple[str, str]]:
        """Return each question, a condition or a function in PDDL, with its answer as a text: all facts, if there are no questions."""

    async def make(self, goal: str, planner: str, seconds: float | None, /, *, with_new_plans: bool = False) -> MadePlan:
        """Search for a plan for a goal from the world as it is; cancelling this ends the planner. "" and None are the defaults.

        Its odds, with or without new plans after failures, are there where something is known of the robots, or new plans are asked for.
        """

    async def check_goal(self, goal: str, /) -> None:
        """Raise an error for a mistake in the goal of a task."""

    async def pack(self, goal: str, /) -> str:
        """Return the problem as the world is now, with this goal, as a text for another process of the same program."""

    async def update(self, add: Sequence[str], remove: Sequence[str], forget: Sequence[str], /) -> int:
        """Record all of it at once or nothing; return how many of the facts were not known to be so before."""

    async def get(self) -> tuple[str, str]:
        """Return domain and problem in PDDL, the problem as the world is now."""

    async def save(self, file: str, /) -> str:
        """Write the problem as the world is now to a file under the folder for problems; return its whole path."""

    async def load(self, domain: str, problem: str, /) -> None:
        """Begin anew with another domain or problem, each PDDL as a text or the path of a file; refused while there are tasks."""

    def follow(self, report: Callable[[Mapping[str, object]], None], /) -> Callable[[], None]:
        """Report every change from now on, as fields of a ``pnm_interfaces/msg/KnowledgeChange``; return what stops that."""
