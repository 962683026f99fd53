"""The settings of a task, and its listeners."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import TYPE_CHECKING, ClassVar, Final, TypeAlias

from planner_bridge.model.plan import Plan, PlanningResult
from planner_bridge.model.problem import Problem
from planner_bridge.model.rates import NO_RATES, Rates
from planner_bridge.planning.kairos import DEFAULT_PLANNER
from planner_bridge.tasks.replanning import Foreseen, Limits, PlanAgain, ResumePlan
from planner_bridge.tasks.result import Violation
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.events import Observer
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import OnFailure, PetriNetMachine
from pnm.core.machine.plan_graph import PlanGraph
from pnm.core.machine.verification.verify import Proof
from pnm.errors import InputError, check_kinds, check_seconds
from pnm.knowledge.sensor_model import NO_SENSING, Sensing
from pnm.tasks import Tasks, TaskState

if TYPE_CHECKING:
    from concurrent.futures import Executor


class TaskObserver(Observer):
    """Listens to a whole task: one more empty method per moment."""

    def managed(self, tasks: Tasks) -> None:
        """Note who carries the task out, and can be told to pause it."""

    def began(self, now: float) -> None:
        """Note the time from which the seconds of the task count."""

    def restored(self) -> None:
        """Note that the task goes on where another process has left it."""

    def planning(self, planner: str) -> None:
        """Note that a planner is being asked."""

    def planned(self, plan: Plan) -> None:
        """Note that a plan was found."""

    def unplanned(self, result: PlanningResult) -> None:
        """Note that no plan was found."""

    def blocked(self, reason: str) -> None:
        """Note that there is no plan, and that the task waits for facts to change: people may help."""

    def generated(self, machine: PetriNetMachine, proof: Proof) -> None:
        """Note that a machine is ready to run, and proved sound."""

    def resigned(self, reason: str) -> None:
        """Note that a hand-written plan has failed, and wants a planner to find another way."""

    def replanning(self, decision: ResumePlan | PlanAgain | Foreseen, result: RunResult) -> None:
        """Note that another machine takes over, and why."""

    def entered(self, state: TaskState, why: str) -> None:
        """Note that the task is in another state, and why."""

    def violated(self, violation: Violation, now: float) -> None:
        """Note that a constraint is violated; the task will not go on."""


class OnChange(Enum):
    """The time at which a plan is looked at again because facts have changed."""

    EAGER = "eager"
    """At once, if the plan has to do with them."""
    LAZY = "lazy"
    """The moment at which a call needs them, and fails."""


ProvedMachine: TypeAlias = tuple[PetriNetMachine, Proof]


class Memory:
    """The memory of runs of one problem: this one keeps nothing; others have what one run has found for the next."""

    improves: ClassVar[bool] = True
    """Whether the rest of a plan may be improved while it is carried out."""

    def plan(self, problem: Problem, timeout: float, search: Callable[[float], PlanningResult]) -> PlanningResult:
        """Return a plan that is remembered, or what the search finds within the limit."""
        return search(timeout)

    def machine(self, graph: PlanGraph, prove: Callable[[], ProvedMachine]) -> ProvedMachine:
        """Return the machine of a plan, remembered or proved now."""
        return prove()


@dataclass(frozen=True)
class Settings:
    """The ways to pursue a task."""

    planner: str = DEFAULT_PLANNER
    planner_timeout: float = 30.0
    improve: float | None = None
    """Seconds for which a better plan is looked for; 0 for the first plan, the same every time; by default a share of what it takes."""
    bindings: Bindings = field(default_factory=Bindings)
    limits: Limits = field(default_factory=Limits)
    on_failure: OnFailure = OnFailure.DRAIN
    on_change: OnChange = OnChange.LAZY
    executor: Executor | None = None
    """Runs the planners when they race; a process for each by default."""
    sensing: Sensing = NO_SENSING
    """Which topics and services of ROS 2 speak of what."""
    ask_for_help: bool = False
    """Whether a person is asked when the task cannot go on: at the terminal, or over ROS 2 topics where there is none."""
    sim_time: bool = False
    """Whether time is that of a simulation, from ``/clock``; with the action servers of ROS 2 only."""
    learned: Rates = NO_RATES
    """How long calls take, and how often they succeed, by what has happened; plans are measured by that."""
    memory: Memory = field(default_factory=Memory)
    """What it knows of other runs of the same problem."""

    def __post_init__(self) -> None:
        """Refuse what has another meaning than it seems to have, such as a name in place of what it names."""
        if not isinstance(self.bindings, Bindings):
            raise InputError(f"expected Bindings, found {self.bindings!r}; `pnm.read_bindings` reads a file")
        kinds = {"planner": str, "limits": Limits, "learned": Rates, "sensing": Sensing, "on_failure": OnFailure, "on_change": OnChange}
        check_kinds("settings", {name: (getattr(self, name), kind) for name, kind in kinds.items()})
        check_seconds("the search for a plan", self.planner_timeout)
        check_seconds("the search for a better plan", self.improve)


DEFAULTS: Final = Settings()
"""Those of a task of which nothing else is said."""
