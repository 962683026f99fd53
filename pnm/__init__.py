"""Petri Net Machines: nets, machines, knowledge, execution. Knows nothing of PDDL, planners or ROS.

A `PlanGraph` says which calls of actions wait for which; `generate` turns it into a
`PetriNetMachine`; `verify` proves that sound; a `Run` executes it without I/O; an `Executor`
connects a run to an `ActionClient`, a clock and knowledge.
"""

from typing import TYPE_CHECKING

from pnm.core import notebook
from pnm.files.lazy_exports import lazy_exports

if TYPE_CHECKING:
    from pnm.actions.bindings_file import read_bindings as read_bindings
    from pnm.core.execution.call_results import CallResult as CallResult, Failure as Failure, RunResult as RunResult
    from pnm.core.execution.events import Observer as Observer
    from pnm.core.execution.run import Run as Run
    from pnm.core.knowledge_base import KnowledgeBase as KnowledgeBase, Layered as Layered
    from pnm.core.logic.computed_values import MISSING as MISSING
    from pnm.core.logic.conditions import Condition as Condition, evaluate as evaluate
    from pnm.core.logic.effects import Effect as Effect, changes as changes
    from pnm.core.logic.expressions import UNKNOWN as UNKNOWN, Fluent as Fluent
    from pnm.core.machine.bindings import Binding as Binding, Bindings as Bindings
    from pnm.core.machine.generate import generate as generate
    from pnm.core.machine.machine import OnFailure as OnFailure, PetriNetMachine as PetriNetMachine
    from pnm.core.machine.plan_graph import (
        ActionCall as ActionCall,
        GroundAction as GroundAction,
        Moment as Moment,
        Ordering as Ordering,
        PlanEvent as PlanEvent,
        PlanGraph as PlanGraph,
    )
    from pnm.core.machine.requests import (
        Accepted as Accepted,
        ActionClient as ActionClient,
        Ended as Ended,
        Outcome as Outcome,
        OutcomeKind as OutcomeKind,
        Request as Request,
    )
    from pnm.core.machine.verification.part import Unsound as Unsound
    from pnm.core.machine.verification.verify import Proof as Proof, explore as explore, verify as verify
    from pnm.core.net.net import (
        Arc as Arc,
        Marking as Marking,
        NetBuilder as NetBuilder,
        PetriNet as PetriNet,
        enabled as enabled,
        fire as fire,
        is_enabled as is_enabled,
    )
    from pnm.core.pictures.net_picture import net_svg as net_svg
    from pnm.core.pictures.plan_picture import plan_dot as plan_dot, plan_svg as plan_svg
    from pnm.core.pictures.timeline import Timeline as Timeline, timeline_svg as timeline_svg
    from pnm.errors import InputError as InputError, NotEnabled as NotEnabled, PnmError as PnmError, Position as Position
    from pnm.executor import Executor as Executor
else:
    __all__, __getattr__, __dir__ = lazy_exports(__name__, __file__)


def _plan_in_notebook(plan: "PlanGraph") -> str:
    from pnm.core.pictures.plan_picture import plan_svg

    return plan_svg(plan)


def _machine_in_notebook(machine: "PetriNetMachine") -> str | None:
    from pnm.core.pictures.net_picture import net_svg

    return net_svg(machine) if len(machine.plan.calls) <= 50 else None  # a browser takes long for more


notebook.PLAN.draw, notebook.MACHINE.draw = _plan_in_notebook, _machine_in_notebook
