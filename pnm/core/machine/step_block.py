"""The block of any step: how it is entered, and how it is left.

Loops, choices and junctions.

A loop counts its rounds: each takes a token from *left* and gives one to *spent*. When all are spent and the condition
still holds, the loop has failed.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Generic, TypeVar

from pnm.core.machine.builder import Builder, Context
from pnm.core.machine.machine import (
    Always,
    CallOutcome,
    ConditionFalse,
    ConditionTrue,
    ConditionUnknown,
    Due,
    Ending,
    Region,
    Rule,
    check_rule,
)
from pnm.core.machine.plan_graph import Cause, Choice, Flow, Junction, Loop, Moment, PlanEvent, Step

AnyStep = TypeVar("AnyStep", bound=Step)


@dataclass
class Block(Generic[AnyStep]):
    """The places and transitions of one step."""

    builder: Builder
    step: AnyStep
    context: Context
    chains: dict[int, Region] = field(default_factory=dict)
    """The chains of its recoveries, by number."""

    @cached_property
    def title(self) -> str:
        """Name of the step, and prefix of its places and transitions."""
        return str(self.step)

    @cached_property
    def awaited(self) -> list[str]:
        """Places that the end of the step waits for besides the step itself."""
        return self.builder.into.get(PlanEvent(self.step.index, Moment.END), [])

    def enter(self, ready: str, release: float = 0.0) -> None:
        """Wait for the orderings into the start, and for the times that it must not be earlier than."""
        orderings = self.builder.orderings
        waiting, ready = self.builder.into[PlanEvent(self.step.index, Moment.START)], self.name(ready)
        delays = tuple((place, orderings[place].delay) for place in waiting if place in orderings and orderings[place].delay > 0)
        join = Due(release, delays) if release or delays else Always()
        if join != Always():  # asked before `join`: when the run ends, tokens pass at once instead of waiting for a release time
            self.add(Rule("overtaken", Ending(), self.step.index, outcome=CallOutcome.WAITING), waiting, [ready])
        self.add(Rule("join", join, self.step.index, outcome=CallOutcome.WAITING), waiting, [ready])

    def leave(self) -> None:
        """Mark the places that wait for the end of the step."""
        leaving = self.builder.out_of[PlanEvent(self.step.index, Moment.END)]
        # Only `fork` takes the awaited places for good; a call looks at them earlier and puts them back.
        self.add(Rule("fork", call=self.step.index, outcome=CallOutcome.PASSED_OVER), [self.name("done"), *self.awaited], leaving)

    def budget(self, left: str, spent: str, times: int, *, refilled: bool = True) -> None:
        """Make the places that count; when the step may be entered again, what was spent comes back before it is left."""
        self.builder.budget_places |= {self.place(left), self.place(spent)}
        self.builder.initial[self.name(left)] = times
        # From `done`, before `fork` is asked: the counters are full again before the block is left.
        if refilled and self.context.repeated and not self.awaited:
            done = self.name("done")
            self.add(Rule("refill"), [done, self.name(spent)], [done, self.name(left)], title=f"refill {left}")

    def region(self, flow: Flow, what: str, *, repeated: bool) -> Region:
        """Make the places around steps that this one holds."""
        context = Context(repeated or self.context.repeated)
        return self.builder.region(flow, self.step.index, self.name(f"{what} begins"), self.name(f"{what} ends"), context)

    def fire(self, rule: Rule, source: str, *targets: str) -> None:
        """Add a transition between places of this block."""
        self.add(rule, [self.name(source)], [self.name(target) for target in targets])

    def add(self, rule: Rule, inputs: dict[str, int] | Iterable[str], outputs: Iterable[str], *, title: str = "") -> None:
        """Add a transition of this step between any places, under its title, or the name of its rule if that is unique in the block."""
        owned = rule if rule.call is not None else rule._replace(call=self.step.index)
        self.builder.transition(self.name(title or rule.name), owned, inputs, outputs)

    def place(self, name: str) -> str:
        """Make a place of this block."""
        place = self.builder.net.place(self.name(name))
        self.builder.blocks.setdefault(self.step.index, []).append(place)
        return place

    def name(self, name: str) -> str:
        """Return the full name of a place or transition of this block."""
        return f"{self.title} {name}"


class LoopBlock(Block[Loop]):
    """``head → body → head``, and out of it when the condition is false; the loop has failed when it is unknown."""

    def build(self) -> None:
        """Add the block to the machine."""
        head, done, failed = (self.place(name) for name in ("head", "done", "failed"))
        left, spent = self.name("left"), self.name("spent")
        self.builder.failure_places[failed] = self.step.index
        body = self.region(self.step.body, "body", repeated=True)
        self.enter("head")
        self.budget("left", "spent", self.step.limit)
        # First of the rules at the head: a run that is ending enters no further round, whatever the condition.
        self.fire(Rule("skip", Ending()), "head", "done")
        condition = self.step.condition
        all_spent = f"(not {condition}) after {self.step.limit} rounds"
        exceeded = check_rule(Cause.LOOP_LIMIT, ConditionTrue(condition))._replace(expected=all_spent)
        # Asked before `repeat`; it needs every token of `spent`, so it is enabled only when no round is left.
        self.add(exceeded, {head: 1, spent: self.step.limit}, [done, failed])
        self.add(Rule("repeat", ConditionTrue(condition)), [head, left], [*body.first, spent])
        self.fire(check_rule(Cause.CONDITION_UNKNOWN, ConditionUnknown(condition)), "head", "done", "failed")
        self.fire(Rule("no_more", ConditionFalse(condition)), "head", "done")
        self.add(Rule("round_done"), body.last, [head])
        self.leave()


class ChoiceBlock(Block[Choice]):
    """One of two regions; it has failed when the condition is unknown."""

    def build(self) -> None:
        """Add the block to the machine."""
        head, done, failed = (self.place(name) for name in ("head", "done", "failed"))
        self.builder.failure_places[failed] = self.step.index
        self.enter("head")
        self.fire(Rule("skip", Ending()), "head", "done")  # asked first: a run that is ending chooses no branch
        self.fire(check_rule(Cause.CONDITION_UNKNOWN, ConditionUnknown(self.step.condition)), "head", "done", "failed")
        branches = (
            ("then", ConditionTrue(self.step.condition), self.step.then),
            ("else", ConditionFalse(self.step.condition), self.step.otherwise),
        )
        for name, guard, flow in branches:
            branch = self.region(flow, name, repeated=False)
            self.add(Rule(name, guard), [head], branch.first)
            self.add(Rule(f"{name}_done"), branch.last, [done])
        self.leave()


class JunctionBlock(Block[Junction]):
    """Takes from all, gives to all."""

    def build(self) -> None:
        """Add the block to the machine."""
        self.place("done")
        self.enter("done")
        self.leave()
