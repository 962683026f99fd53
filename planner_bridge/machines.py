"""From a plan to a run of its machine, which is proved first."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from planner_bridge.mission import Mission
from pnm.actions.base import Outcome, Report, Request
from pnm.analysis import verify
from pnm.calls import UnderWay
from pnm.generation import generate
from pnm.machine import Rule
from pnm.observer import Observer
from pnm.plan_graph import ActionCall, PlanGraph
from pnm.results import Failure
from pnm.run import Run


def make_run(graph: PlanGraph, mission: Mission, alarm: Callable[[], None], origin: float, adopted: Mapping[int, UnderWay]) -> Run:
    """Return a run of the plan.

    Args:
        graph: the plan.
        mission: what it is for.
        alarm: is called when something fails.
        origin: the time from which the plan's times count.
        adopted: for every call that is under way, the request that the run takes over.

    Raises:
        Unsound: the plan cannot be carried out.
    """
    with mission.seconds.of("translate"):
        machine = generate(graph, mission.settings.bindings, on_failure=mission.settings.on_failure)
    with mission.seconds.of("verify"):
        proof = verify(machine)
    mission.observer.generated(machine, proof)
    circumstances = mission.circumstances
    return Run(
        machine,
        mission.knowledge,
        id=circumstances.new_identity(),
        bindings=mission.settings.bindings,
        goal_fields=mission.site.client.goal_fields,
        asks=circumstances.source is not None,
        observer=_Alarmed(mission.observer, alarm),
        origin=origin,
        resources=circumstances.resources,
        task=circumstances.id,
        priority=circumstances.priority,
        adopted=adopted,
    )


class _Alarmed(Observer):
    """Passes on what a run tells, and raises the alarm when something has failed."""

    def __init__(self, observer: Observer, alarm: Callable[[], None]) -> None:
        self._observer = observer
        self._alarm = alarm

    def fired(self, transition: str, rule: Rule, now: float) -> None:
        self._observer.fired(transition, rule, now)

    def sent(self, call: ActionCall, request: Request, now: float) -> None:
        self._observer.sent(call, request, now)

    def ended(self, call: ActionCall, outcome: Outcome, now: float) -> None:
        self._observer.ended(call, outcome, now)

    def failed(self, failure: Failure, now: float) -> None:
        self._observer.failed(failure, now)
        self._alarm()

    def withheld(self, call: ActionCall, names: tuple[str, ...], now: float) -> None:
        self._observer.withheld(call, names, now)

    def waiting(self, is_so: bool, now: float) -> None:
        self._observer.waiting(is_so, now)

    def orphaned(self, report: Report, now: float) -> None:
        self._observer.orphaned(report, now)
