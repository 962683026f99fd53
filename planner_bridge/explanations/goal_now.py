"""Whether a goal can be reached from the world as it is, and why not: asked where that world is known, answered in another process."""

from __future__ import annotations

import base64
import pickle
import zlib

from planner_bridge.explanations.answer import Answer
from planner_bridge.explanations.limited_search import SECONDS, AnswerLimit
from planner_bridge.explanations.no_plan import why_no_plan
from planner_bridge.explanations.plan_overview import why_plan
from planner_bridge.explanations.smallest_change import what_would_help
from planner_bridge.model.grounding import problem_now
from planner_bridge.model.plan import PlanningResult
from planner_bridge.model.problem import Problem
from pnm.core.knowledge_base import KnowledgeBase


def packed(problem: Problem) -> str:
    """Return a problem as a text for another process of this program: PDDL could not say what is unknown."""
    return base64.b64encode(zlib.compress(pickle.dumps(problem))).decode()


def unpacked(text: str) -> Problem:
    """Return the problem of a text that a process which is trusted has made."""
    problem = pickle.loads(zlib.decompress(base64.b64decode(text)))
    assert isinstance(problem, Problem)
    return problem


def answered(text: str, world: KnowledgeBase) -> tuple[Answer, ...]:
    """Return the answers about the goal of a problem that was packed, from a world."""
    problem, limit = problem_now(unpacked(text), world), AnswerLimit.of(SECONDS)
    return why_goal(problem, limit.first_plan(problem), limit)


def why_goal(problem: Problem, found: PlanningResult, limit: AnswerLimit) -> tuple[Answer, ...]:
    """Return what each call of a plan is for; or why there is none, and what would help.

    Args:
        problem: with the goal.
        found: a plan, or what a planner has said instead.
        limit: until when to look further.
    """
    if found.plan is not None:
        return (why_plan(problem, found.plan),)
    reason = why_no_plan(problem, found, limit)
    return reason, what_would_help(problem, limit, reason)
