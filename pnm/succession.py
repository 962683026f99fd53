"""When a run may be succeeded by another, and what that may take over."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from pnm.calls import UnderWay
from pnm.errors import PnmError
from pnm.plan_graph import GroundAction, PlanGraph

if TYPE_CHECKING:
    from pnm.run import Run


class RunError(PnmError):
    """A run was driven wrongly: begun twice, asked for a result before its end, or succeeded by one that loses something."""


def check_adoption(plan: PlanGraph, adopted: Mapping[int, UnderWay], resources: Callable[[GroundAction], tuple[str, ...]]) -> None:
    """Refuse requests other than those of which the plan says that they are under way.

    Raises:
        RunError: they are others, or have more than there is.
    """
    expected = {call.index for call in plan.calls if call.under_way}
    if expected != adopted.keys():
        raise RunError(f"the calls {sorted(expected)} of the plan are under way; requests are taken over for {sorted(adopted)}")
    used = Counter(name for one in adopted.values() for name in one.resources)
    for name, count in used.items():
        if count > plan.capacities.get(name, 1):
            raise RunError(f"{count} requests that are taken over have {name}")
    for call, taken in adopted.items():
        if taken.resources != resources(plan.calls[call].action):
            raise RunError(f"{taken.call} has {', '.join(taken.resources) or 'nothing'} for itself; the plan says otherwise")


def check_succession(old: Run, new: Run) -> None:
    """Refuse to lose what is under way.

    Raises:
        RunError: the one cannot be succeeded by the other.
    """
    if old.over or old.stopped:
        raise RunError("a run that is over, or was told to stop, is not succeeded by another")
    if old.id == new.id:
        raise RunError("the run that succeeds another has an id of its own")
    if old.settling:
        raise RunError(f"the effects of {', '.join(map(str, old.settling))} are still to be looked for")
    taken, there = set(new.open_requests), {one.request for one in old.under_way()}
    left = [str(call) for request, call in old.open_calls.items() if request not in taken]
    if left:
        raise RunError(f"the other run does not take over {', '.join(left)}")
    gone = [str(call) for request, call in new.open_calls.items() if request not in there]
    if gone:
        raise RunError(f"{', '.join(gone)} cannot be taken over: it is over, or being cancelled")
