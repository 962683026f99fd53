"""From files to texts: what `pnm export` and `pnm import` write."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem, read_domain, read_problem
from planner_bridge.pddl.comments import CommentTable
from planner_bridge.pddl.reader import MAX_BYTES, comments
from planner_bridge.pddl.writer import write_domain as domain_text, write_problem as problem_text
from planner_bridge.planning.solve import solve
from planner_bridge.yaml.reader import read
from planner_bridge.yaml.writer import plan_entries, write_bindings, write_domain, write_problem
from pnm.core.logic.domain import ProblemModel
from pnm.core.machine.bindings import NO_BINDINGS, Bindings
from pnm.core.message_fields import Combined, Test
from pnm.errors import InputError, Tolerated, suggestion
from pnm.files.text import read_any_text


@dataclass(frozen=True, slots=True)
class Exported:
    """A YAML text, or why there is none."""

    text: str = ""
    warnings: tuple[Tolerated, ...] = ()
    reason: str = ""
    """Why no plan was found."""


@dataclass(frozen=True, slots=True)
class Imported:
    """PDDL texts, and that of a bindings file, by the names of their files."""

    texts: Mapping[str, str]
    warnings: tuple[Tolerated, ...] = ()


def exported(
    domain: Path,
    problem: Path | None,
    *,
    with_plan: bool = False,
    bindings: Bindings = NO_BINDINGS,
    planner: str = "kairos",
    timeout: float = 30.0,
    improve: float | None = None,
) -> Exported:
    """Return a PDDL domain as YAML: alone, with a problem for it, or with a plan besides, which the planner has `timeout` seconds to find.

    Bindings are written beside the actions. Raises `InputError` if a file is wrong, or has what cannot be written.
    """
    model = read_domain(domain)
    for name in bindings.actions.keys() - model.actions.keys():
        hint = suggestion(name, model.actions.keys())
        raise InputError(f"the bindings have an action {name!r}, which is not in {domain}{hint and f'; {hint}'}")
    if problem is None:
        if with_plan:
            raise InputError(f"a plan is for a problem; expected its file after {domain}")
        return Exported(write_domain(model, _comments(domain, "domain"), bindings), model.warnings)
    whole = read_problem(problem, model)
    if not with_plan:
        return Exported(write_problem(whole, _both(domain, problem), bindings=bindings), whole.warnings)
    result = solve(whole, planner=planner, timeout=timeout, improve=improve, bindings=bindings)
    if result.plan is None:
        return Exported(warnings=whole.warnings, reason=result.reason)
    graph = plan_graph(whole, result.plan)
    return Exported(write_problem(whole, _both(domain, problem), plan_entries(graph, whole.domain), bindings), whole.warnings)


def imported(file: Path) -> Imported:
    """Return a YAML file as PDDL and bindings; raise `InputError` if it is wrong, or has what PDDL has not."""
    contents = read(file)
    texts = {"domain.pddl": domain_text(contents.domain, contents.of("domain"))}
    domain = parse_domain(texts["domain.pddl"], "domain.pddl")  # which warns of requirements that other planners will miss
    warnings = (*contents.domain.warnings, *domain.warnings)
    model = ProblemModel("", domain)
    if contents.problem:
        texts["problem.pddl"] = problem_text(contents.problem, contents.of("problem"))
        model = problem = parse_problem(texts["problem.pddl"], domain, "problem.pddl")
        warnings = (*contents.domain.warnings, *problem.warnings)
    bound, before = dict(contents.bindings.actions), contents.problem or ProblemModel("", contents.domain)
    for name, binding in contents.bindings.actions.items():
        if binding.outcomes:  # which have no names in PDDL, and are equal there if they differ in nothing else
            numbers, tests = {frozenset(way.effects): way.name for way in model.outcomes(name)}, dict[str, list[Test]]()
            for way in before.outcomes(name):
                if way.name in binding.outcomes:
                    tests.setdefault(numbers[frozenset(way.effects)], []).append(binding.outcomes[way.name])
            told = {number: some[0] if len(some) == 1 else Combined("any", tuple(some)) for number, some in tests.items()}
            bound[name] = replace(binding, outcomes=told)
    if text := write_bindings(replace(contents.bindings, actions=bound)):
        texts["bindings.yaml"] = text
    return Imported(texts, warnings)


def _both(domain: Path, problem: Path) -> CommentTable:
    return {**_comments(domain, "domain"), **_comments(problem, "problem")}


def _comments(file: Path, kind: Literal["domain", "problem"]) -> CommentTable:
    return comments(read_any_text(file, MAX_BYTES)[0], kind)
