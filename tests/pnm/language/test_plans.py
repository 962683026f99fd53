"""Plans in YAML: their shapes, recoveries, bounds; and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from pnm.core.logic.computed_values import Layer, Literal, Operation, Update
from pnm.core.logic.conditions import TRUE, Computed, Holds
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import EMPTY, ActionCall, Loop, Then
from pnm.errors import InputError
from pnm.language import parse_plans, read_plans, to_plan_graph
from pnm.language.to_plan_graph import MAX_NESTING
from tests.support.files import refused
from tests.support.yaml.examples import RECIPES, RECOVERING
from tests.support.yaml.formulas import q
from tests.support.yaml.plan_reading import ACTIONS
from tests.support.yaml.programs import only_plan

BAD_INPUT = Path(__file__).with_name("refused")


def test_a_plan_may_stand_in_a_document_of_its_own() -> None:
    plan = only_plan("actions: {a: }\n---\ninitial_knowledge: {x: 1}\nplan: [a: {}]\n")
    assert (plan.name, plan.variables) == ("plan", {"x": 1})


def test_recipes_have_the_names_of_their_plans() -> None:
    plans = parse_plans(RECIPES)
    assert list(plans) == ["first", "second"]
    assert plans["first"].variables == {"value": 5}
    assert plans["second"].graph.steps == ()
    _, loop = plans["first"].graph.steps
    assert isinstance(loop, Loop)
    assert loop.condition == Computed(Operation("ne", (q("value"), Literal.of(10))))
    assert loop.limit == 1000
    assert [str(step) for step in loop.body.steps] == ["a()#1", "b()#2"]
    assert isinstance(loop.body.steps[1], ActionCall)
    assert loop.body.steps[1].action.operation == Update(Literal.of("value"), q("result"), meta=Literal.of(""))


def test_a_plan_names_the_file_of_its_domain(tmp_path: Path) -> None:
    (tmp_path / "domains").mkdir()
    (tmp_path / "domains" / "d.yaml").write_text("actions: {a: }\nignored_plan: {plan: [a: ]}\n")
    (tmp_path / "plan.yaml").write_text("domain: domains/d.yaml\nname: mine\nplan: [a: ]\n")
    assert list(read_plans(tmp_path / "plan.yaml")) == ["mine"]
    (tmp_path / "plan.yaml").write_text("domain: nowhere.yaml\nplan: []\n")
    with pytest.raises(InputError, match=r"plan.yaml:1:9: there is no file 'nowhere.yaml' beside this one"):
        read_plans(tmp_path / "plan.yaml")


def test_what_a_plan_says_besides_its_steps() -> None:
    plan = only_plan(
        """\
name: fetch
params: [what, "?where - place"]
results: [found]
initial_knowledge: {on: true, list: [1, {a: "?x"}], text: (at r1 hall)}
facts: [(free r1), (= (battery r1) 80)]
goal: (free r1)
timeout: 90
on_failure: cancel
resources: {arm: 2, floor: }
actions: {a: {resources: [arm, floor]}}
types: place - object
constants: hall - place
predicates: ['(free ?r)', '(battery ?r)']
problem: {objects: r1, init: [(= (battery r1) 20), (free hall)], goal: (free hall)}
plan: []
"""
    )
    assert (plan.parameters, plan.results, plan.timeout, plan.on_failure) == (("what", "where"), ("found",), 90.0, OnFailure.CANCEL)
    assert plan.variables == {"on": True, "list": [1, {"a": "?x"}], "text": "(at r1 hall)"}
    assert plan.facts == {("battery", "r1"): 80.0, ("free", "hall"): True, ("free", "r1"): True}
    assert plan.goal == Holds(("free", "r1"))
    assert plan.graph.capacities == {"arm": 2, "floor": 1}
    assert plan.objects["place"] == ("hall",)


def test_the_goal_is_that_of_the_problem_if_the_plan_has_none() -> None:
    assert only_plan("actions: {}\nproblem: {goal: (done)}\nplan: []\n").goal == Holds(("done",))
    assert only_plan("actions: {}\nplan: []\n").goal == TRUE


# --- recoveries ---


def test_recoveries() -> None:
    plan = only_plan(RECOVERING)
    moves = [one for one in plan.graph.calls if one.action.name == "move"]
    aborted, preempted, *usual = moves[0].recoveries
    assert (aborted.causes, aborted.then, aborted.times) == ({Cause.ABORTED}, Then.RETRY, 1)
    assert (preempted.causes, preempted.then, preempted.chain) == ({Cause.CANCELED}, Then.FAIL, EMPTY)
    assert usual == []
    said = [recovery.chain.steps[0].action.given for move in moves[:3] for recovery in move.recoveries[:1]]  # type: ignore[union-attr]
    assert [str(given[0][1]) for given in said] == ['["stuck", "r1"]', '["stuck", all[robot]]', '["stuck", all[r]]']
    tired, other, lost, timed_out, after, _ = moves[3].recoveries
    assert (tired.causes, tired.when, tired.times, tired.then) == ({Cause.BEFORE}, Computed(q("tired", Layer.ALL)), 2, Then.SKIP)
    assert (other.causes, other.then, other.times) == ({Cause.PRECONDITION_FALSE, Cause.DATA_MISSING}, Then.RESTART_PLAN, 4)
    assert (after.causes, after.then) == ({Cause.EFFECTS_MISSING}, Then.RETRY)
    assert (lost.causes, lost.then, lost.times, len(lost.chain.steps), len(lost.chain.orderings)) == ({Cause.LOST}, Then.REPLAN, 5, 2, 1)
    assert (timed_out.causes, timed_out.then) == ({Cause.TIMED_OUT}, Then.CONTINUE)
    assert [(one.causes, one.then) for one in moves[4].recoveries] == [({Cause.CANCELED}, Then.CONTINUE)]
    assert generate(plan.graph, plan.bindings)


def test_conditions_of_recoveries_speak_of_the_call() -> None:
    text = "actions: {a: {params: [r], recoveries: {before: {when: '(low ?r)', do: [skip_action]}}}}\nplan: [a: {r: r1}, a: ]\n"
    assert [one.recoveries[0].when for one in only_plan(text).graph.calls] == [Holds(("low", "r1")), Holds(("low", "?r"))]


# --- plans that call plans ---


def test_plans_call_each_other_like_actions() -> None:
    plans = parse_plans(
        """\
actions: {a: }
outer: {plan: [inner: {x: 1}, free: {whatever: 2}]}
inner: {params: [x, y], plan: [a: ]}
free: {plan: [a: ]}
"""
    )
    assert plans["outer"].calls == {"inner", "free"}
    assert [str(one) for one in plans["outer"].graph.calls] == ["inner(1, ?y)#0", "free(2)#1"]
    assert plans["outer"].bindings.of("inner").retries == 0
    assert (plans["inner"].parameters, plans["free"].parameters) == (("x", "y"), None)


WRONG = [
    *refused(BAD_INPUT / "plans.yaml"),
    ("", "2:1: there is no plan in the file; expected the key 'plan'"),
    ("plan: [{any: , id: x, after: [y]}, {any: , id: y, after: [x]}]", "1:8: steps wait for each other: "),
    ("x: {plan: [y: ]}\ny: {plan: [z: ]}\nz: {plan: [x: ]}", "the plan would never end: "),
]


# --- what is wrong ---


@pytest.mark.parametrize(("text", "message"), WRONG)
def test_what_is_wrong_with_a_plan(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_plans(f"{text}\n{ACTIONS}")
    assert message in str(caught.value), str(caught.value)
    assert caught.value.position is not None


def test_objects_are_checked_against_their_types() -> None:
    head = "types: robot place - object\nconstants: [r1 - robot, on hall - place]\n"
    assert only_plan(f"{head}{ACTIONS}plan: [go: {{r: r1, to: on}}]\n")
    for given, message in (
        ("{to: true}", "to of go is the name of an object, not true; write 'true' with quotes"),
        ("{to: r1}", r"there is no object for to of go \(one of type place\) 'r1' here; expected one of: hall, on"),
        ("{r: r2}", r"there is no object for r of go \(one of type robot\) 'r2' here; expected one of: r1"),
    ):
        with pytest.raises(InputError, match=message):
            only_plan(f"{head}{ACTIONS}plan: [go: {given}]\n")


def test_recovering_that_would_need_itself_is_refused() -> None:
    text = "actions: {a: {recoveries: {during: {lost: [b: , fail]}}}, b: {recoveries: {during: {lost: [a: , fail]}}}}\nplan: [a: ]\n"
    with pytest.raises(InputError, match="to recover would never end: a, which uses b, which uses a; give this step recoveries of its own"):
        only_plan(text)
    only_plan(text.replace("[a: , fail]", "[{a: , recoveries: {}}, fail]"))


def test_what_is_wrong_with_recoveries_of_actions_is_told_even_if_they_are_not_called() -> None:
    with pytest.raises(InputError, match=r":1:44: there is no action 'b' here"):
        only_plan("actions: {a: {recoveries: {during: {lost: [b: , fail]}}}}\nplan: []\n")


@pytest.mark.parametrize(
    ("levels", "calls", "message"),
    [(7, 2, "the plan has more than 100 steps, those of recoveries included"), (MAX_NESTING + 1, 1, f"nested deeper than {MAX_NESTING}")],
)
def test_the_number_of_steps_and_the_depth_of_recoveries_are_bounded(
    monkeypatch: pytest.MonkeyPatch, levels: int, calls: int, message: str
) -> None:
    monkeypatch.setattr(to_plan_graph, "MAX_STEPS", 100)
    chains = (f"[{f'a{n + 1}: , ' * calls}fail]" for n in range(levels))
    actions = "".join(f"  a{n}: {{recoveries: {{during: {{lost: {chain}}}}}}}\n" for n, chain in enumerate(chains))
    with pytest.raises(InputError, match=message):
        only_plan(f"actions:\n{actions}  a{levels}:\nplan: [a0: ]\n")


TOO_LONG = (f"domain: {'a' * 300}.yaml\nplan: []", f"1:9: there is no file '{'a' * 200}' beside this one")


@pytest.mark.parametrize(("text", "message"), [*refused(BAD_INPUT / "servers.yaml"), TOO_LONG])
def test_names_that_there_cannot_be_are_refused_where_they_stand(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "plan.yaml").write_text(text)
    with pytest.raises(InputError) as caught:
        read_plans(tmp_path / "plan.yaml")
    assert str(caught.value) == f"{tmp_path / 'plan.yaml'}:{message.strip()}"
