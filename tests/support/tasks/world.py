"""A world that tasks share, and questions about it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.model.problem import Problem
from planner_bridge.node.problem_service import ProblemFolder, ServedProblem
from planner_bridge.node.world_queries import SharedWorld
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.tasks.settings import Settings
from pnm.core.knowledge_base import KnowledgeBase

DOMAIN = parse_domain(
    """(define (domain d) (:requirements :adl :fluents :derived-predicates)
    (:types robot place - object arm - robot)
    (:constants dock - place)
    (:predicates (charged ?r - robot) (at ?r - robot ?p - place) (ready ?r - robot) (dark))
    (:functions (battery ?r - robot) - number (location ?r - robot) - place)
    (:derived (ready ?r - robot) (and (charged ?r) (not (dark))))
    (:action wait :parameters (?r - robot) :effect (dark)))"""
)
PROBLEM = parse_problem(
    """(define (problem p) (:domain d) (:objects r1 R2 - robot a1 - arm kitchen hall - place)
    (:init (at r1 kitchen) (charged r1) (= (battery r1) 0.5) (= (location a1) hall) (at 5 (dark))) (:goal (at r1 hall)))""",
    DOMAIN,
)
GOALS = {"home": "(forall (?r - robot) (at ?r dock))", "dark": "(dark)"}


def world() -> SharedWorld:
    return SharedWorld(PROBLEM, initial_knowledge(PROBLEM), GOALS)


def served(
    knowledge: KnowledgeBase, problem: Problem = PROBLEM, settings: Settings = Settings(), folder: Path | None = None, **more: Any
) -> ServedProblem:
    """The problem of a node, of which nobody hears if another one is loaded."""
    return ServedProblem(problem, knowledge, settings, ProblemFolder(folder), lambda *_: None, **more)


def updated(shared: SharedWorld, *changes: Sequence[str], **more: Sequence[str]) -> int:
    """Record changes as a node does that is asked for it; return how many facts have changed."""
    return shared.record(shared.read_changes(*changes, **more))
