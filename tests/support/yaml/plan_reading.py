"""Plans in YAML and the actions they call."""

from __future__ import annotations

from pnm.core.machine.plan_graph import ActionCall
from pnm.language import HandWrittenPlan


def orderings(plan: HandWrittenPlan) -> set[tuple[int, int]]:
    return {(one.before.call, one.after.call) for one in plan.graph.orderings}


ACTIONS = """\
actions:
  go: {params: "?r - robot ?to - place", preconditions: "(free ?r)", effects: ["(at ?r ?to)"]}
  say: {params: [text]}
  wait: {params: [time]}
  any:
  set: {type: kb_action, params: [operation, value, unused]}
"""


def call_of(plan: HandWrittenPlan, number: int = 0) -> ActionCall:
    return plan.graph.calls[number]
