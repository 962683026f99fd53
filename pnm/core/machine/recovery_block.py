"""Recoveries of a call that the plan itself gives: chains of steps, and how to go on after them.

    recovering → (recover) → chain → recovered → ready, where a success leads, done, or done and failed

Every use takes a token from *uses left* and gives one to *uses spent*; when all are spent, the call gives up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, assert_never

from pnm.core.logic.conditions import Condition
from pnm.core.machine.machine import Ending, Failing, Rule
from pnm.core.machine.plan_graph import EMPTY, ActionCall, Cause, PlanGraphError, Recovery, Then
from pnm.core.machine.step_block import Block

_UNSENT: Final = frozenset({Cause.BEFORE, Cause.DATA_MISSING, Cause.PRECONDITION_FALSE})


@dataclass(frozen=True, slots=True)
class Recoveries:
    """Where the tokens of a call go when something is wrong."""

    places: Mapping[Cause, list[str]] = field(default_factory=dict)
    """Places marked instead of the usual ones, by cause."""
    kept: frozenset[Cause] = frozenset()
    """Causes after which the call goes on as if it had succeeded: what was done at the start stays."""
    checks: tuple[tuple[Cause, str, Condition, list[str]], ...] = ()
    """Checks of the plan's own, before or after: their names, conditions, and what is marked when they hold."""


_DIRECT: Final = {Then.SKIP: ("done",), Then.FAIL: ("done", "failed")}
"""Places that are marked by recoveries which have nothing to do first."""


def build_recoveries(block: Block[ActionCall]) -> Recoveries:
    """Add the plan's own recoveries to the block of a call."""
    places: dict[Cause, list[str]] = {}
    kept: set[Cause] = set()
    checks: list[tuple[Cause, str, Condition, list[str]]] = []
    for number, recovery in enumerate(block.step.recoveries):
        # Without a chain and with nothing to repeat there is nothing to count: the token goes on directly.
        if recovery.chain == EMPTY and recovery.then is Then.CONTINUE:
            entered = [_succeeded(block)]
        elif recovery.chain == EMPTY and recovery.then in _DIRECT:
            entered = [block.name(place) for place in _DIRECT[recovery.then]]
        else:
            entered = _chained(block, recovery, number)
        for cause in recovery.causes:
            # CONTINUE leads to `finished`, where the effects of a request are looked for: it needs a request, and comes before that check.
            if recovery.then is Then.CONTINUE and cause in _UNSENT | {Cause.AFTER, Cause.EFFECTS_MISSING}:
                raise PlanGraphError(
                    f"{block.step} cannot continue after {cause.value}: nothing has succeeded that effects could be seen of"
                )
            if cause in (Cause.BEFORE, Cause.AFTER):
                checks.append((cause, f"{cause.value} {number}", recovery.when, entered))
            elif cause not in places:
                places[cause] = entered
                kept |= {cause} if recovery.then is Then.CONTINUE else set()
    return Recoveries(places, frozenset(kept), tuple(checks))


def _chained(block: Block[ActionCall], recovery: Recovery, number: int) -> list[str]:
    recovering, recovered = block.place(f"recovering {number}"), block.place(f"recovered {number}")
    done, failed = block.name("done"), block.name("failed")
    left, spent = f"uses left {number}", f"uses spent {number}"
    # Uses of a restart are not given back when the plan begins anew, or it could do so for ever.
    block.budget(left, spent, recovery.times, refilled=recovery.then is not Then.RESTART_PLAN)
    chain = block.region(recovery.chain, f"recovery {number}", repeated=recovery.times > 1)
    abandon(block, f"recovering {number}")  # added before `recover`, for rules are asked in order: a run that is ending begins no recovery
    block.add(Rule("recover"), [recovering, block.name(left)], [*chain.first, block.name(spent)], title=f"recover {number}")
    # It takes all tokens of `uses spent`, so it is enabled only when none is left: no inhibitor arc is needed.
    block.add(Rule("give_up"), {recovering: 1, block.name(spent): recovery.times}, [done, failed], title=f"give_up {number}")
    block.add(Rule("chain_done"), chain.last, [recovered], title=f"chain_done {number}")
    abandon(block, f"recovered {number}")  # the run may have begun to end while the chain was carried out
    then = recovery.then
    match then:
        # Back to `ready` and not to `start`: the checks before a call are made again, for the chain may have changed the world.
        case Then.RETRY:
            goal = [block.name("ready")]
        case Then.CONTINUE:
            goal = [_succeeded(block)]
        case Then.SKIP:
            goal = [done]
        # The call is done as well as failed: its successors get their tokens and skip, so that no token is left behind.
        case Then.FAIL | Then.REPLAN:
            goal = [done, failed]
        case Then.RESTART_PLAN:
            asked = block.place(f"restart {number}")
            block.builder.restart_places[asked] = block.step.index
            goal = [done, asked]
        case _:
            assert_never(then)
    block.add(Rule(then.value, replans=then is Then.REPLAN), [recovered], goal, title=f"{then.value} {number}")
    return [recovering]


def _succeeded(block: Block[ActionCall]) -> str:
    """Return the place that is marked when the request has succeeded."""
    return block.name("returned" if block.awaited else "finished")


def abandon(block: Block[ActionCall], place: str, *announced: str, phase: str = "") -> None:
    """Let the call fail when the run does; when the plan begins anew, it has not failed."""
    done, failed = block.name("done"), block.name("failed")
    starts_anew = block.builder.starts_anew
    source, event = block.name(phase + place), place.rstrip(" 0123456789")
    # Ending includes restarts, which are no failures; where no restart is possible both mean the same.
    guard = Failing() if starts_anew else Ending()
    if event == "recover":
        block.add(Rule("abandon", guard, block.step.index), [source], [done, *announced, failed], title=f"{phase}abandon")
    else:
        block.add(Rule(f"abandon {event}", guard), [source], [done, *announced, failed], title=f"{phase}abandon {place}")
    if starts_anew:  # asked after the rule above: what is left then is a restart of the plan, which takes the token out without a failure
        block.add(Rule(f"drop {event}", Ending(), block.step.index), [source], [done, *announced], title=f"{phase}drop {place}")
