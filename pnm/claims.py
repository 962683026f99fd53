"""What the calls of one run have of resources, and where calls wait for some.

Decides nothing: `pnm.run` says when.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
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

    def withheld_from(self, names: tuple[str, ...]) -> Mapping[str, str]:
        """Return which of the names are withheld, and by whom."""
        return self.resources.withheld_from(names)

    def withhold(self, call: int, name: str) -> tuple[str, ...]:
        """Have the request of the call keep what it has, though nobody waits for its end any more; return what that is."""
        request = self._had.pop(call)
        self.resources.withhold(request, f"{name} of task {self._task.hex[:8]}")
        return next((claim.names for claim in self.resources.held if claim.request == request), ())

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
        """Return the places that wait and where the claim may be granted now, or has come to wait for what is withheld."""
        if not self._waiting:
            return []
        ready = self.resources.servable() | {claim.request for claim in self.resources.line if self.resources.withheld_from(claim.names)}
        return [place for place, request in self._waiting.items() if request is None or request in ready]

    def end(self, kept: Collection[UUID], open_calls: Mapping[UUID, str]) -> None:
        """Wait for nothing, and give everything back but what these requests have; those that are open keep what they have."""
        for place in [*self._waiting]:
            self.leave(place)
        for call, request in [*self._had.items()]:
            if request in kept:
                continue
            if request in open_calls:
                self.withhold(call, open_calls[request])
            else:
                self.give(call)
