"""Data of a call: what it sends and stores, which effects it has, and when they are seen. Functions of an action and of knowledge.

Effects. Before: do they hold already? While the call runs: may what is false of its over-all condition be a late report? After: are
its effects seen? An effect is *seen* when its fluent is sensed and has the value; effects on assumed fluents cannot be checked.

A call is *closed* when the plan gives all its parameters. What of it is the same whatever knowledge has is computed once per machine and
shared by its runs. What it changes is constant when its effects assign constants.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import isfinite
from typing import NamedTuple, TypeAlias, assert_never

from pnm.core.execution.questions import EvaluationContext, unknown_values
from pnm.core.knowledge_base import KnowledgeBase, parse_fluent
from pnm.core.logic import conditions
from pnm.core.logic.compiled import CompiledCondition, compiled
from pnm.core.logic.computed_values import may_ask
from pnm.core.logic.conditions import fluents, names
from pnm.core.logic.effects import (
    Changes,
    Effects,
    Set,
    changes,
    constants,
    decided,
    every_effect,
    facts,
    ground_effects,
    is_fixed,
    names_written,
    values_before,
    written,
)
from pnm.core.logic.expressions import UNKNOWN, Constant, Fluent, Unknown, Value, ValueOf, bind, is_number, same_value
from pnm.core.logic.rules import NO_RULES, Reads, Rules, read_by, reads_of
from pnm.core.machine.bindings import Binding, goal_data, open_parameters, own_values, placeholders
from pnm.core.machine.guards import Guard, KnowledgeRead
from pnm.core.machine.plan_graph import ActionCall, GroundAction
from pnm.core.machine.requests import Outcome
from pnm.core.message_fields import Unreadable, parse_field, value_in

GoalFields: TypeAlias = Callable[[GroundAction], tuple[str, ...] | None]
"""Returns which fields the goal of an action must have; None when nothing is known about them."""


def ready(action: GroundAction, context: EvaluationContext) -> GroundAction:
    """Return the action with what knowledge now has for the parameters that the plan leaves open."""
    env = context.environment()
    if not env:
        return action
    # nine times for two calls of a loop, so it is made anew only if knowledge has changed: until then the environment is the same one
    if context.ready and context.ready[0][0] is action and context.ready[0][1] is env:
        return context.ready[0][2]
    made = replace(
        action,
        arguments=bind(action.arguments, env),
        precondition=conditions.ground(action.precondition, env),
        invariant=conditions.ground(action.invariant, env),
        end_condition=conditions.ground(action.end_condition, env),
        expected=conditions.ground(action.expected, env),
        start_effects=ground_effects(action.start_effects, env),
        end_effects=ground_effects(action.end_effects, env),
        outcomes=tuple([replace(way, effects=ground_effects(way.effects, env)) for way in action.outcomes]),
    )
    context.ready[:] = [(action, env, made)]
    return made


def goal(planned: GroundAction, goal_fields: GoalFields, context: EvaluationContext) -> tuple[Mapping[str, object], tuple[str, ...]]:
    """Return the fields of the goal of an action as the plan has it, and the names of those for which there is no value."""
    action, binding = ready(planned, context), context.binding
    if action.operation is not None:
        return {}, unknown_values(action.operation, context)
    fields, missing = goal_data(action, binding, goal_fields(action), context)
    if not (unbound := open_parameters(action)):
        return fields, missing
    patterns = (binding.server or "", *binding.resources, *action.resources)
    in_names = {name for pattern in patterns for name in placeholders(pattern)}
    return fields, tuple(dict.fromkeys((*missing, *(name for name in unbound if name in in_names))))


def variables_of(outcome: Outcome, call: ActionCall, binding: Binding) -> dict[str, object]:
    """Return the fields of a result, under their own names or those of the call or its binding."""
    if not outcome.result:  # simulated servers may have none
        return {}
    store = {**binding.store, **dict(call.store)}
    values = {name: value for name, value in outcome.result.items() if name not in store}
    for name, variable in store.items():
        with suppress(Unreadable):
            if not variable.startswith("("):
                values[variable] = value_in(outcome.result, parse_field(name))
    return values


def facts_of(outcome: Outcome, call: ActionCall, action: GroundAction, binding: Binding, world: KnowledgeBase) -> Changes:
    """Return the fluents that a result sets; unknown are those for which it has no value of their kind, or an object that is not there."""
    found: Changes = {}
    targets = {name: target for name, target in {**binding.store, **dict(call.store)}.items() if target.startswith("(")}
    if targets and outcome.result:
        env, objects = {f"?{name}": argument for name, argument in own_values(action).items()}, world.objects(("object",))
        for name, target in targets.items():
            with suppress(Unreadable):
                value, fluent = value_in(outcome.result, parse_field(name)), bind(parse_fluent(target), env)
                known, is_there = world.value(fluent), value in objects if objects and isinstance(value, str) else True
                is_alike = isinstance(known, bool) is isinstance(value, bool) and is_number(known) is is_number(value)
                match value:
                    case bool() | int() | float() | str() if is_there and (is_alike or known is None or known is UNKNOWN):
                        found[fluent] = value if not is_number(value) else float(value) if isfinite(value) else UNKNOWN
                    case _:
                        found[fluent] = UNKNOWN
    return found


# --- effects ---


def already_true(action: GroundAction, knowledge: EvaluationContext) -> bool:
    """Return whether what is expected of the action holds, and it changes nothing but plain facts and objects which are so already.

    An action of which nothing is expected and that changes nothing is never done already.
    """
    at_start, at_end = facts(action.start_effects, knowledge), facts(decided(action.end_effects, knowledge), knowledge)
    # Numbers and conditional effects cannot be seen to be done already, so such a call is always made; and so is one of several outcomes.
    if action.outcomes or at_start is None or at_end is None or not (at_start or at_end or action.expected != conditions.TRUE):
        return False
    if conditions.evaluate(action.expected, knowledge) is not True:
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
    outcomes: tuple[Intention, ...] = ()
    """The declared outcomes that are possible, where it may have one of several; all that is not the same of them is in these then."""
    before: Changes = field(default_factory=dict)
    """The facts and objects in which sensors should see them differ, as they are if an outcome does not change them."""
    name: str = ""
    """That of the declared outcome."""


def intention(call: ActionCall, knowledge: EvaluationContext) -> Intention:
    """Compute what the call, which is being sent, is going to change, and what of it should be seen.

    Numbers are not expected: a real battery never shows the modelled figure. Nor is, of a durative
    action, what is only decided at its end: effects under a condition, and values that are read then.
    """
    action = call.action
    if action.outcomes:
        only = [replace(call, action=replace(action, end_effects=way.effects, outcomes=())) for way in action.outcomes]
        each = tuple([replace(intention(one, knowledge), name=way.name) for one, way in zip(only, action.outcomes, strict=True)])
        begun, told = each[0].start, Changes({fluent: value for one in each for fluent, value in one.expected.items()})
        before = values_before(told, knowledge) | {fluent: value for fluent, value in begun.items() if fluent in told}
        return Intention(begun, outcomes=each, before=before)
    ending = decided(action.end_effects, knowledge)
    start, end = changes(action.start_effects, knowledge), changes(ending, knowledge)
    lasting = {fluent: value for fluent, value in start.items() if fluent in call.lasting}
    late = names_written(tuple(effect for effect in ending if not is_fixed(effect))) if action.duration is not None else frozenset()
    wanted = {fluent: value for fluent, value in (lasting | end).items() if fluent[0] not in late}
    seen = {fluent: value for fluent, value in wanted.items() if isinstance(value, bool | str) and knowledge.world.is_sensed(fluent)}
    return Intention(start, end, ending, seen)


def sending(call: ActionCall, context: EvaluationContext) -> tuple[GroundAction, Intention]:
    """Return the action of a request that is sent now, and what it is going to change."""
    action = ready(call.action, context)
    return action, intention(call if action is call.action else replace(call, action=action), context)


def finished(action: GroundAction, intended: Intention, knowledge: EvaluationContext) -> Changes:
    """Return the changes at the end of the action.

    A durative action's end effects read the state at its end. An instantaneous action's conditions and
    objects were decided when it was sent; its numbers change from what they are now, for others may
    have changed them meanwhile.
    """
    if intended.outcomes:
        ends = [finished(action, one, knowledge) for one in possible(intended, knowledge) or intended.outcomes]
        before = values_before({fluent: value for end in ends for fluent, value in end.items()}, knowledge)
        first, *others = ({**before, **end} for end in ends)
        return {fluent: value if all(same_value(end[fluent], value) for end in others) else UNKNOWN for fluent, value in first.items()}
    now = changes(intended.end_effects, knowledge)
    if action.duration is not None:
        return now
    return {fluent: value if isinstance(value, bool | str) else now.get(fluent, value) for fluent, value in intended.end.items()}


def unseen(wanted: Mapping[Fluent, Value], action: GroundAction, knowledge: EvaluationContext) -> tuple[conditions.Condition, ...]:
    """Return which expected facts are not reported and which end conditions and expectations do not hold; may raise `Unanswered`."""
    missing = [stated(fluent, value) for fluent, value in wanted.items() if not same_value(knowledge.world.value(fluent), value)]
    # what the end itself changes cannot be checked any more
    base, changed = knowledge.world.rules.base, names_written(action.possible_effects)
    checked = (part for part in conditions.conjuncts(action.end_condition) if not base(names(part)) & changed)
    denied = (part for part in checked if conditions.evaluate(part, knowledge) is not True)
    return (*missing, *denied, *conditions.unmet(action.expected, knowledge))


def stated(fluent: Fluent, value: Value) -> conditions.Condition:
    """Return the condition that a fluent has a value."""
    fact = conditions.Holds(fluent) if isinstance(value, bool) else conditions.Compare("=", ValueOf(fluent), Constant(value))
    return conditions.Not(fact) if value is False else fact


def contradicted(
    outcome: Intention, intended: Intention, knowledge: EvaluationContext, *, by_news: bool = False
) -> tuple[conditions.Condition, ...]:
    """Return what is known to be otherwise than after this one of the declared outcomes; `by_news`: what has become so."""
    found: list[conditions.Condition] = []
    for fluent, value in {**intended.before, **outcome.expected}.items():
        now = knowledge.world.value(fluent)
        if value is UNKNOWN or now is UNKNOWN or same_value(now, value) or (by_news and same_value(now, intended.before[fluent])):
            continue
        found.append(stated(fluent, value))
    return tuple(found)


def possible(intended: Intention, knowledge: EvaluationContext) -> tuple[Intention, ...]:
    """Return the declared outcomes that what is known agrees with: what is unknown agrees with all."""
    return tuple(one for one in intended.outcomes if not contradicted(one, intended, knowledge))


def may_turn_out(intended: Intention, knowledge: EvaluationContext) -> bool:
    """Return whether reports that may still be on their way can tell another one of several declared outcomes."""
    return sum(not contradicted(one, intended, knowledge, by_news=True) for one in intended.outcomes) > 1


def denied_at_end(
    action: GroundAction, knowledge: EvaluationContext, breaks_now: Callable[[conditions.Condition], bool] = lambda part: False
) -> dict[conditions.Condition, str]:
    """Return which parts of the conditions over all and at the end do not hold at the end, and what is so instead.

    No report about them can come late. Over all means until just before the end: a part of it that breaks at this moment does no harm.
    """
    denied: dict[conditions.Condition, str] = {}
    for condition, is_for_the_end in ((action.invariant, False), (action.end_condition, True)):
        for part in conditions.unmet(condition, knowledge):
            is_reported = any(knowledge.world.is_sensed((name,)) for name in knowledge.world.rules.base(names(part)))
            is_excused = is_reported and (is_for_the_end or may_be_late(part, action, knowledge, has_held=False))
            is_excused = is_excused or (not is_for_the_end and breaks_now(part))
            if not is_excused and not any(map(may_ask, conditions.data_in(part))):
                denied[part] = conditions.observed(part, knowledge)
    return denied


def may_be_late(part: conditions.Condition, action: GroundAction, knowledge: EvaluationContext, *, has_held: bool) -> bool:
    """Return whether a part of the over-all condition may look false, while the action is under way, for want of a report alone.

    Either nothing is reported now; or its own start makes the part true, and that has not been seen yet; or its own end changes
    it, which sensors may see before the robot reports the end. Any other report that it is false is news.
    """
    if conditions.evaluate(part, knowledge) is UNKNOWN:
        return True
    changed = written((*action.possible_effects, *(() if has_held else action.start_effects)), knowledge)
    asked, rules = fluents(part, knowledge), knowledge.world.rules
    below = rules.base({fluent[0] for fluent in asked} & rules.derived)
    return any(fluent in asked or fluent[0] in below for fluent in changed)


# --- closed calls ---


class ConstantEffects(NamedTuple):
    """Effects of a call that are the same in every state."""

    intention: Intention
    """The changes by the call, as far as nothing of it is sensed."""
    visible: Mapping[Fluent, Value]
    """The expected observations, where it is sensed."""
    done: tuple[tuple[Fluent, Value | Unknown], ...]
    """The fluents that are true already where there is nothing to do; empty if that can never be told."""

    def intended(self, world: KnowledgeBase) -> Intention:
        """Return the intention of the call, as `intention` would."""
        seen = world.reported(self.visible)
        return replace(self.intention, expected=seen) if seen else self.intention

    def are_done(self, world: KnowledgeBase) -> bool:
        """Return whether there is nothing to do, as `already_true` would."""
        for fluent, value in self.done:
            if not same_value(world.value(fluent), value):
                return False
        return bool(self.done)


class ClosedCall(NamedTuple):
    """The part of a closed call that does not depend on knowledge."""

    own: Mapping[str, object]
    """The values that it has for goal fields by itself."""
    names: frozenset[str]
    """The names of all that its effects may change."""
    expects: bool
    """Whether it has a condition for its end, or something is expected of it."""
    needed: CompiledCondition | None
    """The condition until its end, and there; None for nothing."""
    effects: ConstantEffects | None
    """None if what it changes depends on the state."""


def is_closed(action: GroundAction) -> bool:
    """Return whether the plan gives all parameters of an action, which is not about knowledge itself."""
    return not (action.operation is not None or action.given or open_parameters(action))


def reads_of_guard(guard: Guard, action: GroundAction | None, rules: Rules) -> Reads:
    """Return the fluents that a guard reads, of a call of this action if it is about one; None for anything."""
    if action is not None and not is_closed(action):  # its parameters may depend on anything
        return None
    match guard.reads:
        case KnowledgeRead.NOTHING:
            return frozenset()
        case KnowledgeRead.ANYTHING:  # servers say which goal fields they have without anything being heard of it
            return None
        case KnowledgeRead.CONDITION:
            return None if guard.asks is None else read_by(guard.asks, rules)
        case KnowledgeRead.EFFECTS if action is None:
            return None
        case KnowledgeRead.EFFECTS:
            checked = read_by(conditions.All((action.end_condition, action.expected)), rules)
            fluents = [one.fluent for one in every_effect((*action.start_effects, *action.possible_effects)) if isinstance(one, Set)]
            return None if checked is None else checked.union(*(reads_of(fluent, NO_RULES) for fluent in fluents))
        case _ as unread:
            assert_never(unread)


def closed_call(call: ActionCall) -> ClosedCall | None:
    """Return the part of the call that does not depend on knowledge; None for calls with open parameters or about knowledge itself."""
    action = call.action
    if not is_closed(action):
        return None
    start, end, effects = constants(action.start_effects), constants(action.end_effects), None
    if start is not None and end is not None and action.expected == conditions.TRUE and not action.outcomes:
        changed, lasting = start | end, {fluent: value for fluent, value in start.items() if fluent in call.lasting}
        visible = {fluent: value for fluent, value in (lasting | end).items() if isinstance(value, bool | str)}
        done = () if any(map(is_number, changed.values())) else tuple(changed.items())
        effects = ConstantEffects(Intention(start, end, action.end_effects), visible, done)
    expects, needed = not (action.end_condition == action.expected == conditions.TRUE), (action.invariant, action.end_condition)
    checked = None if (condition := conditions.conjunction(needed)) == conditions.TRUE else compiled(condition)
    return ClosedCall(own_values(action), names_written((*action.start_effects, *action.possible_effects)), expects, checked, effects)
