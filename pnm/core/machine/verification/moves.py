"""Moves of a part of a machine: in which states it can be, and what can happen next in each, whatever the world answers.

A call has a life, as far as the proof needs it. Of its request: sent, alive until its end is reported or it is given up, and over. And what
the run can account for of it: a cause why it has to recover, fails or is passed over, or an outcome.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from enum import Enum
from typing import Final, NamedTuple, TypeAlias

from pnm.core.machine.guards import Accepts, Adopted, Ends, KnowledgeRead, Moods, Opener
from pnm.core.machine.requests import BEFORE_ACCEPTANCE, CallOutcome, TransitionAction
from pnm.core.machine.verification.part import Part, PartStep, Unsound, in_each_case

Tokens: TypeAlias = tuple[int, ...]

STOPS: Final = ("", "restart elsewhere", "stop", "cancel")
AGAIN: Final = "enter again"
SUPPLY: Final = "supply"
FROM_OUTSIDE: Final = frozenset((*STOPS, AGAIN, SUPPLY))
"""The events of a part from outside; no step of its own may have this name."""

_OF_REQUESTS: Final = (Opener.REPORT, Opener.HANDOVER)


class PartState(NamedTuple):
    """A state of a part: its tokens, and what became of the requests of its calls."""

    tokens: Tokens
    stop: int = 0
    """0: going on, 1: another part asks for the plan to begin anew, 2: a stop, 3: a stop that cancels."""
    supplied: int = 0
    """The number of supplies that have come."""
    requests: tuple[Life, ...] = ()
    """The state of the last request of each call."""
    accounts: tuple[Account, ...] = ()
    """The facts that the run can account for of each call."""
    restored: bool = False
    """Whether something that was counted has come back since the part was entered."""


class Moves:
    """The moves of a part. Its places, calls and steps are known by number."""

    def __init__(self, part: Part) -> None:
        self.part = part
        self.index = {place: number for number, place in enumerate(part.places)}
        self.fired: set[int] = set()
        """The steps that can happen, as far as is known."""
        self.consumers: list[list[int]] = [[] for _ in part.places]
        """For every place the steps that take from it, in their order."""
        self.reports: list[list[int]] = [[] for _ in part.places]
        """Those of them that a report opens, and that need nothing else."""
        self.calls: dict[int | None, int] = {None: 0}
        """The calls; with None for a loop, a choice or the frame, which has no request."""
        self._unaccepted: dict[int | None, list[int]] = {}
        """For every call the places at which the acceptance of a request is waited for."""
        for number, step in enumerate(part.steps):
            self.calls.setdefault(step.call, len(self.calls))
            for place in map(self.index.__getitem__, step.inputs):
                self.consumers[place].append(number)
                if step.guard.opened_by is Opener.REPORT:
                    self.reports[place].append(number)
                if isinstance(step.guard, Accepts):
                    self._unaccepted.setdefault(step.call, []).append(place)
        self.resources = {self.index[place]: part.initial.get(place, 0) for place in part.resources}
        # Places without an arc in this part have no index.
        self.records = {self.index[place] for place in part.counters if place in self.index} | self.resources.keys()
        self._needs = [tuple((self.index[place], weight) for place, weight in step.inputs.items()) for step in part.steps]
        self._gives = [tuple((self.index[place], weight) for place, weight in step.outputs.items()) for step in part.steps]
        self._failures = [self.index[place] for place in part.failures]
        self._failing = {number for number, step in enumerate(part.steps) if not part.failures.isdisjoint(step.outputs)}
        self._restarts = [self.index[place] for place in part.restarts]
        self._finals = [self.index[place] for place in part.finals if place in self.index]
        # Only upwards in `successors`: a stop is never taken back, so the states of a part are finitely many.
        self._stops = (1, 2, 3) if part.others_restart else (2, 3)
        # A place that asks for a restart is emptied before anything begins anew.
        counting = {step.counted.place for step in part.steps if step.counted}
        self._lasting = {self.index[place] for place in part.failures | counting if place in self.index}

    def start(self) -> PartState:
        """Return the state that the part begins in."""
        adopted = {step.call for step in self.part.steps if isinstance(step.guard, Adopted)}
        requests = tuple(Life.ADOPTABLE if call in adopted else Life.NONE for call in self.calls)
        tokens = tuple(self.part.initial.get(place, 0) for place in self.part.places)
        return PartState(tokens, requests=requests, accounts=(Account.OPEN,) * len(self.calls))

    def marked(self, state: PartState) -> list[int]:
        """Return the marked places at which rules are asked: all but records."""
        return [place for place, tokens in enumerate(state.tokens) if tokens and place not in self.records]

    def moods(self, state: PartState) -> Moods:
        """Return whether the part is failing, ending, and to cancel what is under way."""
        failing = state.stop > 1 or any(state.tokens[place] for place in self._failures)
        ending = failing or state.stop > 0 or any(state.tokens[place] for place in self._restarts)
        return Moods(failing, ending, state.stop == 3 or (ending and self.part.cancels))

    # --- what can happen ------------------------------------------------------------------------

    def possible(self, state: PartState) -> list[int]:
        """Return the enabled steps whose guards may be open, as `pnm.core.execution.run` asks them: in order, at each marked place.

        Reports are not asked for at a place: they come when they like as long as their request is alive.
        """
        moods, possible, marked = self.moods(state), dict[int, None](), self.marked(state)
        for place in marked:
            possible.update(dict.fromkeys(self.exits(place, state, moods)[0]))
        if Life.ALIVE in state.requests:
            reports = (number for place in marked for number in self.reports[place] if number not in possible)
            possible.update(dict.fromkeys([number for number in reports if self._may_come(self.part.steps[number], state)]))
        return [*possible]

    def exits(self, place: int, state: PartState, moods: Moods) -> tuple[list[int], bool]:
        """Return which steps may be open at a place, and whether those after them wait for resources."""
        exits: list[int] = []
        for number in self.consumers[place]:
            step = self.part.steps[number]
            if not self.is_enabled(number, state):
                # As in the run: the call stands in line here, and the rules after this one are not asked.
                if self.resources and self.lacks_resources(number, state) and not isinstance(step.guard, Adopted):
                    return exits, True
                continue
            opens = step.guard.open_in(moods)
            if opens is None and step.guard.opened_by in _OF_REQUESTS:
                if not self._may_come(step, state):
                    continue
                opens = True if isinstance(step.guard, Adopted) else None
            if opens is not False:  # guards that ask the world may go either way, so both are followed
                exits.append(number)
            if opens and not step.counted:  # rules after one that is surely open are never asked
                break
        return exits, False

    def is_enabled(self, number: int, state: PartState) -> bool:
        """Return whether there are all tokens that the step takes."""
        tokens = state.tokens
        for place, weight in self._needs[number]:  # noqa: SIM110 (this is asked most often of all, and `all` takes twice the time)
            if tokens[place] < weight:
                return False
        return True

    def lacks_resources(self, number: int, state: PartState) -> bool:
        """Return whether the step would be enabled if all resources were free."""
        lacking = {place for place, weight in self._needs[number] if state.tokens[place] < weight}
        return bool(lacking) and lacking <= self.resources.keys()

    def _may_come(self, step: PartStep, state: PartState) -> bool:
        """Return whether a report, or an adoption, may come in this state: as far as the request of the call is concerned."""
        if step.call is None:
            return True
        life = state.requests[self.calls[step.call]]
        return may_come(step, life, accepts=any(state.tokens[place] for place in self._unaccepted.get(step.call, ())))

    def reports_now(self, call: int | None, state: PartState) -> list[PartStep]:
        """Return the steps that take reports about the request of the call."""
        steps = self.part.steps
        return [steps[number] for place in self.marked(state) for number in self.reports[place] if steps[number].call == call]

    def is_stuck(self, state: PartState, possible: Sequence[int]) -> bool:
        """Return whether, in some case of the counters, none of the possible steps is: nothing happens without something from outside."""
        steps = [self.part.steps[number] for number in possible]
        if any(not step.counted for step in steps):
            return False
        moods = self.moods(state)
        for place in {self.index[name] for step in steps for name in step.inputs} - self.records:
            enabled = [self.part.steps[number] for number in self.consumers[place] if self.is_enabled(number, state)]
            if any(all(any(step.guard.open_in(moods) for step in case) for case in cases) for cases in in_each_case(enabled)):
                return False
        return True

    def starves(self, state: PartState) -> bool:
        """Return whether resources are waited for, and nothing else is sure to happen."""
        moods, waits = self.moods(state), False
        for place in self.marked(state):
            exits, waiting = self.exits(place, state, moods)
            sure = [step for step in map(self.part.steps.__getitem__, exits) if not step.counted]
            if (not waiting and exits) or any(step.guard.opened_by is Opener.TIME or step.guard.open_in(moods) for step in sure):
                return False
            waits = waits or waiting
        return waits

    # --- what it leads to -----------------------------------------------------------------------

    def successors(self, state: PartState, possible: Sequence[int], is_at_rest: bool) -> Iterator[tuple[str, PartState]]:
        """Yield everything that can happen next, given the steps that can."""
        ending = self.moods(state).ending
        for number in possible:
            self.fired.add(number)
            yield self.part.steps[number].name, self._after(number, state, ending=ending)
        if state.supplied < len(self.part.supplies):
            tokens = [*state.tokens]
            for name in self.part.supplies[state.supplied]:
                tokens[self.index[name]] += 1
            yield SUPPLY, state._replace(tokens=tuple(tokens), supplied=state.supplied + 1)
        # Entered again only once it has come to rest, and with its counters as they are: that they are full again is to be shown.
        elif self.part.repeats and is_at_rest:
            first = self.part.initial
            tokens = [state.tokens[number] if number in self._lasting else first.get(place, 0) for place, number in self.index.items()]
            stop, calls = 0 if state.stop == 1 else state.stop, len(self.calls)
            yield AGAIN, PartState(tuple(tokens), stop, requests=(Life.NONE,) * calls, accounts=(Account.OPEN,) * calls)
        if any(state.tokens[place] for place in self._finals):
            return  # it is over: nobody stops it any more
        for stop in self._stops:
            if stop > state.stop:  # a stop may come at any moment, between any two firings
                yield STOPS[stop], state._replace(stop=stop)

    def _after(self, number: int, state: PartState, *, ending: bool) -> PartState:
        step, requests, accounts = self.part.steps[number], state.requests, state.accounts
        position = self.calls[step.call]
        life, account = requests[position], accounts[position]
        wrong = lacking_account(step, account, fails=number in self._failing)
        if wrong or (step.call is not None and (wrong := misuse(step, life, ending=ending))):
            raise Unsound(wrong)
        if (now := following(step, life)) is not life:
            requests = (*requests[:position], now, *requests[position + 1 :])
        if (then := accounted(step, account)) is not account:
            accounts = (*accounts[:position], then, *accounts[position + 1 :])
        tokens = [*state.tokens]
        for place, weight in self._needs[number]:
            tokens[place] -= weight
        for place, weight in self._gives[number]:
            tokens[place] += weight
        restores = step.counted.restores if step.counted else None
        if state.restored and restores is False:
            raise Unsound(f"{step.name} counts on after something was counted back, which may go on for ever")
        return PartState(tuple(tokens), state.stop, state.supplied, requests, accounts, state.restored or bool(restores))


# --- the life of a call -----------------------------------------------------------------------


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
