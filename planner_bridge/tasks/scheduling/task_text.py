"""The text of a task: a goal, a plan as a text of calls, or the name of a plan that is loaded. Read in any thread."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Final, TypeAlias

from planner_bridge.model.plan import Plan
from planner_bridge.model.plan_text import read_plan
from planner_bridge.model.problem import Problem
from pnm.core.logic.conditions import Condition
from pnm.errors import InputError
from pnm.tasks import Wanted

MAX_CALLS: Final = 1000
"""Calls of a plan that is sent as a text."""

TaskText: TypeAlias = Condition | Plan | None
"""A goal, a plan, or None for a plan that is loaded."""


def read_text(wanted: Wanted, read_goal: Callable[[str], Condition], loaded: Collection[str], now: Problem) -> TaskText:
    """Read the text of a task.

    Args:
        wanted: the task.
        read_goal: reads a goal; raises InputError.
        loaded: the names of the plans that are loaded.
        now: has the actions and objects of a plan as a text.

    Raises:
        InputError: the text is no goal, or no plan.
    """
    if not wanted.is_plan:
        return read_goal(wanted.text)
    if wanted.text in loaded or (loaded and "(" not in wanted.text):
        return None
    if not now.domain.actions:
        raise InputError("a plan that is sent as a text needs a domain with actions, and none is loaded")
    if wanted.parameters:
        raise InputError(f"a plan that is sent as a text has no parameters; found {', '.join(wanted.parameters)}")
    plan = read_plan(wanted.text, now)
    if len(plan.steps) > MAX_CALLS:
        raise InputError(f"the plan has {len(plan.steps)} calls; expected {MAX_CALLS} at most")
    return plan
