"""How ready action servers and sensors are: what bindings and sensors expect, compared with a snapshot of the ROS graph.

Pure: `pnm.ros.backend` takes the snapshot.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import Any

from pnm.core.knowledge_base import parse_fluent
from pnm.core.logic.computed_values import MISSING
from pnm.core.logic.domain import FluentKind, Vocabulary
from pnm.core.logic.expressions import fluent_text
from pnm.core.machine.bindings import Binding, Bindings, Table, open_parameters, placeholders
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.readiness import Readiness, ReadyState
from pnm.errors import InputError, suggestion
from pnm.knowledge.sensor_model import ByTopic, Stored
from pnm.ros.node.graph import GraphSnapshot, absence, similar
from pnm.ros.node.messages import fields, import_type
from pnm.ros.node.typed_fields import fitted_binding
from pnm.ros.sensors import SensorUse, checked

_EXAMPLES: dict[FluentKind, object] = {FluentKind.FACT: True, FluentKind.NUMBER: 1.0, FluentKind.OBJECT: "object"}


def server_calls(known: Vocabulary, bindings: Bindings) -> Iterator[GroundAction]:
    """Yield for every declared action a call to each server that it may be sent to."""
    for name, parameters in known.actions.items():
        deciding = set(placeholders(bindings.of(name).server or ""))
        choices = [known.arguments(name, parameter) for parameter in parameters]
        some = [chosen if parameter in deciding else chosen[:1] for parameter, chosen in zip(parameters, choices, strict=True)]
        yield from (GroundAction(name, arguments, tuple(parameters)) for arguments in product(*some))


# --- actions -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class ValueSources:
    """What goal fields may be filled from."""

    known: Vocabulary
    """The declared names; of actions that it does not know, only a plan knows what goals are filled from."""
    variables: frozenset[str]
    """The names of variables that have values, or that sensors or the results of actions give values to."""
    is_complete: bool
    """Whether the types of all servers are known; the results of others may have any fields."""


def action_readiness(
    servers: Mapping[GroundAction, str],
    bindings: Bindings,
    known: Vocabulary,
    graph: GraphSnapshot,
    variables: Collection[str],
    patience: float,
) -> Iterator[Readiness]:
    """Yield how ready the servers of the actions are.

    Args:
        servers: their full names.
        bindings: of the actions.
        known: the declared names; of actions that it does not know, only a plan knows what goals are filled from.
        graph: what is there.
        variables: the names of variables that have values, or that sensors give values to.
        patience: seconds for which a server that is not there is waited for.
    """
    by_server: defaultdict[str, dict[str, Binding]] = defaultdict(dict)
    for action, server in servers.items():
        by_server[server][action.name] = bindings.of(action.name)
    stored = {name for bound in by_server.values() for binding in bound.values() for name in (*binding.store.values(), *binding.ask)}
    types = [graph.servers.get(server) or [one.type for one in bound.values() if one.type] for server, bound in by_server.items()]
    for type_name in {kind for kinds in types for kind in kinds}:
        with suppress(InputError):  # it is not installed, as the row of its server says
            stored.update(fields(import_type(type_name).Result))
    sources = ValueSources(known, frozenset(stored.union(variables)), all(types))
    done: set[tuple[str, str]] = set()
    for action, server in servers.items():
        if (action.name, server) not in done:
            done.add((action.name, server))
            yield server_readiness(action, server, by_server[server], graph, sources, patience)


def server_readiness(
    action: GroundAction,
    server: str,
    bound: Mapping[str, Binding],
    graph: GraphSnapshot,
    sources: ValueSources,
    patience: float,
) -> Readiness:
    """Return how ready the server of one action is, given the bindings of all actions that it performs."""
    binding, there = bound[action.name], graph.servers.get(server, ())
    wanted = next((one.type for one in (binding, *bound.values()) if one.type), None)
    row = Readiness(action.name, server, wanted or ", ".join(there), ReadyState.UNFIT, position=binding.position)
    for name, other in bound.items():
        if other.type and binding.type and other.type != binding.type:
            where = f" ({other.position})" if other.position else ""
            reason = f"{server} is a {binding.type} here, and a {other.type} in the binding of {name}{where}"
            return replace(row, advice=f"{reason}; expected one type for one server")
    if there and wanted and wanted not in there:
        return replace(row, type=", ".join(there), advice=absence(graph.servers, server, wanted))
    if not wanted and len(there) > 1:
        advice = f"there are servers of several types under this name, {row.type}; expected one, or a 'type' in the binding"
        return replace(row, state=ReadyState.ABSENT, advice=advice)
    if row.type:
        try:
            advice = fit_goal(action, binding, import_type(row.type), sources)
        except InputError as error:
            return replace(row, advice=error.message)
        if advice and there:
            return replace(row, state=ReadyState.ABSENT, advice=advice)
    number = graph.processes.get(server, 1) if len(there) == 1 else 1  # servers of other types do not carry out our goals
    if number > 1 and not any(one.several_servers for one in bound.values()):
        advice = f"{number} processes offer {server}, unless one of them was killed lately; all would carry out every goal"
        return replace(row, state=ReadyState.SEVERAL, advice=f"{advice} (see `several_servers`)")
    if there:
        return replace(row, state=ReadyState.READY)
    waits = f"is waited for where it is needed, {patience:.0f} s at most"
    return replace(row, state=ReadyState.ABSENT, advice=absence(graph.servers, server, wanted), waits=waits)


def open_readiness(actions: Iterable[GroundAction], bindings: Bindings) -> Iterator[Readiness]:
    """Yield how ready the actions are whose servers have names that depend on values which their calls get when they start."""
    for action in {action.name: action for action in actions}.values():
        binding = bindings.of(action.name)
        row = Readiness(action.name, binding.server or "", binding.type or "", ReadyState.OPEN, position=binding.position)
        names = [name for name in dict.fromkeys(placeholders(row.name)) if name in open_parameters(action)]
        advice = f"not looked for: it depends on {', '.join(names)}, which has no value before the call starts"
        try:
            if binding.type:
                fitted_binding(binding, import_type(binding.type))
        except InputError as error:
            row, advice = replace(row, state=ReadyState.UNFIT), error.message
        yield replace(row, advice=advice)


def fit_goal(action: GroundAction, binding: Binding, action_type: Any, sources: ValueSources) -> str:
    """Refuse goals that can never be filled, or not with these values; return what has no value yet, with advice, if there is something."""
    if action.name not in sources.known.actions:  # what it is given is in a plan: values of all kinds, computed while it runs
        fitted_binding(binding, action_type)
        return ""
    names = fields(action_type.Goal)
    arguments = dict(zip(action.parameters, action.arguments, strict=True))
    own = {"action": action.name, "arguments": list(action.arguments), "duration": 1.0, **arguments}
    goal = {name: f"${name}" for name in names if name in own} if binding.goal is None else binding.goal
    fitted_binding(replace(binding, goal=goal), action_type, partial(example, own, sources.known))
    needed = names if binding.goal is None else tuple(_variables(binding.goal))
    unbound = [name for name in needed if name not in own and name not in sources.variables]
    if not unbound:
        return ""
    if binding.goal is not None:
        hint = suggestion(unbound[0], sources.variables)
        return f"nothing here gives a value to ${unbound[0]}, unless something does while it runs{hint and f'; {hint}'}"
    lacking, only = ", ".join(f"{name}: …" for name in unbound), ", ".join(arguments) or "none"
    reason = f"nothing here gives a value for {', '.join(unbound)} of its goal (parameters: {only})"
    advice = f"expected 'goal: {{{lacking}}}' in the binding of {action.name}, which may leave fields out"
    if sources.is_complete:
        raise InputError(f"{reason}; {advice}")
    return f"{reason}, unless a server that is not there yet returns it; else {advice}"


def _variables(source: object) -> Iterator[str]:
    """Yield the variables that goal fields are filled from."""
    match source:
        case Table(of, rows):
            yield from _variables([of, *rows.values()])
        case Mapping():
            yield from _variables([*source.values()])
        case list() | tuple():
            for part in source:
                yield from _variables(part)
        case str() if source.startswith("$"):
            yield source[1:]


def example(own: Mapping[str, object], known: Vocabulary, source: str) -> object:
    """Return a value of the kind that a parameter, a variable or a fluent has; `MISSING` if that is not known."""
    if source.startswith("("):
        signature = known.signatures.get(parse_fluent(source)[0])
        return _EXAMPLES[signature.kind] if signature else MISSING
    return own.get(source[1:], MISSING)


# --- sensors -------------------------------------------------------------------------------


def sensor_readiness(uses: Iterable[SensorUse], graph: GraphSnapshot) -> Iterator[Readiness]:
    """Yield how ready sensors are."""
    for use in uses:
        is_topic = isinstance(use.instance.sensor.way, ByTopic)
        yield sensor_row(use, "topic" if is_topic else "service", graph.topics if is_topic else graph.services)


def sensor_row(use: SensorUse, kind: str, known: Mapping[str, tuple[str, ...]]) -> Readiness:
    """Return how ready one sensor is, given the topics or services that are there."""
    sensor, there = use.instance.sensor, known.get(use.name, ())
    first, *others = [part.name if isinstance(part, Stored) else fluent_text(part.fluent) for part in sensor.statements]
    wanted = sensor.type
    type_name = wanted or ", ".join(there)
    row = Readiness(f"{first}{', …' if others else ''}", use.name, type_name, ReadyState.UNFIT, position=sensor.position, is_sensor=True)
    if use.refused is not None:
        return replace(row, advice=use.refused.message, position=use.refused.position)
    if wanted and there and wanted not in there:
        return replace(
            row, type=", ".join(there), advice=f"the {kind} {use.name} has the type {', '.join(there)}, the sensor says {wanted}"
        )
    if wanted or len(there) == 1:
        try:
            checked(use.instance, type_name)
        except InputError as error:
            return replace(row, advice=error.message, position=error.position)
    if not there:
        return replace(row, state=ReadyState.ABSENT, advice=f"there is no {kind} {use.name}{similar(use.name, known)}")
    if use.is_stale:
        advice = f"nothing was heard on {use.name} for {sensor.stale:g} s; what it reports is unknown"
        return replace(row, state=ReadyState.STALE, advice=advice)
    if not use.is_heard:
        heard = f"nothing was heard on {use.name} yet" if kind == "topic" else f"{use.name} has not answered yet"
        return replace(row, state=ReadyState.SILENT, advice=f"{heard}; until then what it reports is unknown")
    return replace(row, state=ReadyState.READY)
