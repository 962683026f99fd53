"""Replanning decisions: does the rest of a plan still work, must there be a new plan, or is a limit reached?

Pure: decides from what is known; `planner_bridge.tasks.goal_loop` acts on it. A run that is over is a run with nothing under way.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Final
from zlib import crc32

from planner_bridge.model.grounding import decisive_names
from planner_bridge.model.guards import ANY, ForbiddenCall
from planner_bridge.model.plan import Plan, Policy
from planner_bridge.model.problem import Problem
from planner_bridge.model.progression import ConstraintProgression, NotApplicable, Progression, snapshot
from planner_bridge.ordering.plan_to_graph import deordered, stretch_graph
from pnm.core.execution.call_results import CallResult, Failure
from pnm.core.knowledge_base import KnowledgeBase, statement_text
from pnm.core.logic.conditions import TRUE, conjuncts, evaluate, explanation
from pnm.core.logic.effects import changes
from pnm.core.logic.expressions import is_number, same_value
from pnm.core.logic.trajectory import Constraint
from pnm.core.machine.bindings import NO_BINDINGS, Bindings, WhenLost
from pnm.core.machine.failure_causes import Blame, Cause
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, PlanEvent, PlanGraph
from pnm.core.machine.requests import CallOutcome
from pnm.errors import check_counts, check_seconds, counted
from pnm.tasks import Code

MAX_SHORTENED: Final = 100
"""Calls of the longest rest of a plan that needless calls are removed from."""
_ALIKE: Final = 60
"""Outcomes of a call in a row that are the same, at least, before it is given up."""
_ABSURD: Final = 1e-9
"""A chance of that which is absurd: its other outcomes never come about, or nothing tells them."""
_STATES: Final = 50
"""States that are remembered to see that nothing is new."""


@dataclass(frozen=True, slots=True)
class Limits:
    """The limits of a task."""

    replans: int = 100
    """New nets after the first, whether or not a planner was asked."""
    without_progress: int = 10
    """Of those, the ones in a row that bring no progress; see `Reached`."""
    seconds: float | None = None
    """From the start of the task, pauses left out, on the clock of its runs. By default an hour, or the result of `allowed`."""
    forbid_after: int = 2
    """A ground action that failed so often since it last succeeded is not planned with any more."""
    backoff: float = 0.5
    """Seconds before the second replan in a row without progress; doubled each time."""
    longest_backoff: float = 30.0
    patience: float = 0.0
    """Seconds for which a task without a plan waits for facts to change: a closed door opens again. Its own time goes on."""
    stretches: int = 10_000
    """New nets after declared outcomes, which are no replans: by then what is declared does not come about, or leads round in circles."""

    def __post_init__(self) -> None:
        """Refuse what is no limit."""
        counts = {"replans": self.replans, "without_progress": self.without_progress, "stretches": self.stretches}
        check_counts("limits", forbid_after=self.forbid_after, **counts)
        check_seconds("a task", self.seconds)
        check_seconds("a new plan", self.backoff, self.longest_backoff, self.patience)

    def allowed(self, planned: float = 0.0) -> float:
        """Return the seconds of a task, given those of its plan: three times as long by default."""
        return max(3600.0, 3.0 * planned) if self.seconds is None else self.seconds


@dataclass(frozen=True, slots=True)
class Reached:
    """How far a task has come at its replans, and how many in a row have brought no progress.

    Progress is something new that is known, or a plan with fewer calls left than at any replan since. What can be known is finite, and
    the calls of a plan are: no task replans for ever.
    """

    known: frozenset[str] = frozenset()
    """Actions that are forbidden or cannot be carried out, conditions of the goal that hold: whatever was so at some replan."""
    left: int | None = None
    """The fewest calls that were left since something new was known; None before the first replan."""
    in_vain: int = 0

    def at_replan(self, known: Iterable[str], left: int) -> Reached:
        """Return how far the task has come at one more replan, with so many calls left of its plan."""
        seen = self.known.union(known)
        has_progressed = seen > self.known or self.left is None or left < self.left
        return Reached(seen, left, 0) if has_progressed else replace(self, in_vain=self.in_vain + 1)


@dataclass(frozen=True, slots=True)
class Repeats:
    """How often calls have come to the same declared outcome, all in states that were there before."""

    states: tuple[int, ...] = ()
    """Digests of the last states after a declared outcome."""
    ends: Mapping[ForbiddenCall, tuple[str, int]] = field(default_factory=dict)
    """The last outcome of each call, and how often in a row, since there was a new state."""

    def after(self, results: Iterable[CallResult], now: Problem) -> Repeats:
        """Return them after one more stretch, with its results, that has led to the initial state of this problem."""
        read = decisive_names(now)
        facts = [sorted(one for one in now.init.items() if one[0][0] in read), sorted(one for one in now.unknown if one[0] in read)]
        state = crc32(repr(facts).encode())
        is_new = state not in self.states
        ends = {} if is_new else dict(self.ends)
        for result in results:
            call = ForbiddenCall.of(result.call.action)
            label, times = ends.get(call, ("", 0))
            ends[call] = result.declared, times + 1 if result.declared == label else 1
        return Repeats((*self.states, state)[-_STATES:] if is_new else self.states, ends)

    def livelock(self, results: Iterable[CallResult]) -> str:
        """Return which call goes on as is absurdly unlikely by the chances of its outcomes, declared or even; empty if none does."""
        for result in results:
            label, times = self.ends[ForbiddenCall.of(result.call.action)]
            ways, came = result.call.action.outcomes, label.split(" or ")
            never = [way.name for way in ways if way.name not in came]
            chance = sum(1.0 / len(ways) if way.chance is None else way.chance for way in ways if way.name in came)
            if times >= _ALIKE and (not never or chance**times < _ABSURD):
                missing = f"{', '.join(never)} never came about" if never else "nothing tells which it was"
                expected = f"its outcomes are {', '.join(way.name for way in ways)}, and {missing}"
                look = "look at 'outcomes' of its binding, and at what is reported"
                return f"{result.call.action} has ended {times} times in a row as {label}, and nothing is new; {expected}: {look}"
        return ""


@dataclass(frozen=True)
class History:
    """The memory of a task about its failures."""

    failed: dict[ForbiddenCall, int] = field(default_factory=dict)
    unconfirmed: frozenset[ForbiddenCall] = frozenset()
    """Calls whose server has not confirmed that it stopped: it may still be at work."""
    lacking: frozenset[str] = frozenset()
    """Resources that were waited for in vain."""
    absent: Mapping[str, int] = field(default_factory=dict)
    """Action servers that were not there, and how often they went away since they last carried something out."""
    uninformed: frozenset[GroundAction] = frozenset()
    """Actions whose goals lacked a value: until there is one, they are of no use."""
    lost: frozenset[GroundAction] = frozenset()
    """Actions of which nobody knows how they have ended, and whose bindings have the task end then."""
    replans: int = 0
    fruitless: int = 0
    """Runs in a row in which no call succeeded."""
    reached: Reached = Reached()
    stretches: int = 0
    refused: frozenset[GroundAction] = frozenset()
    """Actions whose precondition was not true: as long as a planner counts what is unknown of it as false, they would not begin again."""
    repeats: Repeats = Repeats()

    @staticmethod
    def of_plan(given_up: Iterable[GroundAction], unconfirmed: Iterable[GroundAction], limits: Limits) -> History:
        """Return the history after a hand-written plan that has given actions up, and left others that may still be at work."""
        failed = {ForbiddenCall.of(action): limits.forbid_after for action in given_up}
        return History(failed, frozenset(map(ForbiddenCall.of, unconfirmed)))

    def after(
        self,
        calls: Iterable[CallResult],
        failures: Iterable[Failure],
        bindings: Bindings = NO_BINDINGS,
        missing: frozenset[str] = frozenset(),
    ) -> History:
        """Return the history with one more failed run; as long as a server is missing, that counts once."""
        calls, failures = tuple(calls), tuple(failures)
        failed, absent = dict(self.failed), dict(self.absent)
        of_calls = [(failure, failure.call) for failure in failures if isinstance(failure.call, ActionCall)]
        succeeded = [result.call.action for result in calls if result.kind is CallOutcome.SUCCEEDED]
        for server in map(bindings.server, succeeded):
            absent.pop(server, None)
        for server in {bindings.server(call.action) for failure, call in of_calls if failure.cause.blame is Blame.SERVER}:
            absent[server] = 1 if server in missing else absent.get(server, 0) + 1
        for failure, failed_call in of_calls:
            if failure.cause.blame is not Blame.WORLD:
                call = ForbiddenCall.of(failed_call.action)
                failed[call] = failed.get(call, 0) + 1
        for action in succeeded:
            failed.pop(ForbiddenCall.of(action), None)
        at_work = [call for failure, call in of_calls if failure.unconfirmed]
        at_work += [result.call for result in calls if result.kind is CallOutcome.UNCONFIRMED]
        uninformed = {call.action for failure, call in of_calls if failure.cause is Cause.DATA_MISSING}
        of_lost = (call.action for failure, call in of_calls if failure.cause is Cause.LOST)
        refused = {call.action for failure, call in of_calls if failure.cause is Cause.PRECONDITION_FALSE}
        lost = {action for action in of_lost if bindings.of(action.name).when_lost is WhenLost.ABORT}
        return History(
            failed,
            self.unconfirmed | {ForbiddenCall.of(call.action) for call in at_work},
            self.lacking.union(*(failure.lacking for failure in failures)),
            absent,
            self.uninformed | uninformed,
            self.lost | lost,
            self.replans + 1,
            0 if succeeded else self.fruitless + 1,
            self.reached,
            self.stretches,
            self.refused | refused,
            self.repeats,
        )

    def given_up(self, limits: Limits) -> GiveUp | None:
        """Return why nothing follows; None if no limit of replans is reached, and everybody knows what the robots have done."""
        if self.lost:
            names = ", ".join(sorted(map(str, self.lost)))
            return GiveUp(f"nobody knows how {names} has ended, and its binding says 'when_lost: abort'", Code.SERVER_UNAVAILABLE)
        if self.stretches > limits.stretches:
            return GiveUp(f"{limits.stretches} declared outcomes have not led to the goal")
        if self.replans > limits.replans:
            return GiveUp(f"the limit of {limits.replans} replans is reached")
        in_vain, nothing = counted(limits.without_progress, "replan"), "nothing new is known, and no fewer calls are left"
        return GiveUp(f"the last {in_vain} brought no progress: {nothing}") if self.reached.in_vain > limits.without_progress else None

    def forbidden(self, limits: Limits) -> frozenset[ForbiddenCall]:
        """Return the calls that failed too often, or whose servers may still be at work."""
        return self.unconfirmed | {call for call, times in self.failed.items() if times >= limits.forbid_after}

    def objection(self, action: GroundAction, limits: Limits, unusable: Mapping[ForbiddenCall, str]) -> str:
        """Return why an action must not be used, in words that follow its name."""
        call = ForbiddenCall.of(action)
        if call in self.unconfirmed:
            return "may still be under way: its server has not confirmed that it is over"
        if self.failed.get(call, 0) >= limits.forbid_after:
            return f"has failed {self.failed[call]} times"
        return next(why for call, why in unusable.items() if call.covers(action))

    def absent_servers(self, limits: Limits) -> frozenset[str]:
        """Return the action servers that were not there too often."""
        return frozenset(server for server, times in self.absent.items() if times >= limits.forbid_after)

    def remedy(self, limits: Limits, missing: frozenset[str] = frozenset()) -> str:
        """Return in words what would help after these failures; empty if there were none."""
        gone = self.absent_servers(limits) | missing & self.absent.keys()
        needs = [f"the action server {server} is there again" for server in sorted(gone)]
        needs += [f"{name} is given back" for name in sorted(self.lacking)]
        needs += [f"{action} gets the value that it lacks" for action in sorted(map(str, self.uninformed))]
        needs += [f"{call} works again" for call in sorted(map(str, self.forbidden(limits)))]
        return f"it would help if {', or '.join(needs)}" if needs else ""

    def backoff(self, limits: Limits) -> float:
        """Return the back-off: the seconds to wait before the next attempt."""
        return 0.0 if self.fruitless < 2 else min(limits.longest_backoff, limits.backoff * 2.0 ** (self.fruitless - 2))


@dataclass(frozen=True, slots=True)
class ResumePlan:
    """Go on with the rest of the plan in a new net; no planner is asked."""

    rest: PlanGraph
    because: str = ""
    """The reports that set it off while nothing had failed, and what they make needless."""


@dataclass(frozen=True, slots=True)
class PlanAgain:
    """Ask the planner, without the forbidden calls."""

    forbidden: frozenset[ForbiddenCall]
    why: str
    because: str = ""
    """The reports that set it off while nothing had failed."""


@dataclass(frozen=True, slots=True)
class BetterRest:
    """Go on with a better rest of the plan, which was found while calls were under way; nothing has failed or changed."""

    why: str


@dataclass(frozen=True, slots=True)
class NextStretch:
    """Go on from what a call with several declared outcomes has come to: no failure."""

    outcome: str
    """The calls and their outcomes, in words."""
    rest: PlanGraph | None = None
    """The calls that the policy has for it; None if a planner is asked."""


@dataclass(frozen=True, slots=True)
class GiveUp:
    """A limit is reached, or only people can decide how to go on."""

    reason: str
    code: Code = Code.REPLAN_LIMIT


Foreseen = BetterRest | NextStretch
"""New machines that are no replans."""
Decision = ResumePlan | PlanAgain | Foreseen | GiveUp


def decision_words(decision: Decision | None) -> str:
    """Return the decision after a run, in the words for everybody; None is a plan that was found without a decision."""
    match decision:
        case ResumePlan(rest, because):
            goes_on = f"the rest of the plan still works: going on with {counted(len(rest.calls), 'call')} in a new machine"
            return "; ".join(filter(None, (goes_on, because)))
        case PlanAgain(forbidden, why, because):
            # of others it is said what they lack
            calls = sorted(str(call) for call in forbidden if ANY not in call.arguments and not call.awaited)
            never = f"not again: {', '.join(calls)}" if calls else ""
            return f"a new plan is needed: {'; '.join(filter(None, (why, because, never)))}"
        case BetterRest(why):
            return f"a better rest of the plan was found at work: {why}"
        case NextStretch(outcome, rest):
            goes_on = "a plan is searched for from here" if rest is None else f"going on with {counted(len(rest.calls), 'call')}"
            return f"{outcome}: {goes_on}"
        case GiveUp(reason):
            return f"given up: {reason}"
        case None:
            return "another plan was found"


@dataclass(frozen=True)
class Progress:
    """A plan, and how far it has come. The calls `under_way`, by number, have requests that are out: they go on, whatever follows."""

    plan: PlanGraph
    calls: tuple[CallResult, ...]
    under_way: frozenset[int] = frozenset()

    @staticmethod
    def beginning(plan: PlanGraph) -> Progress:
        """Return the progress of a plan at its beginning; some calls may be under way."""
        return Progress(plan, tuple(map(CallResult, plan.calls)), frozenset(call.index for call in plan.calls if call.under_way))

    @property
    def rest(self) -> tuple[ActionCall, ...]:
        """The calls that are not over, as they stand in the plan."""
        return tuple(call for call in self.plan.calls if call.index not in self._finished)

    @cached_property
    def _finished(self) -> frozenset[int]:
        over = (result.call.index for result in self.calls if result.is_done)
        return frozenset(over) - self.under_way

    @cached_property
    def events(self) -> tuple[PlanEvent, ...]:
        """The events that are still to come, in an order that the plan allows; starts of what is under way are over."""
        begun = {PlanEvent(number, Moment.START) for number in self.under_way}
        return tuple(event for event in self.plan.order if event.call not in self._finished and event not in begun)

    @property
    def to_begin(self) -> list[ActionCall]:
        """The calls that have still to begin, in an order that the plan allows."""
        return [self.plan.calls[event.call] for event in self.events if event.moment is Moment.START]

    @property
    def what_goes_on(self) -> Progress:
        """The same plan as if only what is under way were left of it."""
        left = self
        for call in self.rest:
            left = left if call.index in self.under_way else left.without(call.index)
        return left

    def without(self, call: int) -> Progress:
        """Return the same plan as if the call were done."""
        done = self.calls[call]._replace(kind=CallOutcome.ALREADY_TRUE)
        return replace(self, calls=(*self.calls[:call], done, *self.calls[call + 1 :]))


def decide(
    now: Problem,
    progress: Progress,
    knowledge: KnowledgeBase,
    history: History,
    limits: Limits,
    unusable: Mapping[ForbiddenCall, str] = MappingProxyType({}),
) -> tuple[ResumePlan | PlanAgain | GiveUp, History]:
    """Decide what follows a run that does not lead to the goal any more, whether or not it has ended; the history has this replan then.

    Args:
        now: the problem from the world as it is known to be.
        history: of all failures, those of this run included.
        unusable: calls that would fail now, and why, in words that follow their names.
    """
    if given_up := history.given_up(limits):
        return given_up, history
    forbidden, found_out = history.forbidden(limits) | unusable.keys(), ""
    if not (why := times_that_matter(now)):
        if action := barred(progress, forbidden):
            why = f"{action} {history.objection(action, limits, unusable)}"
        else:
            found_out, seen = obstacle(progress, knowledge, (*now.domain.constraints, *now.constraints))
            why = found_out + seen
    known = [found_out, *map(str, forbidden), *(str(part) for part in conjuncts(now.goal) if evaluate(part, knowledge) is True)]
    history = replace(history, reached=history.reached.at_replan(known, len(progress.rest)))
    whole = "; the whole network of tasks is planned for once more" if now.network else ""
    follows = PlanAgain(forbidden, why + whole) if why else ResumePlan(rest_of(now, progress))
    return history.given_up(limits) or follows, history


def followed(policies: Iterable[Policy], now: Problem, knowledge: KnowledgeBase) -> tuple[Policy | None, Plan | None]:
    """Return the first policy that says what to do, and what; none does where objects were found that it does not know."""
    knowing = (policy for policy in policies if now.objects.keys() <= policy.problem.objects.keys())
    # an earlier one may have led to where the best one never gets
    stretches = ((policy, policy.stretch(knowledge)) for policy in knowing)
    return next(((policy, plan) for policy, plan in stretches if plan is not None), (None, None))


def next_stretch(
    now: Problem,
    progress: Progress,
    knowledge: KnowledgeBase,
    history: History,
    limits: Limits,
    unusable: Mapping[ForbiddenCall, str],
    plan: Plan | None,
) -> tuple[NextStretch | GiveUp, History]:
    """Decide what follows a stretch that has come to its end, with all calls done, and has this plan by its policy; see `decide`."""
    uncertain = [result for result in progress.calls if result.declared]
    history = replace(history, stretches=history.stretches + 1, repeats=history.repeats.after(uncertain, now))
    if given_up := history.given_up(limits):
        return given_up, history
    if livelock := history.repeats.livelock(uncertain):
        return GiveUp(livelock), history
    turned_out = [f"{result.call.action}: {result.declared}" for result in uncertain]
    rest = stretch_graph(now, plan) if plan else None
    if rest and why_not(Progress.beginning(rest), knowledge, history.forbidden(limits) | unusable.keys()):
        rest = None  # what failed too often, or cannot be carried out now, is not part of any policy
    return NextStretch(", ".join(turned_out) or "all calls are done", rest), history


def times_that_matter(now: Problem) -> str:
    """Return why only a planner can judge a delay; empty when times do not matter."""
    if now.timed:
        return "there are timed facts, so the times of the plan matter"
    if now.domain.nature:
        return "there are processes and events, so the times of the plan matter"
    timed = [str(constraint) for constraint in (*now.domain.constraints, *now.constraints) if constraint.times]
    return f"the times of the plan matter to {', '.join(timed)}" if timed else ""


def rest_of(now: Problem, progress: Progress) -> PlanGraph:
    """Return the calls that are not over, in an order of events of the old plan, with the orderings that their causes demand."""
    number = {call.index: position for position, call in enumerate(progress.rest)}
    renumbered = tuple(replace(call, index=number[call.index], under_way=call.index in progress.under_way) for call in progress.rest)
    begun = [PlanEvent(number[index], Moment.START) for index in sorted(progress.under_way)]
    order = [*begun, *(PlanEvent(number[event.call], event.moment) for event in progress.events)]
    return deordered(replace(now, goal=progress.plan.goal), renumbered, order)


def barred(progress: Progress, forbidden: Iterable[ForbiddenCall]) -> GroundAction | None:
    """Return the first action of the rest of a plan that must not be used; None if there is none."""
    rest = (call.action for call in progress.rest if call.index not in progress.under_way)
    return next((action for action in rest if any(call.covers(action) for call in forbidden)), None)


def why_not(
    progress: Progress,
    knowledge: KnowledgeBase,
    forbidden: frozenset[ForbiddenCall] = frozenset(),
    constraints: tuple[Constraint, ...] = (),
) -> str:
    """Return why the rest of the plan does not lead from what is known to its goal; empty when it does."""
    if action := barred(progress, forbidden):
        return f"{action} must not be used"
    return "".join(obstacle(progress, knowledge, constraints))


def obstacle(progress: Progress, knowledge: KnowledgeBase, constraints: tuple[Constraint, ...] = ()) -> tuple[str, str]:
    """Return what of the rest of the plan does not lead to its goal, and what of the world is against it; both empty when all does.

    Walks through the events in an order that the plan allows and applies them to a copy of the state,
    through which the constraints, none of which may speak of times, are progressed.
    """
    plan = progress.plan
    simulation = Progression(snapshot(knowledge), {number: plan.calls[number].action for number in progress.under_way})
    progression = ConstraintProgression(constraints, simulation.state)
    for event in progress.events:
        try:
            simulation.advance([(event, plan.calls[event.call].action)])
        except NotApplicable as error:
            return f"{plan.calls[error.call].action} would {error.stage}", f" although {error.observed}"
        if violated := progression.advance(simulation.state):
            return f"the {event.moment.value} of {plan.calls[event.call].action} would violate", f" {violated}"
    if evaluate(plan.goal, simulation.state) is not True:
        return "the rest of the plan would leave", f" {explanation(plan.goal, simulation.state)[1]}"
    missing = progression.unfulfilled(simulation.state)
    return ("the rest of the plan would leave", f" {', '.join(map(str, missing))} unfulfilled") if missing else ("", "")


def needless(before: Progress, after: Progress, knowledge: KnowledgeBase) -> str:
    """Return which calls of the rest of a plan it goes without, and what of that which they would change is so already."""
    left, texts = {call.index for call in after.rest}, list[str]()
    for call in (call for call in before.rest if call.index not in left):
        changed = {fluent: value for fluent, value in changes(call.action.end_effects, knowledge).items() if not is_number(value)}
        so = [statement_text(fluent, value) for fluent, value in changed.items() if same_value(knowledge.value(fluent), value)]
        texts.append(f"{call.action} is not needed{f': {chr(32).join(so)} already' if so else ''}")
    return "; ".join(texts)


def shortened(progress: Progress, knowledge: KnowledgeBase) -> Progress:
    """Return the plan without those calls that are needless from here: the rest leads to its goal all the same.

    Those of a stretch are for what comes after it. A rest of more than `MAX_SHORTENED` calls is left as it is: the work grows with the
    square of their number, and the event loop waits.
    """
    for call in progress.rest if len(progress.rest) <= MAX_SHORTENED and progress.plan.goal != TRUE else ():
        if call.index not in progress.under_way and not why_not(shorter := progress.without(call.index), knowledge):
            progress = shorter
    return progress
