"""Bindings against the types of action servers: what can never work is refused, constants of the type have their values."""

from __future__ import annotations

from pathlib import Path

import pytest
from test_msgs.action import Fibonacci, NestedMessage

from pnm.actions.bindings_file import read_bindings
from pnm.core.machine.bindings import Binding
from pnm.errors import InputError
from pnm.ros.node.messages import fitted_binding
from tests.support.files import written


def binding(path: Path, text: str) -> Binding:
    return read_bindings(written(path, f"actions: {{move: {text}}}")).of("move")


@pytest.mark.parametrize(
    "text",
    [
        "{goal: {nested_field: {int32_value: 3, float64_value: 1, int8_value: '(level ?to)', bool_value: true}}}",
        "{goal: {nested_different_pkg: 2.5}}",
        "{goal: {nested_field: {of: '?to', table: {hall: {float64_value: 1.5}, kitchen: {float64_value: '$x'}}}}}",
        "{goal: {nested_field: {float64_value: {of: '?to', table: {hall: 1.5, kitchen: '(x ?to)'}}}}}",
        "{success: {field: nested_field.int32_value, eq: 0}}",
        "{success: {any: [{field: nested_field.bool_value}, {field: nested_field.float64_value, ge: 0.5}]}}",
        "{reason: nested_field.int64_value}",
        "{reason: {field: nested_field.int32_value, table: {1: no way, 2: no battery}}}",
        "{store: {nested_field.int8_value: why}}",
    ],
)
def test_a_binding_that_fits_is_as_before(tmp_path: Path, text: str) -> None:
    wanted = binding(tmp_path, text)
    assert fitted_binding(wanted, NestedMessage) == wanted


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{goal: {nested_fild: {}}}", "NestedMessage_Goal has no field 'nested_fild'; did you mean 'nested_field'?"),
        ("{goal: {nested_field: {int32_valu: 3}}}", "BasicTypes has no field 'int32_valu'; did you mean"),
        ("{goal: {nested_field: {int32_value: 1.5}}}", "field nested_field.int32_value needs int32"),
        ("{goal: {nested_field: {bool_value: 1}}}", "field nested_field.bool_value needs bool, got 1 (int)"),
        ("{goal: {nested_field: 3}}", "field nested_field needs the fields of a test_msgs/BasicTypes, got 3 (int)"),
        (
            "{goal: {nested_field: {of: '?to', table: {hall: {float64_value: far}, kitchen: {}}}}}",
            "field nested_field of hall.float64_value needs float64, got 'far' (str)",
        ),
        ("{success: {field: nested_field.status, eq: 0}}", "has no field 'status'"),
        ("{success: {field: nested_field.int32_value, eq: done}}", "cannot be compared with 'done'"),
        ("{success: {field: nested_field.int32_value}}", "nested_field.int32_value is a int32; expected a boolean"),
        ("{reason: message}", "NestedMessage_Result has no field 'message'"),
        ("{reason: {field: nested_field.int32_value, table: {bad: no way}}}", "cannot be compared with 'bad'"),
        ("{store: {time: t}}", "NestedMessage_Result has no field 'time'"),
    ],
)
def test_what_can_never_work_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InputError) as refusal:
        fitted_binding(binding(tmp_path, text), NestedMessage)
    assert message in str(refusal.value)


def test_items_of_lists_are_looked_at(tmp_path: Path) -> None:
    assert fitted_binding(binding(tmp_path, "{success: {field: 'sequence[-1]', gt: 5}}"), Fibonacci)
    with pytest.raises(InputError, match=r"Fibonacci_Goal has no field 'order\[0\]'|order is a int32; only a list has an item 0"):
        fitted_binding(binding(tmp_path, "{goal: {'order[0]': 3}}"), Fibonacci)
