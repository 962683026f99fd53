"""Petri Net Machines: nets, machines, knowledge, execution. Knows nothing of PDDL, planners or ROS.

A `PlanGraph` says which calls of actions wait for which; `generate` turns it into a
`PetriNetMachine`; `verify` proves that sound; a `Run` executes it without I/O; an `Executor`
connects a run to an `ActionClient`, a clock and knowledge.
"""

from typing import TYPE_CHECKING

from pnm.files.lazy_exports import lazily

if TYPE_CHECKING:
    from pnm.actions.bindings_file import read_bindings
    from pnm.core.execution.call_results import CallResult, Failure, RunResult
    from pnm.core.execution.events import Observer
    from pnm.core.execution.run import Run
    from pnm.core.knowledge_base import KnowledgeBase, Layered
    from pnm.core.logic.computed_values import MISSING
    from pnm.core.logic.conditions import Condition, evaluate
    from pnm.core.logic.effects import Effect, changes
    from pnm.core.logic.expressions import UNKNOWN, Fluent
    from pnm.core.machine.bindings import Binding, Bindings
    from pnm.core.machine.generate import generate
    from pnm.core.machine.machine import OnFailure, PetriNetMachine
    from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
    from pnm.core.machine.requests import Accepted, ActionClient, Ended, Outcome, OutcomeKind, Request
    from pnm.core.machine.verification.explore import Unsound
    from pnm.core.machine.verification.verify import Proof, explore, verify
    from pnm.core.net.firing_rule import enabled, fire, is_enabled
    from pnm.core.net.net import Arc, Marking, NetBuilder, PetriNet
    from pnm.errors import InputError, NotEnabled, PnmError, Position
    from pnm.executor import Executor

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
    "Accepted": "pnm.core.machine.requests",
    "ActionClient": "pnm.core.machine.requests",
    "Ended": "pnm.core.machine.requests",
    "Outcome": "pnm.core.machine.requests",
    "OutcomeKind": "pnm.core.machine.requests",
    "Request": "pnm.core.machine.requests",
    "Proof": "pnm.core.machine.verification.verify",
    "Unsound": "pnm.core.machine.verification.explore",
    "explore": "pnm.core.machine.verification.verify",
    "verify": "pnm.core.machine.verification.verify",
    "Binding": "pnm.core.machine.bindings",
    "Bindings": "pnm.core.machine.bindings",
    "read_bindings": "pnm.actions.bindings_file",
    "UNKNOWN": "pnm.core.logic.expressions",
    "Condition": "pnm.core.logic.conditions",
    "Fluent": "pnm.core.logic.expressions",
    "evaluate": "pnm.core.logic.conditions",
    "Effect": "pnm.core.logic.effects",
    "changes": "pnm.core.logic.effects",
    "InputError": "pnm.errors",
    "NotEnabled": "pnm.errors",
    "PnmError": "pnm.errors",
    "Position": "pnm.errors",
    "Executor": "pnm.executor",
    "generate": "pnm.core.machine.generate",
    "MISSING": "pnm.core.logic.computed_values",
    "KnowledgeBase": "pnm.core.knowledge_base",
    "Layered": "pnm.core.knowledge_base",
    "OnFailure": "pnm.core.machine.machine",
    "PetriNetMachine": "pnm.core.machine.machine",
    "Marking": "pnm.core.net.net",
    "Arc": "pnm.core.net.net",
    "NetBuilder": "pnm.core.net.net",
    "PetriNet": "pnm.core.net.net",
    "Observer": "pnm.core.execution.events",
    "ActionCall": "pnm.core.machine.plan_graph",
    "GroundAction": "pnm.core.machine.plan_graph",
    "Moment": "pnm.core.machine.plan_graph",
    "Ordering": "pnm.core.machine.plan_graph",
    "PlanEvent": "pnm.core.machine.plan_graph",
    "PlanGraph": "pnm.core.machine.plan_graph",
    "CallResult": "pnm.core.execution.call_results",
    "Failure": "pnm.core.execution.call_results",
    "RunResult": "pnm.core.execution.call_results",
    "Run": "pnm.core.execution.run",
    "enabled": "pnm.core.net.firing_rule",
    "fire": "pnm.core.net.firing_rule",
    "is_enabled": "pnm.core.net.firing_rule",
}

__getattr__, __dir__ = lazily(__name__, _WHERE)
