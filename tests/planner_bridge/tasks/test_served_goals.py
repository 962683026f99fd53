"""What comes in with a goal for a plan, what is counted while it goes on, and what goes out: without ROS 2."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from uuid import UUID

import pytest
from hypothesis import given, strategies as st

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.world import simulated_backend
from planner_bridge.node.problem_service import NOTHING
from planner_bridge.tasks.settings import Settings
from planner_bridge.tasks.task_manager import TaskManager
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import Condition
from pnm.errors import InputError
from pnm.language.plan import merge_bindings, read_plans
from pnm.language.runner import PlanRunner, Program
from pnm.ros.tasks.task_messages import read_parameters, result_fields
from pnm.tasks import Code, TaskEnding, TaskListener, Wanted

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("3", "expected a mapping such as {shop: bakery} as parameters, found '3'"),
        ("[a]", "expected a mapping such as {shop: bakery} as parameters, found '[a]'"),
        ("shop", "expected a mapping"),
        ("{shop: bakery", "parameters:1:"),
        ("{a: 1}\n---\n{b: 2}\n", "parameters:3:1: a second document begins here"),
        ("{a: 1, a: 2}", "parameters:1:8: "),
        ("? [a]\n: 1", "parameters:1:"),
        ("a: !!python/name:os.system", "parameters:1:4: "),
        ("[" * 100_000, "parameters:1:"),
        ("{a: &a [1], b: &b [*a, *a, *a], c: [*b, *b, *b, *d]}", "parameters:1:"),
    ],
    ids=lambda value: value[:20],
)
def test_what_is_no_mapping_is_no_parameters(text: str, said: str) -> None:
    with pytest.raises(InputError) as error:
        read_parameters(text)
    assert said in str(error.value)


@pytest.mark.parametrize("text", ["", "  \n", "{}"])
def test_nothing_is_no_parameters(text: str) -> None:
    assert read_parameters(text) == {}


def test_yaml_will_do() -> None:
    assert read_parameters("shop: bakery\nfloors: [1, 2.5]\nopen: true\n") == {"shop": "bakery", "floors": [1, 2.5], "open": True}


@given(st.dictionaries(st.text(), JSON, max_size=4))
def test_parameters_written_as_json_come_in_as_they_were(parameters: dict[str, object]) -> None:
    assert read_parameters(json.dumps(parameters)) == parameters


@given(st.dictionaries(st.text(), JSON, max_size=4))
def test_results_are_json(results: dict[str, object]) -> None:
    fields = result_fields(True, "goal", "done", results)
    assert json.loads(str(fields["results"])) == results
    assert fields["message"] == "done"


def test_a_result_that_json_cannot_say_is_told_of() -> None:
    fields = result_fields(True, "goal", "done\x1b", {"a": float("nan"), "b": 1})
    assert fields["results"] == '{"b": 1}'
    assert str(fields["message"]).startswith("done\N{REPLACEMENT CHARACTER}; a is left out: JSON cannot say nan")


def test_calls_and_restarts_of_a_plan_are_counted_and_told(tmp_path: Path) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text(
        "actions: {go: {params: [place], duration: 5}}\nname: tour\nrestarts: 2\nresults: [n]\ninitial_knowledge: {n: 3}\n"
        "plan:\n  - go: {place: a}\n  - go: {place: b}\n    recoveries: {during: {aborted: restart_plan}}\n"
    )
    (plan,) = read_plans(file).values()
    faults = Faults((Fault("go(b)", FaultKind.ABORT, times=1),))
    runner = PlanRunner({"tour": Program.of(plan)}, simulated_backend(plan, merge_bindings([plan]), faults), KnowledgeBase())
    tour = Wanted(UUID(int=1), "tour", is_plan=True)

    class Told(TaskListener):
        def __init__(self, master: TaskManager) -> None:
            self.master = master
            self.statuses: list[tuple[int, int, tuple[str, ...]]] = []
            self.endings: list[TaskEnding] = []
            self.over = asyncio.Event()

        def changed(self, task: UUID) -> None:
            (status,) = self.master.status()
            self.statuses.append((status.ended, status.restarts, status.running))

        def ended(self, task: UUID, ending: TaskEnding) -> None:
            self.endings.append(ending)
            self.over.set()

    async def go() -> Told:
        await runner.backend.open(runner.world)
        master = TaskManager(NOTHING, runner, Settings(), _no_goal)
        told = Told(master)
        master.listen(told)
        master.begin(tour)
        await asyncio.wait_for(told.over.wait(), 100.0)
        await master.close()
        await runner.backend.close()
        return told

    told = run_async(go(), virtual=True)
    assert (told.endings[0].code, told.endings[0].results, told.endings[0].cause) == (Code.GOAL_REACHED, {"n": 3}, "")
    counts = list(dict.fromkeys(one[:2] for one in told.statuses))
    assert counts == [(0, 0), (1, 0), (2, 0), (2, 1), (3, 1), (4, 1)]
    assert {running for *_, running in told.statuses} == {(), ("go(a)",), ("go(b)",)}


def test_a_pause_does_not_use_up_the_time_of_a_plan(tmp_path: Path) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text("actions: {go: {params: [place], duration: 5}}\nname: tour\ntimeout: 20\nplan: [go: {place: a}, go: {place: b}]\n")
    (plan,) = read_plans(file).values()
    runner = PlanRunner({"tour": Program.of(plan)}, simulated_backend(plan, merge_bindings([plan])), KnowledgeBase())
    over: list[Code] = []

    class Told(TaskListener):
        def ended(self, task: UUID, ending: TaskEnding) -> None:
            over.append(ending.code)

    async def go() -> None:
        await runner.backend.open(runner.world)
        master = TaskManager(NOTHING, runner, Settings(), _no_goal)
        master.listen(Told())
        master.begin(Wanted(UUID(int=1), "tour", is_plan=True))
        await asyncio.sleep(1.0)
        await master.pause(UUID(int=1), at_once=True)
        await asyncio.sleep(100.0)
        await master.resume(UUID(int=1))
        await asyncio.sleep(15.0)
        await master.close()
        await runner.backend.close()

    run_async(go(), virtual=True)
    assert over == [Code.GOAL_REACHED]


def _no_goal(text: str) -> Condition:
    raise InputError(f"not a goal: {text!r}")


def test_a_world_begins_as_all_of_its_plans_say(tmp_path: Path) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text("one: {facts: [(open door1)], plan: []}\ntwo: {facts: [(open door1), (= (n) 2)], plan: []}\n")
    assert initial_knowledge(*read_plans(file).values()).facts() == {("open", "door1"): True, ("n",): 2.0}
    file.write_text("one: {facts: [(open door1)], plan: []}\ntwo: {facts: [(not (open door1))], plan: []}\n")
    with pytest.raises(InputError, match=r"one and two begin with different values of \(open door1\): True, False"):
        initial_knowledge(*read_plans(file).values())
