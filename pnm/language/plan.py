"""Plans that people write: files with a plan, with recipes, with a domain, or with all of these."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Final

from pnm.bindings import Binding, Bindings
from pnm.conditions import TRUE, Condition
from pnm.effects import TimedChange
from pnm.errors import InputError, Position, Tolerated
from pnm.expressions import Fluent, Value, Variable
from pnm.language.actions import ActionKind, LanguageAction, read_class
from pnm.language.calls import Facts
from pnm.language.data import read_literal
from pnm.language.declarations import needed, read_facts
from pnm.language.domain import DOMAIN_KEYS, LanguageDomain, domain_from, read_goal
from pnm.language.files import read_documents
from pnm.language.lowering import Lowering
from pnm.language.scope import read_typed, unknown
from pnm.language.steps import StepReader
from pnm.language.tree import WrittenRecovery
from pnm.machine import OnFailure
from pnm.plan_graph import PlanGraph
from pnm.rules import Rules
from pnm.sources.registry import Choice
from pnm.yaml_files import Mapped

_ALWAYS: Final = (
    *("domain", "params", "results", "initial_knowledge", "facts", "goal"),
    *("timeout", "restarts", "on_failure", "resources", "plan"),
)
PLAN_KEYS: Final = ("name", *_ALWAYS)
"""What a document says about the plan in it."""
RECIPE_KEYS: Final = ("server", "action", *_ALWAYS)
"""What is said about a plan under its name."""
_ONLY_DOMAINS: Final = frozenset(DOMAIN_KEYS) - frozenset(PLAN_KEYS)
_SERVERS: Final = ("ActionServer", "SimpleActionServer", "BasicControllerPluginServer", "DAPluginServer")
"""The classes that files for the original implementation name; every plan becomes a ROS 2 action server."""


@dataclass(frozen=True)
class HandWrittenPlan:
    """A plan, ready for `pnm.generation.generate`, and what it is carried out with."""

    name: str
    graph: PlanGraph
    bindings: Bindings
    parameters: tuple[str, ...] | None = ()
    """Variables that whoever starts the plan gives; any if None."""
    results: tuple[str, ...] = ()
    """Variables that whoever started the plan is told at the end."""
    variables: Mapping[str, object] = field(default_factory=dict)
    """What the run knows at the beginning; parameters come before it."""
    facts: Mapping[Fluent, Value] = field(default_factory=dict)
    """What is so in the world at the beginning, as far as files say."""
    timed: tuple[TimedChange, ...] = ()
    """What changes in the world by itself."""
    objects: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """By type."""
    timeout: float | None = None
    """Seconds that the plan may take."""
    on_failure: OnFailure = OnFailure.DRAIN
    sources: tuple[Choice, ...] = ()
    """The sources of knowledge that the files chose."""
    calls: frozenset[str] = frozenset()
    """The other plans it calls."""
    warnings: tuple[Tolerated, ...] = ()
    """What in the files was not as it should be."""
    domain_file: str = ""
    """Where its domain was read from; empty if it has none."""

    @property
    def goal(self) -> Condition:
        """What must hold at the end."""
        return self.graph.goal

    @property
    def rules(self) -> Rules:
        """What derives facts."""
        return self.graph.rules


@dataclass(frozen=True)
class Draft:
    """A plan of which only the head has been read: what others need to know in order to call it."""

    name: str
    entry: Mapped
    domain: LanguageDomain
    parameters: tuple[Variable, ...] | None
    warnings: tuple[Tolerated, ...] = ()

    @property
    def action(self) -> LanguageAction:
        """The plan as an action that others call."""
        return LanguageAction(self.name, ActionKind.PLAN, self.entry.start, self.parameters)


def read_domain(path: Path) -> LanguageDomain:
    """Read the domain of a file, whatever else is in it.

    Raises:
        InputError: there is none, something is malformed, or has names that are not there.
    """
    documents, warnings = read_documents(path)
    for document in documents:
        _entries(document)
    found = _domain_in(documents, warnings)
    if found is None:
        raise InputError("there is no domain in the file; expected the key 'actions'", Position(str(path), 1, 1))
    return found


def read_plans(path: Path, domain: Path | None = None) -> dict[str, HandWrittenPlan]:
    """Read all plans of a file, by name.

    Args:
        path: the file.
        domain: the file with the domain, for plans that do not say it themselves.

    Raises:
        InputError: there is none, something is malformed, or has names that are not there.
    """
    return finished(drafts(path, None if domain is None else read_domain(domain)))


def drafts(path: Path, domain: LanguageDomain | None = None) -> list[Draft]:
    """Read the heads of all plans of a file.

    Raises:
        InputError: there is none, or something is malformed.
    """
    documents, warnings = read_documents(path)
    own = _domain_in(documents, warnings)
    found: list[Draft] = []
    for document in documents:
        for name, entry in _entries(document):
            _check_classes(entry)
            params = entry.node("params")
            parameters = None if params is None or params.is_null else read_typed(params)
            chosen = _domain_of(entry, own, domain)
            found.append(Draft(name, entry, chosen, parameters, tuple(dict.fromkeys((*warnings, *chosen.warnings)))))
    if not found:
        raise InputError("there is no plan in the file; expected the key 'plan'", documents[0].start)
    return found


def finished(found: Sequence[Draft]) -> dict[str, HandWrittenPlan]:
    """Read plans whose heads are known, so that they may call each other.

    Raises:
        InputError: two have the same name, they call each other in a circle, or something in them is wrong.
    """
    by_name: dict[str, Draft] = {}
    for draft in found:
        if draft.name in by_name or draft.name in draft.domain.actions:
            what = "a plan" if draft.name in by_name else "an action"
            raise InputError(f"there is {what} called {draft.name!r} already", draft.entry.start)
        by_name[draft.name] = draft
    plans = {name: _plan(draft, by_name) for name, draft in by_name.items()}
    try:
        TopologicalSorter({name: plan.calls for name, plan in plans.items()}).prepare()
    except CycleError as error:
        cycle: list[str] = error.args[1]
        raise InputError(f"the plan would never end: {' is called by '.join(cycle)}", by_name[cycle[0]].entry.start) from error
    return plans


# --- documents -----------------------------------------------------------------------------


def _entries(document: Mapped) -> list[tuple[str, Mapped]]:
    """Return the plans of a document: itself, or its recipes; refuse whatever else is in it."""
    if "plan" in document.nodes:
        document.only(*PLAN_KEYS, *DOMAIN_KEYS)
        return [(document.string("name") or Path(document.file).stem, document)]
    found: list[tuple[str, Mapped]] = []
    for key, where, node in document.entries():
        if key in DOMAIN_KEYS:
            continue
        recipe = node.mapped() if node.is_mapping and key not in PLAN_KEYS else None
        if recipe is None or recipe.nodes.keys().isdisjoint(RECIPE_KEYS):
            if key in PLAN_KEYS:
                raise InputError(f"the key 'plan' is missing beside {key!r}", where)
            Mapped(document.file, document.start, {key: document.nodes[key]}).only(*PLAN_KEYS, *DOMAIN_KEYS)
            continue
        recipe.only(*RECIPE_KEYS)
        needed(recipe, "plan")
        found.append((key, recipe))
    return found


def _domain_in(documents: Iterable[Mapped], warnings: tuple[Tolerated, ...] = ()) -> LanguageDomain | None:
    found: LanguageDomain | None = None
    for document in documents:
        if not document.nodes.keys() & _ONLY_DOMAINS:
            continue
        if found is not None:
            raise InputError("there is a domain in this file already", document.start)
        found = domain_from(document, warnings)
    return found


def _domain_of(entry: Mapped, own: LanguageDomain | None, given: LanguageDomain | None) -> LanguageDomain:
    path = entry.string("domain")
    if path is None:
        return own or given or LanguageDomain()
    if own is not None:
        raise InputError("the file has a domain itself; it cannot name another", entry.position("domain"))
    file = Path(entry.file).parent / path
    if not file.is_file():
        raise InputError(f"there is no file {path!r} beside this one", entry.position("domain"))
    return read_domain(file)


def _check_classes(entry: Mapped) -> None:
    """Refuse what the original implementation would import, unless it is what every plan has here."""
    server, message = entry.node("server"), entry.node("action")
    if server is not None and not server.is_null:
        _, name = read_class(server)
        if name not in _SERVERS:
            error = unknown("kind of server", name, _SERVERS, server.position)
            raise InputError(f"{error.message}; every plan becomes a ROS 2 action server, so the key may be left out", server.position)
    if message is not None and not message.is_null:
        module, _ = read_class(message)
        if not module.endswith(".msg"):
            raise message.wrong(f"{module!r} has no messages; expected a module such as 'rpn_recipe_planner_msgs.msg', or no key 'action'")


# --- one plan ------------------------------------------------------------------------------


def _plan(draft: Draft, others: Mapping[str, Draft]) -> HandWrittenPlan:
    entry, domain = draft.entry, draft.domain
    actions = {**domain.actions, **{name: other.action for name, other in others.items()}}
    reader = StepReader(actions, domain.declared)
    steps = reader.steps(needed(entry, "plan"))
    facts = {**domain.facts, **read_facts(entry, "facts", domain.declared.scope(()))}
    recoveries: dict[str, tuple[WrittenRecovery, ...]] = {
        name: reader.recoveries(action, action.recoveries) for name, action in actions.items() if action.recoveries is not None
    }
    lowering = Lowering(lambda action: recoveries.get(action.name, ()), Facts(facts), max(1, entry.whole("restarts", 1)))
    goal = read_goal(entry, domain.declared)
    graph = lowering.graph(steps, domain.goal if goal == TRUE else goal, domain.rules, _capacities(entry))
    return HandWrittenPlan(
        draft.name,
        graph,
        Bindings({name: Binding(retries=0) if action.kind is ActionKind.PLAN else action.binding for name, action in actions.items()}),
        parameters=None if draft.parameters is None else tuple(variable.name[1:] for variable in draft.parameters),
        results=tuple(entry.strings("results")),
        variables=_variables(entry),
        facts=facts,
        timed=domain.timed,
        objects=domain.declared.objects_by_type,
        timeout=entry.number("timeout", None),
        on_failure=_on_failure(entry),
        sources=domain.sources,
        calls=frozenset(call.action.name for call in graph.calls) & others.keys(),
        warnings=draft.warnings,
        domain_file=domain.file,
    )


def _variables(entry: Mapped) -> dict[str, object]:
    node = entry.node("initial_knowledge")
    if node is None or node.is_null:
        return {}
    return {name: read_literal(value).value for name, _, value in node.mapped().entries()}


def _capacities(entry: Mapped) -> dict[str, int]:
    node = entry.node("resources")
    if node is None or node.is_null:
        return {}
    resources = node.mapped()
    found = {name: resources.whole(name, 1) for name in resources.nodes}
    for name, capacity in found.items():
        if capacity < 1:
            raise InputError(f"expected how many calls may have {name} at the same time, at least 1", resources.position(name))
    return found


def _on_failure(entry: Mapped) -> OnFailure:
    name = entry.string("on_failure")
    known = {one.value: one for one in OnFailure}
    if name is not None and name not in known:
        raise unknown("way to end", name, known, entry.position("on_failure"))
    return OnFailure.DRAIN if name is None else known[name]
