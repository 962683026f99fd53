"""Effect checks of a call: pure functions of a ground action and of knowledge.

Before: do its effects hold already? While it runs: may what is false of its over-all condition be a late report? After: are its
effects seen? An effect is *seen* when its fluent is sensed and has the value; effects on assumed fluents cannot be checked.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from pnm.core.execution.questions import EvaluationContext
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.computed_values import may_ask
from pnm.core.logic.conditions import TRUE, Compare, Condition, Holds, Not, conjuncts, data_in, fluents, names
from pnm.core.logic.effects import Changes, Effects, changes, decided, facts, is_fixed, names_written, written
from pnm.core.logic.evaluation import evaluate, observed, unmet
from pnm.core.logic.expressions import UNKNOWN, Constant, Fluent, Value, ValueOf, same_value
from pnm.core.machine.plan_graph import ActionCall, GroundAction


def already_true(action: GroundAction, knowledge: EvaluationContext) -> bool:
    """Return whether what is expected of the action holds, and it changes nothing but plain facts and objects which are so already.

    An action of which nothing is expected and that changes nothing is never done already.
    """
    at_start, at_end = facts(action.start_effects, knowledge), facts(decided(action.end_effects, knowledge), knowledge)
    # Numbers and conditional effects cannot be seen to be done already, so such a call is always made.
    if at_start is None or at_end is None or not (at_start or at_end or action.expected != TRUE):
        return False
    if evaluate(action.expected, knowledge) is not True:
        return False
    return all(same_value(knowledge.value(fluent), value) for fluent, value in (at_start | at_end).items())


@dataclass(frozen=True, slots=True)
class Intention:
    """Intended effects of a call, computed when it is sent: later the sensors already show some of them."""

    start: Changes = field(default_factory=dict)
    end: Changes = field(default_factory=dict)
    end_effects: Effects = ()
    """Those of the action, once their early conditions are decided."""
    expected: Mapping[Fluent, Value] = field(default_factory=dict)
    """The facts and objects that sensors should report once the call has succeeded."""


def intention(call: ActionCall, knowledge: EvaluationContext) -> Intention:
    """Compute what the call, which is being sent, is going to change, and what of it should be seen.

    Numbers are not expected: a real battery never shows the modelled figure. Nor is, of a durative
    action, what is only decided at its end: effects under a condition, and values that are read then.
    """
    action = call.action
    ending = decided(action.end_effects, knowledge)
    start, end = changes(action.start_effects, knowledge), changes(ending, knowledge)
    lasting = {fluent: value for fluent, value in start.items() if fluent in call.lasting}
    late = names_written(tuple(effect for effect in ending if not is_fixed(effect))) if action.duration is not None else frozenset()
    wanted = {fluent: value for fluent, value in (lasting | end).items() if fluent[0] not in late}
    seen = {fluent: value for fluent, value in wanted.items() if isinstance(value, bool | str) and knowledge.world.is_sensed(fluent)}
    return Intention(start, end, ending, seen)


def finished(action: GroundAction, intended: Intention, knowledge: EvaluationContext) -> Changes:
    """Return what the end of the action changes.

    A durative action's end effects read the state at its end. An instantaneous action's conditions and
    objects were decided when it was sent; its numbers change from what they are now, for others may
    have changed them meanwhile.
    """
    now = changes(intended.end_effects, knowledge)
    if action.duration is not None:
        return now
    return {fluent: value if isinstance(value, bool | str) else now.get(fluent, value) for fluent, value in intended.end.items()}


def unseen(wanted: Mapping[Fluent, Value], action: GroundAction, knowledge: EvaluationContext) -> tuple[Condition, ...]:
    """Return which expected facts are not reported and which end conditions and expectations do not hold.

    Raises:
        Unanswered: a question has to be asked first.
    """
    absent = ((fluent, value) for fluent, value in wanted.items() if not same_value(knowledge.world.value(fluent), value))
    missing: list[Condition] = []
    for fluent, value in absent:
        fact = Holds(fluent) if isinstance(value, bool) else Compare("=", ValueOf(fluent), Constant(value))
        missing.append(Not(fact) if value is False else fact)
    base, changed = knowledge.world.rules.base, names_written(action.end_effects)  # what the end itself changes cannot be checked any more
    checked = (part for part in conjuncts(action.end_condition) if not base(names(part)) & changed)
    denied = (part for part in checked if evaluate(part, knowledge) is not True)
    return (*missing, *denied, *unmet(action.expected, knowledge))


def denied_at_end(
    action: GroundAction, knowledge: EvaluationContext, breaks_now: Callable[[Condition], bool] = lambda part: False
) -> dict[Condition, str]:
    """Return which parts of the conditions over all and at the end do not hold at the end, and what is so instead.

    No report about them can come late. Over all means until just before the end: a part of it that breaks at this moment does no harm.
    """
    denied: dict[Condition, str] = {}
    for condition, is_for_the_end in ((action.invariant, False), (action.end_condition, True)):
        for part in unmet(condition, knowledge):
            is_reported = any(knowledge.world.is_sensed((name,)) for name in knowledge.world.rules.base(names(part)))
            is_excused = is_reported and (is_for_the_end or may_be_late(part, action, knowledge, has_held=False))
            is_excused = is_excused or (not is_for_the_end and breaks_now(part))
            if not is_excused and not any(map(may_ask, data_in(part))):
                denied[part] = observed(part, knowledge)
    return denied


def may_be_late(part: Condition, action: GroundAction, knowledge: EvaluationContext, *, has_held: bool) -> bool:
    """Return whether a part of the over-all condition may look false, while the action is under way, for want of a report alone.

    Either nothing is reported now; or its own start makes the part true, and that has not been seen yet; or its own end changes
    it, which sensors may see before the robot reports the end. Any other report that it is false is news.
    """
    if evaluate(part, knowledge) is UNKNOWN:
        return True
    changed = written((*action.end_effects, *(() if has_held else action.start_effects)), knowledge)
    asked, rules = fluents(part, knowledge), knowledge.world.rules
    below = rules.base({fluent[0] for fluent in asked} & rules.derived)
    return any(fluent in asked or fluent[0] in below for fluent in changed)


def lag_of_effects(wanted: Mapping[Fluent, Value], action: GroundAction, knowledge: EvaluationContext) -> float:
    """Return how many seconds late the reports about the effects and the end condition may come."""
    return knowledge.world.lag({*(fluent[0] for fluent in wanted), *names(action.end_condition), *names(action.expected)})


def is_assumed(changed: frozenset[str], world: KnowledgeBase) -> bool:
    """Return whether nothing reports some of what an action changes, by the names of that."""
    return not world.senses(changed)
