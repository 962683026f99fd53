"""Why a policy does not take a way: outcomes of actions on it may lead to states without a way out."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from planner_bridge.explanations.answer import Answer, Known, Unsolvable, listed
from planner_bridge.explanations.no_plan import AnswerLimit, why_unreachable
from planner_bridge.model.determinization import determinization
from planner_bridge.model.plan import Plan, PlanningStatus
from planner_bridge.model.problem import Problem
from planner_bridge.planning.policies.dead_ends import DeadStates
from planner_bridge.planning.policies.grounding import policy_task
from planner_bridge.planning.policies.task import Unsuitable
from pnm.errors import counted

_SHARE: Final = 0.3
"""Of the time that is left, for each search."""


def why_trap(problem: Problem, avoiding: Plan, other: Plan, limit: AnswerLimit) -> Answer | None:
    """Return the first step that may lead to a state without a way out, and why there is none; None if no such is found.

    Args:
        problem: in whose initial state the plans begin.
        avoiding: the plan that is to be explained: its own steps are no reason.
        other: the plan whose steps are looked at, with the outcomes that it hopes for.
        limit: for searches, where it does not follow from what can be reached.
    """
    try:
        task = policy_task(problem)
    except Unsuitable:
        return None
    dead, state, actions = DeadStates(task), task.initial, {(action.name, action.arguments): action for action in task.actions}
    own = {(step.action, step.arguments) for step in avoiding.steps}
    for step in other.steps:
        action = actions.get((step.action, step.arguments))
        if action is None or action.condition_in(state) is None:
            return None
        hoped = next((one for one in action.outcomes if one.name == step.outcome), action.outcomes[0])
        chance, known, reason, claims = 0.0, Known.SEARCH, "", list[Unsolvable]()
        for outcome in action.outcomes:
            after = outcome.after(state)
            if outcome is hoped or task.goal_in(after) or (step.action, step.arguments) in own:
                continue
            same = {fluent: value for fluent, value in problem.init.items() if fluent not in task.facts}
            there = replace(problem, init=same | task.values(after))
            if part := dead.explained(after):
                named = {"true": task.texts(part.true), "false": task.texts(part.false)}
                facts = [f"{listed(those)} {'are' if len(those) > 1 else 'is'} {how}" for how, those in named.items() if those]
                known, reason = Known.RELAXATION, reason or f": {', and '.join(facts)}"
            elif limit.solve(there, share=_SHARE).status is not PlanningStatus.UNSOLVABLE:
                continue
            chance += outcome.chance
            claims.append(Unsolvable(there))
        if chance:
            reasons = filter(None, (why_unreachable(claims[0].problem, problem.goal, limit),))
            return Answer(f"{action} leads with {chance:.0%} to a state without a way out{reason}", known, tuple(reasons), tuple(claims))
        state = hoped.after(state)
    return None


def why_not_short(problem: Problem, plan: Plan, limit: AnswerLimit) -> Answer | None:
    """Return why a policy does not take the way that would be shorter with luck; None if there is none, or no trap on it is found."""
    each = determinization(problem)
    found = limit.solve(each.problem, share=_SHARE).plan
    short = each.plan(found) if found else plan
    if len(short.steps) >= len(plan.steps) or (trap := why_trap(problem, plan, short, limit)) is None:
        return None
    return replace(trap, reasons=(), statement=f"there is a way with {counted(len(short.steps), 'call')}, but {trap.statement}")
