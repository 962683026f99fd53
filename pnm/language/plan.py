"""Hand-written plans: files with a plan, with recipes, with a domain, or with all of these.

A world is a domain and the plans that are served together, each as an action server.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Final

from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import TRUE, Condition, fluents
from pnm.core.logic.domain import ActionSchema, ProblemModel
from pnm.core.logic.effects import TimedChange
from pnm.core.logic.expressions import Fluent, Value, Variable
from pnm.core.logic.rules import Rules
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import PlanGraph
from pnm.errors import InputError, Position, Tolerated, suggestion
from pnm.files.text import read_text
from pnm.files.yaml_nodes import MAX_BYTES, Mapped, parse_yaml
from pnm.knowledge.sources import SourceChoice
from pnm.language.domain import CLASSES, LanguageAction, LanguageDomain, domain_from, read_class, read_facts, read_goal
from pnm.language.formulas.scope import NOTHING_DECLARED, FormulaScope, read_typed, unknown
from pnm.language.formulas.words import read_literal
from pnm.language.grammar import ActionKind, DomainKeys, NamedPlan, NamedWorld, PlanKeys, Recipe, WorldFile
from pnm.language.steps import StepReader, taken_literally
from pnm.language.to_plan_graph import PlanGraphBuilder

ANCHORS: Final = {"base_action": {}, **{kind.value: {"type": kind.value} for kind in CLASSES.values()}}
"""The meanings of ``*ros_action`` and the like in files that do not define them."""
MAX_EXCERPT: Final = 100_000
"""Characters of an excerpt; longer texts are not mended."""
_LONE_KEY: Final = re.compile(r"( *)-( +)[^\s#'\"\[{][^#'\"\[{]*:\s*\Z")
_PLAN: Final = tuple(NamedPlan.known)
_DOMAIN: Final = tuple(DomainKeys.known)
_SERVERS: Final = ("ActionServer", "SimpleActionServer", "BasicControllerPluginServer", "DAPluginServer")
"""The classes that files for the original implementation name; every plan becomes a ROS 2 action server."""
_CALLED: Final = Binding(retries=0, timeout=86_400.0, cancel=60.0)
"""The call of a plan by another: its own limits, and those of its calls, end it sooner than these."""


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


def read_plans(path: Path) -> dict[str, HandWrittenPlan]:
    """Read all plans of a file, or of the world in it, by name.

    Raises `InputError` if there is none, something is malformed, or has names that are not there.
    """
    documents, warnings = read_documents(path)
    if len(documents) == 1 and is_world(documents[0]):
        return dict(read_world(path).plans)
    return finished(plan_heads(documents, warnings, None))


def parse_plans(text: str, file: str = "plan.yaml", domain: LanguageDomain | None = None) -> dict[str, HandWrittenPlan]:
    """Read all plans of a text, by name; see `read_plans`.

    >>> parse_plans("actions: {wave: }\\nplan: [wave: , wave: ]")["plan"].graph
    <PlanGraph 2 calls, 1 orderings>
    """
    return finished(plan_heads(*parse_documents(text, file), domain))


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
    """Read a world: a file with ``domain`` and ``plans``, or by its name one of several, each with ``domain`` and ``recipes``.

    Raises `InputError` if there is no such world, or something in it or its files is wrong.
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
    return World(name, finished([head for path in paths for head in plan_heads(*read_documents(path), domain)]), domain)


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


# --- documents -----------------------------------------------------------------------------
# YAML documents of the language, with predefined anchors for the kinds of actions.
#
# Papers print domains without the definitions of their anchors, between ellipses and with damaged indentation: such an excerpt is mended,
# with a warning, if it cannot be read as it stands. Of files with plans, the heads of the plans and the domain are read first, so that
# plans can call each other.


def read_documents(path: Path) -> tuple[tuple[Mapped, ...], tuple[Tolerated, ...]]:
    """Return the documents of a file, and warnings about what was tolerated; raise `InputError` if it is not there, or no YAML mappings."""
    return parse_documents(read_text(path, MAX_BYTES), str(path))


def parse_documents(text: str, file: str) -> tuple[tuple[Mapped, ...], tuple[Tolerated, ...]]:
    """Return the documents of a text, and warnings about what was tolerated in it; raise `InputError` if these are no mappings in YAML."""
    try:
        return parse_yaml(text, file, ANCHORS), ()
    except InputError as error:
        suggestion, changed = _mended(text) if len(text) <= MAX_EXCERPT else (text, [])
        if not changed:
            raise
        try:
            parsed = parse_yaml(suggestion, file, ANCHORS)
        except InputError:
            raise error from None
        return parsed, tuple(Tolerated(message, Position(file, line, 1)) for line, message in changed)


def _mended(text: str) -> tuple[str, list[tuple[int, str]]]:
    """Return the text without a leading ellipsis and with indentation mended, and what was done in which line."""
    lines = text.splitlines()
    changed: list[tuple[int, str]] = []
    first = next((number for number, line in enumerate(lines) if line.strip() and not line.lstrip().startswith("#")), len(lines))
    if first < len(lines) and lines[first].rstrip() == "...":
        lines[first] = ""
        changed.append((first + 1, "'...' at the beginning is left out"))
    for number, line in enumerate(lines):
        match = _LONE_KEY.match(line)
        if match is None or number + 1 == len(lines):
            continue
        dash, key = len(match[1]), len(match[1]) + 1 + len(match[2])
        if dash < _indent(lines[number + 1]) < key:
            changed.append((number + 2, f"indented less than its owner in line {number + 1}"))
            more = " " * (key + 1 - _indent(lines[number + 1]))
            for below in range(number + 1, len(lines)):  # all that belongs to the key
                if lines[below].strip() and _indent(lines[below]) <= dash:
                    break
                lines[below] = more + lines[below]
    return "\n".join(lines) + "\n", changed


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip(" ")) if line.strip() else 0


@dataclass(frozen=True)
class PlanHead:
    """The head of a plan, whose steps are not read yet: what other plans need in order to call it."""

    name: str
    keys: PlanKeys
    domain: LanguageDomain
    parameters: tuple[Variable, ...] | None
    warnings: tuple[Tolerated, ...] = ()

    @property
    def action(self) -> LanguageAction:
        """The plan as an action that others call."""
        schema = ActionSchema(self.name, self.parameters or ())
        return LanguageAction(schema, ActionKind.PLAN, self.keys.entry.start, self.parameters is None, binding=_CALLED)


def read_domain(path: Path) -> LanguageDomain:
    """Read the domain of a file, whatever else is in it; raise `InputError` if there is none, or something in it is wrong."""
    documents, warnings = read_documents(path)
    for document in documents:
        _entries(document)
    top = domain_document(documents)
    if top is None:
        raise InputError("there is no domain in the file; expected the key 'actions'", Position(str(path), 1, 1))
    return domain_from(top, warnings)


def plan_heads(documents: tuple[Mapped, ...], warnings: tuple[Tolerated, ...], domain: LanguageDomain | None) -> list[PlanHead]:
    """Read the heads of all plans of a file's documents."""
    top = domain_document(documents)
    own = None if top is None else domain_from(top, warnings)
    heads: list[PlanHead] = []
    for document in documents:
        for name, keys in _entries(document):
            if isinstance(keys, Recipe):
                _check_classes(keys)
            entry, path = keys.entry, keys.domain
            parameters = None if keys.params is None else read_typed(keys.params)
            if path is not None and own is not None:
                raise InputError("the file has a domain itself; it cannot name another", entry.position("domain"))
            chosen = own or domain or LanguageDomain() if path is None else read_domain(beside(entry, "domain", path))
            heads.append(PlanHead(name, keys, chosen, parameters, tuple(dict.fromkeys((*warnings, *chosen.warnings)))))
    if not heads:
        raise InputError("there is no plan in the file; expected the key 'plan'", documents[0].start)
    return heads


def _entries(document: Mapped) -> list[tuple[str, PlanKeys]]:
    """Return the plans of a document: itself, or its recipes; refuse whatever else is in it."""
    if "plan" in document.nodes:
        document.only(*_PLAN, *_DOMAIN)
        plan = NamedPlan(document)
        return [(plan.name or Path(document.file).stem, plan)]
    if is_world(document):
        raise InputError("this is a world; expected a plan", document.start)
    recipes: list[tuple[str, PlanKeys]] = []
    for key, where, node in document.entries():
        if key in _DOMAIN:
            continue
        recipe = node.mapped() if node.is_mapping and key not in _PLAN else None
        if recipe is None or recipe.nodes.keys().isdisjoint(Recipe.known):
            if key in _PLAN:
                raise InputError(f"the key 'plan' is missing beside {key!r}", where)
            Mapped(document.file, document.start, {key: document.nodes[key]}).only(*_PLAN, *_DOMAIN)
            continue
        recipes.append((key, Recipe(recipe)))
    return recipes


def is_world(document: Mapped) -> bool:
    """Return whether the document lists the files of plans, or has worlds that do."""
    worlds = (node.mapped() for _, _, node in document.entries() if node.is_mapping)
    return "plan" not in document.nodes and ("plans" in document.nodes or any("recipes" in world.nodes for world in worlds))


def domain_document(documents: Iterable[Mapped]) -> Mapped | None:
    """Return the document that has a domain; None if none has. Raise `InputError` if several have."""
    domains = [document for document in documents if document.nodes.keys() & set(_DOMAIN) - set(_PLAN)]
    if len(domains) > 1:
        raise InputError("there is a domain in this file already", domains[1].start)
    return domains[0] if domains else None


def beside(entry: Mapped, key: str, path: str) -> Path:
    """Return a file that is named relative to the one the entry stands in; raise `InputError` if there is no such file."""
    file = Path(entry.file).parent / path
    if not os.path.isfile(file):  # unlike `Path.is_file` also for names that are too long
        others = sorted(path.name for path in file.parent.glob("*.y*ml")) if os.path.isdir(file.parent) else []
        hint = suggestion(file.name, others)
        raise InputError(f"there is no file {path[:200]!r} beside this one{f'; {hint}' if hint else ''}", entry.position(key))
    return file


def _check_classes(keys: Recipe) -> None:
    """Refuse what the original implementation would import, unless it is what every plan has here."""
    server, message = keys.server, keys.action
    if server is not None:
        _, name = read_class(server)
        if name not in _SERVERS:
            error = unknown("kind of server", name, _SERVERS, server.position)
            raise InputError(f"{error.message}; every plan becomes a ROS 2 action server, so the key may be left out", server.position)
    if message is not None:
        module, _ = read_class(message)
        if not module.endswith(".msg"):
            raise message.wrong(f"{module!r} has no messages; expected a module such as 'rpn_recipe_planner_msgs.msg', or no key 'action'")
