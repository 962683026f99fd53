"""`pnm simulate`: the robots of a problem as ROS 2 action servers, in a process of their own.

There is one server per action, or one per robot where the binding's server name has a parameter in braces. The
process has a simulated world of its own, and publishes what sensors see of it.
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import product, starmap
from math import prod
from pathlib import Path
from typing import Final, TextIO, TypeVar

from planner_bridge.model.grounding import ground_action, initial_knowledge, modelled_duration, with_found
from planner_bridge.model.problem import Problem
from planner_bridge.model.world import robots_of
from pnm.actions.backend import SimulatedBackend
from pnm.actions.faults import Faults
from pnm.actions.simulated_robots import SimulatedRobots, SimulatedWorld, arguments_of, result_of
from pnm.clock import run_async
from pnm.core.knowledge_base import statement_text
from pnm.core.logic.conditions import TRUE
from pnm.core.logic.domain import MAX_CHOICES, ActionSchema
from pnm.core.logic.effects import ground_effects
from pnm.core.logic.expressions import bind
from pnm.core.machine.bindings import Bindings, placeholders
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, Report, Reporter, Request
from pnm.errors import InputError
from pnm.language.plan import called_plans, chosen_plan, merge_bindings, read_plans
from pnm.language.runner import PlanRunner, Program
from pnm.tasks import EVENTS

DEFAULT_TYPE = "pnm_interfaces/action/GroundAction"
_LOGGED: Final = frozenset({"start", "end", "clash"})
"""The events in the log; changes of facts, and all facts at the end, are in the log file only."""


def play(problem: Problem, bindings: Bindings, faults: Faults, speed: float, log: Path | None) -> int:
    """Play the robots of a problem until a signal; see `_played`."""
    robots = robots_of(problem, bindings, faults, speed=speed)
    return _played(robots, lambda: server_models(problem, bindings, robots.world), log)


def play_plans(
    file: Path, name: str | None, parameters: Mapping[str, object], bindings: Bindings, faults: Faults, speed: float, log: Path | None
) -> int:
    """Play the robots of the hand-written plans of a file, or of one of them and those that it calls, until a signal; see `_played`."""
    plans = {one: replace(plan, bindings=bindings.before(plan.bindings)) for one, plan in read_plans(file).items()}
    chosen = called_plans(plans, chosen_plan(plans, name)) if name else (*plans,)
    bound, known = merge_bindings(plans.values()), initial_knowledge(*(plans[one] for one in chosen))
    robots = [robots_of(plans[one], bound, faults, speed=speed) for one in chosen]
    world = SimulatedWorld(known, frozenset().union(*(each.world.dynamic for each in robots)))
    played = replace(robots[0], world=world, capacities={key: value for each in robots for key, value in each.capacities.items()})
    runner = PlanRunner({one: Program.of(plans[one]) for one in chosen}, SimulatedBackend(played, bound.assumed), known)
    actions = dict.fromkeys(action for one in chosen for action in runner.actions_with(one, parameters))
    return _played(played, lambda: plan_server_models(tuple(actions), bound, world), log)


def _played(robots: SimulatedRobots, models: Callable[[], Sequence[ServerModel | PlanServerModel]], log: Path | None) -> int:
    """Serve until a signal; raise an `InputError`, before anything is started, if the log cannot be written."""
    try:
        stream = log.open("w", encoding="utf-8") if log else None
    except OSError as error:
        raise InputError(f"{log}: cannot be written: {error.strerror}") from error
    try:
        run_async(_serve(robots, models, stream))
    finally:
        if stream:
            stream.close()
    return 0


async def _serve(robots: SimulatedRobots, served: Callable[[], Sequence[ServerModel | PlanServerModel]], log: TextIO | None) -> None:
    from pnm.ros.node.ros_thread import RosThread  # here, because rclpy is an extra

    async with RosThread("robots") as ros:
        from pnm.ros.action_server.goal_server import Offer, SimulatedServers, publish_state  # needs rclpy, which is there by now
        from pnm.ros.node.graph import server_name
        from pnm.ros.node.messages import has_own_types

        with suppress(asyncio.CancelledError):  # it may come before the servers are up
            logged = LoggedRobots(robots, log)
            models = [fitted(model) for model in served()]
            # The state before the servers: a client that finds them shall know the world.
            if has_own_types():
                await publish_state(ros, robots.world, robots.world.reported(robots.bindings.assumed), robots.begin)
            else:
                logging.getLogger(__name__).warning(
                    "no facts are reported: pnm_interfaces, which has the type of such reports, is not installed"
                )
                robots.begin()
            positions = [model.bindings.of(model.names[0]).position for model in models]
            names = await ros.ask(lambda: [server_name(ros.node, model.server, at) for model, at in zip(models, positions, strict=True)])
            await SimulatedServers(ros, logged, robots.progress).open(
                [Offer(name, model.type, model.decode, model.answer) for name, model in zip(names, models, strict=True)]
            )
            plural = "s" * (len(models) > 1)
            ready = f"ready: {len(models)} action server{plural}: {', '.join(model.server for model in models)}"
            EVENTS.info(ready)
            print(ready, flush=True)
            with suppress(asyncio.CancelledError):
                await asyncio.Event().wait()
            logged.write("state", facts=sorted(starmap(statement_text, robots.world.truth.facts().items())))


@dataclass(frozen=True)
class ServerModel:
    """The model of one action server: the schemas that it executes, each with the arguments that the server's name fixes."""

    server: str
    type: str
    choices: tuple[tuple[ActionSchema, Mapping[str, str]], ...]
    problem: Problem
    bindings: Bindings
    world: SimulatedWorld

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its actions."""
        return tuple([schema.name for schema, _ in self.choices])

    @property
    def answered(self) -> dict[str, str]:
        """Nothing: PDDL says nothing of the fields of results."""
        return {}

    def decode(self, data: Mapping[str, object]) -> GroundAction:
        """Return the action of a goal, by `action`, field names, or its goal mapping backwards; raise an `InputError` if none fits."""
        planned = data.get("duration")
        candidates = list(self._candidates(data))
        state = initial_knowledge(self.problem)
        for schema, arguments in candidates:
            duration = modelled_duration(schema, arguments, state)
            action = ground_action(schema, arguments, planned if isinstance(planned, float) and planned > 0 else duration, state)
            if len(candidates) == 1 or self.world.holds(action.precondition):
                return action
        raise InputError(f"the goal fits none of the actions {', '.join(self.names)}, as they are bound and as the world is: {dict(data)}")

    def answer(self, action: GroundAction, outcome: Outcome) -> dict[str, object]:
        """Return the result fields that say how the action has ended, as its binding reads them."""
        return result_of(self.bindings.of(action.name), outcome)

    def _candidates(self, data: Mapping[str, object]) -> Iterator[tuple[ActionSchema, tuple[str, ...]]]:
        """Yield the actions that the goal may mean, with arguments: for parameters of which it says nothing, every object that fits."""
        named, problem, state = data.get("action"), with_found(self.problem, self.world.truth), self.world.truth
        for schema, fixed in self.choices:
            told = arguments_of(self.bindings.of(schema.name).goal or {}, data)
            if told is None or (isinstance(named, str) and named != schema.name):
                continue
            listed = data.get("arguments")
            known = dict(zip(schema.names, listed, strict=False)) if isinstance(listed, list) else {}
            known |= {**{name: data[name] for name in schema.names if name in data}, **told, **fixed}
            choices = [
                [known[name]] if (name := variable.name[1:]) in known else state.objects(variable.types) for variable in schema.parameters
            ]
            for arguments in product(*choices) if prod(map(len, choices)) <= MAX_CHOICES else ():
                kinds = zip(arguments, schema.parameters, strict=True)
                if all(problem.domain.matches(problem.objects.get(str(name), ()), variable.types) for name, variable in kinds):
                    yield schema, tuple(map(str, arguments))


def server_models(problem: Problem, bindings: Bindings, world: SimulatedWorld) -> list[ServerModel]:
    """Return the models of all servers that execute actions of the problem."""
    choices: dict[str, list[tuple[ActionSchema, Mapping[str, str]]]] = {}
    types: dict[str, str] = {}
    state = initial_knowledge(problem)
    for schema in problem.domain.actions.values():
        pattern = bindings.of(schema.name).server or schema.name
        variables = {variable.name[1:]: variable.types for variable in schema.parameters}
        names = list(dict.fromkeys(placeholders(pattern)))
        if unknown := [name for name in names if name not in variables]:
            parameters = ", ".join(variables)
            raise InputError(f"the server {pattern!r} of {schema.name} names {{{unknown[0]}}}, which is not a parameter ({parameters})")
        for chosen in product(*(state.objects(variables[name]) for name in names)):
            fixed = dict(zip(names, chosen, strict=True))
            server = pattern.format_map(fixed)
            choices.setdefault(server, []).append((schema, fixed))
            if named := bindings.of(schema.name).type:
                types.setdefault(server, named)
    return [
        ServerModel(server, types.get(server, DEFAULT_TYPE), tuple(served), problem, bindings, world) for server, served in choices.items()
    ]


@dataclass(frozen=True)
class PlanServerModel:
    """The model of one action server of hand-written plans: the calls that it executes. Their conditions are for the plan to check."""

    server: str
    type: str
    actions: tuple[GroundAction, ...]
    bindings: Bindings
    world: SimulatedWorld

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its actions."""
        return tuple(dict.fromkeys(action.name for action in self.actions))

    @property
    def answered(self) -> dict[str, str]:
        """The fields of results that are in the plans, each with its action."""
        return {name: action.name for action in self.actions for name, _ in action.returns}

    def decode(self, data: Mapping[str, object]) -> GroundAction:
        """Return the call of a goal, by `action` and the fields of the goal; raise an `InputError` if none fits."""
        named, listed = data.get("action"), data.get("arguments")
        for action in self.actions:
            told = arguments_of(self.bindings.of(action.name).goal or {}, data)
            if told is None or (isinstance(named, str) and named not in ("", action.name)):
                continue
            known = dict(zip(action.parameters, listed, strict=False)) if isinstance(listed, list) else {}
            known |= {name: value for name, value in data.items() if isinstance(value, str | int | float)} | told
            env = {f"?{name}": value for name, value in known.items()}
            arguments = bind(action.arguments, env)
            if all(str(known.get(name, its)) == its for name, its in zip(action.parameters, arguments, strict=False)):
                start, end = ground_effects(action.start_effects, env), ground_effects(action.end_effects, env)
                ways = tuple([replace(way, effects=ground_effects(way.effects, env)) for way in action.outcomes])
                free = replace(action, precondition=TRUE, invariant=TRUE, end_condition=TRUE, arguments=arguments)
                return replace(free, start_effects=start, end_effects=end, outcomes=ways)
        raise InputError(f"the goal fits no call of {', '.join(self.names)} in the plans: {dict(data)}")

    def answer(self, action: GroundAction, outcome: Outcome) -> dict[str, object]:
        """Return the result fields that say how the action has ended, as its binding reads them."""
        return result_of(self.bindings.of(action.name), outcome)


def plan_server_models(actions: Sequence[GroundAction], bindings: Bindings, world: SimulatedWorld) -> list[PlanServerModel]:
    """Return the models of all servers of the calls of plans; raise an `InputError` if the name of one depends on an unknown parameter."""
    served: dict[str, list[GroundAction]] = {}
    for action in actions:
        if "?" in (server := bindings.server(action)):
            missing = next(name for name in placeholders(bindings.of(action.name).server or "") if f"?{name}" in server)
            advice = f"the server {bindings.of(action.name).server} of {action.name} depends on {missing}, which is not known; give --set"
            raise InputError(f"{advice} {missing}=…", bindings.of(action.name).position)
        served.setdefault(server, []).append(action)
    types = {
        server: next((kind for one in calls if (kind := bindings.of(one.name).type)), DEFAULT_TYPE) for server, calls in served.items()
    }
    return [PlanServerModel(server, types[server], tuple(calls), bindings, world) for server, calls in served.items()]


M = TypeVar("M", bound=ServerModel | PlanServerModel)


def fitted(model: M) -> M:
    """Return the model with its bindings fitted to its server's type, constants by value; raise an `InputError` if one does not fit."""
    from pnm.ros.node.messages import fields, fitted_binding, import_type  # needs rclpy, which is an extra

    bound = dict(model.bindings.actions)
    for name in model.names:
        binding = model.bindings.of(name)
        try:
            bound[name] = fitted_binding(binding, import_type(model.type))
            if absent := [one for one, its in model.answered.items() if its == name and one not in fields(import_type(model.type).Result)]:
                raise InputError(f"a result of {model.type} has no field {absent[0]}, which the action has under 'simulated'")
        except InputError as error:
            advice = "" if binding.type else f"; without a 'type' in its binding, {model.server} is played as a {model.type}"
            raise InputError(f"{name}: {error.message}{advice}", binding.position) from error
    return replace(model, bindings=replace(model.bindings, actions=bound))


@dataclass
class LoggedRobots:
    """Simulated robots with a log of the true events, a JSON object per line. The last two fields change."""

    robots: SimulatedRobots
    log: TextIO | None
    _clashes: int = 0
    """The number of entries in the log."""
    _began: float = field(default_factory=lambda: asyncio.get_running_loop().time())

    def __post_init__(self) -> None:
        self.robots.world.truth.listen(lambda changes: self.write("change", facts=sorted(starmap(statement_text, changes.items()))))

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        """Return the fields of the action's goal."""
        return self.robots.goal_fields(action)

    def send(self, request: Request, report: Reporter, /) -> None:
        """Pass the request on, and log its reports."""

        def log_clashes() -> None:
            for text in self.robots.clashes[self._clashes :]:
                self.write("clash", text=text)
            self._clashes = len(self.robots.clashes)

        def log(what: Report) -> None:
            match what:
                case Accepted():
                    self.write("start", action=str(request.action))
                    asyncio.get_running_loop().call_soon(log_clashes)  # the robots begin right after they have accepted
                case Ended(_, outcome):
                    self.write("end", action=str(request.action), outcome=outcome.kind.value, message=outcome.message)
            report(what)

        self.robots.send(request, log)

    def cancel(self, request: object, /) -> None:
        """Pass the cancellation on."""
        self.robots.cancel(request)  # type: ignore[arg-type]

    def write(self, event: str, **data: object) -> None:
        """Write one line, at once: the process may be killed at any time. What people look for goes to the log of events as well."""
        if event in _LOGGED:
            level = logging.WARNING if event == "clash" or data.get("outcome", "succeeded") != "succeeded" else logging.INFO
            EVENTS.log(level, "%s %s", event, ": ".join(str(value) for value in data.values() if value))
        if self.log:
            time = round(asyncio.get_running_loop().time() - self._began, 4)
            self.log.write(json.dumps({"time": time, "event": event, **data}) + "\n")
            self.log.flush()
