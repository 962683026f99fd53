"""Petri Net Machines: nets, machines, knowledge, execution. Knows nothing of PDDL, planners or ROS.

A `PlanGraph` says which calls of actions wait for which; `generate` turns it into a
`PetriNetMachine`; `verify` proves that sound; a `Run` executes it without I/O; an `Executor`
connects a run to an `ActionClient`, a clock and knowledge.
"""

from typing import TYPE_CHECKING

from pnm.lazy import lazily

if TYPE_CHECKING:
    from pnm.actions.base import Accepted, ActionClient, Ended, Outcome, OutcomeKind, Request
    from pnm.analysis import Proof, explore, verify
    from pnm.bindings import Binding, Bindings, read_bindings
    from pnm.conditions import Condition, evaluate
    from pnm.effects import Effect, changes
    from pnm.errors import InputError, NotEnabled, PnmError, Position
    from pnm.executor import Executor
    from pnm.expressions import UNKNOWN, Fluent
    from pnm.generation import generate
    from pnm.knowledge import KnowledgeBase, Layered
    from pnm.machine import OnFailure, PetriNetMachine
    from pnm.marking import Marking
    from pnm.net import Arc, NetBuilder, PetriNet
    from pnm.observer import Observer
    from pnm.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
    from pnm.queries import MISSING
    from pnm.results import CallResult, Failure, RunResult
    from pnm.run import Run
    from pnm.semantics import enabled, fire, is_enabled
    from pnm.state_space import Unsound

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

_WHERE = {
    "Accepted": "pnm.actions.base",
    "ActionClient": "pnm.actions.base",
    "Ended": "pnm.actions.base",
    "Outcome": "pnm.actions.base",
    "OutcomeKind": "pnm.actions.base",
    "Request": "pnm.actions.base",
    "Proof": "pnm.analysis",
    "Unsound": "pnm.state_space",
    "explore": "pnm.analysis",
    "verify": "pnm.analysis",
    "Binding": "pnm.bindings",
    "Bindings": "pnm.bindings",
    "read_bindings": "pnm.bindings",
    "UNKNOWN": "pnm.expressions",
    "Condition": "pnm.conditions",
    "Fluent": "pnm.expressions",
    "evaluate": "pnm.conditions",
    "Effect": "pnm.effects",
    "changes": "pnm.effects",
    "InputError": "pnm.errors",
    "NotEnabled": "pnm.errors",
    "PnmError": "pnm.errors",
    "Position": "pnm.errors",
    "Executor": "pnm.executor",
    "generate": "pnm.generation",
    "MISSING": "pnm.queries",
    "KnowledgeBase": "pnm.knowledge",
    "Layered": "pnm.knowledge",
    "OnFailure": "pnm.machine",
    "PetriNetMachine": "pnm.machine",
    "Marking": "pnm.marking",
    "Arc": "pnm.net",
    "NetBuilder": "pnm.net",
    "PetriNet": "pnm.net",
    "Observer": "pnm.observer",
    "ActionCall": "pnm.plan_graph",
    "GroundAction": "pnm.plan_graph",
    "Moment": "pnm.plan_graph",
    "Ordering": "pnm.plan_graph",
    "PlanEvent": "pnm.plan_graph",
    "PlanGraph": "pnm.plan_graph",
    "CallResult": "pnm.results",
    "Failure": "pnm.results",
    "RunResult": "pnm.results",
    "Run": "pnm.run",
    "enabled": "pnm.semantics",
    "fire": "pnm.semantics",
    "is_enabled": "pnm.semantics",
}

__getattr__, __dir__ = lazily(__name__, _WHERE)
