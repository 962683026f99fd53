"""The block of any step, drafted as a template: how it is entered, and how it is left.

Names are those within the block, and what connects it to others are its ports: so all steps of one shape can share it.

Loops, choices, waits and junctions.

A loop counts its rounds: each takes a token from *left* and gives one to *spent*. When all are spent and the condition
still holds, the loop has failed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final, Generic, NamedTuple, TypeVar, assert_never

from pnm.core.machine import guards
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.guards import Guard, Rule, check_rule
from pnm.core.machine.plan_graph import Choice, Conditional, Junction, Loop, PlanGraph, Step, WaitUntil
from pnm.core.machine.requests import CallOutcome, TransitionAction
from pnm.core.net.block_net import Template
from pnm.core.net.net import NetBuilder, Weights

AnyStep = TypeVar("AnyStep", bound=Step)
OWN: Final = -1
"""In rules of a template, in place of the number of the call: they are about the block's own."""


class OwnRule(NamedTuple):
    """A rule of which a part follows from the `Terms` of a step, such as its precondition."""

    rule: Rule
    """All else of it."""
    guard: Callable[[Any], Guard] | None = None
    """Returns its guard."""
    expected: Callable[[Any], str] | None = None
    """Returns what was expected, for the text of a failure."""

    @property
    def name(self) -> str:
        """The name of the rule."""
        return self.rule.name

    def guard_for(self, terms: Any) -> Guard:
        """Return the guard of the rule of a step."""
        return self.rule.guard if self.guard is None else self.guard(terms)

    def made_for(self, terms: Any) -> Rule:
        """Return the rule of a step."""
        expected = self.rule.expected if self.expected is None else self.expected(terms)
        return self.rule._replace(guard=self.guard_for(terms), expected=expected)


class Port(StrEnum):
    """The ports of a block, besides those around the steps that it holds."""

    STARTS_AFTER = "what the start waits for"
    ENDS_AFTER = "what the end waits for"
    ANNOUNCES = "what waits for the start"
    LEADS_TO = "what waits for the end"
    RESOURCES = "resources"

    __hash__ = str.__hash__  # without a call of Python: every block asks for its ports


PORTS: Final = tuple(Port)
"""The ports in their order."""


@dataclass(frozen=True, eq=False, kw_only=True)
class BlockTemplate(Template):
    """A block that steps of one shape share: its places and transitions with their rules and roles, by number."""

    rules: tuple[Rule | OwnRule, ...]
    kinds: tuple[Rule, ...]
    """A rule of each transition's kind: that of the block that it was drafted for."""
    is_shared: bool = False
    """Whether blocks of all machines have it."""
    inner: tuple[Inner, ...] = ()
    """The steps that it holds."""
    initial: Mapping[int, int] = field(default_factory=lambda: MappingProxyType({}))
    failures: tuple[int, ...] = ()
    restarts: tuple[int, ...] = ()
    budgets: tuple[int, ...] = ()
    alive: tuple[int, ...] = ()
    settling: tuple[int, ...] = ()

    @cached_property
    def reported(self) -> Sequence[int]:
        """The transitions that reports open."""
        return tuple([number for number, kind in enumerate(self.kinds) if kind.guard.opened_by is guards.Opener.REPORT])

    @cached_property
    def made(self) -> Sequence[int]:
        """The transitions whose guards are made for each block."""
        return tuple([number for number, rule in enumerate(self.rules) if isinstance(rule, OwnRule) and rule.guard])

    @cached_property
    def own(self) -> Sequence[int]:
        """Those, and all others that ask for conditions."""
        return tuple([number for number, kind in enumerate(self.kinds) if number in self.made or kind.guard.asks is not None])

    @cached_property
    def usual(self) -> Sequence[int]:
        """The transitions that are asked of every call that goes well: those of its conditions, and of its time where each has its own."""
        of_time = {number for number in self.made if isinstance(self.kinds[number].guard, guards.After)}
        usual = [
            number
            for number, kind in enumerate(self.kinds)
            if kind.action is TransitionAction.SEND or isinstance(kind.guard, guards.InvariantFalse) or number in of_time
        ]
        return tuple(usual)


class Inner(NamedTuple):
    """The ports of a block around steps that it holds."""

    number: int
    """Of these steps among all that the step holds."""
    what: str
    """What they are to the step."""
    first: tuple[str, ...]
    last: tuple[str, ...]


@dataclass
class Draft:
    """Draft of a template, whose places and transitions have names as long as it is made. All of it is mutable."""

    net: NetBuilder = field(default_factory=NetBuilder)
    ports: list[str] = field(default_factory=list)
    rules: list[Rule | OwnRule] = field(default_factory=list)
    initial: dict[str, int] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)
    restarts: list[str] = field(default_factory=list)
    budgets: list[str] = field(default_factory=list)
    alive: list[str] = field(default_factory=list)
    settling: list[str] = field(default_factory=list)
    inner: list[Inner] = field(default_factory=list)

    def port(self, name: str) -> list[str]:
        """Add a port, and return it as the places that it stands for."""
        self.ports.append(self.net.place(name))
        return [name]

    def region(self, number: int = 0, what: str = "plan") -> Inner:
        """Add the ports around steps that the block holds; they are placed after it."""
        self.inner.append(Inner(number, what, *(tuple(self.port(f"{end} of {what}")) for end in ("first", "last"))))
        return self.inner[-1]

    def transition(self, name: str, rule: Rule | OwnRule, inputs: Weights | Iterable[str], outputs: Iterable[str]) -> None:
        """Add a transition and its rule."""
        self.net.transition(name, inputs, outputs)
        self.rules.append(rule)

    def template(self, terms: Terms[Any] | None = None, *, is_shared: bool = False) -> BlockTemplate:
        """Return what was drafted for a block with these terms, or for the frame, whose rules are all there is."""
        kinds = tuple([rule if isinstance(rule, Rule) else rule.made_for(terms) for rule in self.rules])
        net, ports = self.net.build(), frozenset(self.ports)
        number = {place: number for number, place in enumerate(place for place in net.places if place not in ports)}
        failures, restarts, budgets, alive, settling = (
            tuple([number[place] for place in places]) for places in (self.failures, self.restarts, self.budgets, self.alive, self.settling)
        )
        return BlockTemplate.of(
            net,
            self.ports,
            rules=tuple(self.rules) if is_shared else kinds,
            kinds=kinds,
            is_shared=is_shared,
            inner=tuple(self.inner),
            initial=MappingProxyType({number[place]: tokens for place, tokens in self.initial.items()}),
            failures=failures,
            restarts=restarts,
            budgets=budgets,
            alive=alive,
            settling=settling,
        )


@dataclass(frozen=True, slots=True)
class Context:
    """Context of a block: what surrounds it."""

    plan: PlanGraph
    bindings: Bindings
    starts_anew: bool
    """Some recovery has the whole plan begin anew."""
    repeated: bool = False
    """It may be entered again after it was left."""


class Terms(Generic[AnyStep]):
    """Terms of a step, which are in no template: conditions, times and limits. They do not change."""

    def __init__(self, context: Context, step: AnyStep, delays: tuple[tuple[str, float], ...]) -> None:
        self.context, self.step = context, step
        self.delays: Final = delays
        """Places that the start waits for, and how long it must come after they were marked."""

    @property
    def release(self) -> float:
        """Seconds after the plan's start before which the step is not entered."""
        return 0.0


@dataclass
class Block(Generic[AnyStep]):
    """The places and transitions of one step: what `build` adds to the draft of a template."""

    context: Context
    step: AnyStep
    connected: frozenset[Port]
    """The ports that lead anywhere."""
    delays: tuple[tuple[str, float], ...] = ()
    """Places that the start waits for, and how long it must come after they were marked."""
    draft: Draft = field(init=False)
    """Of its template, once that is being made."""
    chains: dict[int, Inner] = field(default_factory=dict)
    """The chains of its recoveries, by number."""

    @property
    def key(self) -> object:
        """The key of the block's shape: blocks with the same differ only in `OwnRule`; None for one of its own kind."""
        return None

    def template(self) -> BlockTemplate:
        """Return the template of the block."""
        self.draft = Draft()
        for port in PORTS:
            self.draft.port(port)
        self.build()
        return self.draft.template(self.terms, is_shared=self.key is not None)

    def build(self) -> None:
        """Add all places and transitions."""
        raise NotImplementedError

    def at(self, port: Port) -> list[str]:
        """Return the places that a port stands for: itself, if it leads anywhere."""
        return [port] if port in self.connected else []

    @property
    def awaited(self) -> list[str]:
        """Places that the end of the step waits for besides the step itself."""
        return self.at(Port.ENDS_AFTER)

    @cached_property
    def terms(self) -> Terms[AnyStep]:
        """Terms of the step."""
        return Terms(self.context, self.step, self.delays)

    def enter(self, ready: str) -> None:
        """Wait for the orderings into the start, and for the times that it must not be earlier than."""
        waiting = [Port.STARTS_AFTER]
        if (
            self.terms.release or self.delays
        ):  # asked before `join`: when the run ends, tokens pass at once instead of waiting for a release time
            self.add(Rule("overtaken", guards.Ending(), outcome=CallOutcome.WAITING), waiting, [ready])
            join = OwnRule(Rule("join", outcome=CallOutcome.WAITING), lambda own: guards.Due(own.release, own.delays))
            self.add(join, waiting, [ready], title="join")
        else:
            self.add(Rule("join", outcome=CallOutcome.WAITING), waiting, [ready])

    def leave(self) -> None:
        """Mark the places that wait for the end of the step."""
        # Only `fork` takes the awaited places for good; a call looks at them earlier and puts them back.
        self.add(Rule("fork", outcome=CallOutcome.PASSED_OVER), ["done", *self.awaited], [Port.LEADS_TO])

    def budget(self, left: str, spent: str, times: int, *, refilled: bool = True) -> None:
        """Make the places that count; when the step may be entered again, what was spent comes back before it is left."""
        self.draft.budgets += (self.place(left), self.place(spent))
        self.draft.initial[left] = times
        # From `done`, before `fork` is asked: the counters are full again before the block is left.
        if refilled and self.context.repeated and not self.awaited:
            self.add(Rule("refill"), ["done", spent], ["done", left], title=f"refill {left}")

    def fire(self, rule: Rule | OwnRule, source: str, *targets: str, title: str = "") -> None:
        """Add a transition between places of this block."""
        self.add(rule, [source], targets, title=title)

    def add(self, rule: Rule | OwnRule, inputs: dict[str, int] | Iterable[str], outputs: Iterable[str], *, title: str = "") -> None:
        """Add a transition of this step between any places, under its title, or the name of its rule if that is unique in the block."""
        self.draft.transition(title or rule.name, rule, inputs, outputs)

    def place(self, name: str) -> str:
        """Make a place of this block."""
        return self.draft.net.place(name)


class LoopBlock(Block[Loop]):
    """``head → body → head``, and out of it when the condition is false; the loop has failed when it is unknown."""

    def build(self) -> None:
        """Add the block to the machine."""
        head, done, failed = (self.place(name) for name in ("head", "done", "failed"))
        self.draft.failures.append(failed)
        body = self.draft.region(0, "body")
        self.enter("head")
        self.budget("left", "spent", self.step.limit)
        # First of the rules at the head: a run that is ending enters no further round, whatever the condition.
        self.fire(Rule("skip", guards.Ending()), "head", "done")
        condition = self.step.condition
        all_spent = f"(not {condition}) after {self.step.limit} rounds"
        exceeded = check_rule(Cause.LOOP_LIMIT, guards.ConditionTrue(condition))._replace(expected=all_spent)
        # Asked before `repeat`; it needs every token of `spent`, so it is enabled only when no round is left.
        self.add(exceeded, {head: 1, "spent": self.step.limit}, [done, failed])
        self.add(Rule("repeat", guards.ConditionTrue(condition)), [head, "left"], [*body.first, "spent"])
        self.fire(check_rule(Cause.CONDITION_UNKNOWN, guards.ConditionUnknown(condition)), "head", "done", "failed")
        self.fire(Rule("no_more", guards.ConditionFalse(condition)), "head", "done")
        self.add(Rule("round_done"), body.last, [head])
        self.leave()


class ChoiceBlock(Block[Choice]):
    """One of two regions; it has failed when the condition is unknown."""

    def build(self) -> None:
        """Add the block to the machine."""
        head, done, failed = (self.place(name) for name in ("head", "done", "failed"))
        self.draft.failures.append(failed)
        self.enter("head")
        self.fire(Rule("skip", guards.Ending()), "head", "done")  # asked first: a run that is ending chooses no branch
        self.fire(check_rule(Cause.CONDITION_UNKNOWN, guards.ConditionUnknown(self.step.condition)), "head", "done", "failed")
        condition = self.step.condition
        branches: tuple[tuple[str, Guard], ...] = ("then", guards.ConditionTrue(condition)), ("else", guards.ConditionFalse(condition))
        for number, (name, guard) in enumerate(branches):
            branch = self.draft.region(number, name)
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


class WaitBlock(Block[WaitUntil]):
    """``head → done`` once the condition is true; the step has failed when that takes too long."""

    def build(self) -> None:
        """Add the block to the machine."""
        for name in ("head", "done", "failed"):
            self.place(name)
        self.draft.failures.append("failed")
        self.enter("head")
        self.fire(Rule("skip", guards.Ending()), "head", "done")  # asked first: a run that is ending waits for nothing more
        self.fire(Rule("holds", guards.ConditionTrue(self.step.condition)), "head", "done")  # before the limit, at which it may just hold
        self.fire(check_rule(Cause.WAIT_LIMIT, guards.Late(self.step.limit, self.step.condition)), "head", "done", "failed")
        self.leave()


def block_without_call(
    context: Context, step: Conditional | Junction, connected: frozenset[Port], delays: tuple[tuple[str, float], ...]
) -> Block[Any]:
    """Return the block of a step that is no call."""
    match step:
        case Loop():
            return LoopBlock(context, step, connected, delays)
        case Choice():
            return ChoiceBlock(context, step, connected, delays)
        case WaitUntil():
            return WaitBlock(context, step, connected, delays)
        case Junction():
            return JunctionBlock(context, step, connected, delays)
        case _:
            assert_never(step)
