"""Goal ids identify the executive that sent a goal, and so the services for its knowledge.

An executive draws four bytes once, and begins the ids of all its runs and goals with them. The names of its services
contain these bytes, so that an action server finds them by the goal alone. The rest of such an id is that of a UUID
of version 5; clients that know nothing of this send version 4 or no version at all.
"""

from __future__ import annotations

from typing import Final

_MARK: Final = 4


def service_prefix(goal: bytes) -> str:
    """Return the prefix of the names of the knowledge services, given the id of any run or goal of the executive."""
    return f"/pnm_{goal[:_MARK].hex()}"


def may_be_ours(goal: bytes) -> bool:
    """Return True if the goal may come from an executive."""
    return goal[6] >> 4 == 5 and goal[8] >> 6 == 2
