"""What a context has worked out is kept for as long as knowledge is the same, and no longer."""

from __future__ import annotations

from uuid import UUID

from hypothesis import given
from hypothesis import strategies as st

from pnm.core.execution.call_requests import Calls
from pnm.core.execution.questions import EvaluationContext
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import Layer, Literal, Query
from pnm.core.logic.conditions import Holds
from pnm.core.logic.effects import Set
from pnm.core.logic.expressions import Constant
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph

GIVEN = (("speed", Query(Literal.of("pace"), Layer.LOCAL)),)
GO = GroundAction(
    "go", ("?to",), ("to",), precondition=Holds(("open", "?to")), end_effects=(Set(("at", "?to"), Constant(True)),), given=GIVEN
)
VALUES = st.sampled_from([None, 1, True, 1.0, "1", "hall", [1], [True]])
CHANGES = st.lists(st.tuples(st.sampled_from(["to", "pace", "other"]), st.booleans(), VALUES), max_size=8)


def shown(values: object) -> str:
    return repr(values)  # unlike ==, it tells 1, 1.0 and true apart


@given(CHANGES)
def test_an_action_is_ready_with_what_is_known_now(changes: list[tuple[str, bool, object]]) -> None:
    known = Layered(KnowledgeBase(), KnowledgeBase())
    calls = Calls(UUID(int=1), generate(PlanGraph((ActionCall(0, GO),))), known, Bindings(), lambda action: None, asks=False)
    for name, is_local, value in changes:
        (known.local if is_local else known.world).store({name: value})
        kept, fresh = calls.context_of(0, None), EvaluationContext(known, GO)
        assert shown(kept.environment()) == shown(fresh.environment())
        assert shown(kept.given()) == shown(fresh.given())
        others = Calls(UUID(int=1), generate(PlanGraph((ActionCall(0, GO),))), known, Bindings(), lambda action: None, asks=False)
        ready = calls.ready(0, kept)
        assert shown(ready) == shown(others.ready(0, fresh))
        assert calls.ready(0, kept) is ready, "it is made anew although nothing has changed"
