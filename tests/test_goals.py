"""Goals as people say them: conditions, names, nothing; and plans that are only looked for."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from planner_bridge.goals import Goals, read_goals
from planner_bridge.making import Maker
from planner_bridge.state import initial_knowledge
from planner_bridge.tasks import Settings
from pnm.errors import InputError
from pnm.tasking import Code, StepState
from tests.domains import rooms

PROBLEM = rooms(init="(at r1 a)", goal="(at r1 c)", ways="ab bc")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("(at r1 zz)", "goal:1:8: "),
        ("(att r1 c)", "goal:1:2: "),
        ("(at r1)", "goal:1:"),
        ("(at r1 c", "goal:1:1: "),
        ("(at r1 c) (at r1 b)", "expected one condition, found (at ...) after it"),
        ("(preference p (at r1 c))", "goal:1:2: "),
        ("(" * 10000, "goal:1:"),
        ("tidy", "there is no goal 'tidy'; expected a condition such as (at r1 kitchen)"),
        ("(at r1 c) ; \x00", ""),
    ],
)
def test_what_is_no_goal_is_said_with_its_place(text, said):
    if not said:
        assert Goals(PROBLEM).read(text) == PROBLEM.goal
        return
    with pytest.raises(InputError) as error:
        Goals(PROBLEM).read(text)
    assert said in str(error.value)


def test_goals_are_conditions_or_names_or_that_of_the_problem(tmp_path: Path):
    file = tmp_path / "goals.yaml"
    file.write_text("home: (at r1 a)\naway: |\n  (or (at r1 b)\n      (at r1 c))\n")
    goals = read_goals(file, PROBLEM)
    assert goals.read("") == goals.read(" (AT R1 C) ") == PROBLEM.goal
    assert goals.read("home") == goals.read("(at r1 a)")
    assert goals.read("away") == goals.read("(or (at r1 b) (at r1 c))")
    with pytest.raises(InputError, match=r"there is no goal 'hme'; did you mean 'home'\?"):
        goals.read("hme")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("home: (at r1 zz)", "goals.yaml:1:7: in the goal 'home': "),
        ("home: at r1 a", "goals.yaml:1:7: expected a condition in PDDL as the goal 'home'"),
        ("home: 3", "goals.yaml:1:7: expected a text under 'home', found 3"),
        ("home:", "goals.yaml:1:"),
        ("[home]", "goals.yaml:1:1: expected a mapping"),
    ],
)
def test_a_file_of_goals_that_is_wrong_is_refused(tmp_path: Path, text, said):
    file = tmp_path / "goals.yaml"
    file.write_text(text)
    with pytest.raises(InputError) as error:
        read_goals(file, PROBLEM)
    assert said in str(error.value)


def test_a_plan_is_looked_for_from_the_world_as_it_is():
    async def main():
        knowledge = initial_knowledge(PROBLEM)
        knowledge.update({("at", "r1", "a"): False, ("at", "r1", "b"): True})
        maker = Maker(PROBLEM, knowledge, Settings(), Goals(PROBLEM).read, asyncio.get_running_loop().time())
        found = await maker.make("", "", None)
        assert (found.code, [(step.arguments, step.state) for step in found.steps]) == (
            Code.GOAL_REACHED,
            [(("r1", "b", "c"), StepState.WAITING)],
        )
        assert (await maker.make("(at r1 b)", "", 5.0)).steps == ()
        assert (await maker.make("(at r1 a)", "", 5.0)).code is Code.NO_PLAN
        with pytest.raises(InputError, match="kairoz"):
            await maker.make("", "kairoz", 5.0)

    asyncio.run(main())
