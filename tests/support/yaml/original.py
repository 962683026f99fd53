"""Plans of the first implementation, run by this one."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.machine.requests import Outcome, OutcomeKind, Request
from pnm.errors import InputError
from pnm.language.plan import HandWrittenPlan
from tests.support.runs.direct import Answer, Trace, drive, succeed
from tests.support.yaml.programs import only_plan

TYPES = """
external_knowledge_base: {module: rpn_ros_interface.ros_external_knowledge_base, class: ROSExternalKnowledgeBase}
action_types:
  Ros: &ros_action {type: {module: rpn_ros_interface.action, class: ROSAtomicAction}}
  Rpn: &rpn_action {type: {module: rpn_ros_interface.rpn_action, class: RPNAtomicAction}}
  Kb: &kb_action {type: {module: pnp_actions.kb_action, class: KBAction}}
actions:
  a: {<<: *ros_action}
  b: {<<: *ros_action}
  c: {<<: *ros_action}
  given: {<<: *ros_action, params: [value]}
  ready: {<<: *ros_action, preconditions: {Comparison: [eq, [LocalQuery: ready, true]]}}
  found: {<<: *ros_action, effects: {Exists: [LocalQuery: result]}}
  both: {<<: *ros_action, preconditions: {Exists: [LocalQuery: nothing]}, effects: {Exists: [LocalQuery: result]}}
  kb: {<<: *kb_action, params: [operation]}
"""


def read_original(plan: str, knowledge: str = "{}", rest: str = "") -> HandWrittenPlan:
    return only_plan(f"{TYPES}{rest}---\ninitial_knowledge: {knowledge}\nplan: {plan}\n")


def run_original(plan: HandWrittenPlan, answer: Answer = succeed, known: Mapping[str, object] | None = None) -> Trace:
    world = KnowledgeBase(plan.facts, objects=plan.objects, rules=plan.rules)
    return drive(plan.graph, answer, bindings=plan.bindings, variables=plan.variables, known=known, world=world)


class RunOriginal:
    """Reads a plan and runs it."""

    def __call__(
        self, plan: str, answer: Answer = succeed, *, knowledge: str = "{}", rest: str = "", known: dict[str, object] | None = None
    ) -> Trace:
        return run_original(read_original(plan, knowledge, rest), answer, known)

    def wrong(self, plan: str, rest: str = "") -> str:
        with pytest.raises(InputError) as caught:
            read_original(plan, rest=rest)
        return str(caught.value)


def variables(trace: Trace) -> dict[str, object]:
    return trace.run.knowledge.local.variables()


def causes(trace: Trace) -> list[str]:
    return [failure.cause for failure in trace.result.failures]


COUNTING = """
  - found: {}
  - while:
      condition: {Comparison: [ne, [LocalQuery: value, 10]]}
      actions:
        - given: {}
        - kb: {operation: {LocalUpdate: [value, {LocalQuery: result}, ""]}}
"""


def counted(request: Request) -> Outcome:
    value = request.goal.get("value", 0)
    assert isinstance(value, int)
    return Outcome(OutcomeKind.SUCCEEDED, {"result": value + 1})
