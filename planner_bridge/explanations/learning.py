"""Learning rates from journals: each attempt counts once, when the run that has it is over."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Final
from uuid import UUID

from planner_bridge.explanations.history import JournalHistory, RunHistory, beginning
from planner_bridge.model.rates import GONE, NO_RATES, Call, Counts, End, Rates, update_rates
from planner_bridge.tasks.result import TASKS
from pnm.core.machine.failure_causes import Cause
from pnm.core.net.no_collection import no_collection
from pnm.files.database.place import Place
from pnm.journal.records import RunRetired, RunStands, RunSucceeded
from pnm.journal.resume import steps_after
from pnm.journal.store import KeptJournal

_SEEN: Final = {Cause.TIMED_OUT: End.TIMED_OUT, Cause.EFFECTS_MISSING: End.EFFECTS_MISSING}
"""Ends that the run has seen, whatever its server says of the request."""


def learn(place: Place, rates: Rates = NO_RATES, *, is_kept: bool = True) -> Rates:
    """Return rates with what a journal tells and they have not counted yet; what is under way is counted when it is over.

    Args:
        is_kept: whether the journal stays: else nobody will have it counted again.

    Raises:
        JournalError: it is no journal, or one of another version, or cannot be read now.
        PnmError: as `steps_after` does.
    """
    with closing(KeptJournal(place)) as kept, no_collection():
        history, attempts = JournalHistory(lambda key: TASKS.value(kept.part(key))), list[tuple[Call, Counts]]()
        journal = kept.id() if is_kept else f"{GONE}{kept.id()}"
        counted, over = rates.journals.get(journal, 0), set[UUID]()
        for step in steps_after(kept, TASKS, history.apply, beginning(kept, counted)):
            if isinstance(step.record, RunStands) and step.record.results is not None:
                over.add(step.record.made.run)
            if isinstance(step.record, RunRetired | RunSucceeded) and step.record.run not in over:
                over.add(step.record.run)
                if step.number > counted:
                    attempts += attempts_of(history, history.runs[step.record.run])
    return rates.grown(journal, max(counted, history.number), attempts)


def learn_into(file: Path, place: Place, *, is_kept: bool = True) -> None:
    """Have a file of rates count what a journal tells as well; raises as `learn` and `update_rates` do."""
    update_rates(file, partial(learn, place, is_kept=is_kept))


def attempts_of(history: JournalHistory, run: RunHistory) -> Iterator[tuple[Call, Counts]]:
    """Yield the attempts that a run, which is over, has made or taken over, and whose end is known."""
    requests = {call: [under_way.request] for call, under_way in run.made.adopted.items()}
    for call, sent in run.sent.items():
        requests[call] = [*requests.get(call, ()), *sent]
    outcomes = {sent[-1]: run.last_results[call].declared for call, sent in requests.items() if sent and call in run.last_results}
    seen: dict[UUID, End] = {}
    for trouble in (*run.hindrances, *run.failures):
        call, end = trouble.step.index, _SEEN.get(trouble.cause.cause)
        if end is not None and call in requests:
            made = trouble.attempt + (call in run.made.adopted)
            seen.update((request, end) for request in requests[call][made - 1 : made])
    for request in (request for sent in requests.values() for request in sent):
        attempt = history.attempts.get(request)
        if attempt is None or attempt.run != run.id or attempt.action.operation is not None:
            continue
        end = seen.get(request, End(attempt.outcome.kind.value) if attempt.outcome else None)
        if end is not None:
            began = attempt.sent if attempt.accepted is None else attempt.accepted
            # empty for an action with one outcome, and several names for what nothing has told apart
            outcome = next((way.name for way in attempt.action.outcomes if way.name == outcomes.get(request)), "")
            took = None if attempt.ended is None else attempt.ended - began
            yield Call.of(attempt.action, run.source.bindings), Counts.of(end, took, outcome)
