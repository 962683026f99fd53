"""What is checked around a call: pure functions of a ground action and what is known.

Before: do its effects hold already? After: are its effects seen? An effect is *seen* when its
fluent is sensed and has the value; effects on assumed fluents cannot be checked.
"""

from __future__ import annotations

from collections.abc import Iterator

from pnm.conditions import Condition, conjuncts, evaluate, names
from pnm.effects import Changes, Set, changes, facts, names_written
from pnm.expressions import Fluent, Value, show
from pnm.knowledge import Layered
from pnm.plan_graph import ActionCall, GroundAction


def already_true(action: GroundAction, knowledge: Layered) -> bool:
    """Tell whether the action changes nothing but plain facts, at least one, and all are so already."""
    at_start, at_end = facts(action.start_effects, knowledge), facts(action.end_effects, knowledge)
    if at_start is None or at_end is None or not (at_start or at_end):
        return False
    return all((knowledge.value(fluent) or False) is value for fluent, value in (at_start | at_end).items())


def expected(call: ActionCall, knowledge: Layered) -> dict[Fluent, Value]:
    """Return the facts that sensors should report once the call, which starts now, has succeeded.

    Numbers are left out: a real battery never shows the modelled figure. So are, for a durative
    action, effects under a condition, which is only decided at its end.
    """
    action = call.action
    lasting = {fluent: value for fluent, value in changes(action.start_effects, knowledge).items() if fluent in call.lasting}
    effects = action.end_effects
    if action.duration is not None:
        conditional = names_written(
            tuple(effect for effect in effects if facts((effect,), knowledge) is None and not isinstance(effect, Set))
        )
        effects = tuple(effect for effect in effects if not names_written((effect,)) & conditional)
    wanted: Changes = lasting | changes(effects, knowledge)
    return {fluent: value for fluent, value in wanted.items() if isinstance(value, bool) and knowledge.world.is_sensed(fluent)}


def unseen(wanted: dict[Fluent, Value], action: GroundAction, knowledge: Layered) -> tuple[str, ...]:
    """Return, as PDDL, which expected facts are not reported and which end conditions do not hold."""
    missing = (
        show(fluent) if value else f"(not {show(fluent)})"
        for fluent, value in wanted.items()
        if (knowledge.world.value(fluent) or False) is not value
    )
    return (*missing, *map(str, _end_denied(action, knowledge)))


def _end_denied(action: GroundAction, knowledge: Layered) -> Iterator[Condition]:
    """Yield the parts of the end condition that do not hold; those the end itself changes cannot be told any more."""
    changed = names_written(action.end_effects)
    for part in conjuncts(action.end_condition):
        if not names(part) & changed and evaluate(part, knowledge) is not True:
            yield part


def lag_of_effects(wanted: dict[Fluent, Value], action: GroundAction, knowledge: Layered) -> float:
    """Return how many seconds late the reports about the effects and the end condition may come."""
    return knowledge.world.lag({*(fluent[0] for fluent in wanted), *names(action.end_condition)})


def is_assumed(action: GroundAction, knowledge: Layered) -> bool:
    """Tell whether nothing reports some of what the action changes."""
    return not all(knowledge.world.is_sensed((name,)) for name in names_written((*action.start_effects, *action.end_effects)))
