"""The parameters of `pnm serve`, which are options of the command as well, and the files that they name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

from planner_bridge.pipeline.loading import BINDINGS, beside
from planner_bridge.planning.kairos import DEFAULT_PLANNER
from planner_bridge.tasks.settings import DEFAULTS, OnChange
from pnm.actions.bindings_file import bindings_in
from pnm.core.logic.domain import Vocabulary
from pnm.core.machine.bindings import NO_BINDINGS, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.errors import InputError
from pnm.files.database.place import Place, place_of
from pnm.files.yaml_nodes import Mapped, load_yaml
from pnm.journal.fleet import Part
from pnm.journal.kept import DAY, DURABILITIES, KEPT, LEASE
from pnm.knowledge.sensor_file import sensing_in
from pnm.knowledge.sensor_model import NO_SENSING, Sensing
from pnm.ros.node.parameters import NodeParameter, ParameterValue, parameter
from pnm.tasks import OnConflict


@dataclass(frozen=True, slots=True)
class Options:
    """The parameters, and their values as types of Python."""

    domain: Path | None = parameter("", "file with the domain, in PDDL")
    problem: Path | None = parameter("", "file with the problem, in PDDL: the initial facts, and the default goal")
    bindings: Path | None = parameter("", "file with the bindings of actions to servers; by default bindings.yaml beside the domain")
    sensing: Path | None = parameter("", "file that maps topics and services to facts about the world")
    goals: Path | None = parameter("", "YAML file with named goals")
    problems: Path | None = parameter("", "folder of the PDDL files of problem/save and problem/load; without it they cannot name files")
    world: Path | None = parameter("", "YAML file with a domain and hand-written plans, each of which becomes an action server")
    world_name: str | None = parameter("", "the world of that file, if there are several", option="name")
    knowledge: Place | None = parameter("", "SQLite file or postgresql://… of the global knowledge, instead of the choice of the plans")
    journal: str = parameter(
        "",
        "file of the tasks, or postgresql://… for several nodes: tasks go on from it after a crash;"
        " by default one for the node and its files in ~/.local/state/pnm/journals; 'none' keeps nothing",
    )
    durability: bool | None = parameter(
        "",
        "the crash that the journal survives: of the process, or of the computer, which is slower;"
        " by default process-crash for a file, power-loss for PostgreSQL",
        choices=tuple(DURABILITIES),
    )
    """None for the default of the place of the journal."""
    rates: Path | None = parameter("", "file of the rates that `pnm learn` writes; by default rates.yaml beside the domain")
    learn: bool = parameter(False, "whether to add to the rates how calls ended, and after how many seconds, when a task is over")
    learned_limits: bool = parameter(False, "whether calls have the limits of the rates, where no binding says one")
    odds: bool = parameter(True, "whether the status of tasks has the odds of what is left of their plans, where there are rates")
    keep_days: float = parameter(KEPT / DAY, "days for which the journal keeps old records; tasks are listed for longer")
    adopt: bool = parameter(False, "whether to take a journal of another node or computer, a copy, or one without its last records")
    lease: float = parameter(LEASE, "seconds after which another node takes over a journal in PostgreSQL from a silent one", least=1)
    part: Part | None = parameter("", "the part of a fleet that the node serves, such as 2/4, with a journal postgresql://… for all")
    robots: str = parameter("robot", "the type of the robots of a fleet, which are dealt out to its parts")
    planner: str = parameter(DEFAULT_PLANNER, "kairos, any engine of unified-planning, race, or race:NAME,NAME")
    planner_timeout: float = parameter(30.0, "seconds for the planner")
    improve: float | None = parameter(
        -1.0,
        "seconds to search for a better plan, and again while robots work; 0: the first plan, the same every time;"
        " -1: a twentieth of the time that the plan takes, at most 5",
        least=-1,
    )
    """None for that share."""
    replans: int = parameter(DEFAULTS.limits.replans, "how often the plan of a task may be replaced")
    without_progress: int = parameter(
        DEFAULTS.limits.without_progress,
        "how many replans in a row may bring no progress: nothing new is known, and no fewer calls are left",
    )
    patience: float = parameter(0.0, "seconds for which a goal without a plan waits for facts to change")
    ask_for_help: bool = parameter(False, "whether a person is asked when a goal cannot be reached: 'try again' or 'give up'")
    max_tasks: int = parameter(8, "how many tasks are planned for and carried out at a time", least=1)
    max_queue: int = parameter(100, "how many more tasks may wait; others are refused")
    on_failure: OnFailure = parameter(
        "continue_others", "treatment of running actions after a failure in their task", choices=tuple(policy.value for policy in OnFailure)
    )
    on_change: OnChange = parameter(
        "eager",
        "whether a task plans anew as soon as its plan cannot work any more, or when it gets there",
        choices=tuple(policy.value for policy in OnChange),
    )
    on_conflict: OnConflict = parameter(
        "plan_around",
        "treatment of a goal in conflict with others, unless the goal specifies it",
        choices=tuple(policy.word for policy in OnConflict if policy),
    )
    cancel: float = parameter(20.0, "seconds for tasks to end when the node is shut down")
    autostart: bool = parameter(True, "whether the node configures and activates itself")

    @classmethod
    def of(cls, values: Mapping[str, ParameterValue]) -> Options:
        """Convert the values of parameters, which have the right types; raise an `InputError` if they contradict each other."""
        given: dict[str, Any] = dict(values)
        for name in ("domain", "problem", "bindings", "sensing", "goals", "problems", "world", "rates"):
            given[name] = Path(given[name]).expanduser() if given[name] else None
        given["knowledge"] = place_of(given["knowledge"]) if given["knowledge"] else None
        if (given["domain"] is None) != (given["problem"] is None):
            raise InputError("a domain and a problem belong together; expected both or neither")
        if given["domain"] is None and given["world"] is None:
            raise InputError("there is nothing to serve; expected a domain and a problem, or a world of plans, or both")
        if given["goals"] and given["domain"] is None:
            raise InputError("named goals need a domain and a problem; expected both, or no goals")
        if given["learn"] and given["journal"] == "none":
            raise InputError("what is learned comes from the journal; expected one, or not to learn")
        given["world_name"] = given["world_name"] or None
        if part := given["part"] or None:
            part = Part.of(part)
            part.journal(place_of(given["journal"] or "none"))
            if given["world"] is not None:
                raise InputError("a part of a fleet carries out goals; expected a domain and a problem, and no world of plans")
        given["part"] = part
        given["on_failure"], given["on_conflict"] = OnFailure(given["on_failure"]), OnConflict[given["on_conflict"].upper()]
        given["improve"] = None if given["improve"] < 0.0 else given["improve"]
        given["on_change"] = OnChange(given["on_change"])
        given["durability"] = DURABILITIES.get(given["durability"])
        return cls(**given)


PARAMETERS: Final = tuple([NodeParameter(one.name, **one.metadata) for one in fields(Options)])


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
        chosen = (options.bindings or beside(options.domain, BINDINGS), options.sensing)
        return RobotFiles(*[load_yaml(file) if file else None for file in chosen])

    def read(self, known: Vocabulary | None, *, strangers: bool = False) -> tuple[Bindings, Sensing]:
        """Return bindings and sensors; raise an `InputError` where a name is not declared, or used in another way.

        Args:
            known: the names of the problem; any if None.
            strangers: whether there may be bindings of actions that it does not have.
        """
        bindings = bindings_in(self.bindings, known, strangers=strangers) if self.bindings else NO_BINDINGS
        return bindings, sensing_in(self.sensing, known) if self.sensing else NO_SENSING
