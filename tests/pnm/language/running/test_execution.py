"""Plans in YAML, carried out: what the original implementation is known to do with its own examples, and what it gets wrong.

The files are written anew; what happens is what was seen when the original ran.
"""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from pnm.core.logic.computed_values import Layer
from pnm.core.machine.requests import Outcome, OutcomeKind, Request
from tests.support.runs.direct import Answer, Trace, answering_with, drive, succeed
from tests.support.yaml.examples import COUNTING, NESTED, PAPER_DOMAIN, PAPER_PLAN
from tests.support.yaml.programs import only_plan


def run_text(text: str, answer: Answer = succeed, known: Mapping[str, object] | None = None) -> Trace:
    plan = only_plan(text)
    return drive(plan.graph, answer, bindings=plan.bindings, variables=plan.variables, known=known, on_failure=plan.on_failure)


def results(**fields: object) -> Answer:
    """Answer that all went well, each action with a result of one field: a value, or a function of the goal."""

    def answer(request: Request) -> Outcome:
        found = fields.get(request.action.name)
        return Outcome(OutcomeKind.SUCCEEDED, found(request.goal) if callable(found) else {})

    return answer


# --- what was seen when the original ran ---------------------------------------------------


def test_the_listings_of_the_paper() -> None:
    text = PAPER_DOMAIN.rstrip(".\n") + "\n" + PAPER_PLAN
    trace = run_text(text, results(dummy_server=lambda goal: {"time": goal["value"]}))
    assert trace.result.goal, trace.result.reason
    assert [(name, goal.get("value", goal.get("time"))) for name, goal in trace.sent] == [
        ("dummy_server", 3),
        ("wait", 3),
        ("wait", 3),
        ("wait", 5),
        ("wait", 6),
    ]


def test_a_loop_counts_from_5_to_10() -> None:
    trace = run_text(COUNTING, results(echo=lambda goal: {"result": goal["value"]}, add_one=lambda goal: {"result": goal["value"] + 1}))
    assert trace.result.goal, trace.result.reason
    assert [goal["value"] for _, goal in trace.sent] == [5, 5, 6, 7, 8, 9]
    assert trace.run.knowledge.local.variables() == {"value": 10, "result": 10}


ONE = "actions: {a: , b: }\nplan: [a: ]\n"
FORK = "actions: {a: , b: }\nplan: [concurrent_actions: [a: , b: ]]\n"


@pytest.mark.parametrize(
    ("text", "kinds", "goal"),
    [
        (ONE, {"a": ["aborted"]}, False),
        (ONE, {"a": ["canceled"]}, True),
        (ONE, {"a": ["succeeded"]}, True),
        (FORK, {"a": ["aborted"]}, False),
        (FORK, {"a": ["aborted"], "b": ["aborted"]}, False),
        (FORK, {"a": ["canceled"]}, True),
        ("actions: {}\nplan: []\n", {}, True),
    ],
)
def test_how_single_outcomes_end(text: str, kinds: dict[str, list[str]], goal: bool) -> None:
    """A fork of which one branch fails has failed here; the original says nothing then."""
    assert run_text(text, answering_with(**kinds)).result.goal is goal


def test_a_precondition_that_is_false_is_a_failure() -> None:
    trace = run_text("actions: {a: {preconditions: {Exists: [LocalQuery: x]}}}\nplan: [a: ]\n")
    assert not trace.result.goal
    assert trace.sent == []


def test_effects_that_hold_already_spare_the_action_even_if_its_precondition_is_false() -> None:
    text = (
        "actions: {a: {preconditions: {Exists: [Query: nothing]}, effects: {Query: done}}}\ninitial_knowledge: {done: true}\nplan: [a: ]\n"
    )
    trace = run_text(text)
    assert trace.result.goal
    assert trace.sent == []


def test_values_that_a_step_gives_are_not_seen_by_preconditions() -> None:
    assert not run_text("actions: {a: {params: [x], preconditions: {Exists: [LocalQuery: x]}}}\nplan: [a: {x: 1}]\n").result.goal


# --- where the original fails --------------------------------------------------------------


def test_effects_that_never_come_are_waited_for_three_times() -> None:
    trace = run_text("actions: {a: {effects: {Exists: [LocalQuery: result]}}}\nplan: [a: ]\n")
    assert not trace.result.goal
    assert trace.actions == ["a"] * 4


def test_a_value_that_nobody_has_is_a_failure_by_name() -> None:
    trace = run_text("actions: {a: {params: [speed]}}\nplan: [a: ]\n")
    assert not trace.result.goal
    assert "speed" in trace.result.reason


def test_queries_in_what_a_step_gives_are_answered() -> None:
    step = "a: {x: {Operation: [add, [{Query: n}, 1]]}, y: [{LocalQuery: n}]}"
    ((_, goal),) = run_text(f"actions: {{a: {{params: [x, y]}}}}\ninitial_knowledge: {{n: 4}}\nplan: [{step}]\n").sent
    assert (goal["x"], goal["y"]) == (5, [4])


def test_operations_in_operations_are_computed() -> None:
    operation = "{LocalUpdate: [n, {Operation: [add, [{Operation: [add, [{Query: n}, 1]]}, 1]]}]}"
    text = f"actions: {{k: {{type: kb_action}}}}\ninitial_knowledge: {{n: 1}}\nplan: [k: {{operation: {operation}}}]\n"
    assert run_text(text).run.knowledge.local.variable("n") == 3


def test_an_operation_on_knowledge_changes_a_list() -> None:
    operation = "{Operation: [setitem, [{LocalQuery: l}, 0, 9]]}"
    text = f"actions: {{k: {{type: kb_action}}}}\ninitial_knowledge: {{l: [1, 2]}}\nplan: [k: {{operation: {operation}}}]\n"
    assert run_text(text).run.knowledge.local.variable("l") == [9, 2]


def test_others_are_asked_and_told() -> None:
    text = """\
actions: {k: {type: kb_action}}
initial_knowledge: {place: coffee}
plan:
  - k:
      operation:
        LocalUpdate:
          - place
          - RemoteQuery:
              - RemoteQuery: [{LocalQuery: place}, {kind: class}]
              - {status: which}
  - k: {operation: {RemoteUpdate: [CONTROLLER, "", {status: end, value: {LocalQuery: place}}]}}
"""
    trace = run_text(text, known={"coffee": "shops", "shops": "the one upstairs"})
    assert trace.result.goal, trace.result.reason
    assert [(question.name, question.layer, question.meta) for question in trace.asked] == [
        ("coffee", Layer.GLOBAL, '{"kind": "class"}'),
        ("shops", Layer.GLOBAL, '{"status": "which"}'),
    ]
    ((told, value),) = trace.told
    assert (told.name, value, told.meta) == ("CONTROLLER", "", '{"status": "end", "value": "the one upstairs"}')


# --- what the paper promises ---------------------------------------------------------------


def test_blocks_in_blocks() -> None:
    trace = run_text(NESTED)
    assert trace.result.goal, trace.result.reason
    assert sorted(trace.actions) == ["a"] * 4 + ["b"] * 2 + ["c"]
    numbers = [goal["i"] for name, goal in trace.sent if name == "a"]
    assert numbers.index(2) < numbers.index(3)
    assert numbers[-1] == 4


def test_a_chain_of_recovery_knows_what_the_call_was_given() -> None:
    text = """\
actions:
  move:
    params: "?r ?speed"
    recoveries: {during: {aborted: {do: [say: {text: ["?r", "?speed"]}, retry], times: 2}}}
  say: {params: [text]}
initial_knowledge: {speed: 7}
plan: [move: {r: r1}]
"""
    trace = run_text(text, answering_with(move=["aborted", "aborted"]))
    assert trace.result.goal, trace.result.reason
    assert trace.actions == ["move", "say", "move", "say", "move"]
    assert trace.sent[1][1]["text"] == ["r1", 7]


def test_a_step_stores_its_result_where_it_says() -> None:
    text = "actions: {a: {store: {x: other}}}\nplan: [{a: , store: {x: mine}}, a: ]\n"
    trace = run_text(text, results(a=lambda goal: {"x": 1}))
    assert trace.run.knowledge.local.variables() == {"mine": 1, "other": 1}
