"""Progression: the one walk through a plan, and the states that it leads to.

The rules are those of PDDL 2.1 (Fox and Long 2003, *PDDL2.1: An Extension to PDDL for Expressing Temporal Planning Domains*, section 8):

- All events of one time are one *happening*. They are simultaneous: every condition is evaluated in the state before, all effects
  come together, and over-all conditions hold in the state after, from the happening of the start until that of the end. Times that
  differ by at most `EPSILON` are the same, counted from the first event of a happening, as Kairos' validator counts them.
- Who must take the events of a happening one after the other has them in one order: facts that change by themselves, ends, starts,
  ends of what has just started; of the same kind in the order of the plan. In a valid plan no event of a happening changes what
  another one reads ("no moving targets"), so any order that has each start before its own end leads to the same state.

Besides, the progression of trajectory constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import chain, count
from operator import itemgetter
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

from planner_bridge.model.grounding import ground_step, initial_knowledge
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Problem
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TOLERANCE, Condition, evaluate, explanation
from pnm.core.logic.effects import Changes, Effects, TimedChange, changes, decided, written
from pnm.core.logic.expressions import UNKNOWN, Fluent, Unknown, Value, same_value
from pnm.core.logic.trajectory import IMPOSSIBLE, Constraint, instances, is_fulfilled, progressed
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, PlanEvent
from pnm.core.nature import Nature
from pnm.errors import PnmError

if TYPE_CHECKING:
    from pnm.core.execution.run_view import RunView

EPSILON: Final = TOLERANCE
"""Seconds by which times of one happening may differ: planners separate events by 0.001 and compute in floats."""

Stage = Literal["start", "end", "go on"]
_NOTHING: Final[Mapping[Fluent, Value]] = {}


@dataclass(frozen=True, slots=True)
class Happening:
    """All that happens at one time."""

    time: float
    timed: tuple[TimedChange, ...] = ()
    """Facts that change by themselves; they come first."""
    events: tuple[PlanEvent, ...] = ()
    """In the order in which they are taken one after the other."""

    @property
    def changes(self) -> Mapping[Fluent, Value]:
        """The facts that change by themselves, with their values."""
        return {fluent: value for change in self.timed for fluent, value in change.changes.items()} if self.timed else _NOTHING


def calls_of(problem: Problem, plan: Plan, first: int = 0) -> list[ActionCall]:
    """Return the calls of the plan, with numbers from `first`."""
    calls: list[ActionCall] = []
    for index, step in enumerate(plan.steps, first):
        duration = step.duration if plan.temporal else None
        action = ground_step(problem.domain, step.action, step.arguments, duration, step.outcome, problem.members)
        calls.append(ActionCall(index, action, step.start))
    return calls


def stretch(problem: Problem, plan: Plan) -> Plan:
    """Return the plan up to its first step with several outcomes, with that: what follows depends on how it turns out."""
    calls = calls_of(problem, plan) if problem.domain.uncertain else ()
    return next((Plan(plan.steps[: call.index + 1], plan.temporal) for call in calls if call.action.outcomes), plan)


def happenings(problem: Problem, plan: Plan, first: int = 0) -> list[Happening]:
    """Return the happenings of a plan in the order of time, its calls numbered from `first`.

    The steps of a plan without times happen at 0, 1, 2 and so on. Where processes go on, the end is a happening too.
    """
    moments: list[tuple[float, PlanEvent | TimedChange]] = [(change.time, change) for change in problem.timed]
    for number, step in enumerate(plan.steps, first):
        start = step.start if plan.temporal else float(number - first)
        lasts = plan.temporal and problem.domain.actions[step.action].duration is not None
        moments.append((start, PlanEvent(number, Moment.START)))
        moments.append((start + step.duration if lasts else start, PlanEvent(number, Moment.END)))
    moments.sort(key=itemgetter(0))
    groups: list[tuple[float, list[PlanEvent | TimedChange]]] = []
    for time, what in moments:
        if not groups or time - groups[-1][0] > EPSILON:
            groups.append((time, []))
        groups[-1][1].append(what)
    if problem.domain.nature:
        groups.append((max(plan.makespan, groups[-1][0] if groups else 0.0), []))
    found = []
    for time, together in groups:
        events = [one for one in together if isinstance(one, PlanEvent)]
        if len(events) > 1:
            starting = {event.call for event in events if event.moment is Moment.START}
            events.sort(key=lambda event: ((event.call in starting) * (1 + (event.moment is Moment.END)), event.call))
        found.append(Happening(time, tuple([one for one in together if isinstance(one, TimedChange)]), tuple(events)))
    return found


def snapshot(knowledge: KnowledgeBase) -> KnowledgeBase:
    """Return a copy of the knowledge about the world, which changes on its own."""
    return KnowledgeBase(knowledge.facts(), objects=knowledge.objects_by_type(), rules=knowledge.rules)


class NotApplicable(PnmError):
    """An action cannot start, end or go on in a state, because a condition does not hold."""

    def __init__(self, call: int, stage: Stage, condition: Condition, state: KnowledgeBase) -> None:
        expected, self.observed = explanation(condition, state)
        super().__init__(f"expected {expected}; observed {self.observed}")
        self.call = call
        self.stage = stage


Unmet: TypeAlias = Callable[[int, Stage, Condition, KnowledgeBase], bool]
"""Decides on a condition of a call that does not hold in the state: True if the call goes on all the same, False if it is dropped.

What a call that is dropped has done before stays done."""


def refuse(call: int, stage: Stage, condition: Condition, state: KnowledgeBase) -> bool:
    """Refuse a condition that does not hold."""
    raise NotApplicable(call, stage, condition, state)


@dataclass
class Progression:
    """The state that a plan has led to so far, and the actions running in it. The state and what is running change.

    Args:
        state: in which the plan begins.
        running: the actions that have begun before, by the number of the call.
        unmet: asked about every condition that does not hold.
        nature: what happens by itself, where anything does.
    """

    state: KnowledgeBase
    running: dict[int, GroundAction] = field(default_factory=dict)
    unmet: Unmet = refuse
    nature: Nature | None = None

    def advance(self, events: Iterable[tuple[PlanEvent, GroundAction]], timed: Mapping[Fluent, Value] = _NOTHING) -> Changes:
        """Let actions start and end, each start before its own end, and facts change by themselves; return the changed fluents.

        The end of an action that does not run, because it was dropped, is passed over.
        If a condition is refused, nothing has changed unless it is an over-all condition.
        """
        effects: list[Effects] = []
        running = dict(self.running)
        for event, action in events:
            if event.moment is Moment.START:
                if self._holds(event.call, "start", action.precondition):
                    end_effects = decided(action.end_effects, self.state)
                    running[event.call] = action if end_effects is action.end_effects else replace(action, end_effects=end_effects)
                    effects.append(action.start_effects)
            elif (begun := running.pop(event.call, None)) and self._holds(event.call, "end", action.end_condition):
                effects.append(begun.end_effects)
        changed = {**changes(tuple(effect for many in effects for effect in many), self.state), **timed}
        self.state.record(changed)
        self.running = running
        for call in [call for call, action in running.items() if not self._holds(call, "go on", action.invariant)]:
            del running[call]
        return changed

    def pass_time(self, seconds: float) -> Iterator[float]:
        """Let time pass; yield how many seconds have passed at every turn of nature and at the end, and check over-all conditions there."""
        going_on = [action.invariant for action in self.running.values()]
        for passed in self.nature.pass_time(self.state, seconds, going_on) if self.nature else ():
            self.advance(())
            yield passed

    def _holds(self, call: int, stage: Stage, condition: Condition) -> bool:
        return evaluate(condition, self.state) is True or self.unmet(call, stage, condition, self.state)


def foreseen(problem: Problem, plan: Plan) -> Problem:
    """Return the problem with the events that come about beside a plan, which must be valid, as facts that change by themselves."""
    if not problem.domain.nature:
        return problem
    simulation, calls, nature = Progression(initial_knowledge(problem)), calls_of(problem, plan), Nature(problem)
    timed, now = [*problem.timed], 0.0
    for happening in happenings(problem, plan):
        for passed, changed in nature.foresee(simulation.state, happening.time - now):
            facts = {fluent: value for fluent, value in changed.items() if not (fluent[0] in nature.moved or isinstance(value, Unknown))}
            timed += [TimedChange(now + passed, facts)] if facts else []
            simulation.state.record(changed)
        now = happening.time
        simulation.advance([(event, calls[event.call].action) for event in happening.events], happening.changes)
    return replace(problem, timed=tuple(sorted(timed, key=lambda change: change.time)))


class ConstraintProgression:
    """Trajectory constraints, progressed through the states of a simulation. The mutable state is what is left of each."""

    def __init__(self, constraints: Iterable[Constraint], state: KnowledgeBase, time: float = 0.0) -> None:
        every = (ground for constraint in constraints for ground in instances(constraint, state))
        self._remaining = {ground: progressed((ground,), state, time) for ground in every}

    def advance(self, state: KnowledgeBase, time: float = 0.0) -> Constraint | None:
        """Progress the constraints to the next state; return one that is violated, if any is."""
        self._remaining = {constraint: progressed(rest, state, time) for constraint, rest in self._remaining.items()}
        return next((constraint for constraint, rest in self._remaining.items() if IMPOSSIBLE in rest), None)

    def unfulfilled(self, state: KnowledgeBase, time: float = 0.0) -> list[Constraint]:
        """Return the constraints that are not fulfilled if this is the last state."""
        return [constraint for constraint, rest in self._remaining.items() if not is_fulfilled(rest, state, time)]


# --- projected state ------------------------------------------------------------------------------
# Present state: the world with what runs have begun, which sensors may not have reported yet; while a robot moves, say, it is nowhere.
#
# Projected state: the world as it will be when all that has ended.


class NotProjectable(PnmError):
    """A call cannot end in the projected state."""


def present_state(state: KnowledgeBase, runs: Iterable[RunView]) -> KnowledgeBase:
    """Return the state with what the calls of these runs have changed at their start and no sensor has spoken of since.

    A call under way is taken to succeed, so its start is taken to have come about as well, until a sensor says something else: with
    one that is slower than the others, a robot would otherwise be planned with where it has just left.
    """
    begun = {fluent: value for run in (runs if state.sensed_names() else ()) for fluent, value in run.unreported.items()}
    if not begun:
        return state
    present = snapshot(state)
    present.update(begun)
    return present


def projected_state(state: KnowledgeBase, runs: Iterable[RunView], beside: Iterable[RunView] = ()) -> KnowledgeBase:
    """Return the state once the calls of these runs have ended as the domain says, while those of the runs beside them go on.

    Calls that have ended count as well, as long as their effects are still looked for. What a call writes that has begun, and is being
    cancelled or not accepted yet, is unknown.

    Raises:
        NotProjectable: one of them cannot end.
    """
    runs = tuple(runs)
    for call in (call for run in runs for call in (*run.settling, *run.open_calls.values()) if call.action.outcomes):
        raise NotProjectable(f"{call.action} may turn out in several ways")
    simulation, numbers, unknown = Progression(snapshot(present_state(state, chain(runs, beside)))), count(), set[Fluent]()
    for run in runs:
        for call in run.settling:
            simulation.state.update(_still_to_come(run, call, simulation.state, state))
        going_on = {request.request: request for request in run.under_way()}
        for call in (call for request, call in run.open_calls.items() if request not in going_on and _has_begun(call, state)):
            unknown.update(written((*call.action.start_effects, *call.action.end_effects), state))
        for request in going_on.values():
            simulation.running[next(numbers)] = replace(request.call.action, end_effects=request.intended.end_effects)
    actions = dict(simulation.running)
    try:
        for number, action in actions.items():
            simulation.advance([(PlanEvent(number, Moment.END), action)])
    except NotApplicable as error:
        raise NotProjectable(f"{actions[error.call]} would {error.stage} although {error.observed}") from error
    simulation.state.update(dict.fromkeys(unknown, UNKNOWN))
    return simulation.state


def _still_to_come(run: RunView, call: ActionCall, simulated: KnowledgeBase, reported: KnowledgeBase) -> Changes:
    """Return the changes still to come of a call that has ended, as far as the domain says."""
    changed = changes(call.action.end_effects, simulated)
    waits = any(ordering.after == PlanEvent(call.index, Moment.END) for ordering in run.machine.plan.orderings)
    # what nothing reports was written when it ended, if its end in the plan has to wait for others
    return {fluent: value for fluent, value in changed.items() if reported.is_sensed(fluent)} if waits else changed


def _has_begun(call: ActionCall, state: KnowledgeBase) -> bool:
    """Return whether the facts that its start brings about are there, so that its end would have to follow."""
    started = {fluent: value for fluent, value in changes(call.action.start_effects, state).items() if isinstance(value, bool | str)}
    return bool(started) and all(same_value(state.value(fluent), value) for fluent, value in started.items())
