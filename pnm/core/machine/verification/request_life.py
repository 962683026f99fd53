"""Life of a call, as far as the proof needs it.

Of its request: sent, alive until its end is reported or it is given up, and over. And what the run can account for of it: a cause why
it has to recover, fails or is passed over, or an outcome.
"""

from __future__ import annotations

from collections.abc import Iterable
from enum import Enum
from typing import Final

from pnm.core.machine.guards import Accepts, Adopted, Ends, KnowledgeRead
from pnm.core.machine.requests import BEFORE_ACCEPTANCE, CallOutcome, OutcomeKind, TransitionAction
from pnm.core.machine.verification.part import PartStep

_ANY: Final = frozenset(OutcomeKind)


class Life(Enum):
    """Life of the last request of a call."""

    NONE = "none was sent since the call was reached"
    ADOPTABLE = "another run has sent it"
    ALIVE = "it is alive"
    OVER = "it is over, or given up"

    __hash__ = object.__hash__  # each is there once; states are hashed all the time


def following(step: PartStep, life: Life) -> Life:
    """Return the life of the request once the step has happened."""
    if step.action in (TransitionAction.SEND, TransitionAction.ADOPT):
        return Life.ALIVE
    return Life.OVER if step.gives_up or isinstance(step.guard, Ends) else life


def misuse(step: PartStep, life: Life, *, ending: bool) -> str:
    """Return the forbidden act of the step with the request of its call; empty for none."""
    match step.action:
        case TransitionAction.SEND if ending:
            return f"{step.name} sends a request although the run is ending"
        case TransitionAction.SEND if life in (Life.ADOPTABLE, Life.ALIVE):
            return f"{step.name} sends a request while one of the call is alive"
        case TransitionAction.SEND if step.outcome is not CallOutcome.RUNNING:  # the next request would have the identity of this one
            return f"{step.name} sends a request that does not count as an attempt"
        case TransitionAction.ADOPT if life is not Life.ADOPTABLE:
            return f"{step.name} takes over a request that no other run has sent"
        case TransitionAction.CANCEL | TransitionAction.BEGIN if life is not Life.ALIVE:
            return f"{step.name} is about a request, and none is alive"
        case TransitionAction.FINISH | TransitionAction.UNDO if life in (Life.NONE, Life.ADOPTABLE):
            return f"{step.name} is about the effects of a request that was not sent"
        case _:
            pass
    if step.outcome is CallOutcome.SUSPENDED and following(step, life) is not Life.OVER:
        return f"{step.name} makes its call {step.outcome}, and its last request is not over"
    if step.gives_up and life is not Life.ALIVE:
        return f"{step.name} gives a request up, and none is alive"
    if step.guard.reads is KnowledgeRead.EFFECTS and life in (Life.NONE, Life.ADOPTABLE):
        return f"{step.name} looks for the effects of a request that was not sent"
    return ""


def may_come(step: PartStep, life: Life, *, accepts: bool) -> bool:
    """Return whether a report about the request, or its adoption, may come.

    Where an acceptance is waited for (`accepts`), an end that implies one is taken as that first.
    """
    match step.guard:
        case Adopted():
            return life is Life.ADOPTABLE
        case Ends(_, kinds):
            return life is Life.ALIVE and not (accepts and kinds.isdisjoint(BEFORE_ACCEPTANCE))
        case _:
            return life is Life.ALIVE


def untaken(steps: Iterable[PartStep]) -> frozenset[OutcomeKind]:
    """Return the ends of a request that is alive which none of the enabled steps takes; such a report would be lost."""
    taken = frozenset[OutcomeKind]()
    expected = _ANY
    for step in steps:
        if isinstance(step.guard, Ends):
            taken |= step.guard.kinds
        elif isinstance(step.guard, Accepts):
            expected = BEFORE_ACCEPTANCE  # any other is taken once the acceptance is
    return expected - taken


class Account(Enum):
    """Account that a run can give of a call since it was last reached, or of a loop, a choice or all steps of the plan."""

    OPEN = "nothing has become of it yet"
    HINDERED = "there is a cause why it fails or has to recover"
    PASSED_OVER = "there is a cause after which the plan goes on without it"
    ENDED = "it has ended otherwise than the plan wants"
    DONE = "it is done"

    __hash__ = object.__hash__  # each is there once; states are hashed all the time


SETTLED: Final = (Account.PASSED_OVER, Account.DONE)
"""Accounts with which the plan goes on."""
_KNOWN: Final = (Account.HINDERED, Account.PASSED_OVER)


def accounted(step: PartStep, before: Account) -> Account:
    """Return the account of the call once the step has happened, as `pnm.core.execution.call_results` keeps it."""
    match step.outcome:
        case CallOutcome.WAITING:
            return Account.OPEN
        case CallOutcome.SUCCEEDED | CallOutcome.ALREADY_TRUE:
            return Account.DONE
        case CallOutcome.RUNNING | CallOutcome.SUSPENDED:  # a new attempt, which the cause of the last one says nothing about
            return Account.HINDERED if before in _KNOWN or step.finds_cause else Account.OPEN
        case None | CallOutcome.PASSED_OVER if step.settles:
            return Account.DONE if step.call is None else Account.PASSED_OVER
        case None | CallOutcome.PASSED_OVER:
            return Account.HINDERED if step.finds_cause and step.call is not None else before
        case _:
            return Account.ENDED


def lacking_account(step: PartStep, before: Account, *, fails: bool) -> str:
    """Return the assertion of the step about its call without an account of it; empty for none."""
    if step.outcome is CallOutcome.PASSED_OVER and before is Account.OPEN:
        return f"{step.name} leaves a call that has not come to an end"
    # Of loops and choices the run keeps no cause: what marks their failure finds it.
    if fails and not step.finds_cause and (step.call is None or accounted(step, before) not in _KNOWN):
        return f"{step.name} marks a failure, and no rule has found its cause"
    return ""
