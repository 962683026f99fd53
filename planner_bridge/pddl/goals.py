"""Conditions that stand alone, as somebody says them while a problem is being worked on."""

from __future__ import annotations

from typing import Final

from planner_bridge.model import Problem
from planner_bridge.pddl.conditions import condition
from planner_bridge.pddl.names import Names
from planner_bridge.pddl.requirements import Requirements
from planner_bridge.pddl.scope import Scope
from planner_bridge.pddl.sexpr import parse, wrong
from pnm.conditions import Condition
from pnm.errors import InputError, Position

MAX_CHARACTERS: Final = 1_000_000


def parse_condition(text: str, problem: Problem, file: str = "goal") -> Condition:
    """Read a condition about the objects of a problem.

    Args:
        text: the condition in PDDL.
        problem: says which names there are.
        file: where the text comes from, for errors.

    Raises:
        InputError: it is none, or names what is not declared.
    """
    start = Position(file, 1, 1)
    if len(text) > MAX_CHARACTERS:
        raise InputError(f"the condition has more than {MAX_CHARACTERS} characters; no more are read", start)
    nodes = parse(text, file)
    if not nodes:
        raise InputError("expected a condition such as (at r1 kitchen), found nothing", start)
    if len(nodes) > 1:
        raise wrong(nodes[1], f"expected one condition, found {nodes[1]} after it; (and ...) makes one of several")
    needed = Requirements((*problem.domain.requirements, *problem.requirements, ":typing"))
    derived = frozenset(rule.name for rule in problem.domain.rules)
    return condition(nodes[0], Scope(Names(problem.domain, problem.objects, needed, derived=derived)))
