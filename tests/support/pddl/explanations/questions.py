"""Random questions about the problems of a domain, in worlds that differ from theirs by some facts, and their answers."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from random import Random

from planner_bridge.explanations.answer import Answer
from planner_bridge.explanations.goal_now import what_would_help
from planner_bridge.explanations.needed_call import why_call_of_plan, why_not, why_plan
from planner_bridge.explanations.no_plan import SECONDS, AnswerLimit, why_no_plan
from planner_bridge.model.grounding import dynamic_names, ground_action, initial_knowledge
from planner_bridge.model.plan import PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.pipeline.loading import load
from pnm.core.logic.conditions import conjunction, conjuncts, names, unmet
from tests.support.files import ROOT


@dataclass(frozen=True, slots=True)
class Asked:
    """A question, its answers, and the seconds that they took: of the clock, and of the processor."""

    text: str
    answers: tuple[Answer, ...]
    seconds: float
    processor: float


def domains(shared: Path | None = None) -> dict[str, list[Path]]:
    """The domain files of this project with their problems, and those of a folder of pairs, by name."""
    found: dict[str, list[Path]] = {}
    for domain in sorted((ROOT / "domains").glob("*/domain.pddl")):
        name = domain.parent.name
        problems = sorted([*domain.parent.glob("problem*.pddl"), *(ROOT / "problems" / name).glob("*.pddl")])
        if problems:
            found[name] = [domain, *problems]
    for domain in sorted(shared.glob("*/*/domain.pddl")) if shared and shared.is_dir() else ():
        found[f"{domain.parent.parent.name}/{domain.parent.name}"] = [domain, domain.parent / "problem.pddl"]
    return found


def ask(problems: Sequence[Problem], count: int, seed: int = 0) -> Iterator[Asked]:
    """Ask random questions and answer them; yield each with its answers."""
    for number in range(count):
        random = Random(f"{seed} {number}")
        problem = _otherwise(random.choice(problems), random)
        clock, processor = time.perf_counter(), time.process_time()
        limit = AnswerLimit.of(SECONDS)
        found = limit.first_plan(problem)
        asks_for_other = random.random() < 0.45
        if asks_for_other and (action := _action(problem, random)):
            text, answers = f"why not {action}", (why_not(problem, action, found, limit),)
        elif found.plan is None:
            reason = why_no_plan(problem, found, limit)
            text, answers = "why no plan", (reason, what_would_help(problem, limit, reason))
        elif found.plan.steps and random.random() < 0.8:
            call = random.randrange(len(found.plan.steps))
            text, answers = f"why call {call + 1}", (why_call_of_plan(problem, found.plan, call),)
        else:
            text, answers = "why this plan", (why_plan(problem, found.plan),)
        yield Asked(f"{number}: {text}", answers, time.perf_counter() - clock, time.process_time() - processor)


def read(files: Sequence[Path]) -> list[Problem]:
    """Read the problems of a domain."""
    domain, *problems = files
    return [load(domain, problem) for problem in problems]


def _otherwise(problem: Problem, random: Random) -> Problem:
    """Return the problem without some facts, or with others, and perhaps with another goal: one that may have no plan."""
    init = dict(problem.init)
    facts = sorted(fluent for fluent, value in init.items() if value is True)
    for fluent in random.sample(facts, min(len(facts), random.choice([0, 1, 1, 2, 3]))):
        del init[fluent]
    parts = conjuncts(problem.goal)
    if len(parts) > 1 and random.random() < 0.3:
        parts = tuple(random.sample(parts, len(parts) - 1))
    return replace(problem, init=init, goal=conjunction(parts))


def _action(problem: Problem, random: Random) -> PlanStep | None:
    """Return an action with random objects of the right types: more often one whose fixed facts hold."""
    state, schema = initial_knowledge(problem), random.choice([*problem.domain.actions.values()])
    if not all(state.objects(variable.types) for variable in schema.parameters):
        return None
    for _ in range(random.choice([1, 30])):
        env = {variable.name: random.choice(state.objects(variable.types)) for variable in schema.parameters}
        step = PlanStep(schema.name, tuple(env.values()))
        if _is_sensible(problem, step):
            break
    return step


def _is_sensible(problem: Problem, step: PlanStep) -> bool:
    missing = unmet(ground_action(problem.domain.actions[step.action], step.arguments).precondition, initial_knowledge(problem))
    return all(names(part) & dynamic_names(problem) for part in missing)
