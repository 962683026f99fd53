"""Hand-written plans carried out on simulated robots: parameters, plans that call plans, limits."""

from __future__ import annotations

import asyncio
import json
from io import StringIO
from math import inf
from pathlib import Path
from uuid import uuid4

import pytest

from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.options import Files
from planner_bridge.cli.run import run_written
from planner_bridge.pipeline import carry_out
from planner_bridge.simulation import simulated_backend
from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.settings import Settings
from pnm.actions.backend import schedule
from pnm.actions.faults import Fault, FaultKind, Faults
from pnm.clock import run_async
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import Layer, Question
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.errors import InputError
from pnm.knowledge.sources.memory import MemoryKnowledge
from pnm.knowledge.sources.router import Sources
from pnm.knowledge.sources.source import Asker
from pnm.language.plan import chosen_plan, merge_bindings, read_plans
from pnm.language.runner import Performer, Program, check_values
from pnm.tasks import Code

GUIDE = """
actions:
  go: {params: [place], duration: 5}
  say: {type: kb_action}
outer:
  params: [shop]
  plan:
    - go: {place: door}
    - inner: {place: {LocalQuery: shop}}
    - say: {operation: {LocalUpdate: [heard, {LocalQuery: told}]}}
inner:
  params: [place]
  results: [told]
  timeout: 60
  plan:
    - say: {operation: {LocalUpdate: [secret, 1]}}
    - go: {}
    - say: {operation: {LocalUpdate: [told, {LocalQuery: place}]}}
"""


def written(folder: Path, text: str) -> Path:
    file = folder / "plan.yaml"
    file.write_text(text, encoding="utf-8")
    return file


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
    (failure,) = result.failures
    assert (str(failure.call), failure.cause) == ("inner(pharmacy)#1", "aborted")
    assert "go(pharmacy)#1: aborted" in failure.observed


def test_a_parameter_that_nobody_gives_is_refused_by_name_before_anything_begins(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^outer needs a value for its parameter 'shop'; expected one such as {shop: …} among the param"):
        carry_out(written(tmp_path, GUIDE))


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


def test_names_of_plans_and_parameters_are_checked(tmp_path: Path) -> None:
    file = written(tmp_path, GUIDE)
    with pytest.raises(InputError, match=r"outer has no parameter 'shp'; did you mean 'shop'\?"):
        carry_out(file, parameters={"shp": 1})
    with pytest.raises(InputError, match="there is no plan 'otter'; expected --name and one of outer, inner"):
        carry_out(file, "otter")
    two = GUIDE.replace("    - inner: {place: {LocalQuery: shop}}\n", "")
    with pytest.raises(InputError, match="there are several plans; expected --name and one of outer, inner"):
        chosen_plan(read_plans(written(tmp_path, two)), None)


def test_two_runs_of_a_plan_go_on_side_by_side_with_their_own_knowledge(tmp_path: Path) -> None:
    plans = read_plans(written(tmp_path, GUIDE))
    backend = simulated_backend(plans["inner"], merge_bindings(plans.values()))
    performer = Performer({name: Program.of(plan) for name, plan in plans.items()}, backend, KnowledgeBase(), MemoryKnowledge())

    async def both() -> None:
        await backend.open(performer.world)
        one, two = (performer.perform("inner", {"place": place}) for place in ("a", "b"))
        running = asyncio.gather(performer.execute(one), performer.execute(two))
        await asyncio.sleep(1)
        (request,) = one.executor.run.open_requests
        knowledge, asker = performer.knowledge_of(request) or pytest.fail("nobody knows the request")
        assert (knowledge, asker) == (one.executor.run.knowledge, Asker(one.executor.run.id, "inner"))
        assert request.bytes[:4] == performer.prefix
        await running
        assert performer.knowledge_of(request) is None
        assert (one.results, two.results) == ({"told": "a"}, {"told": "b"})
        assert asyncio.get_running_loop().time() == pytest.approx(5.0, abs=0.1)
        await backend.close()

    run_async(both(), virtual=True)


def test_cancelling_a_plan_cancels_the_plan_it_calls(tmp_path: Path) -> None:
    plans = read_plans(written(tmp_path, GUIDE))
    backend = simulated_backend(plans["outer"], merge_bindings(plans.values()))
    performer = Performer({name: Program.of(plan) for name, plan in plans.items()}, backend, KnowledgeBase())

    async def stopped() -> None:
        await backend.open(performer.world)
        outer = performer.perform("outer", {"shop": "pharmacy"})
        running = asyncio.ensure_future(performer.execute(outer))
        await asyncio.sleep(7)
        assert [one.program.plan.name for one in performer.going_on] == ["outer", "inner"]
        assert outer.running == ("inner(pharmacy): go(pharmacy)",)
        outer.executor.stop()
        result = await running
        assert not result.goal
        assert [one.outcome for one in result.calls if one.call.action.name == "inner"] == ["canceled"]
        assert performer.going_on == []
        assert asyncio.get_running_loop().time() == pytest.approx(7.0, abs=0.1)
        await backend.close()

    run_async(stopped(), virtual=True)


ROOMS = """
name: rooms
types: [robot room - object]
predicates:
  - (at ?r - robot ?x - room)
  - (way ?x ?y - room)
actions:
  move:
    params: ?r - robot ?from ?to - room
    duration: 3
    preconditions:
      at_start:
        - (at ?r ?from)
        - (way ?from ?to)
    effects:
      at_start:
        - not: (at ?r ?from)
      at_end:
        - (at ?r ?to)
problem:
  objects: r1 - robot a b c - room
  init:
    - (at r1 a)
    - (way a b)
    - (way a c)
    - (way c b)
goal: (at r1 b)
plan:
  - move: {r: r1, from: a, to: b}
    recoveries:
      during: {aborted: [replan]}
"""
BLOCKED = Faults((Fault("move(r1, a, b)", FaultKind.ABORT, times=100),))


def test_a_plan_that_asks_for_it_is_replanned_without_what_has_failed(tmp_path: Path) -> None:
    task = carry_out(written(tmp_path, ROOMS), faults=BLOCKED)
    assert task.goal_reached, task.reason
    assert (task.plans, task.replans) == (1, 1)
    assert [str(call.call.action) for call in task.calls] == ["move(r1, a, b)", "move(r1, a, c)", "move(r1, c, b)"]


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("goal: (at r1 b)\n", "", "no planner can be asked: the plan rooms has no goal"),
        ("    - (way c b)\n", "", "no plan without move(r1, a, b), not to be tried again"),
        ("aborted: [replan]", "aborted: [fail]", "move(r1, a, b)#0: aborted"),
    ],
)
def test_why_no_planner_finds_another_way(tmp_path: Path, old: str, new: str, why: str) -> None:
    assert old in ROOMS
    task = carry_out(written(tmp_path, ROOMS.replace(old, new)), faults=BLOCKED)
    assert not task.goal_reached
    assert why in task.reason


def test_facts_that_nobody_reports_change_by_themselves(tmp_path: Path) -> None:
    text = ROOMS.replace("    - (way c b)\n", "    - (way c b)\n    - {at: 4, facts: [(open)]}\n").replace(
        "  - (at ?r - robot ?x - room)\n", "  - (at ?r - robot ?x - room)\n  - (open)\n"
    )
    (plan,) = read_plans(written(tmp_path, text)).values()
    world = KnowledgeBase(plan.facts, objects=plan.objects)

    async def later() -> None:
        stop = schedule(world, plan.timed, asyncio.get_running_loop().time())
        await asyncio.sleep(3.9)
        assert not world.value(("open",))
        await asyncio.sleep(0.2)
        assert world.value(("open",)) is True
        stop()

    run_async(later(), virtual=True)


def test_what_files_get_wrong_is_told(tmp_path: Path) -> None:
    heard: list[str] = []
    mended = "...\n" + GUIDE
    carry_out(written(tmp_path, mended), parameters={"shop": "a"}, warn=lambda found: heard.extend(one.message for one in found))
    assert heard


def test_bindings_of_a_file_come_before_those_of_the_domain(tmp_path: Path) -> None:
    plan = read_plans(written(tmp_path, ROOMS.replace("    duration: 3\n", "    duration: 3\n    server: drive\n")))["rooms"]
    action = plan.graph.calls[0].action
    assert plan.bindings.server(action) == "drive"
    assert Bindings({"move": Binding(server="walk")}).before(plan.bindings).server(action) == "walk"


# --- what cannot be computed, and what has to be asked first ---

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
    performer = Performer({plan.name: Program.of(plan)}, backend, KnowledgeBase(), Sources([Cancelled()]))

    async def performed() -> None:
        await backend.open(performer.world)
        result = await performer.execute(performer.perform(plan.name))
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
    with pytest.raises(InputError, match=r"expected finite numbers after --set x, found '\[1, .nan\]'"):
        run_written(Path("no.yaml"), None, given, Files(), actions="simulated", settings=Settings(), on_failure=None, as_json=True)


def test_a_planner_that_is_not_there_is_refused_before_the_plan_begins(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    none, settings = Files(None, None, None, None), Settings(planner="race:kairoos")
    with pytest.raises(InputError, match=r"'kairoos' cannot take part in a race; .*; did you mean 'kairos'\?"):
        run_written(written(tmp_path, "plan: []"), None, (), none, actions="simulated", settings=settings, on_failure=None, as_json=True)
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
