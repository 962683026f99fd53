"""What plans compute while they are carried out, and what has to be asked first."""

from __future__ import annotations

import asyncio
import json
from io import StringIO
from math import inf
from pathlib import Path

import pytest

from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.options import Files, Output
from planner_bridge.cli.run import run_written
from planner_bridge.model.world import simulated_backend
from planner_bridge.pipeline.carry_out import carry_out
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.computed_values import Question
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import OnFailure
from pnm.errors import InputError
from pnm.knowledge.source import Asker
from pnm.knowledge.sources import Sources
from pnm.language.plan import read_plans
from pnm.language.runner import PlanRunner, Program
from pnm.tasks import Code
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
@pytest.mark.parametrize("step", ["act: {x: %s}", "note: {operation: {LocalUpdate: [v, %s]}}"], ids=["goal", "update"])
def test_what_cannot_be_computed_is_a_failure_of_the_call(tmp_path: Path, step: str, why: str) -> None:
    text = COMPUTED % ("0" * 400, step % NOT_COMPUTED[why])
    task = carry_out(written(tmp_path, text), knowledge=tmp_path / "k.sqlite")
    (failure,) = task.failures
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
    assert carry_out(written(tmp_path, CONDITIONAL % action), settings=unseen, knowledge=tmp_path / "k.sqlite").goal_reached


def test_effects_that_depend_on_a_question_do_not_happen_when_the_run_is_stopped(tmp_path: Path) -> None:
    text = "timeout: 2\n" + CONDITIONAL % "act"
    task = carry_out(written(tmp_path, text), knowledge=tmp_path / "k.sqlite")
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
def test_a_value_does_not_grow_without_limit(tmp_path: Path, value: str) -> None:
    result = carry_out(written(tmp_path, GROWING % value), knowledge=tmp_path / "k.sqlite")
    assert [failure.cause for failure in result.failures] == ["aborted"]
    assert len(json.dumps(result.as_json())) < 10_000_000


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
    calls = carry_out(written(tmp_path, text), knowledge=tmp_path / "k.sqlite").calls
    assert [call.call.action.name for call in calls] == ["yes"]


def test_a_fact_that_is_given_is_true_or_false(tmp_path: Path) -> None:
    text = FACTS % "yes: {x: ['(free)', '(shut)', {Holds: (free)}]}"
    (call,) = carry_out(written(tmp_path, text), knowledge=tmp_path / "k.sqlite").calls
    assert call.call.action.arguments == ("[false, true, false]",)


@pytest.mark.parametrize("step", ["yes: {x: (level)}", "note: {operation: {LocalUpdate: [v, (level)]}}"])
def test_a_function_without_a_value_is_missing_data(tmp_path: Path, step: str) -> None:
    (failure,) = carry_out(written(tmp_path, FACTS % step), knowledge=tmp_path / "k.sqlite").failures
    assert failure.cause == "data_missing"


def test_a_result_is_json_whatever_is_in_it(tmp_path: Path) -> None:
    result = carry_out(written(tmp_path, COMPUTED % (0, "note: {operation: {LocalUpdate: [v, [{Operation: [mul, [1.0e+308, 10]]}]]}}")))
    assert result.variables["v"] == [inf]
    assert json.loads(json.dumps(result.as_json(), allow_nan=False))["variables"]["v"] == ["inf"]


def test_parameters_of_the_command_line_are_finite() -> None:
    given = ("x=[1, .nan]",)
    with pytest.raises(InputError, match=r"--set x:1:5: expected a finite number, found \.nan"):
        run_written(
            Path("no.yaml"), None, given, (), Files(), actions="simulated", settings=Settings(), on_failure=None, output=Output.JSON
        )


def test_a_planner_that_is_not_there_is_refused_before_the_plan_begins(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    none, settings = Files(None, None, None, None), Settings(planner="race:kairoos")
    with pytest.raises(InputError, match=r"'kairoos' cannot take part in a race; .*; did you mean 'kairos'\?"):
        run_written(
            written(tmp_path, "plan: []"), None, (), (), none, actions="simulated", settings=settings, on_failure=None, output=Output.JSON
        )
    assert capsys.readouterr().out == ""


def test_a_terminal_is_told_nothing_that_makes_it_do_something() -> None:
    shown = StringIO()
    SafeConsole(file=shown).print("start\n  go(\x1b[31m\ud800)", markup=False)
    assert shown.getvalue() == "start\n  go(\ufffd[31m\ufffd)\n"


def test_a_plan_that_is_called_is_not_tried_again_by_itself(tmp_path: Path) -> None:
    broken = Faults((Fault("go(pharmacy)", FaultKind.ABORT),))
    task = carry_out(written(tmp_path, GUIDE), parameters={"shop": "pharmacy"}, faults=broken)
    assert [call.attempts for call in task.calls if call.call.action.name == "inner"] == [1]


def test_the_name_of_a_server_needs_its_parameters_whatever_the_goal_has(tmp_path: Path) -> None:
    text = "actions: {go: {params: [r], server: '/{r}/go', goal: {x: 1}}}\nplan: [go: ]"
    (failure,) = carry_out(written(tmp_path, text), knowledge=tmp_path / "k.sqlite").failures
    assert (failure.cause, failure.expected) == ("data_missing", "values for r")


def test_limits_and_policy_of_the_caller_count(tmp_path: Path) -> None:
    file = written(tmp_path, GUIDE)
    settings = Settings(limits=Limits(seconds=7))
    result = carry_out(file, parameters={"shop": "a"}, settings=settings, on_failure=OnFailure.CANCEL)
    assert result.reason == "the plan's limit of 7 s is reached"
    assert result.episodes[0].machine.on_failure is OnFailure.CANCEL
