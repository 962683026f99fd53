"""Drives a run without a loop: every request is answered at once by a function, questions by a dictionary."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from pnm.core.execution.call_results import RunResult
from pnm.core.execution.events import Answered, Ask, Begin, Cancel, Command, Event, Send, Store, Tick, Wake
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import MISSING, Question
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.machine import OnFailure
from pnm.core.machine.plan_graph import PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Request
from pnm.core.machine.verification.verify import verify
from tests.support.runs.commands import RUN

Answer = Callable[[Request], Outcome]


def succeed(_request: Request) -> Outcome:
    """Answer that all went well."""
    return Outcome(OutcomeKind.SUCCEEDED)


def answering_with(**kinds: list[str]) -> Answer:
    """Answer the requests of an action with these kinds, one after the other, and then with success."""
    left = {name: [*found] for name, found in kinds.items()}

    def answer(request: Request) -> Outcome:
        waiting = left.get(request.action.name, [])
        return Outcome(OutcomeKind(waiting.pop(0)) if waiting else OutcomeKind.SUCCEEDED)

    return answer


@dataclass
class Trace:
    """Answers everything a run asks for, and is what happened in it. The mutable state is all but the answers."""

    run: Run
    answer: Answer
    known: Mapping[str, object]
    now: float = 0.0
    events: list[Event] = field(default_factory=lambda: [Begin()])
    wakes: list[float] = field(default_factory=list)
    sent: list[tuple[str, Mapping[str, object]]] = field(default_factory=list)
    asked: list[Question] = field(default_factory=list)
    told: list[tuple[Question, object]] = field(default_factory=list)

    @property
    def result(self) -> RunResult:
        return self.run.result()

    @property
    def actions(self) -> list[str]:
        """The names of the actions of all requests, in order."""
        return [name for name, _ in self.sent]

    def drive(self) -> Trace:
        """Go on to the end, which must come."""
        for _ in range(100_000):
            if self.run.over:
                return self
            if self.events:
                event = self.events.pop(0)
            else:
                assert self.wakes, f"it waits for nothing: {self.run.marking}"
                self.now, event = max(self.now, min(self.wakes)), Tick()
                self.wakes.clear()
            for command in self.run.handle(event, self.now):
                self._do(command)
        raise AssertionError(f"it never ends: {self.run.marking}")

    def _do(self, command: Command) -> None:
        match command:
            case Send(request):
                self.sent.append((request.action.name, request.goal))
                outcome = self.answer(request)
                refused = outcome.kind in (OutcomeKind.REJECTED, OutcomeKind.UNAVAILABLE)
                self.events += [*([] if refused else [Accepted(request.id)]), Ended(request.id, outcome)]
            case Cancel(request_id):
                self.events.append(Ended(request_id, Outcome(OutcomeKind.CANCELED)))
            case Wake(at):
                self.wakes.append(at)
            case Ask(identity, question):
                self.asked.append(question)
                self.events.append(Answered(identity, self.known.get(question.name, MISSING)))
            case Store(identity, question, value):
                self.told.append((question, value))
                self.events.append(Ended(identity, Outcome(OutcomeKind.SUCCEEDED)))
            case _:
                pass


def drive(
    graph: PlanGraph,
    answer: Answer = succeed,
    *,
    bindings: Bindings | None = None,
    variables: Mapping[str, object] | None = None,
    known: Mapping[str, object] | None = None,
    world: KnowledgeBase | None = None,
    on_failure: OnFailure = OnFailure.DRAIN,
) -> Trace:
    """Prove the machine of the plan and run it; `known` is what is answered outside, None when there is nobody to ask."""
    machine = generate(graph, bindings, on_failure=on_failure)
    verify(machine)
    knowledge = Layered(world or KnowledgeBase(), KnowledgeBase(variables=variables))
    run = Run(machine, knowledge, id=RUN, bindings=bindings, asks=known is not None)
    return Trace(run, answer, known or {}).drive()
