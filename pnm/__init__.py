"""Petri Net Machines: nets, machines, knowledge, execution. Knows nothing of PDDL, planners or ROS.

A `PlanGraph` says which calls of actions wait for which; `generate` turns it into a
`PetriNetMachine`; `verify` proves that sound; a `Run` executes it without I/O; an `Executor`
connects a run to an `ActionClient`, a clock and knowledge.
"""

from pnm.actions.base import Accepted, ActionClient, Ended, Outcome, OutcomeKind, Request
from pnm.analysis import Proof, Unsound, explore, verify
from pnm.bindings import Binding, Bindings, read_bindings
from pnm.conditions import UNKNOWN, Condition, Fluent, evaluate
from pnm.effects import Effect, changes
from pnm.errors import InputError, NotEnabled, PnmError, Position
from pnm.executor import Executor
from pnm.generate import generate
from pnm.knowledge import MISSING, KnowledgeBase, Layered
from pnm.machine import OnFailure, PetriNetMachine
from pnm.marking import Marking
from pnm.net import Arc, NetBuilder, PetriNet
from pnm.observer import Observer
from pnm.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.results import CallResult, Failure, RunResult
from pnm.run import Run
from pnm.semantics import enabled, fire, is_enabled

__all__ = [
    "MISSING",
    "UNKNOWN",
    "Accepted",
    "ActionCall",
    "ActionClient",
    "Arc",
    "Binding",
    "Bindings",
    "CallResult",
    "Condition",
    "Effect",
    "Ended",
    "Executor",
    "Failure",
    "Fluent",
    "GroundAction",
    "InputError",
    "KnowledgeBase",
    "Layered",
    "Marking",
    "Moment",
    "NetBuilder",
    "NotEnabled",
    "Observer",
    "OnFailure",
    "Ordering",
    "Outcome",
    "OutcomeKind",
    "PetriNet",
    "PetriNetMachine",
    "PlanEvent",
    "PlanGraph",
    "PnmError",
    "Position",
    "Proof",
    "Request",
    "Run",
    "RunResult",
    "Unsound",
    "changes",
    "enabled",
    "evaluate",
    "explore",
    "fire",
    "generate",
    "is_enabled",
    "read_bindings",
    "verify",
]
