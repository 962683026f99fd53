"""Hand-written plans carried out on simulated robots: parameters, plans that call plans, limits, replanning."""

from __future__ import annotations

import asyncio
from pathlib import Path
from uuid import uuid4

import pytest

from planner_bridge.model.world import simulated_backend
from planner_bridge.pipeline.achieve import carry_out
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import Layer, Question
from pnm.core.machine.bindings import Binding, Bindings
from pnm.errors import InputError
from pnm.knowledge.source import Asker, MemoryKnowledge
from pnm.language.plan import chosen_plan, merge_bindings, read_plans
from pnm.language.runner import PlanRunner, Program, check_values
from tests.support.files import ROOT, written
from tests.support.yaml.run_plans import GUIDE, PATROL


def test_a_plan_calls_another_with_knowledge_of_its_own(tmp_path: Path) -> None:
    result = carry_out(written(tmp_path, GUIDE), parameters={"shop": "pharmacy"})
    assert result.goal_reached, result.reason
    assert [(call.call.action.name, call.call.action.arguments) for call in result.calls] == [
        ("go", ("door",)),
        ("inner", ("pharmacy",)),
        ("say", ()),
    ]
    assert result.variables == {"shop": "pharmacy", "told": "pharmacy", "heard": "pharmacy"}


def test_a_plan_that_is_called_and_fails_says_why(tmp_path: Path) -> None:
    broken = Faults((Fault("go(pharmacy)", FaultKind.ABORT),))
    result = carry_out(written(tmp_path, GUIDE), parameters={"shop": "pharmacy"}, faults=broken)
    assert [call.attempts for call in result.calls if call.call.action.name == "inner"] == [1], "a called plan is not tried again by itself"
    (failure,) = result.failures
    assert (str(failure.call), failure.cause) == ("inner(pharmacy)#1", "aborted")
    assert "go(pharmacy)#1: aborted" in failure.observed


@pytest.mark.parametrize(
    "somewhere",
    [
        pytest.param(GUIDE.replace("params: [shop]", "params: [shop]\n  initial_knowledge: {shop: null}"), id="null-is-a-value"),
        pytest.param(GUIDE.replace("  params: [shop]\n", ""), id="parameters-that-are-not-declared"),
        pytest.param(GUIDE.replace("duration: 5}", "duration: 5, ask: {shop: Where to}}"), id="a-person-may-be-asked"),
        pytest.param(
            GUIDE.replace("duration: 5}", "duration: 5, ask: {place: Where to}}").replace(
                "- go: {place: door}", "- go: {place: {LocalQuery: shop}}"
            ),
            id="a-person-may-be-asked-in-its-place",
        ),
    ],
)
def test_a_plan_begins_without_values_that_it_may_have_later(tmp_path: Path, somewhere: str) -> None:
    assert somewhere != GUIDE
    (plan,) = (plan for plan in read_plans(written(tmp_path, somewhere)).values() if plan.name == "outer")
    knowledge = Layered(KnowledgeBase(), KnowledgeBase(variables=plan.variables))
    run_async(check_values(plan, knowledge, None, Asker(uuid4())), virtual=True)


def test_a_parameter_may_be_in_the_global_knowledge(tmp_path: Path) -> None:
    plan = read_plans(written(tmp_path, GUIDE))["outer"]
    source, asker = MemoryKnowledge(), Asker(uuid4())

    async def scene() -> None:
        with pytest.raises(InputError, match="outer needs a value for its parameter 'shop'"):
            await check_values(plan, Layered(KnowledgeBase()), source, asker)
        await source.update(Question("shop", Layer.GLOBAL, "null"), "bakery", asker)
        await check_values(plan, Layered(KnowledgeBase()), source, asker)

    run_async(scene(), virtual=True)


def test_a_plan_has_a_limit(tmp_path: Path) -> None:
    slow = GUIDE.replace("timeout: 60", "timeout: 3")
    result = carry_out(written(tmp_path, slow), parameters={"shop": "pharmacy"})
    (failure,) = result.failures
    assert failure.cause == "aborted"
    assert "the plan's limit of 3 s is reached" in failure.observed


def test_a_plan_that_is_called_may_take_long(tmp_path: Path) -> None:
    slow = GUIDE.replace("duration: 5", "duration: 5000").replace("timeout: 60", "timeout: 80000")
    assert carry_out(written(tmp_path, slow), parameters={"shop": "pharmacy"}).goal_reached


def test_of_several_plans_one_is_named(tmp_path: Path) -> None:
    two = GUIDE.replace("    - inner: {place: {LocalQuery: shop}}\n", "")
    with pytest.raises(InputError, match="there are several plans; expected --name and one of outer, inner"):
        chosen_plan(read_plans(written(tmp_path, two)), None)


def runner_of(tmp_path: Path, name: str) -> PlanRunner:
    plans = read_plans(written(tmp_path, GUIDE))
    backend = simulated_backend(plans[name], merge_bindings(plans.values()))
    return PlanRunner({name: Program.of(plan) for name, plan in plans.items()}, backend, KnowledgeBase(), MemoryKnowledge())


def test_two_runs_of_a_plan_go_on_side_by_side_with_their_own_knowledge(tmp_path: Path) -> None:
    runner = runner_of(tmp_path, "inner")

    async def both() -> None:
        await runner.backend.open(runner.world)
        one, two = (runner.prepare_run("inner", {"place": place}) for place in ("a", "b"))
        running = asyncio.gather(runner.execute(one), runner.execute(two))
        await asyncio.sleep(1)
        (request,) = one.executor.run.open_requests
        knowledge, asker = runner.knowledge_of(request) or pytest.fail("nobody knows the request")
        assert (knowledge, asker) == (one.executor.run.knowledge, Asker(one.executor.run.id, "inner"))
        assert request.bytes[:4] == runner.prefix
        await running
        assert runner.knowledge_of(request) is None
        assert (one.results, two.results) == ({"told": "a"}, {"told": "b"})
        assert asyncio.get_running_loop().time() == pytest.approx(5.0, abs=0.1)
        await runner.backend.close()

    run_async(both(), virtual=True)


def test_cancelling_a_plan_cancels_the_plan_it_calls(tmp_path: Path) -> None:
    runner = runner_of(tmp_path, "outer")

    async def stopped() -> None:
        await runner.backend.open(runner.world)
        outer = runner.prepare_run("outer", {"shop": "pharmacy"})
        running = asyncio.ensure_future(runner.execute(outer))
        await asyncio.sleep(7)
        assert [one.name for one in runner.going_on] == ["outer", "inner"]
        assert outer.executor.running == (("inner(pharmacy): go(pharmacy)", ""),)
        outer.executor.stop()
        result = await running
        assert not result.goal
        assert [one.outcome for one in result.calls if one.call.action.name == "inner"] == ["canceled"]
        assert runner.going_on == []
        assert asyncio.get_running_loop().time() == pytest.approx(7.0, abs=0.1)
        await runner.backend.close()

    run_async(stopped(), virtual=True)


def test_what_files_get_wrong_is_told(tmp_path: Path) -> None:
    heard: list[str] = []
    mended = "...\n" + GUIDE
    carry_out(written(tmp_path, mended), parameters={"shop": "a"}, warn=lambda found: heard.extend(one.message for one in found))
    assert heard


def test_bindings_of_a_file_come_before_those_of_the_domain(tmp_path: Path) -> None:
    plan = read_plans(written(tmp_path, PATROL.replace("    duration: 3\n", "    duration: 3\n    server: drive\n")))["patrol"]
    action = plan.graph.calls[0].action
    assert plan.bindings.server(action) == "drive"
    assert Bindings({"move": Binding(server="walk")}).before(plan.bindings).server(action) == "walk"


@pytest.mark.parametrize("times", ["abc", "12 times", float("nan")])
def test_a_parameter_of_another_kind_fails_the_loop_that_counts_with_it(times: object) -> None:
    result = carry_out(ROOT / "domains/delivery/plans/errands.yaml", "round_trip", {"robot": "r1", "times": times})
    assert not result.goal_reached
    (failure,) = result.failures
    assert failure.cause == "condition_unknown"
    assert "local[times] is " in failure.observed
