"""The world that everything a node does shares, as it is at first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from planner_bridge.model import Problem
from pnm.errors import InputError
from pnm.expressions import Fluent, Value, show
from pnm.knowledge import KnowledgeBase
from pnm.language.plan import HandWrittenPlan
from pnm.rules import Rule, Rules


@dataclass(frozen=True, slots=True)
class _Beginning:
    """What one of those who share a world says of it."""

    name: str
    facts: Mapping[Fluent, Value]
    objects: Mapping[str, tuple[str, ...]]
    rules: Rules


def common_knowledge(plans: Iterable[HandWrittenPlan], problem: Problem | None = None) -> KnowledgeBase:
    """Return the world that all tasks share, which begins as the problem and the plans say.

    Raises:
        InputError: two of them say different things.
    """
    beginnings = [_Beginning(plan.name, plan.facts, plan.objects, plan.rules) for plan in plans]
    if problem is not None:
        beginnings.insert(0, _Beginning(problem.name, problem.init, problem.objects_by_type, Rules(problem.domain.rules)))
    facts: dict[Fluent, Value] = {}
    said: dict[Fluent, str] = {}
    objects: dict[str, tuple[str, ...]] = {}
    rules: dict[str, Rule] = {}
    for one in beginnings:
        for fluent, value in one.facts.items():
            if facts.setdefault(fluent, value) != value:
                raise InputError(f"{said[fluent]} and {one.name} begin with different values of {show(fluent)}: {facts[fluent]}, {value}")
            said.setdefault(fluent, one.name)
        for kind, names in one.objects.items():
            objects[kind] = tuple(dict.fromkeys((*objects.get(kind, ()), *names)))
        rules |= {str(rule): rule for rule in one.rules.rules}
    return KnowledgeBase(facts, objects=objects, rules=Rules(tuple(rules.values())))
