"""The parameters of `pnm serve`, which are options of the command as well, and the files that they name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from planner_bridge.pipeline.loading import bindings_beside
from planner_bridge.planning.kairos import DEFAULT_PLANNER, IMPROVE
from planner_bridge.tasks.settings import OnChange
from pnm.actions.bindings_file import bindings_in
from pnm.core.logic.domain import Vocabulary
from pnm.core.machine.bindings import NO_BINDINGS, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.errors import InputError
from pnm.files.database.place import Place, place_of
from pnm.files.yaml_nodes import Mapped, load_yaml
from pnm.journal.kept import DAY, DURABILITIES, KEPT, LEASE
from pnm.knowledge.sensor_file import sensing_in
from pnm.knowledge.sensor_model import NO_SENSING, Sensing
from pnm.ros.node.parameters import NodeParameter, ParameterValue
from pnm.tasks import OnConflict

PARAMETERS: Final = (
    NodeParameter("domain", "", "file with the domain, in PDDL"),
    NodeParameter("problem", "", "file with the problem, in PDDL: the initial facts, and the default goal"),
    NodeParameter("bindings", "", "file with the bindings of actions to servers; by default bindings.yaml beside the domain"),
    NodeParameter("sensing", "", "file that maps topics and services to facts about the world"),
    NodeParameter("goals", "", "YAML file with named goals"),
    NodeParameter("problems", "", "folder of the PDDL files of problem/save and problem/load; without it they cannot name files"),
    NodeParameter("world", "", "YAML file with a domain and hand-written plans, each of which becomes an action server"),
    NodeParameter("world_name", "", "the world of that file, if there are several", option="name"),
    NodeParameter("knowledge", "", "SQLite file or postgresql://… of the global knowledge, instead of the choice of the plans"),
    NodeParameter(
        "journal", "", "file of the tasks, or postgresql://… for several nodes: tasks go on from it after a crash;"
        " by default one for the node and its files in ~/.local/state/pnm/journals; 'none' keeps nothing",
    ),
    NodeParameter(
        "durability", "", "the crash that the journal survives: of the process, or of the computer, which is slower;"
        " by default process-crash for a file, power-loss for PostgreSQL",
        choices=tuple(DURABILITIES),
    ),
    NodeParameter("keep_days", KEPT / DAY, "days for which the journal keeps old records; tasks are listed for longer"),
    NodeParameter(
        "adopt", False, "whether to take a journal of another node or computer, a copy, or one without its last records"
    ),
    NodeParameter("lease", LEASE, "seconds after which another node takes over a journal in PostgreSQL from a silent one", least=1),
    NodeParameter("planner", DEFAULT_PLANNER, "kairos, any engine of unified-planning, race, or race:NAME,NAME"),
    NodeParameter("planner_timeout", 30.0, "seconds for the planner"),
    NodeParameter("improve", IMPROVE, "seconds to search for a better plan, at most"),
    NodeParameter("replans", 10, "how often the plan of a task may be replaced"),
    NodeParameter("patience", 0.0, "seconds for which a goal without a plan waits for facts to change"),
    NodeParameter("ask_for_help", False, "whether a person is asked when a goal cannot be reached: 'try again' or 'give up'"),
    NodeParameter("max_tasks", 8, "how many tasks are planned for and carried out at a time", least=1),
    NodeParameter("max_queue", 100, "how many more tasks may wait; others are refused"),
    NodeParameter(
        "on_failure", "continue_others", "treatment of running actions after a failure in their task",
        choices=tuple(policy.value for policy in OnFailure),
    ),
    NodeParameter(
        "on_change", "eager", "whether a task plans anew as soon as its plan cannot work any more, or when it gets there",
        choices=tuple(policy.value for policy in OnChange),
    ),
    NodeParameter(
        "on_conflict", "plan_around", "treatment of a goal in conflict with others, unless the goal specifies it",
        choices=tuple(policy.word for policy in OnConflict if policy),
    ),
    NodeParameter("cancel", 20.0, "seconds for tasks to end when the node is shut down"),
    NodeParameter("autostart", True, "whether the node configures and activates itself"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Options:
    """The values of the parameters, as types of Python."""

    domain: Path | None
    problem: Path | None
    bindings: Path | None
    sensing: Path | None
    goals: Path | None
    problems: Path | None
    world: Path | None
    world_name: str | None
    knowledge: Place | None
    journal: str
    """A file, postgresql://…, 'none', or empty for the default."""
    durability: bool | None
    """None for the default of the place of the journal."""
    keep_days: float
    adopt: bool
    lease: float
    planner: str
    planner_timeout: float
    improve: float
    replans: int
    patience: float
    ask_for_help: bool
    max_tasks: int
    max_queue: int
    on_failure: OnFailure
    on_change: OnChange
    on_conflict: OnConflict
    cancel: float
    autostart: bool

    @classmethod
    def of(cls, values: Mapping[str, ParameterValue]) -> Options:
        """Convert the values of parameters, which have the right types; raise an `InputError` if they contradict each other."""
        given: dict[str, Any] = dict(values)
        for name in ("domain", "problem", "bindings", "sensing", "goals", "problems", "world"):
            given[name] = Path(given[name]).expanduser() if given[name] else None
        given["knowledge"] = place_of(given["knowledge"]) if given["knowledge"] else None
        if (given["domain"] is None) != (given["problem"] is None):
            raise InputError("a domain and a problem belong together; expected both or neither")
        if given["domain"] is None and given["world"] is None:
            raise InputError("there is nothing to serve; expected a domain and a problem, or a world of plans, or both")
        if given["goals"] and given["domain"] is None:
            raise InputError("named goals need a domain and a problem; expected both, or no goals")
        given["world_name"] = given["world_name"] or None
        given["on_failure"], given["on_conflict"] = OnFailure(given["on_failure"]), OnConflict[given["on_conflict"].upper()]
        given["on_change"] = OnChange(given["on_change"])
        given["durability"] = DURABILITIES.get(given["durability"])
        return cls(**given)


# --- bindings and sensors -------------------------------------------------------------------------
# The bindings and sensors of a node, which stay while problems come and go.


@dataclass(frozen=True)
class RobotFiles:
    """The contents of the files of bindings and sensors when the node was configured; None without such a file."""

    bindings: Mapped | None
    sensing: Mapped | None

    @staticmethod
    def of(options: Options) -> RobotFiles:
        """Load the files; raise an `InputError` if one is no YAML."""
        chosen = (options.bindings or bindings_beside(options.domain), options.sensing)
        return RobotFiles(*[load_yaml(file) if file else None for file in chosen])

    def read(self, known: Vocabulary | None, *, strangers: bool = False) -> tuple[Bindings, Sensing]:
        """Return bindings and sensors; raise an `InputError` where a name is not declared, or used in another way.

        Args:
            known: the names of the problem; any if None.
            strangers: whether there may be bindings of actions that it does not have.
        """
        bindings = bindings_in(self.bindings, known, strangers=strangers) if self.bindings else NO_BINDINGS
        return bindings, sensing_in(self.sensing, known) if self.sensing else NO_SENSING
