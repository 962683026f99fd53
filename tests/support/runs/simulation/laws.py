"""What holds in every simulation, whatever dies in it: one pure function for each law, which yields what is against it."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Final, TypeAlias
from uuid import UUID

from pnm.core.execution.call_results import CallResult
from pnm.core.logic.conditions import Holds, conjuncts
from pnm.core.logic.expressions import Fluent, Unknown, Value
from pnm.core.machine.guards import Ends
from pnm.core.machine.plan_graph import ActionCall, PlanGraph
from pnm.core.machine.requests import CallOutcome, Ended, OutcomeKind
from pnm.core.net.net import PetriNet
from pnm.journal.records import WORLD, Happened, KnowledgeBegan, KnowledgeDelta, Repetition, TaskOver
from pnm.tasks import Code
from tests.support.runs.simulation.plans import HELD
from tests.support.runs.simulation.story import Began, CancelSent, Committed, Finished, Heard, Sent, Started, Story, Suffered

Law: TypeAlias = Callable[[Story], Iterator[str]]


def what_is_committed_is_kept(story: Story) -> Iterator[str]:
    """The journal that is left has all that was committed, in its order, and nothing else."""
    committed = [row for commit in story.of(Committed) for row in commit.rows]
    kept = [story.codec.text(record) for record in story.records]
    if len(committed) != len(kept):
        yield f"{len(committed)} records were committed, {len(kept)} are kept"
    yield from (f"{before} was committed, {after} is kept" for before, after in zip(committed, kept, strict=False) if before != after)


def matrix_equation(story: Story) -> Iterator[str]:
    """The journalled firings lead from the initial marking to that of the replay: m = m0 + C·x, calculated without the engine."""
    fired: dict[UUID, Counter[int]] = defaultdict(Counter)
    for record in story.records:
        if isinstance(record, Happened):
            fired[record.run].update(record.fired)
    for id, replayed in story.replay.runs.items():
        machine = replayed.run.machine
        marking = _moved(machine.net, machine.initial, fired[id])
        if any(count < 0 for count in marking.values()):
            yield f"run {id} has fewer tokens than none: {marking}"
        if +marking != Counter(replayed.run.marking):
            yield f"run {id} is at {replayed.run.marking}, its firings lead to {+marking}"


def _moved(net: PetriNet, initial: Mapping[str, int], fired: Mapping[int, int]) -> Counter[str]:
    marking, transitions = Counter(initial), net.transitions
    for index, times in fired.items():
        for places, sign in ((net.inputs[transitions[index]], -1), (net.outputs[transitions[index]], 1)):
            for place, weight in places.items():
                marking[place] += sign * weight * times
    return marking


def knowledge_is_the_fold_of_its_changes(story: Story) -> Iterator[str]:
    """What is known follows from the journalled changes alone; it is what the last process knew, and what the replay knows."""
    facts: dict[Fluent, Value | Unknown] = {}
    for record in story.records:
        match record:
            case KnowledgeBegan(base, began) if base == WORLD:
                facts = dict(began)
            case KnowledgeDelta(base, changes) if base == WORLD:
                facts.update(changes)
            case Happened(deltas=deltas):
                for delta in deltas:
                    facts.update(delta.facts if delta.base == WORLD else {})
    known = {fluent: value for fluent, value in facts.items() if value is not False}
    if story.replay.bases and known != story.replay.world.facts():
        yield f"the journal has {known}, its replay {story.replay.world.facts()}"
    if story.beliefs is not None and known != story.beliefs.facts():
        yield f"the journal has {known}, the process that has kept it {story.beliefs.facts()}"


def what_is_counted_is_counted_once(story: Story) -> Iterator[str]:
    """Each operation that has succeeded has changed its variable once, whatever processes have died."""
    for id, replayed in story.replay.runs.items():
        done = [result for result in _results(story, id) if result.call.action.operation is not None]
        expected = sum(result.kind is CallOutcome.SUCCEEDED for result in done)
        counted = replayed.run.knowledge.local.variable("count")
        if counted != expected:
            yield f"run {id} has counted to {counted} in {expected} steps"


def a_request_is_started_once(story: Story) -> Iterator[str]:
    """No server begins a request twice that it knows of."""
    starts = Counter((moment.request, moment.life) for moment in story.of(Began))
    yield from (f"{request} was begun {count} times" for (request, _), count in starts.items() if count > 1)


def an_end_comes_after_the_intent_and_counts_once(story: Story) -> Iterator[str]:
    """The journal has the intent of a request before its end, and only one end of it fires anything that waits for that."""
    intended: set[UUID] = set()
    ended: set[UUID] = set()
    for number, record in enumerate(story.records, 1):
        if not isinstance(record, Happened):
            continue
        if isinstance(record.event, Ended):
            request = record.event.request
            if request not in intended:
                yield f"record {number}: {request} has ended before it was to be sent"
            rules = story.replay.runs[record.run].run.machine.rules
            transitions = story.replay.runs[record.run].run.machine.net.transitions
            if any(isinstance(rules[transitions[index]].guard, Ends) for index in record.fired):
                if request in ended:
                    yield f"record {number}: the end of {request} counts again"
                ended.add(request)
        intended.update(record.intents)


def a_call_has_one_live_request(story: Story) -> Iterator[str]:
    """No robot begins a request while another one of the same call is at work, unless that was given up."""
    calls = _calls(story)
    at_work: dict[UUID, tuple[UUID, str]] = {}
    given_up: set[tuple[UUID, str]] = set()
    records = iter(story.records)
    for moment in story.moments:
        match moment:
            case Committed(rows=rows):
                for _ in rows:
                    given_up.update(_given_up(story, next(records, None)))
            case Began(request=request) if request in calls:
                rivals = [other for other, call in at_work.items() if call == calls[request] and other != request]
                if rivals and calls[request] not in given_up:
                    yield f"{moment.time:.3f} s: {moment.call} is begun while another request for it is at work"
                at_work[request] = calls[request]
            case Finished(request=request):
                at_work.pop(request, None)


def _given_up(story: Story, record: object) -> Iterator[tuple[UUID, str]]:
    if isinstance(record, Happened) and record.fired:
        replayed = story.replay.runs[record.run]
        machine = replayed.run.machine
        for index in record.fired:
            rule = machine.rules[machine.net.transitions[index]]
            if rule.gives_up and rule.call is not None:
                yield replayed.made.task, str(machine.plan.calls[rule.call].action)


def no_resource_is_used_beyond_its_capacity(story: Story) -> Iterator[str]:
    """By the robots' own log."""
    yield from story.clashes


def every_task_ends(story: Story) -> Iterator[str]:
    """Every task ends once, in its goal or in a failure with a name, and no process has an error that it does not handle."""
    yield from story.failures
    endings, repetition = Counter[UUID](), Repetition()
    for record in story.records:
        if not repetition.has(record) and isinstance(record, TaskOver):
            endings[record.task] += 1
    yield from (f"task {job.task} has {endings[job.task]} ends" for job in story.scenario.jobs if endings[job.task] != 1)
    for record in story.records:
        if isinstance(record, TaskOver) and not record.ending.message:
            yield f"task {record.task} has ended without a reason"


def success_is_true(story: Story) -> Iterator[str]:
    """A task that has reached its goal: what sensors report of it is so in the world; what they do not, a server has reported done."""
    succeeded = {str(moment.request) for moment in story.of(Heard) if moment.kind is OutcomeKind.SUCCEEDED}
    effects: dict[Fluent, set[str]] = defaultdict(set)
    for request, (task, call) in _calls(story).items():
        action = next(other.action for other in story.scenario.job(task).plan.calls if str(other.action) == call)
        for name in (HELD,):
            effects[name, *action.arguments].add(str(request))
    for record in story.records:
        if not (isinstance(record, TaskOver) and record.ending.code is Code.GOAL_REACHED):
            continue
        for part in conjuncts(story.scenario.job(record.task).plan.goal):
            if isinstance(part, Holds):
                is_true = story.truth.value(part.fluent) is True
                if not is_true and not (part.fluent[0] == HELD and effects[part.fluent] & succeeded):
                    yield f"task {record.task} has reached its goal, and {part} is not so"


def an_outcome_is_told_as_it_was(story: Story) -> Iterator[str]:
    """A call that says which of its outcomes it has had says what its robot drew, or leaves that open as well.

    A robot that begins anew with a request after its own death draws anew, and what it did before stays: sensors tell both.
    """
    calls, drawn, told = _calls(story), dict[tuple[UUID, str], object](), dict[tuple[UUID, str], str]()
    begun = Counter(moment.request for moment in story.of(Began))
    for record in story.records:
        is_end = isinstance(record, Happened) and isinstance(record.event, Ended) and begun[record.event.request] == 1
        if is_end and "outcome" in record.event.outcome.result:
            drawn[calls[record.event.request]] = record.event.outcome.result["outcome"]
    for id, replayed in story.replay.runs.items():
        told |= {(replayed.made.task, str(result.call.action)): result.declared for result in _results(story, id) if result.declared}
    for call, declared in told.items():
        if drawn.get(call, declared) not in (declared, *declared.split(" or ")):
            yield f"{call[1]} has come to {drawn[call]}, and is said to have come to {declared}"


def nothing_is_sent_before_its_intent_is_kept(story: Story) -> Iterator[str]:
    """Every request that leaves a process is in a record that was committed before."""
    intended: set[UUID] = set()
    records = iter(story.records)
    for moment in story.moments:
        if isinstance(moment, Committed):
            for _ in moment.rows:
                record = next(records, None)
                intended.update(record.intents if isinstance(record, Happened) else ())
        elif isinstance(moment, Sent) and moment.request not in intended:
            yield f"{moment.time:.3f} s: {moment.process} sends {moment.call}, which is not in the journal"


def nothing_is_sent_after_another_has_taken_over(story: Story) -> Iterator[str]:
    """No request and no cancellation leaves a process once another one has opened the journal."""
    latest = ""
    for moment in story.moments:
        if isinstance(moment, Started):
            latest = moment.process
        elif isinstance(moment, Sent | CancelSent) and moment.process != latest:
            what = f"sends {moment.call}" if isinstance(moment, Sent) else "cancels"
            yield f"{moment.time:.3f} s: {moment.process} {what}, and {latest} has taken over"


def a_call_is_tried_as_often_as_it_may_be(story: Story) -> Iterator[str]:
    """No call is sent more often than its retries, its recoveries and its loop allow; a pause at once lets it begin anew."""
    pauses = sum(moment.what == "pause at once" for moment in story.of(Suffered))
    sent = Counter(_calls(story).values())
    for (task, call), count in sent.items():
        plan = story.scenario.job(task).plan
        most = next(_attempts(story, plan, other) for other in plan.calls if str(other.action) == call)
        if count > most + pauses:
            yield f"{call} was sent {count} times, {most} are allowed"


def _attempts(story: Story, plan: PlanGraph, call: ActionCall) -> int:
    """Return how often a call may be sent at most: rounds of loops, and recoveries that it has or is part of, multiply."""
    own = 1 + story.scenario.bindings.of(call.action.name).retries
    recoveries = [recovery for other in plan.calls for recovery in other.recoveries if call in (other, *recovery.chain.steps)]
    for recovery in recoveries:
        own *= 1 + recovery.times
    is_outermost = call in plan.steps
    return own if is_outermost else own * 3


def _calls(story: Story) -> dict[UUID, tuple[UUID, str]]:
    """Return the task and the call of each request that was sent."""
    return {moment.request: (moment.task, moment.call) for moment in story.of(Sent)}


def _results(story: Story, run: UUID) -> tuple[CallResult, ...]:
    replayed = story.replay.runs[run]
    result = replayed.result or replayed.run.interim_result()
    return result.calls


GENERAL: Final[tuple[Law, ...]] = (
    what_is_committed_is_kept,
    nothing_is_sent_before_its_intent_is_kept,
    nothing_is_sent_after_another_has_taken_over,
    matrix_equation,
    knowledge_is_the_fold_of_its_changes,
    a_request_is_started_once,
    an_end_comes_after_the_intent_and_counts_once,
    no_resource_is_used_beyond_its_capacity,
)
"""Those of all journals."""
LAWS: Final[tuple[Law, ...]] = (
    every_task_ends,
    *GENERAL,
    what_is_counted_is_counted_once,
    a_call_has_one_live_request,
    a_call_is_tried_as_often_as_it_may_be,
    success_is_true,
    an_outcome_is_told_as_it_was,
)


def broken_laws(story: Story, laws: Iterable[Law] = LAWS) -> Iterator[str]:
    """Yield what is against these laws."""
    for law in laws:
        yield from (f"{law.__name__}: {what}" for what in law(story))
