"""Hand-written plans: files with a plan, with recipes, with a domain, or with all of these.

A world is a domain and the plans that are served together, each as an action server.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, Condition, fluents
from pnm.core.logic.domain import ProblemModel
from pnm.core.logic.effects import TimedChange
from pnm.core.logic.expressions import Fluent, Value
from pnm.core.logic.rules import Rules
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import PlanGraph
from pnm.errors import InputError, Tolerated
from pnm.files.yaml_nodes import Mapped
from pnm.knowledge.sources import SourceChoice
from pnm.language.domain import LanguageDomain, read_facts, read_goal
from pnm.language.files import PlanHead, beside, is_world, parse_documents, plan_heads, plan_heads_in, read_documents, read_domain
from pnm.language.formulas.scope import NOTHING_DECLARED, FormulaScope, unknown
from pnm.language.formulas.values import read_literal
from pnm.language.grammar import NamedWorld, WorldFile
from pnm.language.steps import StepReader, taken_literally
from pnm.language.to_plan_graph import PlanGraphBuilder


@dataclass(frozen=True)
class HandWrittenPlan:
    """A plan graph, ready for `pnm.core.machine.generate`, with its bindings, parameters and initial knowledge."""

    name: str
    graph: PlanGraph
    bindings: Bindings
    parameters: tuple[str, ...] | None = ()
    """Variables that are given when the plan is started; any if None."""
    results: tuple[str, ...] = ()
    """Variables whose values are the result of the plan."""
    variables: Mapping[str, object] = field(default_factory=dict)
    """The local knowledge at the beginning; parameters come before it."""
    facts: Mapping[Fluent, Value] = field(default_factory=dict)
    """The initial facts, as far as files have them."""
    timed: tuple[TimedChange, ...] = ()
    objects: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """By type."""
    timeout: float | None = None
    """Seconds that the plan may take."""
    on_failure: OnFailure = OnFailure.DRAIN
    sources: tuple[SourceChoice, ...] = ()
    """The sources of knowledge that the files chose."""
    calls: frozenset[str] = frozenset()
    """The other plans it calls."""
    warnings: tuple[Tolerated, ...] = ()
    """The tolerated mistakes in the files."""
    declared: ProblemModel = NOTHING_DECLARED
    """The model of its domain."""
    domain_file: str = ""
    """The source file of its domain; empty if it has none."""

    @property
    def goal(self) -> Condition:
        """The condition at the end."""
        return self.graph.goal

    @property
    def rules(self) -> Rules:
        """The rules for derived facts."""
        return self.graph.rules


def read_plans(path: Path, domain: Path | None = None) -> dict[str, HandWrittenPlan]:
    """Read all plans of a file, or of the world in it, by name.

    Args:
        path: the file.
        domain: the file with the domain, for plans that do not name one themselves.

    Raises:
        InputError: there is none, something is malformed, or has names that are not there.
    """
    documents, _ = read_documents(path)
    if len(documents) == 1 and is_world(documents[0]):
        return dict(read_world(path).plans)
    return finished(plan_heads(path, None if domain is None else read_domain(domain)))


def parse_plans(text: str, file: str = "plan.yaml", domain: LanguageDomain | None = None) -> dict[str, HandWrittenPlan]:
    """Read all plans of a text, by name; see `read_plans`.

    >>> parse_plans("actions: {wave: }\\nplan: [wave: , wave: ]")["plan"].graph
    <PlanGraph 2 calls, 1 orderings>
    """
    return finished(plan_heads_in(*parse_documents(text, file), domain))


def finished(heads: Sequence[PlanHead]) -> dict[str, HandWrittenPlan]:
    """Read plans whose heads are known, so that they may call each other.

    Raises `InputError` if two have the same name, they call each other in a circle, or something in them is wrong.
    """
    by_name: dict[str, PlanHead] = {}
    for head in heads:
        if head.name in by_name or head.name in head.domain.actions:
            what = "a plan" if head.name in by_name else "an action"
            raise InputError(f"there is {what} called {head.name!r} already", head.keys.entry.start)
        by_name[head.name] = head
    plans = {name: _plan(head, by_name) for name, head in by_name.items()}
    try:
        TopologicalSorter({name: plan.calls for name, plan in plans.items()}).prepare()
    except CycleError as error:
        cycle: list[str] = error.args[1]
        raise InputError(f"the plan would never end: {' is called by '.join(cycle)}", by_name[cycle[0]].keys.entry.start) from error
    return plans


# --- one plan ------------------------------------------------------------------------------


def _plan(head: PlanHead, others: Mapping[str, PlanHead]) -> HandWrittenPlan:
    keys, domain = head.keys, head.domain
    actions = {**domain.actions, **{name: other.action for name, other in others.items()}}
    reader = StepReader(actions, domain.model)
    steps = reader.steps(keys.plan)
    scope = FormulaScope(domain.model, {})
    facts = {**domain.model.init, **read_facts(keys.facts, scope)}
    own = {name: action.recoveries for name, action in actions.items() if action.recoveries is not None}
    recoveries = {name: reader.recoveries(actions[name], node) for name, node in own.items()}
    restarts = None if keys.restarts is None else max(1, keys.restarts)
    builder = PlanGraphBuilder(lambda action: recoveries.get(action.name, ()), KnowledgeBase(facts), restarts)
    goal = read_goal(keys.goal, scope)
    graph = builder.graph(steps, domain.model.goal if goal == TRUE else goal, domain.model.domain.rules)
    used = {name for action in actions.values() for name in action.resources}
    used |= {name for call in graph.calls for name in call.action.resources}
    graph = replace(graph, due=_due(graph.goal, domain), capacities=_capacities(keys.resources, used))
    parameters = None if head.parameters is None else tuple(variable.name[1:] for variable in head.parameters)
    variables = {name: read_literal(value).value for name, _, value in keys.initial_knowledge.entries()}
    return HandWrittenPlan(
        head.name,
        graph,
        Bindings({name: action.binding for name, action in actions.items()}),
        parameters=parameters,
        results=tuple(keys.results),
        variables=variables,
        facts=facts,
        timed=domain.model.timed,
        objects=domain.model.objects_by_type,
        timeout=keys.timeout,
        on_failure=keys.on_failure or OnFailure.DRAIN,
        sources=domain.sources,
        calls=frozenset(call.action.name for call in graph.calls) & others.keys(),
        warnings=(*head.warnings, *taken_literally(keys.plan, {*variables, *(parameters or ())})),
        declared=domain.model,
        domain_file=domain.file,
    )


def _due(goal: Condition, domain: LanguageDomain) -> float:
    """Return when the last timed fact comes that the goal reads: the goal is not looked at before."""
    asked = fluents(goal, KnowledgeBase(objects=domain.model.objects_by_type))
    rules = domain.model.domain.rules
    base = rules.base(fluent[0] for fluent in asked if fluent[0] in rules.derived)
    late = (change.time for change in domain.model.timed for fluent in change.changes if fluent in asked or fluent[0] in base)
    return max(late, default=0.0)


def _capacities(resources: Mapped, used: set[str]) -> dict[str, int]:
    """Read the capacities of resources; refuse that of one which neither the plan nor any action of the domain uses."""
    capacities = {name: resources.whole(name, 1) for name in resources.nodes}
    for name, capacity in capacities.items():
        if capacity < 1:
            raise InputError(f"expected how many calls may have {name} at the same time, at least 1", resources.position(name))
        if name not in used:
            raise unknown("resource", name, used, resources.nodes[name][0])
    return capacities


@dataclass(frozen=True)
class World:
    """Plans by name, and the domain they share."""

    name: str
    plans: Mapping[str, HandWrittenPlan]
    domain: LanguageDomain


def read_world(path: Path, name: str | None = None) -> World:
    """Read a world.

    Args:
        path: a file with ``domain`` and ``plans``, or with several worlds, each with ``domain`` and ``recipes``.
        name: which of several worlds.

    Raises:
        InputError: there is no such world, or something in it or its files is wrong.
    """
    documents, _ = read_documents(path)
    if len(documents) > 1:
        raise InputError("a second document begins here; expected one", documents[1].start)
    top = documents[0]
    if not top.nodes.keys().isdisjoint(("plans", "domain")):
        file = WorldFile(top)
        return _world(file.name or path.stem, file)
    worlds = top.mappings()
    if name is None and len(worlds) == 1:
        name = next(iter(worlds))
    if name is None:
        raise InputError(f"there are several worlds; expected the name of one: {', '.join(worlds)}", top.start)
    if name not in worlds:
        raise unknown("world", name, worlds, top.start)
    return _world(name, NamedWorld(worlds[name]))


def _world(name: str, keys: WorldFile | NamedWorld) -> World:
    entry, key = keys.entry, type(keys).plans.name
    domain = LanguageDomain() if keys.domain is None else read_domain(beside(entry, "domain", keys.domain))
    paths = [beside(entry, key, file_name) for file_name in keys.plans]
    if not paths:
        raise InputError(f"the world {name!r} has no plans; expected files under {key!r}", entry.start)
    return World(name, finished([head for path in paths for head in plan_heads(path, domain)]), domain)


# --- the plans of a file or a world ----------------------------------------------------------


def chosen_plan(plans: Mapping[str, HandWrittenPlan], name: str | None) -> str:
    """Return the name of the plan to carry out: the only one that no other calls, if none is named.

    Raises `InputError` if there is no such plan, or none is named and there are several.
    """
    called = frozenset(other for plan in plans.values() for other in plan.calls)
    candidates = [candidate for candidate in plans if candidate not in called] if name is None else [name]
    if len(candidates) != 1 or candidates[0] not in plans:
        wrong = "there are several plans" if name is None else f"there is no plan {name!r}"
        raise InputError(f"{wrong}; expected --name and one of {', '.join(plans)}")
    return candidates[0]


def called_plans(plans: Mapping[str, HandWrittenPlan], name: str) -> tuple[str, ...]:
    """Return the names of a plan and of all plans that it calls, or that these call."""
    names = [name]
    for caller in names:
        names += [called for called in sorted(plans[caller].calls) if called not in names]
    return tuple(names)


def merge_bindings(plans: Iterable[HandWrittenPlan]) -> Bindings:
    """Return the bindings of all plans, which are those of their domains."""
    return reduce(Bindings.before, (plan.bindings for plan in plans), Bindings())


def sources_of(plans: Iterable[HandWrittenPlan]) -> tuple[SourceChoice, ...]:
    """Return the sources of knowledge that any of the plans chose, each once."""
    choices: dict[str, SourceChoice] = {}
    for choice in (choice for plan in plans for choice in plan.sources):
        choices.setdefault(f"{choice.name} {choice.options}", choice)
    return tuple(choices.values())
