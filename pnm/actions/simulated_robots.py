"""Simulated robots: an action client that performs actions in a simulated world, with faults.

Part of the product: plans can be tried without robots and without ROS. `pnm simulate`
offers the same robots as ROS 2 action servers.
"""

from __future__ import annotations

import asyncio
import random
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import isclose
from typing import Final, assert_never
from uuid import UUID

from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults
from pnm.actions.prediction import Prediction
from pnm.core.knowledge_base import KnowledgeBase, parse_fluent
from pnm.core.logic.computed_values import MISSING, Question, Uncomputable, compute
from pnm.core.logic.conditions import TOLERANCE, TRUE, Condition, data_in, evaluate, unmet
from pnm.core.logic.effects import Changes, TimedChange, changes, decided, undo, values_before
from pnm.core.logic.expressions import UNKNOWN, Fluent, Unknown, Value, bind
from pnm.core.machine.bindings import Binding, Bindings, Table, WhenLost, own_values
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.core.message_fields import Combined, Comparison, Field, Flag, Test, parse_field
from pnm.core.nature import Nature
from pnm.errors import InputError
from pnm.files.yaml_nodes import parse_value

# --- the true state, apart from the knowledge that any run has of it -----------------------
# Actions begin and finish in it by their real conditions and effects; the effects of an action that does not
# succeed are rolled back, as far as the same fluents were not changed since.


class SimulatedWorld:
    """The true state, and the actions that are going on in it; raises `InputError` if rules derive one of the dynamic names."""

    def __init__(self, truth: KnowledgeBase, dynamic: Iterable[str]) -> None:
        self.truth = truth
        self.dynamic = frozenset(dynamic)
        """The predicates and functions that can change: sensors report these."""
        for name in sorted(self.dynamic & truth.rules.derived):
            raise InputError(f"facts of {name} follow from rules; they are neither set nor reported")

    def holds(self, condition: Condition) -> bool:
        """Return whether the condition is true in the world."""
        return evaluate(condition, self.truth) is True

    def change(self, facts: Mapping[Fluent, Value | Unknown]) -> None:
        """Change facts without an action, unknown to every run."""
        self.truth.update(facts)

    def begin(self, action: GroundAction) -> Activity | str:
        """Begin the action and return its activity, or the reason why it cannot be done."""
        if denied := _denied(action.precondition, self.truth):
            return f"{action} cannot start: {denied} is not true"
        activity = Activity(self, action)
        if denied := _denied(action.invariant, self.truth):
            activity.undo()
            return f"{action} cannot go on: {denied} is not true"
        return activity

    def reported(self, assumed: Iterable[str] = ()) -> frozenset[str]:
        """Return the names that sensors report: all that can change, without those assumed."""
        return self.dynamic - frozenset(assumed)

    def report(self, names: frozenset[str]) -> Changes:
        """Return the sensor report on these predicates and functions."""
        return {fluent: value for fluent, value in self.truth.facts().items() if fluent[0] in names}


class Activity:
    """A ground action going on in the world."""

    def __init__(self, world: SimulatedWorld, action: GroundAction) -> None:
        self.world = world
        self.action = action
        self._ending = decided(action.end_effects, world.truth)
        self._written = changes(action.start_effects, world.truth)
        self._before = values_before(self._written, world.truth)
        world.change(self._written)

    @property
    def broken(self) -> str:
        """The conjuncts of the over-all condition that no longer hold; empty when all of them do."""
        return _denied(self.action.invariant, self.world.truth)

    def finish(self) -> str:
        """Apply the end effects, or roll the start effects back and return why the action cannot succeed."""
        if denied := _denied(self.action.end_condition, self.world.truth):
            self.undo()
            return f"{self.action} cannot end well: {denied} is not true"
        self.world.change(changes(self._ending, self.world.truth))
        return ""

    def undo(self) -> None:
        """Roll the start effects back."""
        self.world.change(undo(self._before, self._written, self.world.truth))


def _denied(condition: Condition, truth: KnowledgeBase) -> str:
    """Return the conjuncts that do not hold. The world has no variables: conditions on these are left to the run."""
    parts = () if condition == TRUE else unmet(condition, truth)
    return " ".join(str(part) for part in parts if evaluate(part, truth) is False or not any(data_in(part)))


LAG: Final = 0.01
"""Seconds within which all changes of one moment are reported."""


def report_changes(world: SimulatedWorld, knowledge: KnowledgeBase, assumed: Iterable[str] = ()) -> None:
    """Keep knowledge up to date with the world, without the assumed names; an action's end effects are reported before its end."""
    names = world.reported(assumed)
    knowledge.sense(names, lag=LAG)
    knowledge.replace(names, world.report(names))

    def report(changes: Mapping[Fluent, Value | Unknown]) -> None:
        knowledge.update({fluent: value for fluent, value in changes.items() if fluent[0] in names})

    world.truth.listen(report)


# --- the robots ----------------------------------------------------------------------------

SLOWNESS: Final = 10.0
"""The factor by which a slow action takes longer."""


class RobotLog:
    """The log of simulated robots: one empty method per moment."""

    def began(self, request: Request) -> None:
        """Note that a robot begins to carry out a request."""

    def ended(self, request: Request, outcome: Outcome) -> None:
        """Note that a request that had begun is over, before that is reported."""


@dataclass(slots=True)
class _Job:
    """An accepted request that is not over."""

    request: Request
    report: Reporter
    activity: Activity
    fault: Fault | None
    began: float
    resources: tuple[str, ...] = ()
    lasts: float | None = None
    """Seconds of the clock until it ends well; None if it never will."""
    timer: asyncio.TimerHandle | None = None
    broken: str = ""
    """The conjuncts of the over-all condition that were violated."""


@dataclass
class SimulatedRobots:
    """An action client that performs every action for its duration and changes the world, unless there is a fault.

    The mutable state is the current jobs, the clashes, the lost servers, and how many requests each fault has counted.
    """

    world: SimulatedWorld
    faults: Faults = NO_FAULTS
    bindings: Bindings = field(default_factory=Bindings)
    scheduled: tuple[TimedChange, ...] = ()
    untimed: float = 1.0
    """Seconds that an action without a planned duration takes."""
    speed: float = 1.0
    """Seconds of the world per second of the clock."""
    nature: Nature | None = None
    """What happens in the world by itself, where anything does."""
    capacities: Mapping[str, int] = field(default_factory=dict)
    """The number of jobs that may use a resource at the same time; one for those not listed."""
    clashes: list[str] = field(default_factory=list)
    """Resources that more jobs used at once than their capacity allows: a mistake of the client."""
    log: RobotLog = field(default_factory=RobotLog)
    _jobs: dict[UUID, _Job] = field(default_factory=dict)
    _results: dict[UUID, tuple[str, Outcome]] = field(default_factory=dict)
    """The servers of requests that are over, and how these have ended."""
    lost: set[str] = field(default_factory=set)
    _seen: dict[int, int] = field(default_factory=dict)
    _chance: random.Random = field(init=False)
    _begun: bool = False
    _going_on: Prediction | None = None
    _timers: dict[Callable[[], None], asyncio.TimerHandle] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._chance = random.Random(self.faults.seed)

    def begin(self) -> None:
        """Start the world's clock, once: the times of changes count from here."""
        if self._begun:
            return
        self._begun = True
        self.world.truth.listen(self._check)
        timed = [(change.at, change.changes) for change in self.faults.changes if change.at is not None]
        for time, due in (*timed, *((change.time, change.changes) for change in self.scheduled)):
            self._later(time, self.world.change, due)
        if self.nature:
            self._going_on = Prediction(self.nature, self.world.truth, self.speed)

    def go_on_from(self, known: KnowledgeBase, passed: float) -> None:
        """Begin in the world that another process knew, so many seconds after its beginning."""
        facts = {fluent: value for fluent, value in known.facts().items() if not isinstance(value, Unknown)}
        self.world.truth.replace({fluent[0] for fluent in self.world.truth.facts()}, facts)
        self.scheduled = tuple(TimedChange(change.time - passed, change.changes) for change in self.scheduled if change.time > passed)

    def close(self) -> None:
        """Cancel all timers: the world no longer changes."""
        for timer in self._timers.values():
            timer.cancel()
        if self._going_on:
            self._going_on.close()

    # --- ActionClient ---------------------------------------------------------------------------

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        """Return the names of the action's parameters, which are the goal fields of a simulated robot."""
        return action.parameters

    def send(self, request: Request, report: Reporter, /) -> None:
        """Perform the request, beginning in the next turn of the loop."""
        self.begin()
        asyncio.get_running_loop().call_soon(self._receive, request, report)

    def reattach(self, request: Request, report: Reporter, /, *, accepted: bool) -> None:
        """Report on a request that was sent before, or perform it, beginning in the next turn of the loop."""

        def report_again() -> None:
            if job := self._jobs.get(request.id):
                job.report = report
                report(Accepted(request.id))
            elif request.id in self._results:
                report(Ended(request.id, self._results[request.id][1]))
            elif accepted and self.bindings.of(request.action.name).when_lost is not WhenLost.RESEND:
                report(Ended(request.id, Outcome(OutcomeKind.LOST, message="the robot knows nothing of it")))
            else:
                self._receive(request, report)

        asyncio.get_running_loop().call_soon(report_again)

    def cancel(self, request: UUID, /) -> None:
        """Stop the request unless it ignores that."""
        job = self._jobs.get(request)
        if job and not (job.fault and job.fault.ignores_cancel):
            asyncio.get_running_loop().call_soon(self._fail, job, OutcomeKind.CANCELED, "cancelled on request")

    def progress(self, request: UUID) -> float:
        """Return the share of the request that is done, from 0 to 1; 0 when the robot hangs."""
        job = self._jobs.get(request)
        if job is None or not job.lasts:
            return 0.0
        return min(1.0, (asyncio.get_running_loop().time() - job.began) / job.lasts)

    @property
    def at_work(self) -> tuple[Request, ...]:
        """The requests that are being carried out; a robot that hangs is at work for ever."""
        return tuple(job.request for job in self._jobs.values())

    def restart(self, server: str) -> None:
        """Restart a server: its robot stops, and it knows nothing any more of what it was asked before."""
        for job in [job for job in self._jobs.values() if self.bindings.server(job.request.action) == server]:
            self._forget(job)
            job.activity.undo()
            self.log.ended(job.request, Outcome(OutcomeKind.LOST, message="the server was restarted"))
        for request in [request for request, (name, _) in self._results.items() if name == server]:
            del self._results[request]

    # --- what the robots do ---------------------------------------------------------------------

    def _receive(self, request: Request, report: Reporter) -> None:
        action, server = request.action, self.bindings.server(request.action)
        if server in self.lost:
            report(Ended(request.id, Outcome(OutcomeKind.UNAVAILABLE, message=f"there is no server {server}")))
            return
        fault = self._fault(action)
        if fault and fault.kind is FaultKind.REJECT:
            self._answer(request, report, Outcome(OutcomeKind.REJECTED, message=fault.message or "goal rejected"))
            return
        forced = fault.outcome if fault else ""
        if ways := [way for way in action.outcomes if forced in ("", way.name)]:
            (way,) = self._chance.choices(ways, [1.0 if way.chance is None else way.chance for way in ways])
            action = replace(action, end_effects=way.effects, outcome=way.name)
        if fault and fault.succeeded is not None:
            action = replace(action, end_effects=fault.succeeded)
        if self._going_on:
            self._going_on.bring_up_to_date()
        begun = self.world.begin(action) if ways or not forced else f"{action} has no outcome {forced!r}"
        report(Accepted(request.id))
        if isinstance(begun, str):
            self._answer(request, report, Outcome(OutcomeKind.ABORTED, message=begun))
            return
        now, resources = asyncio.get_running_loop().time(), self.bindings.resources(action)
        job = self._jobs[request.id] = _Job(request, report, begun, fault, now, resources)
        for name in resources:
            users = [str(user.request.action) for user in self._jobs.values() if name in user.resources]
            if len(users) > self.capacities.get(name, 1):
                self.clashes.append(f"{name} is used by {' and '.join(users)} at once")
        self.log.began(request)
        self._happen("start", action)
        self._schedule(job)

    def _schedule(self, job: _Job) -> None:
        def lose() -> None:
            self.lost.add(self.bindings.server(job.request.action))
            self._fail(job, OutcomeKind.LOST, "the server went away")

        duration = self.untimed if job.request.action.duration is None else job.request.action.duration
        fault = job.fault
        kind = fault.kind if fault else None
        if kind is FaultKind.HANG:
            return
        if kind is FaultKind.SLOW:
            duration *= SLOWNESS
        until_fault = duration / 2
        if fault and fault.seconds is not None:
            duration = until_fault = fault.seconds
        job.lasts = duration / self.speed
        match kind:
            case FaultKind.ABORT:
                outcome = OutcomeKind.ABORTED_FOR_GOOD if fault and fault.for_good else OutcomeKind.ABORTED
                job.timer = self._later(until_fault, self._fail, job, outcome, "the action failed")
            case FaultKind.LOSE_SERVER:
                job.timer = self._later(until_fault, lose)
            case _:
                job.timer = self._later(duration, self._succeed, job)

    def _succeed(self, job: _Job) -> None:
        if self._going_on:
            self._going_on.bring_up_to_date()
        if job.broken:
            self._fail(job, OutcomeKind.ABORTED, f"{job.request.action} went wrong: {job.broken} was not true all the time")
            return
        self._forget(job)
        problem, result, ended = "", dict[str, object](), job.activity.action
        if job.fault and job.fault.kind is FaultKind.NO_EFFECT:
            job.activity.undo()
        elif not (problem := job.activity.finish()):
            try:
                result = returned(job.request, self.world, self.bindings.of(ended.name))
                result |= {"outcome": ended.outcome} if ended.outcomes else {}
                if found := self.bindings.of(ended.name).found:
                    self.world.change(found.facts_in(result, ended, self.world.truth)[0])
            except Uncomputable as error:
                problem = f"the result of {job.request.action} cannot be computed: {error}"
        kind = OutcomeKind.ABORTED if problem else OutcomeKind.SUCCEEDED
        told = (
            ended.outcome if not problem and ended.outcome in self.bindings.of(ended.name).outcomes else ""
        )  # as a real one would tell it
        self._end(job, Outcome(kind, result, problem, told))

    def _fail(self, job: _Job, kind: OutcomeKind, message: str) -> None:
        if job.request.id in self._jobs:
            self._forget(job)
            job.activity.undo()
            self.world.change(changes(job.fault.failed if job.fault else (), self.world.truth))
            self._end(job, Outcome(kind, message=(job.fault.message if job.fault and kind is OutcomeKind.ABORTED else "") or message))

    def _end(self, job: _Job, outcome: Outcome) -> None:
        self.log.ended(job.request, outcome)
        self._answer(job.request, job.report, outcome)
        if outcome.kind is OutcomeKind.SUCCEEDED:
            self._happen("end", job.request.action)

    def _answer(self, request: Request, report: Reporter, outcome: Outcome) -> None:
        self._results[request.id] = self.bindings.server(request.action), outcome
        report(Ended(request.id, outcome))

    def _forget(self, job: _Job) -> None:
        self._jobs.pop(job.request.id, None)
        if job.timer:
            job.timer.cancel()

    # --- what goes wrong ------------------------------------------------------------------------

    def _fault(self, action: GroundAction) -> Fault | None:
        """Return the fault that applies to this request; every fault counts the requests it concerns."""
        if self.faults.drawn is not None:
            return self.faults.drawn(action, self._chance)
        chosen = None
        for position, fault in enumerate(self.faults.faults):
            if fault.concerns(action):
                seen = self._seen[position] = self._seen.get(position, 0) + 1
                counts = seen > fault.after and (fault.times is None or seen <= fault.after + fault.times)
                if counts and (fault.chance == 1.0 or self._chance.random() < fault.chance):
                    chosen = chosen or fault
        return chosen

    def _happen(self, moment: str, action: GroundAction) -> None:
        for change in self.faults.changes:
            if change.follows(moment, action):
                self.world.change(change.changes)

    def _check(self, changes: Mapping[Fluent, Value | Unknown]) -> None:
        """Note which actions can no longer succeed; like real robots they report that at their end."""
        now = asyncio.get_running_loop().time()
        for job in self._jobs.values():
            if job.lasts is None or now < job.began + job.lasts - TOLERANCE:  # what ends now is over already
                job.broken = job.broken or job.activity.broken

    def _later(self, seconds: float, callback: Callable[..., object], *args: object) -> asyncio.TimerHandle:
        def run() -> None:
            del self._timers[run]
            callback(*args)

        timer = asyncio.get_running_loop().call_later(seconds / self.speed, run)
        self._timers[run] = timer  # not in a set: all timers of the same moment have the same hash
        return timer


@dataclass(frozen=True, slots=True)
class _Server:
    """The goal and the world, from which a simulated server computes its result."""

    goal: Mapping[str, object]
    world: SimulatedWorld

    def value(self, fluent: Fluent, /) -> Value | Unknown | None:
        """Return the true value of a fluent, which may name fields of the goal."""
        return self.world.truth.value(bind(fluent, {f"?{name}": value for name, value in self.goal.items()}))

    def local_variable(self, name: str, /) -> object:
        """Return `MISSING`: variables are the run's."""
        return MISSING

    def parameter(self, name: str, /) -> object:
        """Return a field of the goal."""
        return self.goal.get(name.removeprefix("?"), MISSING)

    def answer(self, question: Question, /) -> object:
        """Return `MISSING`: a simulated server asks no questions."""
        return MISSING


def returned(request: Request, world: SimulatedWorld, binding: Binding) -> dict[str, object]:
    """Return the result of a simulated server, without fields that have no value; raises `Uncomputable` as `compute` does.

    Fields that set fluents have what is true of these; one that names objects has what the binding says.
    """
    env, result = {f"?{name}": value for name, value in own_values(request.action).items()}, dict[str, object]()
    for name, target in binding.store.items():
        value = world.truth.value(bind(parse_fluent(target), env)) if target.startswith("(") else UNKNOWN
        if value is not None and value is not UNKNOWN:
            _put(result, parse_field(name), value)
    if binding.found is not None:
        _put(result, binding.found.field, binding.found.rehearsed(request.action, world.truth))
    values = {name: compute(data, _Server(request.goal, world)) for name, data in request.action.returns}
    return result | {name: value for name, value in values.items() if value is not MISSING}


# --- bindings read backwards: the arguments that a goal means, and the result of an outcome ----

_CLOSE = 1e-6
"""The allowed difference of numbers: a float32 keeps seven digits."""


def arguments_of(goal: Mapping[str, object], message: Mapping[str, object]) -> dict[str, str] | None:
    """Return the arguments that a message means which these goal fields filled, or None; variables and functions say nothing."""
    arguments: dict[str, str] = {}
    return arguments if _fits(goal, message, arguments) else None


def _fits(source: object, value: object, arguments: dict[str, str]) -> bool:
    match source:
        case Table(of, rows):
            fitting = [key for key, row in rows.items() if _fits(row, value, {})]
            return bool(fitting) and _fits(of, fitting[0], arguments)
        case Mapping():
            parts = [(part, value[name]) for name, part in source.items() if name in value] if isinstance(value, Mapping) else []
            return len(parts) == len(source) and all(_fits(part, its, arguments) for part, its in parts)
        case list() | tuple():
            items = value if isinstance(value, list) else []
            return len(items) == len(source) and all(_fits(part, its, arguments) for part, its in zip(source, items, strict=True))
        case str() if source.startswith("?"):
            return arguments.setdefault(source[1:], str(value)) == str(value)
        case str() if source.startswith(("$", "(")):
            return True
        case int() | float() if not isinstance(source, bool):
            return isinstance(value, int | float) and isclose(source, value, rel_tol=_CLOSE, abs_tol=_CLOSE)
        case _:
            return source == value


def result_of(binding: Binding, outcome: Outcome) -> dict[str, object]:
    """Return the result fields by which the binding finds that an action has succeeded, and in which outcome, or why it has failed.

    Fields of items in lists are left alone, and so are negations: their defaults have to do. Where numbers stand for reasons, it is the
    one that has the outcome's message for a word, or the first.
    """
    result: dict[str, object] = {}
    if outcome.kind is OutcomeKind.SUCCEEDED:
        if (told := binding.outcomes.get(outcome.declared, binding.success)) is not None:
            _satisfy(told, result)
    elif binding.reason is not None and binding.reason.table is None:
        _put(result, binding.reason.field, outcome.message)
    elif binding.reason is not None and binding.reason.table and outcome.kind is OutcomeKind.ABORTED:
        words = {str(word): key for key, word in binding.reason.table.items()}
        _put(result, binding.reason.field, parse_value(words.get(outcome.message, next(iter(words.values()))), "reason"))
    return result


def _satisfy(test: Test, result: dict[str, object]) -> None:
    match test:
        case Flag(where):
            _put(result, where, True)
        case Comparison(where, "eq", constant):
            _put(result, where, constant)
        case Combined("all" | "any", tests):
            for part in tests:
                _satisfy(part, result)
        case Comparison() | Combined():
            pass
        case _:
            assert_never(test)


def _put(result: dict[str, object], where: Field, value: object) -> None:
    *path, last = where.steps
    for step in path:
        inner = result.setdefault(step, {}) if isinstance(step, str) else None
        if not isinstance(inner, dict):
            return
        result = inner
    if isinstance(last, str):
        result[last] = value
