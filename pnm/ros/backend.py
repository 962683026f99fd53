"""The ROS 2 execution backend: the action servers, state reports and sensors of the ROS graph."""

from __future__ import annotations

import asyncio
from collections import defaultdict
from collections.abc import Awaitable, Callable, Collection, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from itertools import product
from time import monotonic
from typing import Any, Final
from uuid import UUID

from pnm.clock import follow_real_time
from pnm.core.knowledge_base import KnowledgeBase, parse_fluent
from pnm.core.logic.computed_values import MISSING
from pnm.core.logic.domain import FluentKind, Vocabulary
from pnm.core.machine.bindings import Binding, Bindings, Table, open_parameters, placeholders
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import ActionClient
from pnm.core.readiness import Readiness, ReadyState
from pnm.errors import InputError, RosError, suggestion
from pnm.knowledge.sensor_model import NO_SENSING, Objects, Sensing, instances, unknown
from pnm.knowledge.source import FindKnowledge, Source
from pnm.knowledge.state_reports import StateReports
from pnm.ros.action_client.client import Ros2ActionClient
from pnm.ros.knowledge import KnowledgeServices, service_prefix
from pnm.ros.node.graph import GraphSnapshot, absence, resolved, server_name, similar, snapshot
from pnm.ros.node.messages import fields, fitted_binding, has_own_types, import_type
from pnm.ros.node.ros_thread import RosThread
from pnm.ros.sensors import TOPIC, SensedReports, Sensors, SensorUse, checked
from pnm.ros.sim_time import USE_SIM_TIME, follow_sim_time

DISCOVERY: Final = 10.0
"""Seconds to wait for servers and reports of robots that are started together with this node."""
_LOOK: Final = 0.25
"""Seconds between two looks at the ROS graph while something is waited for."""
_FINAL: Final = frozenset({ReadyState.READY, ReadyState.UNFIT, ReadyState.OPEN})
"""States that waiting does not change."""


@dataclass(eq=False, repr=False)
class Ros2Backend:
    """The action servers found in the ROS 2 graph, the facts published on `knowledge/sensed`, and sensors.

    The mutable state is what `open` and `share` make.
    Raises `InputError` if a fluent has a sensor and is among the assumed ones of the bindings.
    """

    bindings: Bindings
    sensing: Sensing = NO_SENSING
    known: Vocabulary | None = None
    """The declared names, which reports are checked against; None if nothing is declared."""
    ros: Any = None
    """The thread of a node that goes on when the backend is closed; by default the backend has one of its own, once it is open."""
    _: KW_ONLY
    sim_time: bool = False
    """Whether time is that of a simulation, from ``/clock``."""
    prefix: bytes = b""
    """The first bytes of the ids of all goals that processes of this node send; empty if they have none in common."""
    kept: Iterable[UUID] = ()
    """Goals of another process of this node that this one goes on with."""
    may_act: Callable[[], bool] = lambda: True
    """Whether something may be sent; asked by any thread, right before that."""

    def __post_init__(self) -> None:
        for name in sorted(self.sensing.names & self.bindings.assumed):
            raise InputError(f"there is a sensor for {name}, which is among the 'assumed' of the bindings; expected one of the two")
        self._is_shared = self.ros is not None
        self._knowledge = KnowledgeBase()
        self._sensed: SensedReports | None = None
        self._reports: StateReports | None = None
        self._sensors: Sensors | None = None
        self._client: Any = None
        self._services: list[KnowledgeServices] = []

    @property
    def client(self) -> ActionClient:
        """The client of every action server, once the backend is open."""
        return self._client  # type: ignore[no-any-return]

    async def open(self, knowledge: KnowledgeBase) -> None:
        """Join the ROS 2 graph and wait for the first report about the world, if there is a publisher of reports."""
        loop, self._knowledge = asyncio.get_running_loop(), knowledge
        if not self._is_shared:
            self.ros = RosThread("pnm_run", args=USE_SIM_TIME if self.sim_time else ())  # `pnm` is the one that serves
            await follow_sim_time(self.ros)

        def ended(request: UUID) -> Awaitable[object]:
            """Withdraw what a server is still asking for a request that is over, and ask how the world is now."""
            for services in self._services:
                services.end(request)
            if self._sensors is not None:
                self._sensors.expect_news()
            return self.refresh()

        lag, sensing = self.bindings.lag, self.sensing
        self._sensors = Sensors(self.ros, sensing, knowledge, lag)
        from pnm.ros.action_client.action_services import OtherGoals  # here, because rclpy is an extra

        self._others = OtherGoals(self.ros, self.prefix, self.kept, self.may_act)
        self._client = Ros2ActionClient(self.ros, self.bindings, loop, ended, self._others, self.may_act)
        ignored = {
            **dict.fromkeys(knowledge.rules.derived, "its facts follow from rules"),
            **dict.fromkeys(sensing.names, "there is a sensor for it"),
            **dict.fromkeys(self.bindings.assumed, ""),
        }
        self._reports = StateReports(knowledge, ignored, lag, sensing.stale, self.known, TOPIC)
        self._sensed = SensedReports(self.ros, loop, self._reports.record, self._reports.refuse)
        await self._sensors.open()
        await self._sensed.first(DISCOVERY)

    async def check(
        self, actions: Iterable[GroundAction] = (), wait: float = 0.0, known: Vocabulary | None = None
    ) -> tuple[Readiness, ...]:
        """Return how ready all is, when others are discovered and `wait` seconds are over; `InputError` for an invalid name of a server."""
        until, has_settled = monotonic() + wait, False
        while True:
            rows = await self.look(actions, known)
            if all(row.state in _FINAL for row in rows) or (has_settled and monotonic() >= until):
                return rows
            if not has_settled:
                await self.ros.settled()
                has_settled = True
            else:
                await asyncio.sleep(_LOOK)

    async def check_sensors(self, sensing: Sensing, objects: Objects) -> None:
        """Raise an `InputError` if these sensors cannot be those of another world: two report the same, or a name is not valid in ROS."""
        every = instances(sensing, objects)
        resolve = self.ros.node.resolve_topic_name
        await self.ros.ask(lambda: [resolved(resolve, one.name, "a sensor", one.sensor.position) for one in every])

    async def sense_objects(self, sensing: Sensing) -> None:
        """Have the sensors report on the objects that are known now, if these are others than before."""
        if self._sensors is not None and instances(sensing, self._knowledge.objects) != self._sensors.instances:
            await self._sensors.close()
            self._sensors = Sensors(self.ros, sensing, self._knowledge, self.bindings.lag)
            await self._sensors.open()

    async def look(self, actions: Iterable[GroundAction] = (), known: Vocabulary | None = None) -> tuple[Readiness, ...]:
        """Return the present readiness, as far as this node has discovered the others; see `check`."""
        known = known or self.known or Vocabulary({})
        every = dict.fromkeys((*server_calls(known, self.bindings), *actions))
        calls = [call for call in every if self.bindings.names_server(call)]
        bound = {call: (self.bindings.server(call), self.bindings.of(call.name).position) for call in calls}
        node = self.ros.node
        servers = await self.ros.ask(lambda: {call: server_name(node, *named) for call, named in bound.items()})
        graph, topic = await self.ros.ask(lambda: (snapshot(node), str(node.resolve_topic_name(TOPIC))))
        await self.ros.ask(lambda: [self._others.watch(server) for server in {*servers.values()} & graph.servers.keys()])
        uses = self._sensors.uses() if self._sensors else ()
        sensed = (unknown(use.instance, self._knowledge.objects).variables for use in uses)
        variables = frozenset(self._knowledge.variables()).union(*sensed)
        reports = self._reports.readiness(topic, graph.topics.get(topic, ())) if self._reports else ()
        rows = (*action_readiness(servers, self.bindings, known, graph, variables, self._patience), *sensor_readiness(uses, graph))
        return *rows, *open_readiness([call for call in every if call not in bound], self.bindings), *reports

    async def refresh(self) -> None:
        """Ask the services that are sensors, and wait for their answers, within their limits."""
        if self._sensors is not None:
            await self._sensors.refresh()

    def declare(self, known: Vocabulary) -> None:
        """Check reports against these names from now on."""
        self.known = known
        if self._reports is not None:
            self._reports.declare(known)

    async def share(self, mark: bytes, find: FindKnowledge, source: Source) -> None:
        """Offer the two services that action servers find by the identity of their goal."""
        if not has_own_types():  # servers that ask for knowledge find none then
            return
        self._services.append(KnowledgeServices(self.ros, asyncio.get_running_loop(), service_prefix(mark), find, source))
        await self._services[-1].open()

    async def prepare(self, actions: Iterable[GroundAction]) -> tuple[str, ...]:
        """Look for the servers of these actions that have names already; wait for them only while this node itself is new."""
        named = [action for action in actions if self.bindings.names_server(action)]
        return await self._client.prepare(named, self._patience)  # type: ignore[no-any-return]

    @property
    def missing(self) -> frozenset[str]:
        """The action servers that were waited for in vain, and are not there yet, as seen at the last look at them."""
        return self._client.missing if self._client is not None else frozenset()

    async def busy_elsewhere(self) -> tuple[str, ...]:
        """Return the action servers that are at work on goals of other programs, or on goals that this node has forgotten."""
        try:
            return await self.ros.ask(self._others.busy_servers)  # type: ignore[no-any-return]
        except RosError:  # the node is closed, as when another process has taken its journal over
            return ()

    @property
    def _patience(self) -> float:
        """Seconds for which servers are waited for: while this node itself is new."""
        return max(0.0, float(self.ros.joined) + DISCOVERY - monotonic())

    async def close(self) -> None:
        """Leave the ROS 2 graph; a simulation whose time was followed may have left before."""
        if not self._is_shared:
            follow_real_time()
        if self._reports is not None:
            self._reports.close()
        if self._sensors is not None:
            await self._sensors.close()
        for services in self._services:
            await services.close()
        if self._client is not None:
            self._client.close()
        if self._sensed is not None:
            self._sensed.close()
        if self.ros is not None and not self._is_shared:
            await asyncio.to_thread(self.ros.close)  # what still happens on its thread may need this loop


# --- how ready action servers are: pure, `Ros2Backend` takes the snapshot ------------------

_EXAMPLES: dict[FluentKind, object] = {FluentKind.FACT: True, FluentKind.NUMBER: 1.0, FluentKind.OBJECT: "object"}


def server_calls(known: Vocabulary, bindings: Bindings) -> Iterator[GroundAction]:
    """Yield for every declared action a call to each server that it may be sent to."""
    for name, parameters in known.actions.items():
        deciding = set(placeholders(bindings.of(name).server or ""))
        choices = [known.arguments(name, parameter) for parameter in parameters]
        some = [chosen if parameter in deciding else chosen[:1] for parameter, chosen in zip(parameters, choices, strict=True)]
        yield from (GroundAction(name, arguments, tuple(parameters)) for arguments in product(*some))


@dataclass(frozen=True, slots=True)
class ValueSources:
    """The possible sources of goal fields."""

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
    """Yield how ready the servers of the actions are, given their full names and the declared names.

    The variables are those that have values, or that sensors give values to; a server that is not there is waited for `patience` seconds.
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
    action: GroundAction, server: str, bound: Mapping[str, Binding], graph: GraphSnapshot, sources: ValueSources, patience: float
) -> Readiness:
    """Return the readiness of the server of one action, given the bindings of all actions that it performs."""
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


def sensor_readiness(uses: Iterable[SensorUse], graph: GraphSnapshot) -> Iterator[Readiness]:
    """Yield how ready sensors are."""
    for use in uses:
        yield sensor_row(use, *(("service", graph.services) if use.instance.sensor.service else ("topic", graph.topics)))


def sensor_row(use: SensorUse, kind: str, known: Mapping[str, tuple[str, ...]]) -> Readiness:
    """Return the readiness of one sensor, given the present topics or services."""
    sensor, there = use.instance.sensor, known.get(use.name, ())
    first, *others = map(str, sensor.statements)
    wanted, type_name = sensor.type, sensor.type or ", ".join(there)
    row = Readiness(f"{first}{', …' if others else ''}", use.name, type_name, ReadyState.UNFIT, position=sensor.position, is_sensor=True)
    if use.refused is not None:
        return replace(row, advice=use.refused.message, position=use.refused.position)
    if wanted and there and wanted not in there:
        types = ", ".join(there)
        return replace(row, type=types, advice=f"the {kind} {use.name} has the type {types}, the sensor says {wanted}")
    if wanted or len(there) == 1:
        try:
            checked(use.instance, type_name)
        except InputError as error:
            return replace(row, advice=error.message, position=error.position)
    if not there:
        return replace(row, state=ReadyState.ABSENT, advice=f"there is no {kind} {use.name}{similar(use.name, known)}")
    if use.is_stale:
        advice = f"nothing was heard on {use.name} for {sensor.stale:g} s; its facts are unknown"
        return replace(row, state=ReadyState.STALE, advice=advice)
    if not use.is_heard:
        heard = f"nothing was heard on {use.name} yet" if kind == "topic" else f"{use.name} has not answered yet"
        return replace(row, state=ReadyState.SILENT, advice=f"{heard}; until then its facts are unknown")
    return replace(row, state=ReadyState.READY)
