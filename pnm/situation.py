"""How a run is doing: the time, what it was told, and whether it can still succeed."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

from pnm.compiled import Engine
from pnm.events import Pause, Stop
from pnm.ledger import Ledger
from pnm.machine import OnFailure
from pnm.roles import Roles


@dataclass
class Situation:
    """What guards ask for besides knowledge. The mutable state is what has a default."""

    engine: Engine
    roles: Roles
    ledger: Ledger
    origin: float | None = None
    """The time from which releases count."""
    now: float = -inf
    stop: Stop | None = None
    """What the run was told about its end."""
    pause: Pause | None = None
    """What it was told about a pause that has not ended."""

    @property
    def passed(self) -> float:
        """The seconds since the plan's start."""
        return self.now - (self.origin or 0.0)

    @property
    def over(self) -> bool:
        """Whether the goal place or the failed place is marked."""
        return bool(self.engine.tokens[self.roles.goal] or self.engine.tokens[self.roles.failed])

    @property
    def failing(self) -> bool:
        """Whether the run can no longer succeed."""
        return bool(self.ledger.failures) or self.stop is not None

    @property
    def ending(self) -> bool:
        """Whether nothing more is started."""
        return self.failing or any(self.engine.tokens[place] for place in self.roles.restarts)

    @property
    def cancels(self) -> bool:
        """Whether running calls shall be cancelled."""
        told = self.stop is not None and self.stop.cancel
        return told or (self.ending and self.roles.machine.on_failure is OnFailure.CANCEL)

    @property
    def suspends(self) -> bool:
        """Whether running calls shall be cancelled, to begin anew later."""
        return self.pause is not None and self.pause.at_once

    @property
    def idle(self) -> bool:
        """Whether no call is under way."""
        return not any(self.engine.tokens[place] for place in self.roles.alive)
