"""The frame around all steps: where a machine begins, and where it ends in goal or failed.

What blocks are built with: the net so far, its roles, and which places connect which steps.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import assert_never

from pnm.core.machine.bindings import Bindings, is_open
from pnm.core.machine.builder import Builder, Context
from pnm.core.machine.call_block import CallBlock
from pnm.core.machine.machine import Always, ConditionFalse, ConditionTrue, Due, Ending, Failing, OnFailure, PetriNetMachine, Rule
from pnm.core.machine.plan_graph import ActionCall, Cause, Choice, Junction, Loop, PlanGraph, Step
from pnm.core.machine.step_block import ChoiceBlock, JunctionBlock, LoopBlock
from pnm.core.resources import check_capacity
from pnm.errors import check_kinds


def generate(
    plan: PlanGraph,
    bindings: Bindings | None = None,
    *,
    on_failure: OnFailure = OnFailure.DRAIN,
    capacities: Mapping[str, int] | None = None,
) -> PetriNetMachine:
    """Build the machine of a plan.

    Args:
        plan: its steps, with their retries and limits.
        bindings: what retries, limits and resources of calls are taken from besides.
        on_failure: what happens to running calls once a step has failed.
        capacities: how many calls may have a resource at the same time, one for those not listed: those of the `Resources` that the
            machine's runs share with others; the plan's own when not given.

    Raises:
        InputError: the name of a server or a resource has a part in braces that is not a parameter of its action.
    """
    check_kinds("generate", {"plan": (plan, PlanGraph)})
    builder = Builder(plan, bindings or Bindings())
    start, end = builder.net.place("start"), builder.net.place("end")
    goal, failed = builder.net.place("goal"), builder.net.place("failed")
    builder.initial[start] = 1  # the only token besides counters and resources: all others come from it, and end on `goal` or on `failed`
    for call in plan.calls:
        if call.action.operation is None:
            builder.bindings.server(call.action)  # refuses a name that cannot be filled: while the machine runs is too late
    users = Counter(name for call in plan.calls for name in builder.bindings.resources(call.action))
    # The capacities of the pool that runs share win: a net with more units than the pool would promise what it cannot give.
    shared = plan.capacities if capacities is None else capacities
    for name, count in users.items():
        place = builder.net.place(f"resource {name}")
        builder.resource_places[place] = name
        # calls may turn out to need different resources under an open name: the net must not be stricter than what runs share
        builder.initial[place] = count if is_open(name) else shared.get(name, 1)
        check_capacity(name, builder.initial[place])
    # If the plan can begin anew, every block can be entered again, and must give back what it has spent.
    whole = builder.region(plan.flow, None, "begin", "finish", Context(repeated=builder.starts_anew))
    builder.transition("begin", Rule("begin"), [start], whole.first)
    # A queue instead of recursion: blocks that hold others add these while they are built, however deeply they are nested.
    while builder.waiting:
        _build(builder, *builder.waiting.popleft())
    if plan.due:  # added before `finish`, so that a run which is ending does not wait for a time that only the goal needs
        builder.transition("overtaken", Rule("overtaken", Ending()), whole.last, [end])
    builder.transition("finish", Rule("finish", Due(plan.due) if plan.due else Always()), whole.last, [end])
    # Rules of `end` are asked in this order: failures first, then restarts; the goal is only looked at when there are neither.
    builder.transition("ended_by_failure", Rule("ended_by_failure", Failing()), [end], [failed])
    if builder.restart_places:
        restarting = builder.net.place("restarting")
        # Each request to restart is taken by a firing of its own: a second one would otherwise stay marked and restart the plan again.
        for place in builder.restart_places:
            for source, name in ((end, "restart"), (restarting, "restart_too")):
                builder.transition(f"{name} {place}", Rule(name), [source, place], [restarting])
        builder.transition("begin_anew", Rule("begin_anew", restarts=True), [restarting], [start])
    # The last two rules exclude each other, so that one of them opens whatever the world is like.
    builder.transition("goal_holds", Rule("goal_holds", ConditionTrue(plan.goal)), [end], [goal])
    builder.transition("goal_missing", Rule("goal_missing", ConditionFalse(plan.goal), cause=Cause.GOAL_FALSE), [end], [failed])
    return builder.machine(goal, failed, on_failure)


def _build(builder: Builder, step: Step, context: Context) -> None:
    match step:
        case ActionCall():
            CallBlock(builder, step, context).build()
        case Loop():
            LoopBlock(builder, step, context).build()
        case Choice():
            ChoiceBlock(builder, step, context).build()
        case Junction():
            JunctionBlock(builder, step, context).build()
        case _:
            assert_never(step)
