"""What whoever starts a hand-written plan gives it: no other parameters than it has, and a value for each."""

from __future__ import annotations

from collections.abc import Mapping

from pnm.errors import InputError
from pnm.knowledge import Layered
from pnm.language.plan import HandWrittenPlan
from pnm.nearest import meant
from pnm.queries import MISSING, Layer, Literal, Query, Question, parts
from pnm.sources.base import Asker, Source


def check_names(plan: HandWrittenPlan, given: Mapping[str, object]) -> None:
    """Refuse parameters that the plan does not have.

    Raises:
        InputError: there is one.
    """
    known = plan.parameters
    for name in given:
        if known is not None and name not in known:
            hint = meant(name, known) or f"expected {', '.join(known) or 'none'}"
            raise InputError(f"{plan.name} has no parameter {name!r}; {hint}")


async def check_values(plan: HandWrittenPlan, knowledge: Layered, source: Source | None, asker: Asker) -> None:
    """See to it that every parameter has a value, or that a person may be asked for it when it is needed.

    Args:
        plan: which says what its parameters are; if it does not, nothing is expected.
        knowledge: of the run, before it begins; what is null in it need not have a value.
        source: has the global knowledge, in which there may be a value as well.
        asker: who asks.

    Raises:
        InputError: one has none.
    """
    nameless = [name for name in plan.parameters or () if knowledge.variable(name) is MISSING]
    askable = _askable(plan) if nameless else frozenset()
    for name in nameless:
        if name not in askable and not await _is_known(name, source, asker):
            where = f"such as {{{name}: …}} among the parameters, under initial_knowledge, or in the global knowledge"
            raise InputError(f"{plan.name} needs a value for its parameter {name!r}; expected one {where}")


def _askable(plan: HandWrittenPlan) -> frozenset[str]:
    """Return the variables in whose place a person may be asked."""
    found: set[str] = set()
    for call in plan.graph.calls:
        given = dict(call.action.given)
        for field in plan.bindings.of(call.action.name).ask:
            read = parts(given[field]) if field in given else ()
            found |= {field, *(str(one.name.value) for one in read if isinstance(one, Query) and isinstance(one.name, Literal))}
    return frozenset(found)


async def _is_known(name: str, source: Source | None, asker: Asker) -> bool:
    try:
        return source is not None and await source.query(Question(name, Layer.GLOBAL, "null"), asker) not in (MISSING, None)
    except Exception:  # a knowledge base that cannot be asked: the run tells of it if it needs the value
        return True
