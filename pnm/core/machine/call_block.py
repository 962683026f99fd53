"""The block of a call: checks, request, outcomes, checks, recovery.

    ready → (start) → requested → (accepted) → running → … → finished → done

A call whose start others wait for *announces* it once: when the first request is accepted, or with whatever
replaces that (skip, already true, failure). Therefore such a call has its places up to acceptance twice: for the
attempts before its start was announced and for those after.

An end that must wait for other events (`awaited`) is reached by the robot when it likes. What nothing reports of it is
believed then, so that a match that went out too early is out for all who need its light; its checks and its `fork`
wait. Which of several outcomes it was is only known with its checks. A retry moves a token from *budget* to *spent*;
giving up takes all of *spent*, by an arc whose weight is the whole budget. A recovery that the plan gives for a cause
replaces retrying.

A call that is under way already, sent by another run, is taken over as it is: its first attempt begins at `running`.
A run that is paused at once has its calls cancelled: they begin anew later, and none of their budget is spent.

The call has its resources as long as a request may be alive and until its effects have been looked for, unless that
must wait for other events: whatever leads from outside into those places takes all of them at once, and whatever
leads out of them gives all back. That is so in the net; outside of it a request that was given up keeps them until its
server reports the end (`pnm.core.resources`). So wherever they are waited for there is a way out, `withheld`, after as
long as a server may take to answer.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite
from typing import NamedTuple, assert_never

from pnm.core.logic.computed_values import may_ask
from pnm.core.logic.conditions import TRUE, Condition, conjunction, conjuncts, data_in, names
from pnm.core.logic.effects import When, every_effect, names_written
from pnm.core.machine import guards
from pnm.core.machine.bindings import Binding, WhenLost
from pnm.core.machine.failure_causes import ASKED, Cause, NoRecovery, Phase
from pnm.core.machine.guards import Guard, Rule, check_rule
from pnm.core.machine.plan_graph import EMPTY, ActionCall, PlanGraphError, Recovery, Then
from pnm.core.machine.requests import CallOutcome, OutcomeKind, TransitionAction
from pnm.core.machine.step_block import OWN, Block, OwnRule, Port, Terms

_SUCCEEDED = frozenset({OutcomeKind.SUCCEEDED})
_UNSUCCESSFUL = frozenset(OutcomeKind) - _SUCCEEDED
_EARLY = {OutcomeKind.REJECTED: Cause.REJECTED, OutcomeKind.UNAVAILABLE: Cause.UNAVAILABLE, OutcomeKind.LOST: Cause.LOST}
"""Ends of a request that may come before its acceptance."""
_NOT_EARLY = frozenset(OutcomeKind) - frozenset(_EARLY)
_LATE = {OutcomeKind.ABORTED: Cause.ABORTED, OutcomeKind.CANCELED: Cause.CANCELED, OutcomeKind.LOST: Cause.LOST}
_FOR_GOOD = frozenset({OutcomeKind.ABORTED_FOR_GOOD})
_ODD = _UNSUCCESSFUL - frozenset(_LATE) - _FOR_GOOD
_SEND, _CANCEL, _UNDO = TransitionAction.SEND, TransitionAction.CANCEL, TransitionAction.UNDO
_RESTARTED = "restarted "
"""Prefix of the places and transitions of attempts after the start was announced."""
_ANSWER = "an answer to the goal in time"
_ALIVE = ("requested", "withdrawing", f"{_RESTARTED}requested", f"{_RESTARTED}withdrawing", "running", "overdue", "stopping", "suspending")
"""Places of a call whose request may be alive."""


class CallTerms(Terms[ActionCall]):
    """Terms of a call: all that its action, its binding and its plan ask for, said once. The proof looks for it in the net."""

    @cached_property
    def may_start(self) -> Condition:
        """Condition that is checked before the start: the precondition, and the part of the over-all condition that it does not change."""
        # The over-all condition is checked as well: the call would otherwise be cancelled as soon as it has begun.
        action, rules = self.step.action, self.context.plan.rules
        if action.invariant == TRUE:
            return conjunction((action.precondition,))
        parts, changed = conjuncts(action.invariant), names_written(action.start_effects)
        kept = [part for part in parts if not rules.base(names(part)) & changed] if changed else parts
        return conjunction((action.precondition, *kept))

    @property
    def release(self) -> float:
        """Seconds after the plan's start before which the call must not start."""
        return self.step.earliest

    @property
    def timeout(self) -> float:
        """Seconds that its request may take."""
        return self.context.bindings.timeout(self.step.action) if self.step.timeout is None else self.step.timeout

    @property
    def latest(self) -> float:
        """Seconds after the plan's start by which it must have been sent."""
        return min(self.step.latest_start, self.step.deadline)

    @cached_property
    def binding(self) -> Binding:
        """Limits of the action."""
        return self.context.bindings.of(self.step.action.name)

    @property
    def retries(self) -> int:
        """Retries of the call, from the plan or else from its binding."""
        return self.binding.retries if self.step.retries is None else self.step.retries

    @property
    def is_timed(self) -> bool:
        """Whether its start waits for a time."""
        return bool(self.step.earliest or self.delays)

    def must_happen(self, *, relied_on: bool) -> bool:
        """Return whether the call is made even if all that it would change is so already.

        What comes while it runs relies on its start (`relied_on`); time may still undo what seems to be done; and when it is
        repeated, effects of its own last round prove nothing.
        """
        return relied_on or bool(self.step.release) or (self.context.repeated and self.step.action.expected != TRUE)

    @property
    def may_turn_out(self) -> bool:
        """Whether its action has several outcomes."""
        return bool(self.step.action.outcomes)

    @property
    def asks_at_its_end(self) -> bool:
        """Whether a check after success, or an effect, may have to ask what the run does not know."""
        action, recoveries = self.step.action, self.step.recoveries
        asked = [recovery.when for recovery in recoveries if Cause.AFTER in recovery.causes]
        if asked and any(argument.startswith("?") for argument in action.arguments):
            return True
        asked += [effect.condition for effect in every_effect(action.possible_effects) if isinstance(effect, When)]
        asked += [part for part in (action.end_condition, action.expected) if part is not TRUE]
        return any(may_ask(data) for part in asked for data in data_in(part))


class RecoveryKey(NamedTuple):
    """All traits of a recovery that the template of its call depends on."""

    causes: frozenset[Cause]
    then: Then
    times: int
    when: Condition
    is_direct: bool


class CallKey(NamedTuple):
    """All traits that the template of a call depends on; the proof looks for each of them in the net."""

    connected: frozenset[Port]
    repeated: bool
    starts_anew: bool
    is_timed: bool
    has_latest_start: bool
    has_deadline: bool
    under_way: bool
    must_happen: bool
    has_invariant: bool
    asks_at_its_end: bool
    may_turn_out: bool
    retries: int
    accept: float
    cancel: float
    when_lost: WhenLost
    recoveries: tuple[RecoveryKey, ...]


@dataclass
class CallBlock(Block[ActionCall]):
    """The places and transitions of one call."""

    recoveries: Recoveries = field(default_factory=lambda: Recoveries())

    def build(self) -> None:
        """Add the block to the machine."""
        announced = self.at(Port.ANNOUNCES)
        ending = ("returned", "ended", "finished") if self.awaited else ("finished",)
        for name in ("running", "overdue", "stopping", "settling", "suspending", *ending, "done", "failed"):
            self.place(name)
        # A second set of places, because the token that announces the start must be given once only, however often the call is retried.
        for phase in ("", _RESTARTED) if announced else ("",):
            for name in ("ready", "requested", "recover", "withdrawing"):
                self.place(phase + name)
        self.draft.failures.append("failed")
        if self.terms.retries:
            self.budget("budget", "spent", self.terms.retries)
        self.recoveries = build_recoveries(self)  # before the attempts, whose transitions lead to the places of recoveries
        self._attempt("", announced)
        if announced:
            self._attempt(_RESTARTED, [])
        self.enter("ready")
        self._run(_RESTARTED if announced else "")
        self._finish(_RESTARTED if announced else "")
        self.leave()

    @property
    def key(self) -> object:
        """The key of the block's shape."""
        step, terms, binding = self.step, self.terms, self.terms.binding
        return CallKey(
            self.connected,
            self.context.repeated,
            self.context.starts_anew,
            terms.is_timed,
            isfinite(step.latest_start),
            isfinite(step.deadline),
            step.under_way,
            self._must_happen,
            step.action.invariant != TRUE,
            terms.asks_at_its_end,
            terms.may_turn_out,
            terms.retries,
            binding.accept,
            binding.cancel,
            binding.when_lost,
            tuple([RecoveryKey(one.causes, one.then, one.times, one.when, is_direct(one)) for one in step.recoveries]),
        )

    def add(self, rule: Rule | OwnRule, inputs: dict[str, int] | Iterable[str], outputs: Iterable[str], *, title: str = "") -> None:
        """Add a transition between any places; one that leads to where a request may be alive takes the resources."""
        if resources := self.at(Port.RESOURCES):
            like = rule.rule if isinstance(rule, OwnRule) else rule
            taken, marked = inputs if isinstance(inputs, dict) else dict.fromkeys(inputs, 1), [*outputs]
            # Resources are taken and given where the boundary of the alive places is crossed, so that no transition can forget it.
            was_alive, is_alive = (not self._alive.isdisjoint(places) for places in (taken, marked))
            # What is adopted brings its resources along: it does not wait for them.
            if is_alive and not was_alive and not isinstance(like.guard, guards.Adopted):
                name = title or like.name
                out = ["done", *(self.at(Port.ANNOUNCES) if name == "start" else []), "failed"]
                # Before the start as if the server were not there. But a recovery that goes on as if it had succeeded needs a request.
                is_unserved = name.endswith("start") and Cause.UNAVAILABLE not in self.recoveries.kept
                marked_then = self._after(Cause.UNAVAILABLE, out) if is_unserved else out
                withheld = check_rule(Cause.WITHHELD, guards.Withheld(OWN, self.terms.binding.accept, like.action))
                # Added before the transition itself: a wait for resources must have a way out that does not need them.
                super().add(withheld, taken, marked_then, title=f"{withheld.name} before {name}")
            inputs = {**taken, **dict.fromkeys(resources, 1)} if is_alive and not was_alive else taken
            outputs = [*marked, *resources] if was_alive and not is_alive else marked
        super().add(rule, inputs, outputs, title=title)

    def place(self, name: str) -> str:
        """Make a place of this block."""
        if name in self._alive:
            self.draft.alive.append(name)
        if name in ("returned", "ended", "finished", "settling"):
            self.draft.settling.append(name)
        return super().place(name)

    @cached_property
    def _alive(self) -> frozenset[str]:
        """Places of a call that is under way; what waits for others or for answers before its effects are looked for is not."""
        # The robot is at rest then, and its resources are free for others: nothing is asked while resources are held.
        settling = () if self.terms.asks_at_its_end else ("settling",) if self.awaited else ("settling", "finished")
        return frozenset((*_ALIVE, *settling))

    @cached_property
    def terms(self) -> CallTerms:
        """Terms of the call."""
        return CallTerms(self.context, self.step, self.delays)

    @property
    def _must_happen(self) -> bool:
        """Whether the call is made even if all that it would change is so already."""
        return self.terms.must_happen(relied_on=bool(self.awaited or self.at(Port.ANNOUNCES)))

    def _attempt(self, phase: str, announced: list[str]) -> None:
        """From `ready` to acceptance, and from `recover` back or out."""
        ready, requested, recover, withdrawing = (phase + name for name in ("ready", "requested", "recover", "withdrawing"))
        out = ["done", *announced]
        failed = [*out, "failed"]

        def add(rule: Rule | OwnRule, source: str, outputs: Iterable[str]) -> None:
            self.add(rule, [source], outputs, title=phase + rule.name)

        # First of all rules, and in the first attempt only: after a retry there is no request to adopt any more.
        if self.step.under_way and announced == self.at(Port.ANNOUNCES):
            add(Rule("adopt", guards.Adopted(OWN), action=TransitionAction.ADOPT), ready, ["running", *announced])
        # Before every check: a run that is ending asks no questions and sends nothing.
        add(Rule("skip", guards.Ending(), outcome=CallOutcome.SKIPPED), ready, out)
        if not self._must_happen:  # before the checks of conditions and data, none of which matter for a call that is not needed
            add(Rule("already_true", guards.AlreadyTrue(OWN), outcome=CallOutcome.ALREADY_TRUE), ready, out)
        self._own_checks(Cause.BEFORE, "ready")
        # Before the precondition, which cannot be evaluated for parameters without a value.
        add(check_rule(Cause.DATA_MISSING, guards.DataMissing(OWN)), ready, self._after(Cause.DATA_MISSING, failed))
        if isfinite(self.terms.latest):  # before `start`, which would begin something that cannot end in time
            add(OwnRule(check_rule(Cause.TOO_LATE), lambda own: guards.Due(own.latest)), ready, failed)
        # The complement follows right after it: one of the two opens for every state of the world.
        start = Rule("start", action=_SEND, outcome=CallOutcome.RUNNING)
        add(OwnRule(start, lambda own: guards.ConditionTrue(own.may_start)), ready, [requested])
        refused = self._after(Cause.PRECONDITION_FALSE, failed)
        add(OwnRule(check_rule(Cause.PRECONDITION_FALSE), lambda own: guards.ConditionFalse(own.may_start)), ready, refused)

        add(Rule("accepted", guards.Accepts(OWN), action=TransitionAction.BEGIN), requested, ["running", *announced])
        # Nothing is undone after these: assumed start effects are only written once the goal is accepted. A server that is not there has
        # been waited for: another attempt would end in the same way.
        for kind, cause in _EARLY.items():
            name = f"{kind.value}{'_early' if kind is OutcomeKind.LOST else ''}"
            otherwise = failed if cause is Cause.UNAVAILABLE else [recover]
            add(Rule(name, guards.Ends(OWN, frozenset({kind})), cause=cause), requested, self._after(cause, otherwise))
        unavailable = self._after(Cause.UNAVAILABLE, [recover])
        # A report that skips the acceptance is put right by the run; this exit makes the block complete without relying on that.
        add(Rule("ended_early", guards.Ends(OWN, _NOT_EARLY), cause=Cause.UNAVAILABLE), requested, unavailable)
        too_long, in_vain = guards.After(self.terms.binding.accept), guards.After(self.terms.binding.cancel)
        unanswered = Rule("unanswered", too_long, action=_CANCEL, cause=Cause.UNAVAILABLE, expected=_ANSWER, observed="none")
        # The goal may have arrived all the same, so it is cancelled and its end awaited before another attempt.
        add(unanswered, requested, [withdrawing])
        # A success is one although it was not wanted any more; after any other end the robot is free for another attempt.
        came_late = Rule("came_late", guards.Ends(OWN, _SUCCEEDED), action=TransitionAction.BEGIN)
        add(came_late, withdrawing, [succeeded_place(self), *announced])
        add(Rule("withdrawn", guards.Ends(OWN, _UNSUCCESSFUL)), withdrawing, unavailable)
        unheard = Rule("unheard", in_vain, cause=Cause.UNAVAILABLE, expected=_ANSWER, observed="none", gives_up=True)
        add(unheard, withdrawing, failed)  # no retry here: the robot may still carry out the first request

        abandon(self, "recover", *announced, phase=phase)  # asked before `retry`: an ending run does not try again
        budget, spent, retries = "budget", "spent", self.terms.retries
        if retries:  # by their counters just one of `retry` and `give_up` is enabled at any time
            again = Rule("retry", outcome=CallOutcome.SUSPENDED)
            self.add(again, [recover, budget], [ready, spent], title=f"{phase}retry")
        self.add(Rule("give_up"), {recover: 1, spent: retries} if retries else {recover: 1}, failed, title=f"{phase}give_up")

    def _run(self, phase: str) -> None:
        """From acceptance to one exit per outcome."""
        returned, recover = succeeded_place(self), [phase + "recover"]
        self.fire(Rule("succeeded", guards.Ends(OWN, _SUCCEEDED)), "running", returned)
        for_good = ["done", "failed"]
        for kind, cause in _LATE.items():
            is_final = cause is Cause.LOST and self.terms.binding.when_lost is WhenLost.ABORT
            self._outcome(kind.value, guards.Ends(OWN, frozenset({kind})), "running", cause, for_good if is_final else recover)
        # No server sends these after an acceptance, but the place needs an exit for every kind of end.
        self._outcome("ended_oddly", guards.Ends(OWN, _ODD), "running", Cause.ABORTED, recover)
        # Past `recover`: whatever is left of the budget, another attempt would end in the same way.
        self._outcome("aborted_for_good", guards.Ends(OWN, _FOR_GOOD), "running", Cause.ABORTED, for_good)
        # Before `suspend`: a call that is stopped does not begin anew after the pause.
        self.fire(Rule("stop", guards.CancelAsked(), action=_CANCEL), "running", "stopping")
        self.fire(Rule("suspend", guards.PauseAsked(), action=_CANCEL), "running", "suspending")
        if self.step.action.invariant != TRUE:
            # The failure is marked at once, with the cancellation still to be confirmed: it is the cause, whatever the server answers.
            self.fire(
                OwnRule(check_rule(Cause.INVARIANT_FALSE, action=_CANCEL), lambda own: guards.InvariantFalse(own.step.action.invariant)),
                *("running", "stopping", "failed"),
            )
        if isfinite(self.step.deadline):
            missed = OwnRule(check_rule(Cause.DEADLINE_MISSED, action=_CANCEL), lambda own: guards.Due(own.step.deadline))
            self.fire(missed, "running", "stopping", "failed")
        self.fire(OwnRule(Rule("timed_out", action=_CANCEL), lambda own: guards.After(own.timeout)), "running", "overdue")

        in_vain, confirmation = guards.After(self.terms.binding.cancel), f"a confirmed cancellation within {self.terms.binding.cancel:g} s"
        # A success after the limit is a success: cancelling is a race with the server that it may win.
        self.fire(Rule("late_success", guards.Ends(OWN, _SUCCEEDED)), "overdue", returned)
        late, taken_back = guards.Ends(OWN, _UNSUCCESSFUL), self._undone(Cause.TIMED_OUT)
        expired = Rule("expired", late, action=taken_back, cause=Cause.TIMED_OUT, observed="none; then {message}")
        in_time = OwnRule(expired, expected=lambda own: f"an end within {own.timeout:g} s")
        self.add(in_time, ["overdue"], self._after(Cause.TIMED_OUT, recover))
        # Never retried: two requests for the same robot could be at work at the same time.
        unconfirmed = Rule("unconfirmed", in_vain, action=_UNDO, cause=Cause.TIMED_OUT, observed="neither", gives_up=True)
        at_all = OwnRule(unconfirmed, expected=lambda own: f"an end within {own.timeout:g} s, or {confirmation} after that")
        self.fire(at_all, "overdue", "done", "failed")

        # The request is being cancelled already: only what follows changes, so nothing is sent.
        self.fire(Rule("stop_suspending", guards.CancelAsked()), "suspending", "stopping")
        self.fire(Rule("ended_before", guards.Ends(OWN, _SUCCEEDED)), "suspending", returned)
        # Back to `ready` directly, past `recover`: a pause is no failure and takes nothing from the budget.
        suspended = Rule("suspended", guards.Ends(OWN, _UNSUCCESSFUL), None, _UNDO, CallOutcome.SUSPENDED)
        self.fire(suspended, "suspending", phase + "ready")
        for_a_pause = f"{confirmation}, for a pause"
        unconfirmed = Rule("unconfirmed_pause", in_vain, None, _UNDO, None, Cause.TIMED_OUT, for_a_pause, "none", gives_up=True)
        self.fire(unconfirmed, "suspending", "done", "failed")

        # The effects may have come about although the call was to stop: they are looked for, as after any other success.
        self.fire(Rule("completed", guards.Ends(OWN, _SUCCEEDED)), "stopping", "settling")
        self.fire(Rule("completely", guards.EffectsSeen(OWN), None, TransitionAction.FINISH, CallOutcome.SUCCEEDED), "settling", "done")
        incomplete = Rule("incompletely", guards.EffectsMissing(OWN), None, _UNDO, CallOutcome.CANCELED, Cause.EFFECTS_MISSING)
        self.fire(incomplete, "settling", "done")
        stopped = Rule("stopped", guards.Ends(OWN, _UNSUCCESSFUL), None, _UNDO, CallOutcome.CANCELED)
        self.fire(stopped, "stopping", "done")
        unconfirmed_stop = Rule("unconfirmed_stop", in_vain, None, _UNDO, CallOutcome.UNCONFIRMED, gives_up=True)
        self.fire(unconfirmed_stop, "stopping", "done")

    def _finish(self, phase: str) -> None:
        """From success to done, once the effects are seen."""
        believed = self.awaited and not self.terms.may_turn_out
        if self.awaited:
            self.fire(Rule("end", action=TransitionAction.FINISH if believed else None), "returned", "ended")
            # The places are given back at once: here they are only looked at, and `fork` takes them in the end.
            self.add(Rule("await"), ["ended", *self.awaited], ["finished", *self.awaited])
        # Before the check of the effects: the plan may want to react to a success that only looks like one.
        self._own_checks(Cause.AFTER, "finished")
        finish = None if believed else TransitionAction.FINISH
        effects_hold = Rule("effects_hold", guards.EffectsSeen(OWN), action=finish, outcome=CallOutcome.SUCCEEDED)
        self.fire(effects_hold, "finished", "done")
        recover = [phase + "recover"]
        self._outcome(Cause.EFFECTS_MISSING.value, guards.EffectsMissing(OWN), "finished", Cause.EFFECTS_MISSING, recover)

    # --- ends without success ---------------------------------------------------------------------

    def _after(self, cause: Cause, otherwise: list[str]) -> list[str]:
        """Return the places that are marked for this cause: the plan's own recovery, or else these."""
        return self.recoveries.places.get(cause, otherwise)

    def _outcome(self, name: str, guard: Guard, source: str, cause: Cause, otherwise: list[str]) -> None:
        """Add an end without success; assumed start effects are taken back unless the plan goes on as if it were one."""
        self.add(Rule(name, guard, action=self._undone(cause), cause=cause), [source], self._after(cause, otherwise))

    def _undone(self, cause: Cause) -> TransitionAction | None:
        return None if cause in self.recoveries.kept else _UNDO

    def _own_checks(self, wanted: Cause, source: str) -> None:
        """Add the checks that the plan has besides, in its order."""
        for cause, title, condition, places in self.recoveries.checks:
            if cause is wanted:
                self.add(check_rule(cause, guards.ConditionTrue(condition)), [source], places, title=title)


# --- recoveries -------------------------------------------------------------------------------
#
# Those that the plan itself gives: chains of steps, and how to go on after them.
#
#     recovering → (recover) → chain → recovered → ready, where a success leads, done, or done and failed
#
# Every use takes a token from *uses left* and gives one to *uses spent*; when all are spent the next recovery for the same cause is
# used, and after the last the call gives up.


@dataclass(frozen=True, slots=True)
class Recoveries:
    """The ways of the tokens of a call after a problem."""

    places: Mapping[Cause, list[str]] = field(default_factory=dict)
    """Places marked instead of the usual ones, by cause."""
    kept: frozenset[Cause] = frozenset()
    """Causes after which the call goes on as if it had succeeded: what was done at the start stays."""
    checks: tuple[tuple[Cause, str, Condition, list[str]], ...] = ()
    """Checks of the plan's own, before or after: their names, conditions, and what is marked when they hold."""


def build_recoveries(block: Block[ActionCall]) -> Recoveries:
    """Add the plan's own recoveries to the block of a call; those for one cause are used in their order."""
    lists: dict[Cause, list[int]] = {}
    for number, recovery in enumerate(block.step.recoveries):
        if not is_direct(recovery):
            _chained(block, recovery, number)
        for cause in recovery.causes:
            if isinstance(cause.phase, NoRecovery):
                raise PlanGraphError(f"recovery {number} of {block.step} for {cause.value} can never happen: {cause.phase.value}")
            # CONTINUE leads to `finished`, where the effects of a request are looked for: it needs a request, and comes before that check.
            if recovery.then is Then.CONTINUE and cause.phase in (Phase.BEFORE, Phase.AFTER):
                raise PlanGraphError(
                    f"{block.step} cannot continue after {cause.value}: nothing has succeeded that effects could be seen of"
                )
            before = block.step.recoveries[lists[cause][-1]] if cause in lists else recovery
            # The first for any other cause is used without asking for its condition.
            is_unasked = before.when == TRUE or (cause not in ASKED and len(lists.get(cause, ())) == 1)
            if before is not recovery and is_unasked and before.then.is_last(chain=before.chain != EMPTY):
                raise PlanGraphError(f"recovery {number} of {block.step} for {cause.value} can never happen: the one before it always can")
            lists.setdefault(cause, []).append(number)
    built: dict[tuple[int, ...], list[str]] = {}
    places: dict[Cause, list[str]] = {cause: _in_turn(block, (*numbers,), built) for cause, numbers in lists.items() if cause not in ASKED}
    kept = frozenset(cause for cause in places if any(block.step.recoveries[one].then is Then.CONTINUE for one in lists[cause]))
    checks = [
        (cause, f"{cause.value} {number}", block.step.recoveries[number].when, _in_turn(block, (*numbers[position:],), built))
        for cause, numbers in lists.items()
        if cause in ASKED
        for position, number in enumerate(numbers)
    ]
    return Recoveries(places, kept, tuple(checks))


def is_direct(recovery: Recovery) -> bool:
    """Return whether there is nothing to do first and nothing to repeat, and so nothing to count: the token goes on directly."""
    return recovery.chain == EMPTY and recovery.then in (Then.CONTINUE, Then.SKIP, Then.FAIL)


def _in_turn(block: Block[ActionCall], numbers: tuple[int, ...], built: dict[tuple[int, ...], list[str]]) -> list[str]:
    """Return the places that are marked to have the first of these recoveries used that has uses left.

    The rules are asked in order, so that each is only used when those before it are used up; and only if its own condition holds,
    but for the first, whose condition has been asked before.
    """
    first, recoveries = numbers[0], block.step.recoveries
    if is_direct(recoveries[first]):
        return _marked_after(block, recoveries[first].then, first)
    if numbers in built:
        return built[numbers]
    names = ", ".join(map(str, numbers))
    recovering = block.place(f"recovering {names}")
    # What was done at the start stays if one of them goes on as if the call had succeeded, so the others take it back here.
    is_mixed = len({recoveries[number].then is Then.CONTINUE for number in numbers}) > 1
    undo = TransitionAction.UNDO if is_mixed else None
    abandon(block, f"recovering {names}", action=undo)  # before `recover`, for rules are asked in order: a run that is ending begins none
    for number in numbers:
        recovery = recoveries[number]
        guard = guards.Always() if number == first or recovery.when == TRUE else guards.ConditionTrue(recovery.when)
        rule = Rule("recover", guard, action=None if recovery.then is Then.CONTINUE else undo)
        title = f"recover {number}" if len(numbers) == 1 else f"recover {number} of {names}"
        if is_direct(recovery):
            block.add(rule, [recovering], _marked_after(block, recovery.then, number), title=title)
        else:
            entered = [*block.chains[number].first, f"uses spent {number}"]
            block.add(rule, [recovering, f"uses left {number}"], entered, title=title)
    last = recoveries[numbers[-1]]
    if not (is_direct(last) and last.when == TRUE):
        # It takes all tokens of `uses spent`, so it is enabled only when none is left: no inhibitor arc is needed.
        spent = {recovering: 1, f"uses spent {first}": recoveries[first].times}
        block.add(Rule("give_up", action=undo), spent, ["done", "failed"], title=f"give_up {names}")
    built[numbers] = [recovering]
    return built[numbers]


def _chained(block: Block[ActionCall], recovery: Recovery, number: int) -> None:
    """Add the chain of a recovery, the counters of its uses, and how the call goes on after it."""
    recovered = block.place(f"recovered {number}")
    # Uses of a restart are not given back when the plan begins anew, or it could do so for ever.
    restarts = recovery.then is Then.RESTART_PLAN
    block.budget(f"uses left {number}", f"uses spent {number}", recovery.times, refilled=not restarts)
    chain = block.draft.region(number, f"recovery {number}")
    block.chains[number] = chain
    block.add(Rule("chain_done"), chain.last, [recovered], title=f"chain_done {number}")
    abandon(block, f"recovered {number}")  # the run may have begun to end while the chain was carried out
    goal, replans = _marked_after(block, recovery.then, number), recovery.then is Then.REPLAN
    block.add(Rule(recovery.then.value, replans=replans), [recovered], goal, title=f"{recovery.then.value} {number}")


def _marked_after(block: Block[ActionCall], then: Then, number: int) -> list[str]:
    """Return the places that are marked at the end of a recovery."""
    match then:
        # Back to `ready` and not to `start`: the checks before a call are made again, for the chain may have changed the world.
        case Then.RETRY:
            return ["ready"]
        case Then.CONTINUE:
            return [succeeded_place(block)]
        case Then.SKIP:
            return ["done"]
        # After a failure the call is done as well: its successors get their tokens and skip, so that no token is left behind.
        case Then.FAIL | Then.REPLAN:
            return ["done", "failed"]
        case Then.RESTART_PLAN:
            asked = block.place(f"restart {number}")
            block.draft.restarts.append(asked)
            return ["done", asked]
        case _:
            assert_never(then)


def succeeded_place(block: Block[ActionCall]) -> str:
    """Return the place that is marked when the request has succeeded."""
    return "returned" if block.awaited else "finished"


def abandon(block: Block[ActionCall], place: str, *announced: str, phase: str = "", action: TransitionAction | None = None) -> None:
    """Let the call fail when the run does; when the plan begins anew, it has not failed."""
    starts_anew = block.context.starts_anew
    source, event = phase + place, place.rstrip(" ,0123456789")
    # Ending includes restarts, which are no failures; where no restart is possible both mean the same.
    guard = guards.Failing() if starts_anew else guards.Ending()
    name, title = ("abandon", "abandon") if event == "recover" else (f"abandon {event}", f"abandon {place}")
    block.add(Rule(name, guard, action=action), [source], ["done", *announced, "failed"], title=f"{phase}{title}")
    if starts_anew:  # asked after the rule above: what is left then is a restart of the plan, which takes the token out without a failure
        block.add(Rule(f"drop {event}", guards.Ending(), action=action), [source], ["done", *announced], title=f"{phase}drop {place}")
