"""A process that ends with its first request, or where unified-planning is asked with its plan.

usage: python -m tests.support.benchmarks.executives.first_request ours|unified-planning DOMAIN PROBLEM
"""

from __future__ import annotations

import os
import sys
from typing import Any, NoReturn
from uuid import UUID


class FirstOnly:
    """A client for which one request is enough."""

    def goal_fields(self, action: object, /) -> None:
        return None

    def send(self, request: object, report: object, /) -> NoReturn:
        os._exit(0)

    def cancel(self, request: UUID, /) -> None:
        """There is none."""


def ours(domain: str, problem: str) -> None:
    from planner_bridge import achieve
    from planner_bridge.tasks.settings import Settings

    achieve(domain, problem, actions=FirstOnly(), settings=Settings(improve=0.0))
    raise SystemExit("nothing was requested")


def unified_planning(domain: str, problem: str) -> None:
    from unified_planning.io import PDDLReader
    from unified_planning.shortcuts import OneshotPlanner, get_environment

    get_environment().credits_stream = None
    read: Any = PDDLReader().parse_problem(domain, problem)
    with OneshotPlanner(name="aries") as planner:
        if planner.solve(read).plan is None:
            raise SystemExit("there is no plan")


if __name__ == "__main__":
    {"ours": ours, "unified-planning": unified_planning}[sys.argv[1]](*sys.argv[2:])
