"""Plans that are only looked for, from the world as it is."""

from __future__ import annotations

import asyncio

import pytest

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.node.problem_service import make_plan
from planner_bridge.node.world_queries import SharedWorld
from planner_bridge.tasks.settings import Settings
from pnm.errors import InputError
from pnm.tasks import Code, StepState
from tests.support.pddl.problems import rooms

PROBLEM = rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc")


def test_a_plan_is_looked_for_from_the_world_as_it_is():
    async def main():
        knowledge = initial_knowledge(PROBLEM)
        knowledge.update({("at", "r1", "a"): False, ("at", "r1", "b"): True})
        world = SharedWorld(PROBLEM, knowledge)
        made = await make_plan(world, Settings(), "", "", None)
        assert (made.code, [(step.arguments, step.state) for step in made.steps]) == (
            Code.GOAL_REACHED,
            [(("r1", "b", "c"), StepState.WAITING)],
        )
        assert (await make_plan(world, Settings(), "(at r1 b)", "", 5.0)).steps == ()
        assert (await make_plan(world, Settings(), "(at r1 a)", "", 5.0)).code is Code.NO_PLAN
        for goal, planner, said in (("", "kairoz", "kairoz"), ("(flies r1)", "", "goal:1:2: unknown predicate")):
            with pytest.raises(InputError, match=said):
                await make_plan(world, Settings(), goal, planner, 5.0)

    asyncio.run(main())
