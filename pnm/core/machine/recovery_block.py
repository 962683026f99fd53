"""Recoveries of a call that the plan itself gives: chains of steps, and how to go on after them.

    recovering → (recover) → chain → recovered → ready, where a success leads, done, or done and failed

Every use takes a token from *uses left* and gives one to *uses spent*; when all are spent the next recovery for the same cause is
used, and after the last the call gives up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final, assert_never

from pnm.core.logic.conditions import TRUE, Condition
from pnm.core.machine.failure_causes import ASKED, Cause, NoRecovery, Phase
from pnm.core.machine.guards import Always, ConditionTrue, Ending, Failing, Rule
from pnm.core.machine.plan_graph import EMPTY, ActionCall, PlanGraphError, Recovery, Then
from pnm.core.machine.requests import TransitionAction
from pnm.core.machine.step_block import Block


@dataclass(frozen=True, slots=True)
class Recoveries:
    """The ways of the tokens of a call after a problem."""

    places: Mapping[Cause, list[str]] = field(default_factory=dict)
    """Places marked instead of the usual ones, by cause."""
    kept: frozenset[Cause] = frozenset()
    """Causes after which the call goes on as if it had succeeded: what was done at the start stays."""
    checks: tuple[tuple[Cause, str, Condition, list[str]], ...] = ()
    """Checks of the plan's own, before or after: their names, conditions, and what is marked when they hold."""


_LEAVING: Final = {Then.SKIP: ("done",), Then.FAIL: ("done", "failed"), Then.REPLAN: ("done", "failed")}
"""Places that are marked by recoveries which leave the call: what comes after one in a list can never happen."""


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
        return _direct(block, recoveries[first])
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
        guard = Always() if number == first or recovery.when == TRUE else ConditionTrue(recovery.when)
        rule = Rule("recover", guard, action=None if recovery.then is Then.CONTINUE else undo)
        title = f"recover {number}" if len(numbers) == 1 else f"recover {number} of {names}"
        if is_direct(recovery):
            block.add(rule, [recovering], _direct(block, recovery), title=title)
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


def _direct(block: Block[ActionCall], recovery: Recovery) -> list[str]:
    if recovery.then is Then.CONTINUE:
        return [succeeded_place(block)]
    return [*_LEAVING[recovery.then]]


def _chained(block: Block[ActionCall], recovery: Recovery, number: int) -> None:
    """Add the chain of a recovery, the counters of its uses, and how the call goes on after it."""
    recovered = block.place(f"recovered {number}")
    # Uses of a restart are not given back when the plan begins anew, or it could do so for ever.
    restarts = recovery.then is Then.RESTART_PLAN
    block.budget(f"uses left {number}", f"uses spent {number}", recovery.times, refilled=not restarts)
    chain = block.region(recovery.chain, f"recovery {number}", repeated=recovery.times > 1)
    block.chains[number] = chain
    block.add(Rule("chain_done"), chain.last, [recovered], title=f"chain_done {number}")
    abandon(block, f"recovered {number}")  # the run may have begun to end while the chain was carried out
    then = recovery.then
    match then:
        # Back to `ready` and not to `start`: the checks before a call are made again, for the chain may have changed the world.
        case Then.RETRY:
            goal = ["ready"]
        case Then.CONTINUE:
            goal = [succeeded_place(block)]
        # After a failure the call is done as well: its successors get their tokens and skip, so that no token is left behind.
        case Then.SKIP | Then.FAIL | Then.REPLAN:
            goal = [*_LEAVING[then]]
        case Then.RESTART_PLAN:
            asked = block.place(f"restart {number}")
            block.draft.restarts.append(asked)
            goal = ["done", asked]
        case _:
            assert_never(then)
    block.add(Rule(then.value, replans=then is Then.REPLAN), [recovered], goal, title=f"{then.value} {number}")


def succeeded_place(block: Block[ActionCall]) -> str:
    """Return the place that is marked when the request has succeeded."""
    return "returned" if block.awaited else "finished"


def abandon(block: Block[ActionCall], place: str, *announced: str, phase: str = "", action: TransitionAction | None = None) -> None:
    """Let the call fail when the run does; when the plan begins anew, it has not failed."""
    starts_anew = block.context.starts_anew
    source, event = phase + place, place.rstrip(" ,0123456789")
    # Ending includes restarts, which are no failures; where no restart is possible both mean the same.
    guard = Failing() if starts_anew else Ending()
    if event == "recover":
        block.add(Rule("abandon", guard), [source], ["done", *announced, "failed"], title=f"{phase}abandon")
    else:
        block.add(Rule(f"abandon {event}", guard, action=action), [source], ["done", *announced, "failed"], title=f"{phase}abandon {place}")
    if starts_anew:  # asked after the rule above: what is left then is a restart of the plan, which takes the token out without a failure
        block.add(Rule(f"drop {event}", Ending(), action=action), [source], ["done", *announced], title=f"{phase}drop {place}")
