"""The claims of an answer, checked one by one: plans by both validators, what is impossible by a second planner."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import combinations, islice, product
from random import Random
from typing import Final

from planner_bridge.explanations.answer import Answer, Best, Claim, Fails, Known, NoSmallerChange, Solves, Unsolvable
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.plan import Plan
from planner_bridge.model.problem import Problem
from planner_bridge.planning.kairos import validate
from planner_bridge.planning.solve import solve
from planner_bridge.planning.validate import why_invalid
from pnm.core.logic.conditions import fluents
from pnm.core.logic.expressions import Fluent
from tests.support.pddl.explanations.second_planner import fewest_calls, is_classical, second_opinion

_TRIED: Final = 30
"""Changes of several facts that are tried, drawn at random."""
_MOST: Final = 300
"""Changes of one fact that are tried."""
_SECONDS: Final = 0.3
"""For one search, in which a plan would speak against a claim."""


@dataclass
class Checked:
    """What the checks have found. Everything is mutable state."""

    false: list[str] = field(default_factory=list)
    confirmed: Counter[str] = field(default_factory=Counter)
    unconfirmed: list[str] = field(default_factory=list)
    """Claims that the second planner can neither confirm nor refute: it knows neither numbers nor time."""

    def look(self, answer: Answer) -> None:
        """Check every claim of an answer."""
        for part in answer.every():
            if part.claims and part.known is Known.NOT_PROVED:
                self.false.append(f"claims something, and calls it not proved: {part.statement}")
            for claim in part.claims:
                self.check(claim, part.statement)

    def check(self, claim: Claim, said: str) -> None:
        """Check one claim."""
        match claim:
            case Solves(problem, plan):
                self._note(claim, said, _is_valid(problem, plan))
            case Fails(problem, plan):
                self._note(claim, said, not _is_valid(problem, plan))
            case Unsolvable(problem):
                self._note(claim, said, _has_no_plan(problem))
            case Best(problem, plan):
                fewest = fewest_calls(problem) if is_classical(problem) else None
                self._note(claim, said, None if fewest is None else fewest == len(plan.steps))
            case NoSmallerChange(problem, facts):
                self._note(claim, said, not any(solve(each, timeout=_SECONDS, improve=0.0).plan for each in smaller(problem, facts)))

    def _note(self, claim: Claim, said: str, verdict: bool | None) -> None:
        kind = type(claim).__name__
        if verdict:
            self.confirmed[kind] += 1
        else:
            (self.unconfirmed if verdict is None else self.false).append(f"{kind}: {said}")


def _is_valid(problem: Problem, plan: Plan) -> bool:
    return not why_invalid(problem, plan) and not validate(problem, plan)


def _has_no_plan(problem: Problem) -> bool | None:
    """Return whether there is no plan; None if neither planner finds that out."""
    has_plan = second_opinion(problem)
    if has_plan is None:
        return False if solve(problem, timeout=_SECONDS, improve=0.0).plan else None
    return not has_plan


def smaller(problem: Problem, facts: int) -> Iterator[Problem]:
    """Yield the problem after every change of fewer facts than so many; of several facts some that are drawn at random."""
    asked_for = fluents(problem.goal, initial_knowledge(problem))
    others = sorted(fluent for fluent in _facts(problem) if fluent not in asked_for)
    for size in range(facts):
        every = (
            islice(combinations(others, size), _MOST)
            if size < 2
            else (Random(n).sample(others, min(size, len(others))) for n in range(_TRIED))
        )
        for change in {tuple(sorted(change)) for change in every}:
            yield _flipped(problem, change)


def _flipped(problem: Problem, change: tuple[Fluent, ...]) -> Problem:
    init = dict(problem.init)
    for fluent in change:
        if init.pop(fluent, None) is not True:
            init[fluent] = True
    return replace(problem, init=init)


def _facts(problem: Problem) -> Iterator[Fluent]:
    derived = problem.domain.rules.derived
    for name, declared in problem.domain.predicates.items():
        objects = [[o for kind in variable.types for o in problem.objects_by_type.get(kind, ())] for variable in declared.parameters]
        yield from ((name, *chosen) for chosen in product(*objects) if name not in derived)
