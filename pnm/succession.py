"""When a run may be succeeded by another."""

from __future__ import annotations

from pnm.errors import RunError
from pnm.run import Run


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
