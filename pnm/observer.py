"""Who listens to a run: one empty method per moment. Progress, traces and journals are observers."""

from __future__ import annotations

from pnm.actions.base import Outcome, Report, Request
from pnm.machine import Rule
from pnm.plan_graph import ActionCall
from pnm.results import Failure


class Observer:
    """Does nothing; override what is of interest. Must not raise and must not block. `now` is in seconds of the event loop."""

    def fired(self, transition: str, rule: Rule, now: float) -> None:
        """Note that a transition has fired."""

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        """Note that a request is being sent."""

    def ended(self, call: ActionCall, outcome: Outcome, now: float) -> None:
        """Note that a request is over."""

    def failed(self, failure: Failure, now: float) -> None:
        """Note that a failure place was marked."""

    def withheld(self, call: ActionCall, names: tuple[str, ...], now: float) -> None:
        """Note that a request was given up, and keeps these resources until its server says that it is over."""

    def waiting(self, is_so: bool, now: float) -> None:
        """Note that nothing goes on before a person has answered, or that this is over."""

    def orphaned(self, report: Report, now: float) -> None:
        """Note a report that nothing waits for: late, repeated, or about an unknown request."""
