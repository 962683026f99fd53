"""PlanGraph → PetriNetMachine: one block of places and transitions per call.

    orderings → (join) → ready → (start) → requested → (accepted) → running → … → finished → done → (fork) → orderings

Every block ends with exactly one token on `done`, whatever its servers and the world answer.
When the call has failed there is one token on `failed` besides, which stays. A call whose start
others wait for *announces* it once: when the first request is accepted, or with whatever
replaces that (skip, already true, failure). Therefore such a call has its places up to
acceptance twice: for the attempts before its start was announced and for those after.

An end that must wait for other events (`awaited`) is reached by the robot when it likes; its
checks and its `fork` wait. A retry moves a token from *budget* to *spent*; giving up takes all
of *spent*, by an arc whose weight is the whole budget.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from math import isfinite

from pnm.actions.base import OutcomeKind
from pnm.bindings import Binding, Bindings
from pnm.conditions import TRUE, All, Condition, conjuncts, names
from pnm.effects import names_written
from pnm.machine import (
    Accepts,
    After,
    AlreadyTrue,
    Always,
    CancelAsked,
    DataMissing,
    Deed,
    Denied,
    Due,
    EffectsMissing,
    EffectsSeen,
    Ending,
    Ends,
    Guard,
    Holding,
    OnFailure,
    PetriNetMachine,
    Rule,
)
from pnm.marking import Marking
from pnm.net import NetBuilder
from pnm.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.rules import Rules

_SUCCEEDED = frozenset({OutcomeKind.SUCCEEDED})
_UNSUCCESSFUL = frozenset(OutcomeKind) - _SUCCEEDED


def generate(plan: PlanGraph, bindings: Bindings | None = None, *, on_failure: OnFailure = OnFailure.DRAIN) -> PetriNetMachine:
    """Build the machine of a plan; retries and limits of each call come from the bindings."""
    return _Generator(plan, bindings or Bindings(), on_failure).machine()


@dataclass
class _Generator:
    """Collects the net and its roles block by block."""

    plan: PlanGraph
    bindings: Bindings
    on_failure: OnFailure
    net: NetBuilder = field(default_factory=NetBuilder)
    rules: dict[str, Rule] = field(default_factory=dict)
    initial: dict[str, int] = field(default_factory=dict)
    failure_places: dict[str, int] = field(default_factory=dict)
    budget_places: set[str] = field(default_factory=set)
    blocks: dict[int, list[str]] = field(default_factory=dict)
    orderings: dict[str, Ordering] = field(default_factory=dict)
    into: dict[PlanEvent, list[str]] = field(default_factory=dict)
    """For every event, the places it waits for."""
    out_of: dict[PlanEvent, list[str]] = field(default_factory=dict)
    """For every event, the places it marks."""

    def machine(self) -> PetriNetMachine:
        start, end = self.net.place("start"), self.net.place("end")
        goal, failed = self.net.place("goal"), self.net.place("failed")
        self.initial[start] = 1
        self._connect()
        first, last = self._boundary()
        if not self.plan.calls:
            first = last = [self.net.place("begin < finish")]
        self.transition("begin", Rule("begin"), [start], first)
        for call in self.plan.calls:
            _Block(self, call, self.bindings.of(call.action.name)).build()
        if self.plan.due:
            self.transition("overtaken", Rule("overtaken", Ending()), last, [end])
        self.transition("finish", Rule("finish", Due(self.plan.due) if self.plan.due else Always()), last, [end])
        self.transition("ended_by_failure", Rule("ended_by_failure", Ending()), [end], [failed])
        self.transition("goal_holds", Rule("goal_holds", Holding(self.plan.goal)), [end], [goal])
        self.transition("goal_missing", Rule("goal_missing", Denied(self.plan.goal)), [end], [failed])
        return PetriNetMachine(
            plan=self.plan,
            net=self.net.build(),
            initial=Marking(self.initial),
            rules=self.rules,
            goal_place=goal,
            failed_place=failed,
            failure_places=self.failure_places,
            budget_places=frozenset(self.budget_places),
            blocks={call: tuple(places) for call, places in self.blocks.items()},
            orderings=self.orderings,
            on_failure=self.on_failure,
        )

    def _connect(self) -> None:
        """Make a place for every ordering of the plan."""
        calls = self.plan.calls
        for number, ordering in enumerate(self.plan.orderings):
            before, after = ordering.before, ordering.after
            name = f"{before.moment.value} {calls[before.call]} < {after.moment.value} {calls[after.call]} ({number})"
            place = self.net.place(name)
            self.orderings[place] = ordering
            self.out_of.setdefault(before, []).append(place)
            self.into.setdefault(after, []).append(place)

    def _boundary(self) -> tuple[list[str], list[str]]:
        """Make the places between `begin` and the first calls, and between the last calls and `finish`."""
        first: list[str] = []
        last: list[str] = []
        for call in self.plan.calls:
            start, end = PlanEvent(call.index, Moment.START), PlanEvent(call.index, Moment.END)
            if start not in self.into:
                first.append(self.net.place(f"begin < {call}"))
                self.into[start] = [first[-1]]
            if end not in self.out_of:
                last.append(self.net.place(f"{call} < finish"))
                self.out_of[end] = [last[-1]]
        return first, last

    def transition(self, name: str, rule: Rule, inputs: dict[str, int] | Iterable[str], outputs: Iterable[str]) -> None:
        self.net.transition(name, inputs, outputs)
        self.rules[name] = rule


@dataclass
class _Block:
    """The places and transitions of one call."""

    all: _Generator
    call: ActionCall
    binding: Binding

    def build(self) -> None:
        index = self.call.index
        self.title = str(self.call)
        announced = self.all.out_of.get(PlanEvent(index, Moment.START), [])
        self.awaited = self.all.into.get(PlanEvent(index, Moment.END), [])
        for name in ("running", "overdue", "stopping", "finished", "done", "failed"):
            self.place(name)
        self.all.failure_places[self.name("failed")] = index
        self._budget()
        self._attempt("", announced)
        if announced:
            self._attempt("again ", [])
        self._enter("ready")
        self._run("again " if announced else "")
        self._finish("again " if announced else "")
        leaving = self.all.out_of[PlanEvent(index, Moment.END)]
        self.all.transition(self.name("fork"), Rule("fork", call=index), [self.name("done"), *self.awaited], leaving)

    def _budget(self) -> None:
        if self.binding.retries:
            self.all.budget_places |= {self.place("budget"), self.place("spent")}
            self.all.initial[self.name("budget")] = self.binding.retries

    def _enter(self, ready: str) -> None:
        """Wait for the orderings into the start, and for the times that it must not be earlier than."""
        waiting, ready = self.all.into[PlanEvent(self.call.index, Moment.START)], self.name(ready)
        delays = tuple((place, self.all.orderings[place].delay) for place in waiting if self._is_delayed(place))
        join = Due(self.call.release, delays) if self.call.release or delays else Always()
        if join != Always():
            self.all.transition(self.name("overtaken"), Rule("overtaken", Ending(), self.call.index), waiting, [ready])
        self.all.transition(self.name("join"), Rule("join", join, self.call.index), waiting, [ready])

    def _is_delayed(self, place: str) -> bool:
        return place in self.all.orderings and self.all.orderings[place].delay > 0

    def _attempt(self, phase: str, announced: list[str]) -> None:
        """From `ready` to acceptance, and from `recover` back or out."""
        call, action = self.call.index, self.call.action
        ready, requested, recover = (self.place(phase + name) for name in ("ready", "requested", "recover"))
        out = [self.name("done"), *announced]
        failed = [*out, self.name("failed")]
        may_start = _conjunction(action.precondition, _before_invariant(action, self.all.plan.rules))

        def add(name: str, guard: Guard, source: str, outputs: Iterable[str], deed: Deed | None = None) -> None:
            self.all.transition(self.name(phase + name), Rule(name, guard, call, deed), [source], outputs)

        add("skip", Ending(), ready, out)
        if not self.awaited and not self.call.release and not self.all.out_of.get(PlanEvent(call, Moment.START)):
            # what comes while it runs relies on its start, or may, as time may, still undo what seems to be done
            add("already_true", AlreadyTrue(call), ready, out)
        add("data_missing", DataMissing(call), ready, failed)
        if isfinite(self.call.deadline):
            add("too_late", Due(self.call.deadline), ready, failed)
        add("start", Holding(may_start), ready, [requested], Deed.SEND)
        add("precondition_false", Denied(may_start), ready, failed)

        add("accepted", Accepts(call), requested, [self.name("running"), *announced], Deed.BEGIN)
        for kind in (OutcomeKind.REJECTED, OutcomeKind.UNAVAILABLE, OutcomeKind.LOST):
            add(f"{kind.value}{'_early' if kind is OutcomeKind.LOST else ''}", Ends(call, frozenset({kind})), requested, [recover])
        others = _UNSUCCESSFUL - {OutcomeKind.REJECTED, OutcomeKind.UNAVAILABLE, OutcomeKind.LOST}
        add("ended_early", Ends(call, others | _SUCCEEDED), requested, [recover])
        withdrawing = self.place(phase + "withdrawing")
        add("unanswered", After(self.binding.accept), requested, [withdrawing], Deed.CANCEL)
        add("withdrawn", Ends(call, frozenset(OutcomeKind)), withdrawing, [recover])
        add("unheard", After(self.binding.cancel), withdrawing, failed)

        add("abandon", Ending(), recover, failed)
        budget, spent, retries = self.name("budget"), self.name("spent"), self.binding.retries
        if retries:
            self.all.transition(self.name(phase + "retry"), Rule("retry", call=call), [recover, budget], [ready, spent])
        weights = {recover: 1, spent: retries} if retries else {recover: 1}
        self.all.transition(self.name(phase + "give_up"), Rule("give_up", call=call), weights, failed)

    def _run(self, phase: str) -> None:
        """From acceptance to one exit per outcome."""
        call, recover = self.call.index, phase + "recover"
        returned = "finished"
        if self.awaited:
            self.place("returned")
            returned = "returned"
        self.fire("succeeded", Ends(call, _SUCCEEDED), "running", returned)
        for kind in (OutcomeKind.ABORTED, OutcomeKind.CANCELED, OutcomeKind.LOST):
            self.fire(kind.value, Ends(call, frozenset({kind})), "running", recover, deed=Deed.UNDO)
        others = _UNSUCCESSFUL - {OutcomeKind.ABORTED, OutcomeKind.CANCELED, OutcomeKind.LOST}
        self.fire("ended_oddly", Ends(call, others), "running", recover, deed=Deed.UNDO)
        self.fire("stop", CancelAsked(), "running", "stopping", deed=Deed.CANCEL)
        if self.call.action.invariant != TRUE:
            self.fire("invariant_false", Denied(self.call.action.invariant), "running", "stopping", "failed", deed=Deed.CANCEL)
        if isfinite(self.call.deadline):
            self.fire("deadline_missed", Due(self.call.deadline), "running", "stopping", "failed", deed=Deed.CANCEL)
        self.fire("timed_out", After(self.all.bindings.timeout(self.call.action)), "running", "overdue", deed=Deed.CANCEL)

        self.fire("late_success", Ends(call, _SUCCEEDED), "overdue", returned)
        self.fire("expired", Ends(call, _UNSUCCESSFUL), "overdue", recover, deed=Deed.UNDO)
        self.fire("unconfirmed", After(self.binding.cancel), "overdue", "done", "failed", deed=Deed.UNDO)

        self.fire("completed", Ends(call, _SUCCEEDED), "stopping", "done", deed=Deed.FINISH)
        self.fire("stopped", Ends(call, _UNSUCCESSFUL), "stopping", "done", deed=Deed.UNDO)
        self.fire("unconfirmed_stop", After(self.binding.cancel), "stopping", "done", deed=Deed.UNDO)

    def _finish(self, phase: str) -> None:
        """From success to done, once the effects are seen."""
        call = self.call.index
        if self.awaited:
            inputs, outputs = [self.name("returned"), *self.awaited], [self.name("finished"), *self.awaited]
            self.all.transition(self.name("await"), Rule("await", call=call), inputs, outputs)
        self.fire("effects_hold", EffectsSeen(call), "finished", "done", deed=Deed.FINISH)
        self.fire("effects_missing", EffectsMissing(call), "finished", phase + "recover", deed=Deed.UNDO)

    def fire(self, name: str, guard: Guard, source: str, *targets: str, deed: Deed | None = None) -> None:
        """Add a transition between places of this block."""
        self.all.transition(self.name(name), Rule(name, guard, self.call.index, deed), [self.name(source)], map(self.name, targets))

    def place(self, name: str) -> str:
        found = self.all.net.place(self.name(name))
        self.all.blocks.setdefault(self.call.index, []).append(found)
        return found

    def name(self, name: str) -> str:
        return f"{self.title} {name}"


def _before_invariant(action: GroundAction, rules: Rules) -> Condition:
    """Return what of the over-all condition can be checked before the start: all that the start does not itself change."""
    changed = names_written(action.start_effects)
    return All(tuple(part for part in conjuncts(action.invariant) if not rules.base(names(part)) & changed))


def _conjunction(*conditions: Condition) -> Condition:
    real = tuple(part for condition in conditions for part in conjuncts(condition))
    return real[0] if len(real) == 1 else All(real)
