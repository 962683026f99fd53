"""What the calls of one run have of resources, and where calls wait for some.

Decides nothing: `pnm.run` says when.
"""

from __future__ import annotations

from collections.abc import Collection
from uuid import UUID

from pnm.resources import Claim, Resources


class Claims:
    """The claims of one run to resources that it shares with others.

    Args:
        resources: who has what.
        task: on whose behalf they are claimed.
        priority: how they stand among those of others.

    The mutable state is what the constructor sets under "state".
    """

    def __init__(self, resources: Resources, task: UUID, priority: int) -> None:
        self.resources = resources
        self._task = task
        self._priority = priority
        # state
        self._waiting: dict[int, UUID | None] = {}
        """By place, the requests that stand in line; None where only calls of this run are in the way."""
        self._had: dict[int, UUID] = {}
        """For every call that has resources, the request that has them."""

    def claim(self, request: UUID, names: tuple[str, ...]) -> Claim:
        """Return what the request claims."""
        return Claim(self._task, request, self._priority, names)

    def are_free(self, place: int, claim: Claim) -> bool:
        """Tell whether the claim would be granted; if not, it stands in line, and the place waits for it."""
        if self.resources.is_free(claim):
            return True
        self.resources.take(claim)
        self._waiting[place] = claim.request
        return False

    def wait_for_own(self, place: int) -> None:
        """Wait at the place for what other calls of this run have, and not in line."""
        self.leave(place)
        self._waiting[place] = None

    def take(self, call: int, claim: Claim) -> None:
        """Have what is free."""
        granted = self.resources.take(claim)
        assert granted, "what is not free opens nothing"
        self._had[call] = claim.request

    def keep(self, call: int, claim: Claim) -> None:
        """Have what the request of the call has been granted before."""
        self.resources.keep(claim)
        self._had[call] = claim.request

    def give(self, call: int) -> None:
        """Give back what the call has."""
        self.resources.give(self._had.pop(call))

    @property
    def is_waiting(self) -> bool:
        """Whether anything is waited for."""
        return bool(self._waiting)

    def leave(self, place: int) -> bool:
        """No longer wait at the place; tell whether it did."""
        if place not in self._waiting:
            return False
        request = self._waiting.pop(place)
        if request is not None:
            self.resources.withdraw(request)
        return True

    def served(self) -> list[int]:
        """Return the places that wait and where the claim may be granted now."""
        if not self._waiting:
            return []
        servable = self.resources.servable()
        return [place for place, request in self._waiting.items() if request is None or request in servable]

    def end(self, kept: Collection[UUID] = ()) -> None:
        """Give everything back but what these requests have, and wait for nothing."""
        for place in [*self._waiting]:
            self.leave(place)
        for call, request in [*self._had.items()]:
            if request not in kept:
                self.give(call)
