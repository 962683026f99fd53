"""Runs of hand-written plans: any number at the same time, each with its own local knowledge.

A run begins with a value for every parameter that its plan declares. A call of another plan becomes a run of its own here:
the arguments of the call are its parameters, its result variables are the result of the call.
"""

from __future__ import annotations

import asyncio
import logging
import os
from collections.abc import Coroutine, Mapping
from dataclasses import InitVar, dataclass, field, replace
from functools import partial
from math import inf
from typing import Final
from uuid import UUID, uuid4

from pnm.actions.backend import Backend
from pnm.clock import TimeLimit
from pnm.core.execution.call_results import RunResult
from pnm.core.execution.events import Observer
from pnm.core.execution.questions import EvaluationContext
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import MISSING, Layer, Literal, Query, Question, parts
from pnm.core.logic.expressions import bind
from pnm.core.machine import requests
from pnm.core.machine.bindings import ABOUT_THE_CALL
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.verification.verify import Proof, verify
from pnm.core.resources import Hands, Resources
from pnm.errors import InputError, suggestion
from pnm.executor import Executor
from pnm.journal.journal import NO_JOURNAL, Journal
from pnm.journal.replay import Replay, ReplayedRun
from pnm.knowledge.source import Asker, Source
from pnm.language.plan import HandWrittenPlan


async def check_values(plan: HandWrittenPlan, knowledge: Layered, source: Source | None, asker: Asker) -> None:
    """See to it that every parameter has a value, or that a person may be asked for it when it is needed.

    A value may also be in the global knowledge, and what is null in the knowledge before the run need not have one.
    Raises `InputError` if a parameter has none.
    """
    nameless = [name for name in plan.parameters or () if knowledge.variable(name) is MISSING]
    askable: set[str] = set()  # variables in whose place a person may be asked
    for call in plan.graph.calls if nameless else ():
        given = dict(call.action.given)
        for asked in plan.bindings.of(call.action.name).ask:
            read = parts(given[asked]) if asked in given else ()
            askable |= {asked, *(str(part.name.value) for part in read if isinstance(part, Query) and isinstance(part.name, Literal))}
    for name in nameless:
        try:
            question = Question(name, Layer.GLOBAL, "null")
            is_known = name in askable or (source is not None and await source.query(question, asker) not in (MISSING, None))
        except Exception:  # a knowledge base that cannot be asked: the run reports that if it needs the value
            is_known = True
        if not is_known:
            where = f"{{{name}: …}} among the parameters (--set {name}=…), or under initial_knowledge, or one in the global knowledge"
            raise InputError(f"{plan.name} needs a value for its parameter {name!r}; expected {where}")


_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Program:
    """A plan and its machine, proved sound."""

    plan: HandWrittenPlan
    machine: PetriNetMachine
    proof: Proof

    @staticmethod
    def of(plan: HandWrittenPlan, capacities: Mapping[str, int] | None = None) -> Program:
        """Generate the machine and prove it; `capacities` are those of shared resources, in the place of the plan's own.

        Raises `InputError` if a call of another plan is given resources.
        """
        for call in plan.graph.calls:
            if call.action.name in plan.calls and (names := plan.bindings.resources(call.action)):
                raise InputError(f"{call.action.name} is a plan and has no resources ({', '.join(names)}): its calls take their own")
        machine = generate(plan.graph, plan.bindings, on_failure=plan.on_failure, capacities=capacities)
        return Program(plan, machine, verify(machine))

    def sharing(self, resources: Resources) -> Program:
        """Return the program for runs that share these resources with others."""
        if all(resources.capacity(name) == capacity for name, capacity in self.machine.capacities.items()):
            return self
        return Program.of(self.plan, resources.capacities)


@dataclass
class PlanRun:
    """One run of a plan."""

    program: Program
    executor: Executor
    client: PlansClient
    limit: TimeLimit = field(init=False)
    """The time that the plan has."""

    def __post_init__(self) -> None:
        seconds = self.program.plan.timeout
        stop = self.executor.stop
        self.limit = TimeLimit(
            inf if seconds is None else seconds, lambda limit: stop(reason=f"the plan's limit of {limit:g} s is reached")
        )

    @property
    def requests(self) -> int:
        """The requests so far to action servers, those of plans that it calls among them: a call of a plan is none."""
        return self.executor.run.result_so_far().requests + self.client.called

    @property
    def variables(self) -> dict[str, object]:
        """The knowledge of the run itself."""
        return self.executor.run.knowledge.local.variables()

    @property
    def results(self) -> dict[str, object]:
        """The result variables of the plan; those without a value are left out."""
        known = {name: self.executor.run.knowledge.local.variable(name) for name in self.program.plan.results}
        return {name: value for name, value in known.items() if value is not MISSING}


PREFIX: Final = 4
"""Bytes that the identities of all runs and requests of a process have in common."""


@dataclass
class PlanRunner:
    """Carries out the plans of a world on a backend.

    The mutable state is the executors of the runs that go on, those of plans of a planner among them.

    Args:
        programs: by the name of the plan.
        backend: carries the actions out.
        world: what all runs share.
        source: the source for questions and updates outside the run.
        journal: records the runs.
        replay: what goes on of another process: its resources, and its prefix of identities, in place of new ones.
    """

    programs: Mapping[str, Program]
    backend: Backend
    world: KnowledgeBase
    source: Source | None = None
    journal: Journal = NO_JOURNAL
    replay: InitVar[Replay | None] = None
    resources: Resources = field(init=False)
    """Shared by all runs, those of plans that are called included."""
    prefix: bytes = field(default_factory=partial(os.urandom, PREFIX))
    """The first bytes of the identities of all runs and requests: action servers find this process by them."""
    going_on: list[Executor] = field(default_factory=list)
    kept: dict[UUID, ReplayedRun] = field(default_factory=dict)
    """By the request that has called it, runs of plans that another process has begun, and that are still to go on."""

    def __post_init__(self, replay: Replay | None) -> None:
        capacities: dict[str, int] = {}
        for program in self.programs.values():  # the most careful of the plans counts
            for name, capacity in program.plan.graph.capacities.items():
                capacities[name] = min(capacity, capacities.get(name, capacity))
        self.resources = replay.resources if replay else Resources(capacities)
        self.hands = replay.hands if replay else Hands()
        if replay and replay.shared and replay.shared.prefix:
            self.prefix = replay.shared.prefix
        self.programs = {name: program.sharing(self.resources) for name, program in self.programs.items()}

    @property
    def actions(self) -> tuple[GroundAction, ...]:
        """The actions of the plans that servers carry out; the names of some servers are only known when their calls start."""
        needed = (
            call.action
            for program in self.programs.values()
            for call in program.plan.graph.calls
            if call.action.operation is None and call.action.name not in self.programs
        )
        return tuple(dict.fromkeys(needed))

    def actions_with(self, name: str, parameters: Mapping[str, object]) -> tuple[GroundAction, ...]:
        """Return the same actions, with what a run of the plan knows at its beginning for the parameters that the plan leaves open."""
        plan = self.programs[name].plan
        knowledge = Layered(self.world, KnowledgeBase(variables={**plan.variables, **parameters}))
        own = {call.action for call in plan.graph.calls}

        def known(action: GroundAction) -> GroundAction:
            environment = EvaluationContext(knowledge, action, plan.bindings.of(action.name)).environment()
            return replace(action, arguments=bind(action.arguments, environment)) if action in own and environment else action

        return tuple(map(known, self.actions))

    def new_id(self) -> UUID:
        """Return the identity of a new run."""
        return UUID(bytes=self.prefix + uuid4().bytes[PREFIX:])

    async def prepare(self) -> tuple[str, ...]:
        """Prepare the backend for the actions of the plans; return the names of servers that are not there yet."""
        return await self.backend.prepare(self.actions)

    def prepare_run(
        self,
        name: str,
        parameters: Mapping[str, object] | None = None,
        observer: Observer | None = None,
        *,
        task: UUID | None = None,
        priority: int = 0,
        caller: UUID | None = None,
    ) -> PlanRun:
        """Make a run of the plan, with what it knows at first; `execute` carries it out.

        Resources are claimed on behalf of a task, those of plans that it calls included; the run's own if it is None. The caller is the
        request of the plan that calls it. Raises `InputError` if there is no such plan, or it has no such parameter.
        """
        if name not in self.programs:
            hint = suggestion(name, self.programs) or f"expected one of {', '.join(self.programs) or 'none, for none is loaded'}"
            raise InputError(f"there is no plan {name!r}; {hint}")
        program, given = self.programs[name], dict(parameters or {})
        known = program.plan.parameters
        if known is not None and (strange := next((parameter for parameter in given if parameter not in known), None)) is not None:
            hint = suggestion(strange, known) or f"expected {', '.join(known) or 'none'}"
            raise InputError(f"{program.plan.name} has no parameter {strange!r}; {hint}")
        knowledge = Layered(self.world, KnowledgeBase(variables={**program.plan.variables, **given}))
        identity = self.new_id()
        client = PlansClient(self, observer, task or identity, priority)
        run = self.journal.make_run(
            program.machine,
            knowledge,
            id=identity,
            bindings=program.plan.bindings,
            goal_fields=client.goal_fields,
            name=name,
            caller=caller,
            asks=self.source is not None,
            observer=observer,
            resources=self.resources,
            task=task or identity,
            priority=priority,
        )
        return self._plan_run(run, client, name)

    def go_on_with(self, replayed: ReplayedRun, name: str, observer: Observer | None) -> PlanRun:
        """Return a run of the plan that goes on where another process has left it; the arguments are those of `prepare_run`."""
        client = PlansClient(self, observer, replayed.made.task, replayed.made.priority)
        run = self.journal.go_on(replayed, observer, client.goal_fields)
        plan_run = self._plan_run(run, client, name)
        if replayed.used:
            plan_run.limit.continue_from(replayed.used, replayed.replay.now)
        return plan_run

    def _plan_run(self, run: Run, client: PlansClient, name: str) -> PlanRun:
        note = partial(self.journal.noted, client.task)
        executor = Executor(run, client, self.source, name, self.journal, note, client.executor_of, self.hands)
        return PlanRun(self.programs[name], executor, client)

    async def check(self, plan_run: PlanRun) -> None:
        """See to it that every parameter of the plan has a value, before it is carried out; see `check_values`."""
        run, plan = plan_run.executor.run, plan_run.program.plan
        await check_values(plan, run.knowledge, self.source, Asker(run.id, plan.name))

    async def execute(self, plan_run: PlanRun) -> RunResult:
        """Carry the plan out, within its time."""
        plan_run.limit.note = partial(self.journal.counted, plan_run.executor.run.id)
        plan_run.limit.begin()
        try:
            return await self.execute_run(plan_run.executor)
        finally:
            plan_run.limit.close()

    async def execute_run(self, executor: Executor) -> RunResult:
        """Carry a run out; whoever asks meanwhile finds it."""
        self.going_on.append(executor)
        try:
            return await executor.execute()
        finally:
            self.going_on.remove(executor)

    def knowledge_of(self, request: UUID) -> tuple[Layered, Asker] | None:
        """Return the knowledge of the run with this request, and as whom it asks; None when it is not, or no longer, open."""
        for executor in self.going_on:
            run = executor.run
            if request in run.open_requests:
                return run.knowledge, Asker(run.id, executor.name)
        return None


@dataclass(eq=False, repr=False)
class PlansClient:
    """Carries out calls of plans as runs of their own, on behalf of a task, and passes all others on to the backend.

    The mutable state is the runs of plans by request, what those that are over have sent, the requests that were cancelled, and the
    tasks that carry them out.
    """

    runner: PlanRunner
    observer: Observer | None
    task: UUID
    priority: int
    _runs: dict[UUID, PlanRun] = field(init=False, default_factory=dict)
    _sent: int = field(init=False, default=0)
    _cancelled: set[UUID] = field(init=False, default_factory=set)
    _tasks: set[asyncio.Task[None]] = field(init=False, default_factory=set)

    @property
    def _client(self) -> requests.ActionClient:
        return self.runner.backend.client

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        """Return the parameters of the plan, or the fields that the server's goal has."""
        program = self.runner.programs.get(action.name)
        return self._client.goal_fields(action) if program is None else program.plan.parameters

    def send(self, request: requests.Request, report: requests.Reporter, /) -> None:
        """Begin to carry the plan out, or send the goal."""
        if request.action.name not in self.runner.programs:
            self._client.send(request, report)
            return
        self._begin(self._run_plan(request, report))

    def reattach(self, request: requests.Request, report: requests.Reporter, /, *, accepted: bool) -> None:
        """Go on with the plan that the request has begun in another process; or have it found out what became of the goal."""
        replayed = self.runner.kept.pop(request.id, None)
        if replayed is not None:
            plan_run = self.runner.go_on_with(replayed, request.action.name, self.observer)
            self._begin(self._execute(request, plan_run, report))
        elif request.action.name in self.runner.programs:  # nothing of it was begun
            self.send(request, report)
        elif isinstance(self._client, requests.ReattachingClient):
            self._client.reattach(request, report, accepted=accepted)
        else:
            asyncio.get_running_loop().call_soon(report, requests.Ended(request.id, requests.NOT_REATTACHED))

    def _begin(self, work: Coroutine[None, None, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def cancel(self, request: UUID, /) -> None:
        """Have the plan, or the action, cancelled."""
        if request in self._runs:
            self._cancelled.add(request)
            self._runs[request].executor.stop()
        else:
            self._client.cancel(request)

    def executor_of(self, request: UUID) -> Executor | None:
        """Return the executor of the run that a request for a plan has started; None if it has none, or it is over."""
        return self._runs[request].executor if request in self._runs else None

    @property
    def called(self) -> int:
        """The requests that plans have sent, less those that have called them: they are carried out here, and not by a server."""
        return self._sent + sum(plan_run.requests - 1 for plan_run in self._runs.values())

    async def _run_plan(self, request: requests.Request, report: requests.Reporter) -> None:
        given = {name: value for name, value in request.goal.items() if name not in ABOUT_THE_CALL}
        try:
            plan_run = self.runner.prepare_run(
                request.action.name, given, self.observer, task=self.task, priority=self.priority, caller=request.id
            )
        except InputError as error:
            report(requests.Ended(request.id, requests.Outcome(requests.OutcomeKind.REJECTED, message=str(error))))
            return
        await self._execute(request, plan_run, report)

    async def _execute(self, request: requests.Request, plan_run: PlanRun, report: requests.Reporter) -> None:
        self._runs[request.id] = plan_run
        report(requests.Accepted(request.id))
        try:
            result = await self.runner.execute(plan_run)
        except Exception as error:  # the calling plan waits for its end
            _log.exception("%s has come to no end", request.action)
            report(
                requests.Ended(
                    request.id, requests.Outcome(requests.OutcomeKind.ABORTED, message=f"internal error: {type(error).__name__}: {error}")
                )
            )
            return
        finally:
            self._sent += plan_run.requests - 1
            del self._runs[request.id]
        unsuccessful = requests.OutcomeKind.CANCELED if request.id in self._cancelled else requests.OutcomeKind.ABORTED
        self._cancelled.discard(request.id)
        kind = requests.OutcomeKind.SUCCEEDED if result.goal else unsuccessful
        report(requests.Ended(request.id, requests.Outcome(kind, plan_run.results, "" if result.goal else result.reason)))
