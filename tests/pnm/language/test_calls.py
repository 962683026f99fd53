"""What calls in plans are given."""

from __future__ import annotations

from math import inf
from pathlib import Path

import pytest

from pnm.core.logic.computed_values import Layer, Literal
from pnm.core.logic.conditions import Compare, Holds
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant, ValueOf
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import Moment
from pnm.core.machine.verification.verify import verify
from pnm.errors import InputError
from tests.support.files import refused
from tests.support.yaml.formulas import q
from tests.support.yaml.plan_reading import ACTIONS, call_of, orderings
from tests.support.yaml.programs import only_plan

BAD_INPUT = Path(__file__).with_name("refused")


def test_what_is_given_goes_into_conditions_and_effects() -> None:
    action = call_of(only_plan(f"{ACTIONS}plan: [go: {{r: r1, to: hall}}]\n")).action
    assert (action.parameters, action.arguments) == (("r", "to"), ("r1", "hall"))
    assert action.precondition == Holds(("free", "r1"))
    assert action.end_effects == (Set(("at", "r1", "hall"), Constant(True)),)
    assert action.given == (("r", Literal.of("r1")), ("to", Literal.of("hall")))


def test_what_is_not_given_stays_open() -> None:
    action = call_of(only_plan(f"{ACTIONS}plan: [go: {{to: {{Query: goal}}}}]\n")).action
    assert action.arguments == ("?r", "?to")
    assert action.given == (("to", q("goal", Layer.ALL)),)
    assert action.precondition == Holds(("free", "?r"))


def test_without_declared_parameters_a_step_gives_what_it_likes() -> None:
    action = call_of(only_plan(f"{ACTIONS}plan: [any: {{x: 1, y: [2], z: {{a: {{Query: b}}}}}}]\n")).action
    assert (action.parameters, action.arguments) == (("x", "y", "z"), ("1", "?y", "?z"))


def test_numbers_are_numbers_in_conditions_and_effects() -> None:
    plan = only_plan(
        """\
actions:
  fill:
    params: "?t ?by ?unit"
    preconditions: [{Comparison: ["=", ["(level ?t)", "?by"]]}, {Comparison: [lt, [{Query: x}, "?by"]]}, "(scale ?by ?unit)"]
    effects:
      - increase: ["(level ?t)", "?by"]
      - increase: [(total), {Operation: ["*", ["?by", "(price ?unit)"]]}]
      - forall: {variables: "?by", effects: "(seen ?by)"}
    duration: "?by"
plan: [fill: {t: tank, by: 2.5, unit: litre}]
"""
    )
    action = call_of(plan).action
    assert action.arguments == ("tank", "2.5", "litre")
    assert action.precondition.operands[0] == Compare("=", ValueOf(("level", "tank")), Constant(2.5))  # type: ignore[union-attr]
    assert str(action.precondition.operands[1]) == "lt(all[x], 2.5)"  # type: ignore[union-attr]
    assert action.precondition.operands[2] == Holds(("scale", "2.5", "litre"))  # type: ignore[union-attr]
    assert list(map(str, action.end_effects)) == [
        "(increase (level tank) 2.5)",
        "(increase (total) (* 2.5 (price litre)))",
        "(forall (?by - object) (seen ?by))",
    ]
    assert action.duration == 2.5


def test_durations_are_known_if_facts_at_the_beginning_tell_them() -> None:
    text = """\
actions:
  move: {params: "?a ?b", duration: {Operation: ["/", ["(distance ?a ?b)", 2]]}, effects: {increase: [(time), "?duration"]}}
  rest: {duration: [{">=": 3}, {"<=": 9}]}
  nod: {duration: [{"=": 3}]}
facts: [(= (distance x y) 10)]
plan: [move: {a: x, b: y}, move: {a: y, b: x}, rest: , nod: ]
"""
    plan = only_plan(text)
    assert [one.action.duration for one in plan.graph.calls] == [5.0, None, None, 3.0]
    assert call_of(plan).action.end_effects == (Set(("time",), Constant(5.0), "increase"),)


def test_a_text_that_looks_like_a_parameter_is_not_put_into_facts() -> None:
    action = call_of(only_plan("actions: {a: {params: [x], preconditions: '(p ?x)'}}\nplan: [a: {x: {Literal: '?y'}}]\n")).action
    assert (action.arguments, action.precondition) == (("?x",), Holds(("p", "?x")))


def test_actions_on_knowledge_have_the_parameters_they_use() -> None:
    plan = only_plan(
        f"{ACTIONS}plan: [set: {{operation: {{LocalUpdate: [a, 1]}}}}, set: {{operation: {{LocalUpdate: [a, '?value']}}, unused: 3}}]\n"
    )
    assert [one.action.parameters for one in plan.graph.calls] == [(), ("value", "unused")]
    assert call_of(plan).action.given == ()
    assert [one.recoveries for one in plan.graph.calls] == [(), ()]


def test_options_of_a_step() -> None:
    plan = only_plan(
        """\
actions: {a: {retries: 4, timeout: 9, resources: [arm]}, timeout: }
plan:
  - a:
    retries: 1
    timeout: 2.5
    resources: [arm, floor]
    store: {result: mine}
  - a:
  - timeout: {x: 1}
"""
    )
    first, second, third = plan.graph.calls
    assert (first.retries, first.timeout, first.action.resources, first.store) == (1, 2.5, ("arm", "floor"), (("result", "mine"),))
    assert (second.retries, second.timeout, second.action.resources, second.store) == (4, None, ("arm",), ())
    assert (third.action.name, third.timeout, third.retries) == ("timeout", None, 0)
    assert plan.bindings.of("a").timeout == 9.0


def test_a_step_that_names_none_waits_for_all_before_it_that_do_not_wait_for_it() -> None:
    light = f"""\
{ACTIONS}plan:
  - {{go: , id: light, end_after: [look]}}
  - {{go: , after: [{{start: light}}]}}
  - {{go: }}
  - {{go: , id: look}}
  - {{go: }}
"""
    ends = {pair for pair in orderings(only_plan(light)) if 0 not in pair}
    assert ends == {(1, 2), (2, 3)}
    assert (0, 4) in orderings(only_plan(light))


def test_starts_ends_and_times_are_waited_for() -> None:
    plan = only_plan(
        f"""\
{ACTIONS}plan:
  - go:
    id: one
    end_after: [two, {{start: three}}]
  - go:
    id: two
    after: [{{start: one}}]
    release: 3
    deadline: 60
  - go:
    id: three
    after: [{{end: two, delay: 2.5}}]
"""
    )
    start, end = Moment.START, Moment.END
    told = [((one.before.call, one.before.moment), (one.after.call, one.after.moment), one.delay) for one in plan.graph.orderings]
    assert told == [((1, end), (0, end), 0.0), ((2, start), (0, end), 0.0), ((0, start), (1, start), 0.0), ((1, end), (2, start), 2.5)]
    assert [(call.release, call.deadline, bool(call.recoveries)) for call in plan.graph.calls] == [
        (0.0, inf, False),
        (3.0, 60.0, True),
        (0.0, inf, False),
    ]
    verify(generate(plan.graph, plan.bindings))


@pytest.mark.parametrize(
    ("steps", "message"),
    [*refused(BAD_INPUT / "orderings.yaml"), ("{go: , id: a, end_after: [b]}, {go: , id: b, after: [a]}", "steps wait for each other: ")],
)
def test_what_cannot_be_waited_for(steps: str, message: str) -> None:
    with pytest.raises(InputError) as raised:
        only_plan(f"{ACTIONS}plan: [{steps}]\n")
    assert message in str(raised.value)
