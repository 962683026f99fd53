"""What of a task does not begin anew when its process dies: its time, its constraints, facts to come, and what people have said."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.tasks.replanning import Limits
from planner_bridge.tasks.result import TASKS, TrajectoryNote
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import Faults, HiddenChange
from pnm.core.execution.events import Begin, Cancel, Reattach, Restarted, Stop
from pnm.core.execution.run import Run
from pnm.core.knowledge_base import KnowledgeBase, Layered
from pnm.core.logic.computed_values import Question
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.generate import generate
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.core.machine.requests import Accepted
from pnm.journal.records import TaskNoted
from pnm.journal.replay import Replay
from pnm.journal.resume import replay_steps
from pnm.knowledge.source import Asker
from pnm.language.plan import parse_plans
from pnm.language.runner import Program
from pnm.tasks import Code, Wanted
from tests.support.runs.simulation.disk import DEATHS, DiskPlan, Fate
from tests.support.tasks.rooms import ring
from tests.support.tasks.scenarios.crash import Survival, survive

QUICK = Settings(improve=0.0)
TASK = Wanted(UUID(int=1), "(at r1 d)")

SHOP = """
predicates: [(open), (bought)]
actions:
  knock: {duration: 4}
  buy: {duration: 1, effects: [(bought)]}
  go_home: {duration: 1}
problem: {init: [{at: 10, facts: [(open)]}, {at: 13.5, facts: [(not (open))]}], goal: (bought)}
plan: [knock: , knock: , knock: , {if: (open), then: [buy: ], else: [go_home: ]}]
"""

TEA = """
actions: {serve: {params: [drink], duration: 2}}
plan:
  - serve: {drink: {PersonQuery: drink}}
  - serve: {drink: water}
"""


@dataclass
class Person:
    """A person who outlives the processes that ask, and answers each question in the same way however often it comes."""

    answers: tuple[object, ...]
    asked: list[UUID | None] = field(default_factory=list)
    """The questions, in the order in which they came first."""
    order: list[int] = field(default_factory=list)
    """Every time that one was asked, its place among them."""

    async def query(self, question: Question, asker: Asker, /) -> object:
        """Answer after a while."""
        if asker.question not in self.asked:
            self.asked.append(asker.question)
        self.order.append(self.asked.index(asker.question))
        answer = self.answers[self.order[-1]]
        await asyncio.sleep(2.0)
        return answer

    async def update(self, question: Question, value: object, asker: Asker, /) -> None:
        """Hear."""

    async def close(self) -> None:
        """Stay."""


def at_every_commit(folder: Path, process: Callable[[Path, DiskPlan], Survival], least: int) -> list[tuple[Path, Survival]]:
    """Return what was left of processes that die before or after each of their commits, with their journals."""
    survivals: list[tuple[Path, Survival]] = []
    while not survivals or survivals[-1][1].deaths:
        commit = len(survivals) + 1
        journal = folder / f"{commit}.journal"
        survivals.append((journal, process(journal, DiskPlan(commit, (Fate.DIES_BEFORE, Fate.DIES_AFTER)[commit % 2]))))
        assert not survivals[-1][1].wrong, commit
    assert len(survivals) > least
    return survivals


def test_a_limit_ends_a_task_however_often_its_process_dies(tmp_path: Path) -> None:
    goal = Wanted(UUID(int=1), "(and (clean a) (clean b) (clean c) (clean d))")
    limited = Settings(improve=0.0, limits=Limits(seconds=5.0))
    for deaths in ([], [6], [5, 5], [5, 3, 6, 4, 5], [8, 9, 10]):
        survival = survive(ring(), [goal], limited, tmp_path / f"{len(deaths)}{sum(deaths)}", deaths)
        assert survival.endings[goal.id].code is Code.TIMED_OUT, (deaths, survival.endings)
        assert survival.deaths == len(deaths)


def test_a_constraint_that_was_fulfilled_is_fulfilled_in_the_next_process(tmp_path: Path) -> None:
    there = ring("(and (sometime (at r1 b)) (at-most-once (at r1 b)))", ways="(way a b) (way b a) (way a d)")
    for _, survival in at_every_commit(tmp_path, lambda journal, death: survive(there, [TASK], QUICK, journal, [death]), 8):
        assert survival.endings[TASK.id].code is Code.GOAL_REACHED, survival.endings
        assert not survival.doubled


def test_a_constraint_that_was_violated_is_violated_in_the_next_process(tmp_path: Path) -> None:
    fluent = ("clean", "b")
    passing = Faults(changes=(HiddenChange({fluent: True}, at=1.3), HiddenChange({fluent: False}, at=1.4)))
    problem = ring("(always (not (clean b)))", ways="(way a b) (way b c) (way c d)")
    seen = 0
    for journal, survival in at_every_commit(
        tmp_path, lambda journal, death: survive(problem, [TASK], QUICK, journal, [death], faults=passing), 5
    ):
        records = [step.record for step in replay_steps(journal, TASKS, Replay())]
        notes = [record.note for record in records if isinstance(record, TaskNoted)]
        is_seen = any(note.violations for note in notes if isinstance(note, TrajectoryNote))
        assert survival.endings[TASK.id].code is (Code.CONSTRAINT_VIOLATED if is_seen else Code.GOAL_REACHED), journal
        seen += is_seen
    assert seen > 2


def test_facts_of_a_plan_by_hand_change_at_their_time_also_in_the_next_process(tmp_path: Path) -> None:
    (plan,) = parse_plans(SHOP).values()
    wanted, programs = Wanted(UUID(int=1), "shop", is_plan=True), {"shop": Program.of(plan)}
    for _, survival in at_every_commit(
        tmp_path, lambda journal, death: survive(ring(), [wanted], QUICK, journal, [death], programs=programs), 8
    ):
        assert survival.endings[wanted.id].code is Code.GOAL_REACHED, survival.endings
        assert len(survival.told) == 4


@pytest.mark.parametrize(("answers", "questions"), [(("try again", "give up"), 2), (("give up",), 1), (("hm", "try again", "give up"), 3)])
def test_a_person_who_has_helped_is_not_asked_again_by_the_next_process(tmp_path: Path, answers: tuple[str, ...], questions: int) -> None:
    nowhere = ring(ways="(way b a)")
    for commit in range(1, 12):
        fate = DEATHS[commit % len(DEATHS)]
        person = Person(answers)
        survival = survive(nowhere, [TASK], QUICK, tmp_path / f"{commit}{fate.name}", [DiskPlan(commit, fate)], person=person)
        assert survival.endings[TASK.id].code is Code.NO_PLAN
        assert "a person was asked for help, and says to give up" in survival.endings[TASK.id].message
        assert len(person.asked) == questions, (commit, fate)
        assert person.order == sorted(person.order) or "hm" in answers, "what means something is kept, and not asked again"


def test_a_question_of_a_plan_has_the_same_id_in_the_next_process(tmp_path: Path) -> None:
    (plan,) = parse_plans(TEA).values()
    wanted, programs, people = Wanted(UUID(int=1), "tea", is_plan=True), {"tea": Program.of(plan)}, []

    def process(journal: Path, death: DiskPlan) -> Survival:
        people.append(Person(("green tea",)))
        return survive(ring(), [wanted], QUICK, journal, [death], programs=programs, person=people[-1])

    for _, survival in at_every_commit(tmp_path, process, 8):
        assert survival.endings[wanted.id].code is Code.GOAL_REACHED, survival.endings
        served = {dict(action.given).get("drink") or action.arguments for _, action in survival.told}
        assert len(served) == 2, served
    assert {len(person.asked) for person in people} == {1}
    assert all(person.asked != [None] for person in people)


def test_a_request_that_is_being_cancelled_is_cancelled_by_the_next_process_once_it_is_attached() -> None:
    plan = PlanGraph(tuple(ActionCall(number, GroundAction(f"act{number}")) for number in range(2)))
    run = Run(generate(plan), Layered(KnowledgeBase()), id=UUID(int=1), bindings=Bindings())
    run.handle(Begin(), 0.0)
    first, second = run.open_requests
    run.handle(Accepted(first), 1.0)
    assert [command.accepted for command in run.handle(Restarted(), 2.0) if isinstance(command, Reattach)] == [True, False]
    run.handle(Stop(cancel=True), 3.0)
    commands = run.handle(Restarted(), 4.0)
    attached = [command.request.id for command in commands if isinstance(command, Reattach)]
    assert attached == [first, second]
    place = next(place for place, command in enumerate(commands) if isinstance(command, Reattach) and command.request.id == first)
    assert commands[place + 1] == Cancel(first), "the process before may have died when this was kept, and not done yet"
    assert Cancel(second) not in commands, "it is cancelled when it is accepted"
