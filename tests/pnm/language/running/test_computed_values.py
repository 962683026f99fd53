"""What plans compute while they are carried out, and what has to be asked first."""

from __future__ import annotations

import asyncio
import json
from math import inf
from pathlib import Path

import pytest

from planner_bridge.model.world import simulated_backend
from planner_bridge.pipeline.achieve import carry_out
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic import computed_values
from pnm.core.logic.computed_values import Question
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import OnFailure
from pnm.knowledge.source import Asker
from pnm.knowledge.sources import Sources
from pnm.language.plan import read_plans
from pnm.language.runner import PlanRunner, Program
from pnm.tasks import Code
from tests.support.e2e.command_line import pnm
from tests.support.files import written
from tests.support.yaml.run_plans import GUIDE

COMPUTED = """
initial_knowledge: {big: 1%s, list: [1]}
actions: {act: {params: [x]}, note: {type: kb_action}}
plan:
  - %s
"""
NOT_COMPUTED = {
    "the remainder of a text": "{Operation: [mod, ['%99999999999d', 5]]}",
    "no number that JSON can say": "{Operation: [pow, [-8, 0.5]]}",
    "unsupported operand": "{Operation: [truediv, [{Query: big}, a]]}",
    "division by zero": "{Operation: [truediv, [1, 0]]}",
    "as large as that": "{Operation: [mul, [a, {Query: big}]]}",
    "the name of a variable": "{Query: {Query: list}}",
}


@pytest.mark.parametrize("why", NOT_COMPUTED)
def test_what_cannot_be_computed_is_a_failure_of_the_call(tmp_path: Path, why: str) -> None:
    step = "act: {x: %s}" if "the" in why else "note: {operation: {LocalUpdate: [v, %s]}}"
    (failure,) = carry_out(written(tmp_path, COMPUTED % ("0" * 400, step % NOT_COMPUTED[why]))).failures
    assert failure.cause in ("aborted", "data_missing")
    assert why in failure.observed


CONDITIONAL = """
predicates: [(free)]
actions:
  note: {type: kb_action}
  act: {duration: 3, effects: {at_end: [{when: {condition: {Comparison: [eq, [{RemoteQuery: mode}, fast]]}, effects: [(free)]}}]}}
  quick: {effects: [{when: {condition: {Comparison: [eq, [{RemoteQuery: mode}, fast]]}, effects: [(free)]}}]}
goal: (free)
plan:
  - note: {operation: {RemoteUpdate: [mode, fast]}}
  - %s:
"""


@pytest.mark.parametrize("action", ["act", "quick"])
def test_effects_may_depend_on_global_knowledge(tmp_path: Path, action: str) -> None:
    unseen = Settings(bindings=Bindings(assumed=frozenset({"free"})))
    assert carry_out(written(tmp_path, CONDITIONAL % action), settings=unseen).goal_reached


def test_effects_that_depend_on_a_question_do_not_happen_when_the_run_is_stopped(tmp_path: Path) -> None:
    text = "timeout: 2\n" + CONDITIONAL % "act"
    task = carry_out(written(tmp_path, text))
    assert "limit of 2 s" in task.reason
    assert task.code is Code.TIMED_OUT


class Cancelled:
    """A source whose connection was cancelled by somebody else."""

    async def query(self, question: Question, asker: Asker, /) -> object:
        raise asyncio.CancelledError

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        raise asyncio.CancelledError

    async def close(self) -> None:
        """Do nothing."""


@pytest.mark.parametrize("operation", ["{LocalUpdate: [v, {RemoteQuery: w}]}", "{RemoteUpdate: [v, 1]}"])
def test_a_source_that_was_cancelled_by_somebody_else_is_a_failure(tmp_path: Path, operation: str) -> None:
    (plan,) = read_plans(written(tmp_path, f"actions: {{note: {{type: kb_action}}}}\nplan: [note: {{operation: {operation}}}]")).values()
    backend = simulated_backend(plan, plan.bindings)
    runner = PlanRunner({plan.name: Program.of(plan)}, backend, KnowledgeBase(), Sources([Cancelled()]))

    async def performed() -> None:
        await backend.open(runner.world)
        result = await runner.execute(runner.prepare_run(plan.name))
        assert "cannot be" in result.failures[0].observed
        await backend.close()

    run_async(asyncio.wait_for(performed(), 100), virtual=True)


GROWING = """
initial_knowledge: {v: [1]}
actions: {note: {type: kb_action}}
plan:
  - while: {limit: 1000, condition: true, actions: [note: {operation: {LocalUpdate: [v, %s]}}]}
"""


@pytest.mark.parametrize("value", ["[{Query: v}, {Query: v}]", "{again: {Query: v}}", "{Operation: [concat, [{Query: v}, {Query: v}]]}"])
def test_a_value_does_not_grow_without_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    monkeypatch.setattr(computed_values, "MAX_SIZE", 10_000)
    result = carry_out(written(tmp_path, GROWING % value))
    assert [failure.cause for failure in result.failures] == ["aborted"]
    assert len(json.dumps(result.as_json())) < 100_000


FACTS = """
predicates: [(free), (shut)]
functions: [(level)]
facts: [(shut)]
actions: {yes: {params: [x]}, no: {}, note: {type: kb_action}}
plan: [%s]
"""


@pytest.mark.parametrize(
    "condition",
    [
        "{Comparison: [eq, ['(free)', false]]}",
        "{Comparison: [ne, [true, '(free)']]}",
        "{BooleanAssertion: ['(free)', false]}",
        "{BooleanAssertion: ['(shut)', true]}",
        "{Operation: [is_, ['(free)', false]]}",
    ],
)
def test_a_fact_that_nobody_has_recorded_is_false(tmp_path: Path, condition: str) -> None:
    text = FACTS % f"{{if: {condition}, then: [yes: {{x: 1}}], else: [no: ]}}"
    calls = carry_out(written(tmp_path, text)).calls
    assert [call.call.action.name for call in calls] == ["yes"]


def test_a_fact_that_is_given_is_true_or_false(tmp_path: Path) -> None:
    text = FACTS % "yes: {x: ['(free)', '(shut)', {Holds: (free)}]}"
    (call,) = carry_out(written(tmp_path, text)).calls
    assert call.call.action.arguments == ("[false, true, false]",)


@pytest.mark.parametrize("step", ["yes: {x: (level)}", "note: {operation: {LocalUpdate: [v, (level)]}}"])
def test_a_function_without_a_value_is_missing_data(tmp_path: Path, step: str) -> None:
    (failure,) = carry_out(written(tmp_path, FACTS % step)).failures
    assert failure.cause == "data_missing"


def test_a_result_is_json_whatever_is_in_it(tmp_path: Path) -> None:
    result = carry_out(written(tmp_path, COMPUTED % (0, "note: {operation: {LocalUpdate: [v, [{Operation: [mul, [1.0e+308, 10]]}]]}}")))
    assert result.variables["v"] == [inf]
    assert json.loads(json.dumps(result.as_json(), allow_nan=False))["variables"]["v"] == ["inf"]


def test_what_is_wrong_on_the_command_line_is_refused_before_the_plan_begins(tmp_path: Path) -> None:
    done = pnm("run", "--plan", str(written(tmp_path, "plan: []")), "--set", "x=[1, .nan]", "--json")
    assert (done.returncode, done.stdout) == (2, "")
    assert "--set x:1:5: expected a finite number, found .nan" in done.stderr


def test_the_name_of_a_server_needs_its_parameters_whatever_the_goal_has(tmp_path: Path) -> None:
    text = "actions: {go: {params: [r], server: '/{r}/go', goal: {x: 1}}}\nplan: [go: ]"
    (failure,) = carry_out(written(tmp_path, text)).failures
    assert (failure.cause, failure.expected) == ("data_missing", "values for r")


def test_limits_and_policy_of_the_caller_count(tmp_path: Path) -> None:
    file = written(tmp_path, GUIDE)
    settings = Settings(limits=Limits(seconds=7))
    result = carry_out(file, parameters={"shop": "a"}, settings=settings, on_failure=OnFailure.CANCEL)
    assert result.reason == "the plan's limit of 7 s is reached"
    assert result.episodes[0].machine.on_failure is OnFailure.CANCEL
