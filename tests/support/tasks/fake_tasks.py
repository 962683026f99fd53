"""Tasks that do as their goals say, for tests of what stands before them.

The goal is a word: a state in which the task stays ("queued", "planning", "running", "replanning"), a code with which it ends
at once ("no_plan"), or "stubborn": it runs, and does not end for a long time when it is cancelled. Further words are ignored.
A condition in PDDL is pursued for ever; the plan "empty" is carried out at once.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from uuid import UUID

from planner_bridge.node.node_context import NodeContext
from planner_bridge.node.serve import make_task_manager
from planner_bridge.tasks.settings import DEFAULTS, Settings
from pnm.core.knowledge_base import KnowledgeBase, parse_fluent
from pnm.core.logic.computed_values import Layer, Question
from pnm.core.logic.expressions import Fluent, Unknown, Value, fluent_text
from pnm.core.machine.failure_causes import Cause
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import PetriNetMachine
from pnm.core.net.net import Marking
from pnm.core.resources import Hand
from pnm.errors import InputError, Position
from pnm.knowledge.people import read_answer
from pnm.tasks import (
    Code,
    MadePlan,
    StepState,
    TaskEnding,
    TaskListener,
    TaskOdds,
    TaskRefused,
    TaskState,
    TaskStatus,
    TaskStep,
    TraceEvent,
    TraceKind,
    Wanted,
)
from tests.support.runs.plan_graphs import plan

_STAYS = {state.name.lower(): state for state in (TaskState.QUEUED, TaskState.PLANNING, TaskState.RUNNING, TaskState.REPLANNING)}
_ENDS = {code.word: code for code in Code}
_STUBBORN = 1000.0
_MACHINE = generate(plan(2, "0e<1s"))
_STEPS = (
    TaskStep("done", (), 0.0, 1.0, StepState.DONE, started=0.0, ended=1.0, attempts=1),
    TaskStep("move", ("r1", "hall"), 1.0, 2.0, StepState.RUNNING, (0,), attempts=2, limit=10.0, cause=Cause.ABORTED),
    TaskStep("pick", ("r1", "cup"), 3.0, 2.0, StepState.WAITING, (1,)),
)


@dataclass
class FakeTasks:
    """Does not more than it says; `wanted` has everything that was."""

    max_queue: int = 100
    wanted: list[Wanted] = field(default_factory=list)
    open: dict[UUID, TaskStatus] = field(default_factory=dict)
    listeners: list[TaskListener] = field(default_factory=list)
    paused: bool = False
    settings: Settings = DEFAULTS
    said: list[tuple[object, ...]] = field(default_factory=list)
    """What an operator has said besides."""
    in_hands: list[Hand] = field(default_factory=list)
    _before: dict[UUID, TaskState] = field(default_factory=dict)
    _traces: dict[UUID, list[TraceEvent]] = field(default_factory=dict)

    # the protocol

    def begin(self, wanted: Wanted, /) -> None:
        self.wanted.append(wanted)
        self._happened(wanted.id, TraceKind.GOAL, text=wanted.text)
        word = "running" if wanted.text.startswith("(") else wanted.text.split()[0] if wanted.text else ""
        if word == "empty":
            self._end(wanted.id, Code.GOAL_REACHED, "there is nothing to do")
        elif word in _ENDS:
            self._end(wanted.id, _ENDS[word], f"as it was told: {word}")
        elif word not in _STAYS and word != "stubborn":
            self._end(wanted.id, Code.INVALID_GOAL, f"goal:1:1: there is no predicate {word!r} here")
        elif len(self.open) >= self.max_queue:
            self._end(wanted.id, Code.QUEUE_FULL, f"{self.max_queue} tasks are waiting already")
        else:
            self.open[wanted.id] = TaskStatus(wanted.id, wanted.text, wanted.priority, TaskState.QUEUED)
            self._enter(wanted.id, TaskState.PAUSED if self.paused else _STAYS.get(word, TaskState.RUNNING))
            self._before[wanted.id] = _STAYS.get(word, TaskState.RUNNING)

    async def pause(self, task: UUID | None, /, *, at_once: bool, why: str = "", is_kept: bool = True) -> None:
        self.paused |= task is None
        for one in self._meant(task):
            if self.open[one].state is not TaskState.PAUSED:
                self._before[one] = self.open[one].state
                self._enter(one, TaskState.PAUSING)
                await asyncio.sleep(0)
                self._enter(one, TaskState.PAUSED)

    async def resume(self, task: UUID | None, /, *, but: Collection[UUID] = ()) -> None:
        self.paused &= task is not None
        for one in set(self._meant(task)).difference(but):
            if self.open[one].state is TaskState.PAUSED:
                self._enter(one, self._before[one])
            elif task is not None:
                raise TaskRefused(f"the task {task} is not paused")

    async def cancel(self, task: UUID | None, /, *, why: str = "") -> None:
        await asyncio.gather(*map(self._cancel, self._meant(task)))

    async def take(self, name: str, /, *, reason: str = "", by: str = "") -> str:
        if any(hand.name == name for hand in self.in_hands):
            raise TaskRefused(f"{name} is taken")
        self.in_hands.append(Hand(name, 100.0, reason, by))
        return "it may still move" if name == "stubborn" else ""

    async def give(self, name: str, /) -> None:
        self.in_hands = [hand for hand in self.in_hands if hand.name != name]

    def hands(self) -> tuple[Hand, ...]:
        return tuple(self.in_hands)

    def plans(self) -> Mapping[str, Mapping[str, object]]:
        return {"empty": {}, "round": {"rounds": 2, "place": None}}

    async def step(self, task: UUID, /) -> None:
        self._said("step", *self._meant(task))

    def settle(self, request: UUID, /, *, is_done: bool) -> None:
        self._said("settle", request, is_done)

    def answer(self, question: UUID, text: str, /) -> None:
        read_answer(text, Question("said", Layer.PERSON, ""))
        self._said("answer", question, text)

    def answer_of(self, task: UUID, name: str, text: str, /) -> None:
        self._said("answer_of", *self._meant(task), name, text)

    def status(self) -> tuple[TaskStatus, ...]:
        return tuple(self.open.values())

    def plan(self, task: UUID, /) -> tuple[int, tuple[TaskStep, ...]]:
        return (3, _STEPS) if self._has_plan(task) else (0, ())

    def net(self, task: UUID, /) -> tuple[int, PetriNetMachine, Marking] | None:
        return (3, _MACHINE, _MACHINE.initial) if self._has_plan(task) else None

    def listen(self, listener: TaskListener, /) -> Callable[[], None]:
        self.listeners.append(listener)
        return lambda: self.listeners.remove(listener)

    # of a task manager besides

    def restore(self, replay: object) -> None:
        """Go on with nothing, for nothing is kept."""

    async def close(self) -> None:
        """Leave all tasks as they are."""

    # what tests have happen

    def end(self, task: UUID, code: Code) -> None:
        """Have a task end."""
        self._end(task, code, "the test said so")

    def tell(self, task: UUID, times: int) -> None:
        """Have so many things happen to a task."""
        for number in range(times):
            self._happened(task, TraceKind.SENT, f"call {number}")

    def _said(self, *words: object) -> None:
        self.said.append(words)

    def feed(self, task: UUID, text: str) -> None:
        """Have the server of the call of a task report feedback."""
        self.open[task] = replace(self.open[task], feedback=(text,))
        self._happened(task, TraceKind.FEEDBACK, "move(r1, hall)", text)

    # inside

    def _meant(self, task: UUID | None) -> tuple[UUID, ...]:
        if task is not None and task not in self.open:
            raise TaskRefused(f"there is no task {task}")
        return tuple(self.open) if task is None else (task,)

    async def _cancel(self, task: UUID) -> None:
        busy = self.open[task].state in (TaskState.RUNNING, TaskState.REPLANNING)
        if busy:
            self._enter(task, TaskState.CANCELLING)
            await asyncio.sleep(_STUBBORN if self.open[task].goal == "stubborn" else 0)
        if task in self.open:
            self._end(task, Code.CANCELLED, "cancelled")

    def _has_plan(self, task: UUID) -> bool:
        return task in self.open and self.open[task].state not in (TaskState.QUEUED, TaskState.PLANNING)

    def _enter(self, task: UUID, state: TaskState) -> None:
        running = ("move(r1, hall)",) if state is TaskState.RUNNING else ()
        self.open[task] = replace(self.open[task], state=state, running=running, ended=1, feedback=("",) * len(running))
        self._happened(task, TraceKind.STATE, text=state.name.lower())
        for one in self.listeners:
            one.changed(task)
            if state is TaskState.RUNNING:
                one.planned(task)
                one.moved(task, lambda: TraceEvent(task, 0.0, TraceKind.FIRED))

    def _happened(self, task: UUID, kind: TraceKind, subject: str = "", text: str = "") -> None:
        moment = TraceEvent(task, asyncio.get_running_loop().time(), kind, subject, text)
        self._traces.setdefault(task, []).append(moment)
        for one in self.listeners:
            one.happened(moment)

    def _end(self, task: UUID, code: Code, message: str) -> None:
        replans = self.open.pop(task).replans if task in self.open else 0
        ending = TaskEnding(code, message, replans, tuple(self._traces.pop(task, ())), {"eggs": 3})
        for one in tuple(self.listeners):
            one.ended(task, ending)


@dataclass
class FakeWorld:
    """Facts without a problem around them."""

    knowledge: KnowledgeBase

    async def make(self, goal: str, planner: str, limit: float | None, /, *, with_new_plans: bool = False) -> MadePlan:
        """Find a plan at once for any goal but "no_plan", or never for "planning"."""
        if goal == "planning":
            await asyncio.get_running_loop().create_future()
        if goal == "wrong":
            raise InputError("goal:1:1: expected a condition")
        if goal == "no_plan":
            return MadePlan(Code.NO_PLAN, "there is none")
        odds = TaskOdds(0.75, 4.0, 9.0, "assumed: go") if with_new_plans else None
        return MadePlan(Code.GOAL_REACHED, f"{planner} {limit}", goal, _STEPS, odds)

    async def query(self, questions: Sequence[str], /) -> tuple[tuple[str, str], ...]:
        return tuple((one, str(self.knowledge.value(parse_fluent(one)) is True).lower()) for one in questions)

    async def update(self, add: Sequence[str], remove: Sequence[str], forget: Sequence[str], /) -> int:
        return len(self.knowledge.update({parse_fluent(one): True for one in add} | {parse_fluent(one): False for one in remove}))

    async def check_goal(self, goal: str, /) -> None:
        if goal and goal[0] != "(" and goal.split()[0] not in {*_ENDS, *_STAYS}:
            raise InputError(f"there is no predicate {goal!r} here", Position("goal", 1, 1))

    async def pack(self, goal: str, /) -> str:
        raise InputError("there is no problem here")

    async def get(self) -> tuple[str, str]:
        return "(define (domain d))", "(define (problem p))"

    async def save(self, file: str, /) -> str:
        if Path(file).is_absolute():
            raise InputError(f"{file} is outside of the folder for problems")
        return f"/problems/{file}"

    async def load(self, domain: str, problem: str, /) -> None:
        raise InputError("problem:1:1: expected (define")

    def follow(self, tell: Callable[[Mapping[str, object]], None], /) -> Callable[[], None]:
        return self.knowledge.listen(lambda batch: tell(self._fields(batch)))

    def _fields(self, batch: Mapping[Fluent, Value | Unknown]) -> Mapping[str, object]:
        numbers = {fluent_text(fluent): value for fluent, value in batch.items() if isinstance(value, float)}
        added = [fluent_text(fluent) for fluent, value in batch.items() if value is True]
        return {"added": added, "fluents": [*numbers], "values": [*numbers.values()]}


def make_fake_tasks(context: NodeContext) -> tuple[Any, Any]:
    """Stand in for `planner_bridge.node.serve.make_task_manager` where there are goals to be pursued."""
    if context.problem is None:
        return make_task_manager(context)
    return FakeTasks(context.options.max_queue), FakeWorld(context.runner.world)
