"""The encoding of a task for Kairos: an action for every outcome, and forbidden pairs of actions and states.

An action that is forbidden in some states is copied for these objects, without parameters, with the states ruled out in its
precondition; a fact that never changes keeps Kairos from using the general action for these objects. Texts are joined from ready parts.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Final

import kairos

from planner_bridge.model.determinization import determinized_domain
from planner_bridge.model.guards import guarded, unused_name
from planner_bridge.model.plan import Plan, SpelledNames
from planner_bridge.model.problem import Problem
from planner_bridge.pddl.writer import write_domain, write_problem
from planner_bridge.planning.policies.task import ANY, PartialState, PolicyAction, PolicyOutcome, PolicyTask, places
from pnm.core.logic.conditions import Holds, Not
from pnm.core.logic.domain import Declaration
from pnm.core.logic.expressions import Constant, fluent_text

_OWN: Final = "auto"
WAYS: Final = (("ff", 0.2), (_OWN, 0.5), ("eager-lama", 1.0), (_OWN, 5.0))
"""Ways of searching in Kairos, and the seconds that each gets; its own one also proves that there is no plan."""
_LONGER: Final = 2.0
"""How much longer than the longest search that found a plan all ways together may take: most that take longer find none."""
_FIRST: Final = 1.0
"""Seconds that each way gets at least as long as none has found a plan; then, as long as the longest search that did."""
_SHORT: Final = 0.7
"""Seconds that they may take in any case."""

Step = tuple[PolicyAction, int]
"""An action, and the number of the outcome that is hoped for."""


class OutOfTime(Exception):
    """Kairos has found no plan, which proves nothing."""


class OutcomePlanner:
    """What Kairos is asked for: a plan for the case that every outcome can be chosen. Its text and what found plans are mutable state.

    Args:
        known: a plan whose rest is the answer for the states on its way.
    """

    def __init__(self, problem: Problem, task: PolicyTask, known: Plan | None = None) -> None:
        self._task, self._planner = task, kairos.Planner()  # type: ignore[no-untyped-call]
        self.is_patient = False
        """Whether all ways of searching get their seconds, however long others took."""
        self._actions = {(action.name, action.arguments): action for action in task.actions}
        domain, stand_for = determinized_domain(problem.domain, problem.members)
        numbers = {(name, way.name): number for name, ways in task.alternatives.items() for number, way in enumerate(ways)}
        self._of = {name: (action, numbers[action, way]) for name in domain.actions for action, way in [stand_for.get(name, (name, ""))]}
        self._guards = {name: unused_name(f"only-copies--{name}", domain) for name in problem.domain.actions}
        self._domain = replace(
            domain, requirements=tuple(dict.fromkeys((*domain.requirements, ":adl"))), constants=problem.objects, hierarchy=(), borrowed={}
        )
        self._names = SpelledNames(replace(problem, domain=self._domain, own_objects={}))
        changing = frozenset[object](task.facts).union(scale.fluent for scale in task.scales)
        static = {fluent: value for fluent, value in problem.init.items() if fluent not in changing}
        text = write_problem(replace(problem, domain=self._domain, own_objects={}, init=static, metric=None))
        self._before, init, self._after = text.partition("(:init")
        self._before += init
        self._text_of = cache(lambda place: task.texts(1 << place)[0])
        self._levels = sum(scale.mask for scale in task.scales)
        self._parsed: tuple[object, kairos.Domain] | None = None
        self._copies: dict[str, Step] = {}
        self._guarding = ""
        self._longest = 0.0
        self._known: list[tuple[int, Step]] = []
        self.luck: float = 1.0 if known is not None else 0.0
        """The chance that all outcomes are as the known plan expects them, of those that change anything; 0 without one."""
        at = task.initial
        for step in known.steps if known is not None else ():
            action, number = self._actions.get((step.action, step.arguments)), numbers.get((step.action, step.outcome), 0)
            if action is None or action.condition_in(at) is None:  # where numbers are rounded, it may not lead to the goal
                self._known, self.luck = [], 0.0
                break
            self._known.append((at, (action, number)))
            before, at = at, action.outcomes[number].after(at)
            self.luck *= action.outcomes[number].chance / (sum(way.chance for way in action.outcomes if way.after(before) != before) or 1.0)

    def plan(
        self, state: int, forbidden: Mapping[PolicyAction, Sequence[PartialState]], until: float, ways: Sequence[tuple[str, float]] = WAYS
    ) -> list[Step] | None:
        """Return steps from the state to the goal; None if there are none, which only Kairos' own way of searching is believed.

        Raises:
            OutOfTime: none were found in time, or by this time on the clock of `time.monotonic`.
        """
        rest = self._known[next((place for place, (at, _) in enumerate(self._known) if at == state), len(self._known)) :]
        if rest and not any(part.holds(at) for at, (action, _) in rest for part in forbidden.get(action, ())):
            return [step for _, step in rest]
        domain = self._domain_for({action: tuple(parts) for action, parts in forbidden.items() if parts})
        numbers = (f"(= {fluent_text(scale.fluent)} {Constant(scale.value(state))})" for scale in self._task.scales)
        facts = " ".join((*map(fluent_text, self._task.named(state)), *numbers))
        parsed = kairos.parse_problem(f"{self._before} {facts} {self._guarding}{self._after}", domain)
        status, began = None, time.monotonic()
        until = min(until, began + max(_SHORT, _LONGER * self._longest)) if self._longest and not self.is_patient else until
        for way, seconds in ways:
            if status is kairos.Status.UNSOLVABLE and way != _OWN:
                continue
            limit = min(max(seconds, self._longest or _FIRST), until - time.monotonic())
            if limit <= 0.0:
                raise OutOfTime
            search: kairos.Search = self._planner.start(parsed, timeout=limit, anytime=False, threads=1, search=way)
            found = search.next_plan(limit)
            if found is None:
                status = search.wait().status
                found = search.best()
            search.stop()
            if found is not None:
                self._longest = max(self._longest, time.monotonic() - began)
                return [self._step(step) for step in found.steps]
            if status is kairos.Status.UNSOLVABLE and way == _OWN:
                break
        if status is kairos.Status.UNSOLVABLE and not self._task.scales:  # with numbers, Kairos 1.0.6 says so of others, too
            return None
        raise OutOfTime

    def _step(self, step: kairos.PlanStep) -> Step:
        if copy := self._copies.get(step.name.lower()):
            return copy
        spelled = self._names.step(step.name, step.args, 0.0, 0.0)
        action, number = self._of[spelled.action]
        return self._actions[action, spelled.arguments], number

    def _domain_for(self, forbidden: Mapping[PolicyAction, tuple[PartialState, ...]]) -> kairos.Domain:
        if self._parsed is not None and self._parsed[0] == forbidden:
            return self._parsed[1]
        concerned = sorted({action.name for action in forbidden})
        predicates, actions = dict(self._domain.predicates), {}
        for name, schema in self._domain.actions.items():
            if (of := self._of[name][0]) in concerned:
                guard = self._guards[of]
                predicates[guard] = Declaration(guard, schema.parameters)
                schema = guarded(schema, Not(Holds((guard, *(variable.name for variable in schema.parameters)))))
            actions[name] = schema
        text = write_domain(replace(self._domain, predicates=predicates, actions=actions)).rstrip()
        self._copies, copies, guarding = {}, [text[:-1]], []
        for place, action in enumerate(action for action in self._task.actions if action in forbidden):
            guarding.append(f"({' '.join((self._guards[action.name], *action.arguments))})")
            for alternative, condition in enumerate(action.conditions):
                clauses = self._clauses(condition, forbidden[action])
                if "" in clauses:
                    continue
                for number, outcome in enumerate(action.outcomes):
                    if outcome.changes:
                        name = f"{action.name}--{number}--{place}--{alternative}"
                        self._copies[name.lower()] = action, number
                        needed = f"(and {self._literals(condition)}{' '.join(clauses)})"
                        copies.append(f"(:action {name} :parameters () :precondition {needed} :effect {self._effect(outcome)})")
        self._guarding = " ".join(guarding)
        domain = kairos.parse_domain("\n".join((*copies, ")")))
        self._parsed = forbidden, domain
        return domain

    def _literals(self, part: PartialState) -> str:
        return "".join(
            (*(self._text_of(place) for place in places(part.true)), *(f"(not {self._text_of(place)})" for place in places(part.false)))
        )

    def _clauses(self, condition: PartialState, forbidden: Iterable[PartialState]) -> list[str]:
        """Return what rules the parts out where the condition holds; an empty one if nothing does."""
        parts = [part for part in forbidden if not (part.true & condition.false or part.false & condition.true)]
        found = [self._literals(PartialState(part.false & ~condition.false, part.true & ~condition.true)) for part in parts]
        return [text and f"(or {text})" for text in found]

    def _effect(self, outcome: PolicyOutcome) -> str:
        effects = []
        for condition, add, delete in outcome.changes:
            effects.append((condition, self._literals(PartialState(add & ~self._levels, delete & ~add & ~self._levels))))
        effects += ((condition, str(effect)) for condition, effect in outcome.counting)
        texts = (
            text if condition == ANY else f"(when (and {self._literals(condition)}) (and {text}))" for condition, text in effects if text
        )
        return f"(and {''.join(texts)})"
