"""Robots in rooms in a ring, with constraints that tests write in PDDL."""

from __future__ import annotations

from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.tasks.result import TaskResult
from tests.support.pddl.problems import ROOMS

ROUND = "(way a b) (way b a) (way b c) (way a d) (way d a) (way d c) (way c d)"
"""Rooms a, b, c and d in a ring; there is no way back from c to b."""


def ring(constraints: str = "", *, goal: str = "(at r1 c)", init: str = "(at r1 a)", ways: str = ROUND, more: str = "") -> Problem:
    domain = parse_domain(ROOMS.replace("(:requirements :strips", "(:requirements :adl :constraints :preferences :strips", 1))
    return parse_problem(
        f"(define (problem p) (:domain rooms) (:objects r1 r2 - robot a b c d - room) (:init {init} {ways} (= (total-cost) 0))"
        f" (:goal {goal}) {f'(:constraints {constraints})' if constraints else ''} {more})",
        domain,
    )


def done(result: TaskResult) -> list[str]:
    return [str(call.call.action) for call in result.calls if call.outcome == "succeeded"]
