"""Plans that are only looked for, from the world as it is."""

from __future__ import annotations

import asyncio

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.node.problem_service import ProblemFolder, ServedProblem
from planner_bridge.tasks.settings import Settings
from pnm.errors import InputError
from pnm.tasks import Code, StepState
from tests.support.pddl.problems import rooms

PROBLEM = rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc")


def test_a_plan_is_looked_for_from_the_world_as_it_is():
    async def main():
        knowledge = initial_knowledge(PROBLEM)
        knowledge.update({("at", "r1", "a"): False, ("at", "r1", "b"): True})
        served = ServedProblem(PROBLEM, knowledge, Settings(), ProblemFolder(None), lambda *_: None)
        made = await served.make("", "", None)
        assert (made.code, [(step.arguments, step.state) for step in made.steps]) == (
            Code.GOAL_REACHED,
            [(("r1", "b", "c"), StepState.WAITING)],
        )
        assert (await served.make("(at r1 b)", "", 5.0)).steps == ()
        assert (await served.make("(at r1 a)", "", 5.0)).code is Code.NO_PLAN
        for goal, planner, said in (("", "kairoz", "kairoz"), ("(flies r1)", "", "goal:1:2: unknown predicate")):
            with pytest.raises(InputError, match=said):
                await served.make(goal, planner, 5.0)

    asyncio.run(main())
