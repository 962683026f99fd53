"""What a run may take over from another.

When a run may be succeeded by another.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

from pnm.core.execution.call_requests import UnderWay
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import GroundAction
from pnm.errors import RunError


def check_adoption(machine: PetriNetMachine, adopted: Mapping[int, UnderWay], resources: Callable[[GroundAction], tuple[str, ...]]) -> None:
    """Refuse requests other than those of which the plan says that they are under way.

    Raises:
        RunError: they are others, or have more than there is.
    """
    plan, capacities = machine.plan, machine.capacities
    expected = {call.index for call in plan.calls if call.under_way}
    if expected != adopted.keys():
        raise RunError(f"the calls {sorted(expected)} of the plan are under way; requests are taken over for {sorted(adopted)}")
    used = Counter(name for one in adopted.values() for name in one.resources)
    for name, count in used.items():
        if count > capacities.get(name, 1):
            raise RunError(f"{count} requests that are taken over have {name}")
    for call, taken in adopted.items():
        if taken.resources != resources(plan.calls[call].action):
            raise RunError(f"{taken.call} has {', '.join(taken.resources) or 'nothing'} for itself; the plan says otherwise")
