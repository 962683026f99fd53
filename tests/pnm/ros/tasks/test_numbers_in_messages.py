"""The numbers in messages are those of the enums that all code uses, under the same names."""

from __future__ import annotations

from typing import Any

import pytest
from pnm_interfaces.action import AchieveGoal
from pnm_interfaces.msg import PlanStep, TaskStatus, TraceEvent
from pnm_interfaces.srv import QueryKnowledge, UpdateKnowledge

from pnm.ros.knowledge import LAYERS
from pnm.ros.tasks.task_messages import CAUSES
from pnm.tasks import Code, OnConflict, StepState, TaskState, TraceKind


def constants(message: Any) -> dict[str, int]:
    """Return the constants of a message by name, which are properties of the class of its class."""
    return {name: getattr(message, name) for name, kind in vars(type(message)).items() if isinstance(kind, property)}


@pytest.mark.parametrize(
    ("message", "named"),
    [
        (AchieveGoal.Goal, {policy.name: policy.value for policy in OnConflict}),
        (AchieveGoal.Result, {code.name: code.value for code in Code}),
        (TaskStatus, {state.name: state.value for state in TaskState}),
        (TraceEvent, {kind.name: kind.value for kind in TraceKind}),
        (PlanStep, {s.name: s.value for s in StepState} | {cause.name if cause else "NONE": CAUSES.index(cause) for cause in CAUSES}),
        *(
            (request, {layer.name: LAYERS.index(layer) for layer in LAYERS})
            for request in (QueryKnowledge.Request, UpdateKnowledge.Request)
        ),
    ],
)
def test_the_constants_of_a_message_are_those_of_the_enum(message, named):
    assert constants(message) == named
