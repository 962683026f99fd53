"""The story that the page tells: the history of a journal, with facts, open questions, and its last records in words; and its views.

A view has its things by key, and they are JSON as they are sent; what changes from one moment to the next is told key by key, see
`planner_bridge.view.app`. A thing is never changed, but replaced.

The story reaches back to the beginning of the segment before the last one: a segment may begin as soon as a task has ended, and people
still want to see it then.
"""

from __future__ import annotations

import json
from array import array
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from math import isfinite
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Self, TypeAlias
from uuid import UUID

from planner_bridge.explanations.history import Attempt, JournalHistory, RunHistory, TaskHistory, Trouble, beginning
from planner_bridge.model.grounding import problem_now
from planner_bridge.pipeline.odds import NOTHING_KNOWN, KnownRobots
from planner_bridge.pipeline.policy_odds import RestOfPlan
from planner_bridge.tasks.replanning import decision_words
from planner_bridge.tasks.result import TASKS
from pnm.core.execution.call_results import CallResult, Failure
from pnm.core.execution.events import Answered, Ask, Restarted, Withdraw
from pnm.core.execution.questions import EvaluationContext
from pnm.core.logic.computed_values import Layer, Unanswered
from pnm.core.logic.conditions import Condition, conjuncts, evaluate, fluents, observed
from pnm.core.logic.expressions import Fluent, Unknown, Value, fluent_text, text_of
from pnm.core.machine.plan_graph import Ordering, PlanEvent, step_words
from pnm.core.machine.requests import CallOutcome, Ended, OutcomeKind
from pnm.core.pictures.timeline import TimedAttempt, TimedCall, TimedPlan, Timeline, timeline_svg, timelines_xes
from pnm.errors import PnmError
from pnm.files.database.place import Place, place_of
from pnm.journal import records
from pnm.journal.replay import ReplayStep, words
from pnm.journal.store import KeptJournal
from pnm.tasks import TaskState, percent

if TYPE_CHECKING:
    from planner_bridge.planning.policies.net import PolicyRun
    from planner_bridge.planning.policies.policy import Policy

SEGMENTS: Final = 2
"""The number of segments that it reaches back to."""

Thing: TypeAlias = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class View:
    """The whole state after a record.

    Args:
        time: of the record, on the clock of its process.
        began: when what is shown began.
        first: the first record of what is shown.
        problem: why no more can be shown; empty if all is well.
        clock: the time of day, in seconds, when that clock was 0; None if it is not known.
        calls: by run and number.
        hands: by name, the robots and other things that people have in their hands.
        troubles: by record, and their number in it.
        events: by record: what is marked, and what people did; all else is told of the other things.
    """

    number: int = 0
    time: float = 0.0
    began: float = 0.0
    first: int = 0
    problem: str = ""
    clock: float | None = None
    tasks: Mapping[str, Thing] = field(default_factory=dict)
    runs: Mapping[str, Thing] = field(default_factory=dict)
    calls: Mapping[str, Thing] = field(default_factory=dict)
    requests: Mapping[str, Thing] = field(default_factory=dict)
    facts: Mapping[str, Thing] = field(default_factory=dict)
    servers: Mapping[str, Thing] = field(default_factory=dict)
    questions: Mapping[str, Thing] = field(default_factory=dict)
    hands: Mapping[str, Thing] = field(default_factory=dict)
    troubles: Mapping[str, Thing] = field(default_factory=dict)
    events: Mapping[str, Thing] = field(default_factory=dict)


class Story(JournalHistory):
    """The story of a journal so far. Everything in it is mutable state; `apply` is the only thing that changes it."""

    def __init__(self, source: Callable[[str], records.MachineSource] | None = None, known: KnownRobots = NOTHING_KNOWN) -> None:
        super().__init__(source, SEGMENTS)
        self._robots = known
        self.facts: Mapping[str, Thing] = {}
        """A new mapping whenever one of them changes."""
        self.events: dict[int, Thing] = {}
        self.clock: float | None = None
        """The time of day when the clock of the records was 0, as long as one process writes them."""
        self._times = array("d")
        """Of the records so far."""
        self._questions: dict[str, Thing] = {}
        """Those of runs."""
        self._shown: dict[str, tuple[object, Thing]] = {}
        """What was shown last, and its sources: most things have not changed since."""

    @classmethod
    def of(cls, kept: KeptJournal, number: float, known: KnownRobots = NOTHING_KNOWN) -> Self:
        """Return a story that can tell all after a record, and of the segment before: as it is before the first of these."""
        story = cls(lambda key: TASKS.value(kept.part(key)), known)
        story.number = beginning(kept, number, SEGMENTS)
        return story

    @property
    def questions(self) -> dict[str, Thing]:
        """The questions that are open: those of runs, and those to a person about tasks."""
        about_tasks = {
            help.asked.question.hex: _question(
                "a person", help.asked.text, task.name, help.since, task.accepted.wanted.id, help.asked.choices
            )
            for task in self.tasks.values()
            for help in task.helps.values()
        }
        return self._questions | about_tasks

    def apply(self, number: int, time: float, record: records.Record) -> ReplayStep:
        """Note and execute a record, because the page shows the wishes of the runs; raises as `Replay.apply` does."""
        of_all = isinstance(record, records.HandPut) or (isinstance(record, records.TaskHeld) and not record.task)
        is_said = of_all and not self._repetition.left
        super().apply(number, time, record)
        step = self.execute()
        assert step is not None, "this record was executed"
        self._tell(step)
        if (mark := self._mark(record)) or is_said:
            self.events[number] = {"time": self.time, "lines": words(step, self.replay) if is_said else (), "mark": mark}
        self._times.append(self.time)
        return step

    def record_at(self, time: float) -> int:
        """Return the last record by a time; the first one if it is earlier."""
        return max(self.number - len(self._times) + max(bisect_right(self._times, time), 1), self.first, 1)

    def once(self, key: str, made_of: object, show: Callable[[], Thing]) -> Thing:
        """Return what is shown of a thing: what was shown last, if its sources are the same."""
        if (known := self._shown.get(key)) is None or known[0] != made_of:
            known = self._shown[key] = made_of, show()
        return known[1]

    def odds(self, task: TaskHistory) -> Thing | None:
        """Return the odds of what is left of the plan of a task, and the time at which they are so; None where they are not known."""
        run = task.own_runs[-1] if self._robots and task.ending is None and task.own_runs else None
        if run is None or run.is_over:
            return None
        rest, note = RestOfPlan.of(run.executed().run, run.time), task.policy

        def follows() -> Thing:
            problem = note.problem if note and run.record else None  # else nobody knows any more what was so when it was made
            policy = note.policy(problem) if note and problem else None
            return {"chain": policy and rest.chain(self._robots, policy, problem_now(policy.problem, run.state))}

        def told() -> Thing:
            odds = rest.odds(self._robots, self.once(f"chain of {run.id.hex}", note, follows)["chain"])
            told = odds.told if odds else None
            return {"at": rest.now, "words": percent(told.chance), **told.as_json()} if told else {}

        return self.once(f"odds of {run.id.hex}", (rest, note), told) or None

    def _mark(self, record: records.Record) -> str:
        """Return the mark of a record for going through them."""
        match record:
            case records.TaskOver():  # also when it is said again, or what is shown would depend on what was read before
                return "end"
            case records.RunMade(run) if self.runs[run].replan is not None:
                return "replan"
            case records.Happened(event=Ended(outcome=outcome)) if outcome.kind is not OutcomeKind.SUCCEEDED:
                return "failure"
            case records.Happened(run) if any(trouble.record == self.number and trouble.is_failure for trouble in self.runs[run].latest):
                return "failure"
            case _:
                return ""

    def _tell(self, step: ReplayStep) -> None:
        match step.record:
            case records.SharedBegan():
                self.events = {number: event for number, event in self.events.items() if number >= self.first}
                self._questions, self._shown = self._questions if step.record.again else {}, {}
            case records.KnowledgeBegan(base, facts) if base == records.WORLD:
                self.facts = {fluent_text(fluent): self._fact(fluent, value, is_initial=True) for fluent, value in facts.items()}
            case records.KnowledgeDelta():
                self._tell_facts(step.record)
            case records.TaskAccepted(wall=wall):
                self.clock = wall - step.time
            case records.Happened(run, event, deltas=deltas):
                for delta in deltas:
                    self._tell_facts(delta)
                self._tell_questions(run, event, step)
            case _:
                pass

    def _tell_questions(self, run: UUID, event: object, step: ReplayStep) -> None:
        match event:
            case Restarted():
                self.clock = None
            case Answered(id):
                self._questions.pop(id.hex, None)
            case _:
                pass
        made = self.runs[run].made
        for command in step.commands:
            match command:
                case Ask(id, question) if question.layer is Layer.PERSON:
                    said = json.loads(question.meta) if question.meta else None
                    text = (said if isinstance(said, str) else said and json.dumps(said, ensure_ascii=False)) or question.name
                    self._questions[id.hex] = _question("a person", text, made.name, self.time, made.task)
                case Ask(id, question):
                    self._questions[id.hex] = _question("a source of knowledge", str(question), made.name, self.time, made.task)
                case Withdraw(id):
                    self._questions.pop(id.hex, None)
                case _:
                    pass

    def _tell_facts(self, delta: records.KnowledgeDelta) -> None:
        if delta.base != records.WORLD:
            return
        facts = dict(self.facts)
        if delta.sensed:
            sensed = {fluent_text(fluent): self.world.is_sensed(fluent) for fluent in self.world.facts()}
            facts = {name: {**fact, "source": "sensed" if sensed.get(name) else "assumed"} for name, fact in facts.items()}
        self.facts = facts | {fluent_text(fluent): self._fact(fluent, value) for fluent, value in delta.facts.items()}

    def _fact(self, fluent: Fluent, value: Value | Unknown, *, is_initial: bool = False) -> Thing:
        """Return a fact, and since when it is so: if it is initial, since the beginning of what is shown at least."""
        before = self.facts.get(fluent_text(fluent))
        return {
            "value": value_words(value),
            "source": "sensed" if self.world.is_sensed(fluent) else "assumed",
            "since": self.time,
            "is_initial": is_initial,
            "was": "" if before is None or not isinstance(value, Unknown) else before["was"] or before["value"],  # known last
        }


def _question(who: str, text: str, subject: str, since: float, task: UUID | None, choices: tuple[str, ...] = ()) -> Thing:
    """Return an open question: who is asked, what, for which task, since when, and the answers to choose from; none for any."""
    return {"who": who, "text": text, "subject": subject, "since": since, "task": task.hex if task else "", "choices": choices}


def value_words(value: Value | Unknown) -> str:
    """Return a fact in words."""
    match value:
        case bool():
            return "true" if value else "false"
        case Unknown():
            return "unknown"
        case _:
            return text_of(value)


# --- the view of a story --------------------------------------------------------------------------
# The view of a story: what is shown after its last record. A pure function, which changes nothing that can be seen.


def view_of(story: Story) -> View:
    """Return the view of a story; the same story gives the same view."""
    runs = story.runs.values()
    results = {f"{run.id.hex}/{index}": (run, result) for run in runs for index, result in run.last_results.items()}
    troubles = {key: (run, trouble) for run in runs for key, trouble in run.troubles.items()}
    told = {key: result.declared for key, (_, result) in results.items() if result.declared}

    def request(id: UUID, attempt: Attempt) -> Thing:
        has_succeeded = attempt.outcome is not None and attempt.outcome.kind is OutcomeKind.SUCCEEDED
        declared = told.get(f"{attempt.run.hex}/{attempt.call}", "") if has_succeeded else ""
        return story.once(id.hex, (attempt, declared), partial(_request, story, attempt, declared))

    def trouble_of(run: RunHistory, trouble: Trouble) -> Thing:
        step = {"run": run.id.hex, "call": trouble.step.index, "step": step_words(trouble.step)}
        cause = {"cause": trouble.cause.cause.value, "expected": trouble.cause.expected, "observed": trouble.cause.observed}
        return {**step, **cause, "is_failure": trouble.is_failure, "time": trouble.time, "followed": trouble.followed}

    return View(
        story.number,
        story.time,
        story.began,
        story.first,
        "",
        story.clock,
        {id.hex: _task(story, task) for id, task in story.tasks.items()},
        {run.id.hex: story.once(run.id.hex, (run.origin, run.is_over, run.replan), partial(_run, run)) for run in runs},
        {key: story.once(key, result, partial(_call, run, result)) for key, (run, result) in results.items()},
        {id.hex: request(id, attempt) for id, attempt in story.attempts.items()},
        story.facts,
        _servers(story),
        story.questions,
        {name: {"words": str(hand)} for name, hand in story.replay.hands.taken.items()},
        {key: story.once(key, trouble, partial(trouble_of, run, trouble)) for key, (run, trouble) in troubles.items()},
        {str(number): event for number, event in story.events.items()},
    )


def _task(story: Story, task: TaskHistory) -> Thing:
    """Return a task: times of day, and used seconds of its limit; its code is empty while it has not ended."""
    wanted, used, accepted = task.accepted.wanted, task.used, task.accepted.wall
    return {
        "goal": task.name,
        **named(task),
        "time": task.time,
        "ended": task.ended,
        "state": task.state.word,
        "reason": _reason(task),
        "priority": wanted.priority,
        "accepted": accepted,
        "deadline": None if wanted.deadline is None else accepted + wanted.deadline,
        "used": round(task.seconds(story.time), 6),
        "limit": used.limit if used and isfinite(used.limit) else None,
        "code": task.ending.code.word if task.ending else "",
        "runs": tuple(run.id.hex for run in task.runs),
        "order": task.accepted.order,
        "counts": str(task.counts) if task.runs else "",
        "odds": story.odds(task),
    }


def named(task: TaskHistory) -> Thing:
    """Return the text of a task, or its goal as its first plan has it, with its parameters; empty while nobody knows."""
    wanted, first = task.accepted.wanted, (*task.own_runs[:1],)
    goals = (run.policy.problem.goal if run.policy and run.policy.problem else run.source.plan.goal for run in first)
    return {"title": wanted.text or "".join(map(str, goals)), "given": {name: str(value) for name, value in wanted.parameters.items()}}


def _run(run: RunHistory) -> Thing:
    """Return a run: when it was made, and the time from which its plan counts, None until it begins."""
    return {
        "name": run.made.name,
        "time": run.time,
        "origin": run.origin,
        "is_over": run.is_over,
        "is_own": run.is_own,
        "is_foreseen": run.is_foreseen,
        "replan": run.replan and asdict(run.replan),
        "has_policy": bool(run.policy and run.policy.entries and run.policy.problem),
    }


def _reason(task: TaskHistory) -> str:
    """Return why a task is as it is; if nobody has said that, what it does."""
    if task.reason or task.ending:
        return task.reason
    if task.helps:
        return "a person is asked for a decision"
    if not task.runs:
        return "it has no plan yet: a planner looks for one, or it waits for other tasks" if task.state is TaskState.PLANNING else ""
    run = task.runs[-1]
    if task.decision:  # about what follows the last run
        return decision_words(task.decision)
    if run.failures:
        failed = f"{step_words(run.failures[-1].step)} has failed: {run.failures[-1].cause.cause}"
        return f"{failed}; running calls come to their ends" if task.state is TaskState.RUNNING else failed
    going_on = [str(call.action) for call in run.executed().run.open_calls.values()]
    return f"{', '.join(going_on)} {'run' if len(going_on) > 1 else 'runs'}" if going_on else ""


def _call(run: RunHistory, result: CallResult) -> Thing:
    """Return a call, planned in seconds after the origin of its run; nothing reports effects that are assumed."""
    call, action = result.call, result.call.action
    return {
        "run": run.id.hex,
        "index": call.index,
        "action": str(action),
        "lane": run.lane(action),
        "state": result.kind.name.lower(),
        "outcome": result.outcome if result.kind is not CallOutcome.ALREADY_TRUE else "not needed: its effects held",
        "attempts": result.attempts,
        "started": result.started,
        "ended": result.ended,
        "planned": call.planned,
        "duration": action.duration,
        "is_assumed": result.assumed,
    }


def _request(story: Story, attempt: Attempt, declared: str) -> Thing:
    run, outcome = story.runs[attempt.sender], attempt.outcome
    return {
        "run": attempt.run.hex,
        "call": attempt.call,
        "action": str(attempt.action),
        "lane": run.lane(attempt.action),
        "attempt": attempt.number,
        "sent": attempt.sent,
        "accepted": attempt.accepted,
        "ended": attempt.ended,
        "outcome": outcome.kind.value if outcome else "",
        "declared": declared,
        "message": outcome.message if outcome else "",
        "feedback": attempt.feedback,
    }


def _servers(story: Story) -> dict[str, Thing]:
    """Return the action servers, as far as the journal knows: with how many requests that they have not carried out."""
    actions: dict[str, dict[str, None]] = {}
    busy: dict[str, list[str]] = {}
    failed = Counter[str]()
    for run in story.runs.values():
        for server, names in run.servers.items():
            actions.setdefault(server, {}).update(dict.fromkeys(names))
    for attempt in story.attempts.values():
        server = story.runs[attempt.sender].server(attempt.action)
        actions.setdefault(server, {})[attempt.action.name] = None
        if attempt.outcome is None and story.runs[attempt.run].results is None:
            busy.setdefault(server, []).append(str(attempt.action))
        failed[server] += attempt.outcome is not None and attempt.outcome.kind is not OutcomeKind.SUCCEEDED
    found = sorted(name for name in actions if name)
    return {name: {"actions": (*actions[name],), "busy": (*busy.get(name, ()),), "failed": failed[name]} for name in found}


def timelines(journal: Place | str) -> tuple[Timeline, ...]:
    """Return the timelines of the tasks in a journal, in the order in which they were accepted.

    Raises:
        JournalError: it is no journal, or one of another version.
        ReplayDiffers: its runs do something else in this version.
        Undecodable: this version does not know what its records are made of.
    """
    history = JournalHistory.read(place_of(journal) if isinstance(journal, str) else journal)
    told = []
    for task in history.tasks.values():
        began = min((task.time, *(run.time for run in task.runs)))
        words = f"{task.ending.code.word}: {task.ending.message}" if task.ending else ""
        end = history.time if task.ended is None else task.ended
        plans, accepted = tuple(_timed_plan(history, run, began) for run in task.runs), task.accepted
        told.append(Timeline(task.name, plans, end - began, words, str(accepted.wanted.id), accepted.wall - (task.time - began)))
    return tuple(told)


def timelines_as(form: str, journal: Place, *, only_last: bool = False) -> str:
    """Return the timelines of the tasks in a journal, or that of the last one alone: as a picture (`svg`), or a log of events (`xes`)."""
    told = timelines(journal)[-1:] if only_last else timelines(journal)
    return timelines_xes(told) if form == "xes" else timeline_svg(*told)


def _timed_plan(history: JournalHistory, run: RunHistory, began: float) -> TimedPlan:
    """Return the plan of a run in a task that has begun then."""
    results, origin = run.last_results, (run.time if run.origin is None else run.origin) - began
    calls = []
    for call in run.source.plan.calls:
        became, lane, lasts = results[call.index], run.lane(call.action), call.action.duration
        attempts = tuple(
            TimedAttempt(sent.sent - began)
            if sent.ended is None or sent.outcome is None
            else TimedAttempt(sent.sent - began, sent.ended - began, sent.outcome.kind, sent.outcome.message)
            for sent in history.sent(run, call.index)
        )
        name, planned, has_failed = str(became.call.action), origin + call.planned, became.kind is CallOutcome.FAILED
        calls.append(
            TimedCall(call.index, name, lane, planned, lasts, attempts, became.outcome, became.is_done, has_failed, became.declared)
        )
    failures = tuple(str(Failure(trouble.step, *trouble.cause)) for trouble in run.failures)
    return TimedPlan(run.time - began, tuple(calls), run.replan, failures)


# --- policies ---------------------------------------------------------------------------------------


class Followed(NamedTuple):
    """A policy, and what of it was carried out by a record."""

    policy: Policy
    runs: tuple[PolicyRun, ...]

    @staticmethod
    def by(history: JournalHistory, run: RunHistory) -> Followed | None:
        """Return the policy that a run follows, as far as its task has come with it; None if none is known."""
        task, note = history.tasks.get(run.made.task), run.policy
        runs = [one for one in task.own_runs if one.policy is note and one.record] if task else []
        if not runs or (policy := runs[0].followed) is None:
            return None
        return Followed(policy, tuple((one.state, (*one.last_results.values(),), one.is_over) for one in runs))

    def __str__(self) -> str:
        from planner_bridge.planning.policies.net import followed, followed_words  # here, because most actions have one outcome

        return followed_words(self.policy, *followed(self.policy, self.runs))

    def picture(self) -> str:
        """Return the picture of the policy, in which that is lit."""
        from planner_bridge.planning.policies.net import followed_svg  # here, because most actions have one outcome

        return followed_svg(self.policy, self.runs)


# --- call detail ----------------------------------------------------------------------------------
# The detail of one call: what it waits for, its conditions with what is known of them, and where its token is.


_READ: Final = 6
"""Facts of a condition that are shown one by one."""


def detail(story: Story, run: UUID, index: int) -> dict[str, Any] | None:
    """Return all that is known of a call of a run, as JSON; None if there is no such call.

    Its limit is in seconds from its acceptance, ``accept`` those in which its server has to answer a request; None for none. Resources
    come with the action that has them now. Its places are in the order of time; neither they nor transitions have its name before theirs.
    """
    if (found := story.runs.get(run)) is None or not 0 <= index < len(found.source.plan.calls):
        return None
    replayed, call, bindings = found.executed().run, found.source.plan.calls[index], found.source.bindings
    action = next((open.action for open in replayed.open_calls.values() if open.index == index), call.action)
    limit, context = replayed.limit(call), EvaluationContext(replayed.knowledge, call.action, bindings.of(call.action.name))
    conditions = (
        ("before it starts", call.action.precondition),
        ("while it runs", call.action.invariant),
        ("when it ends", call.action.end_condition),
        ("once it is done", call.action.expected),
    )
    replay, holders = story.replay, dict[str, list[str]]()
    for claim in replay.resources.held:
        for name in claim.names if claim.request in replay.requests else ():
            holders.setdefault(name, []).append(str(replay.requests[claim.request].action))
    recoveries = [(one, ", ".join(map(step_words, one.chain.steps))) for one in call.recoveries]
    orderings = [each for each in found.source.plan.orderings if each.before.call != each.after.call]
    return {
        "run": run.hex,
        "index": index,
        "action": str(action),
        "server": found.server(action),
        "limit": limit if limit and isfinite(limit) else None,
        "accept": None if action.operation is not None else bindings.of(action.name).accept,
        "resources": [(name, ", ".join(holders.get(name, ()))) for name in bindings.resources(action)],
        "waits_for": [_wait(found, each, each.before) for each in orderings if each.after.call == index],
        "needed_by": [_wait(found, each, each.after) for each in orderings if each.before.call == index],
        "checks": [_check(story, when, part, context) for when, condition in conditions for part in conjuncts(condition)],
        "effects": [f"at the start: {effect}" for effect in action.start_effects]
        + [f"at the end: {effect}" for effect in action.end_effects],
        "recoveries": [
            f"after {', '.join(sorted(one.causes))}: {chain and f'{chain}, then '}{one.then.value}" for one, chain in recoveries
        ],
        **_block(found, index),
    }


def _wait(run: RunHistory, ordering: Ordering, other: PlanEvent) -> dict[str, Any]:
    """Return an ordering with the event of another call that is waited for, or waits."""
    return {
        "call": other.call,
        "action": step_words(run.steps[other.call]),
        "moment": other.moment.value,
        "protects": list(map(fluent_text, ordering.protects)),
        "has_come": run.time_of(ordering.before) is not None,
    }


def _check(story: Story, when: str, condition: Condition, context: EvaluationContext) -> dict[str, Any]:
    """Return a condition: whether it is true now, what is observed, the facts in it, of many the first ones, and how that is known."""
    try:
        truth = evaluate(condition, context)
        text = "unknown" if isinstance(truth, Unknown) else "true" if truth else "false"
        seen = observed(condition, context)
    except (Unanswered, PnmError) as error:
        text, seen = "unknown", str(error)
    read, reads = fluents(condition, context), list[dict[str, Any]]()
    for fluent in sorted(read)[:_READ]:
        name, source = fluent_text(fluent), _sources(frozenset({fluent}), context)
        if fact := story.facts.get(name):
            value, since, is_initial = fact["value"], fact["since"], fact["is_initial"]
        else:
            value, since, is_initial = value_words(context.value(fluent) or False), None, False
        reads.append({"name": name, "value": value, "source": source, "since": since, "is_initial": is_initial})
    source, others = _sources(read, context), len(read) - len(reads)
    return {"when": when, "text": str(condition), "truth": text, "observed": seen, "source": source, "reads": reads, "others": others}


def _sources(read: frozenset[Fluent], context: EvaluationContext) -> str:
    derived = {fluent for fluent in read if fluent[0] in context.world.rules.derived}
    ways = {
        "derived": bool(derived),
        "sensed": any(context.world.is_sensed(fluent) for fluent in read - derived),
        "assumed": any(not context.world.is_sensed(fluent) for fluent in read - derived),
    }
    return ", ".join(way for way, is_so in ways.items() if is_so) or "computed"


def _block(run: RunHistory, index: int) -> dict[str, Any]:
    """Return the places and transitions of a call, by the short names that people know them by."""
    machine, marking = run.executed().run.machine, run.executed().run.marking
    prefix = f"{machine.plan.calls[index]} "
    own, transitions = frozenset(machine.blocks[index]), []
    for name in machine.net.transitions:
        inputs, outputs = machine.net.inputs[name], machine.net.outputs[name]
        if machine.rules[name].call == index and not own.isdisjoint((*inputs, *outputs)):
            is_enabled = all(marking[place] >= weight for place, weight in inputs.items())
            taken, marked = ([place.removeprefix(prefix) for place in weights if place in own] for weights in (inputs, outputs))
            short = name.removeprefix(prefix)
            transitions.append({"name": short, "inputs": taken, "outputs": marked, "is_enabled": is_enabled})
    places = [{"name": place.removeprefix(prefix), "tokens": marking[place]} for place in machine.blocks[index]]
    return {"places": places, "transitions": transitions}
