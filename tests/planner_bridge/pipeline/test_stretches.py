"""Plans of actions that may turn out in several ways: one machine up to each of these, and what follows goes by how it turned out."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from random import Random

from planner_bridge.model.plan import Plan, PlanningResult, PlanStep, Policy
from planner_bridge.model.problem import Problem
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.tasks.replanning import GiveUp, Limits, NextStretch, decision_words
from planner_bridge.tasks.settings import Memory, Settings
from planner_bridge.view.follow import Reader
from planner_bridge.view.story import timelines, view_of
from pnm.actions.faults import Fault, Faults, HiddenChange
from pnm.core.logic.expressions import State
from pnm.core.machine.bindings import Bindings
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.pictures.timeline import timeline_svg
from pnm.tasks import Code
from tests.support.e2e.command_line import pnm
from tests.support.files import written
from tests.support.tasks.replanning import aborts, decisions, pursued

CUPS = """
(define (domain cups) (:requirements :strips :typing :non-deterministic) (:types cup room) (:constants kitchen - room)
  (:predicates (held ?c - cup) (floor ?c - cup) (broken ?c - cup) (table ?c - cup) (at ?r - room) (swept))
  (:action pick :parameters (?c - cup) :precondition (and (table ?c) (at kitchen))
    :effect (oneof (and (held ?c) (not (table ?c))) (and (floor ?c) (not (table ?c))) (and)))
  (:action lift :parameters (?c - cup) :precondition (and (floor ?c) (at kitchen)) :effect (and (table ?c) (not (floor ?c))))
  (:action sweep :parameters () :effect (swept))
  (:action go :parameters (?from ?to - room) :precondition (at ?from) :effect (and (at ?to) (not (at ?from)))))
"""
PROBLEM = "(define (problem p) (:domain cups) (:objects mug - cup hall - room) (:init (table mug) (at hall)) (:goal (held mug)))"
HELD, FLOOR, NOTHING = "1", "2", "3"


def cups(goal: str = "(held mug)") -> Problem:
    return parse_problem(PROBLEM.replace("(held mug)", goal), parse_domain(CUPS))


def drawn(*names: str) -> Faults:
    """The outcomes of the next calls that have several; then always the first."""
    left = [*names]

    def draw(action: GroundAction, _: Random) -> Fault | None:
        return Fault(action.name, outcome=left.pop(0) if left else HELD) if action.outcomes else None

    return Faults(drawn=draw)


def outcomes(result: object) -> list[str]:
    return [f"{call.call.action.name}: {call.outcome}" for call in result.calls]  # type: ignore[attr-defined]


def test_what_follows_goes_by_the_outcome_and_nothing_has_failed() -> None:
    result, _ = pursued(cups(), drawn(FLOOR, NOTHING), limits=Limits(replans=0))
    assert result.goal_reached
    assert outcomes(result) == ["go: succeeded", "pick: 2", "lift: succeeded", "pick: 3", "pick: 1"]
    assert (result.replans, result.failures, decisions(result)) == (0, (), [NextStretch, NextStretch])
    assert [call.attempts for call in result.calls] == [1] * 5


def test_an_outcome_however_often_it_comes_is_never_forbidden() -> None:
    result, _ = pursued(cups(), drawn(*[NOTHING] * 20))
    assert (result.goal_reached, result.replans, len(result.calls)) == (True, 0, 22)


def test_what_never_comes_ends_with_a_reason() -> None:
    result, _ = pursued(cups(), drawn(*[NOTHING] * 20), limits=Limits(stretches=5))
    assert (result.code, decisions(result)[-1]) == (Code.REPLAN_LIMIT, GiveUp)
    assert "5 declared outcomes have not led to the goal" in result.reason


def test_a_call_whose_other_outcomes_never_come_is_given_up_by_their_chances() -> None:
    result, _ = pursued(cups(), drawn(*[NOTHING] * 100))
    assert (result.code, len(result.calls)) == (Code.REPLAN_LIMIT, 1 + 60)
    assert "pick(mug) has ended 60 times in a row as 3, and nothing is new; its outcomes are 1, 2, 3, and 1, 2 never came" in result.reason


def test_a_circle_of_calls_is_given_up_too() -> None:
    result, _ = pursued(cups(), drawn(*[FLOOR] * 100))
    assert (result.code, len(result.calls)) == (Code.REPLAN_LIMIT, 2 * 60)  # it is lifted between


def test_a_real_failure_of_such_a_call_is_tried_again_and_then_planned_around() -> None:
    result, _ = pursued(cups(), aborts("pick"))
    assert not result.goal_reached
    assert [call.attempts for call in result.calls if call.call.action.name == "pick"] == [2, 2]
    assert "pick(mug), not to be tried again" in result.reason


def test_calls_beside_are_carried_out_in_the_same_machine() -> None:
    result, _ = pursued(cups("(and (held mug) (swept))"), drawn())
    assert result.goal_reached
    assert {call.call.action.name for call in result.calls} == {"go", "pick", "sweep"}


def test_sensors_of_some_facts_tell_which_outcome_it_was() -> None:
    result, _ = pursued(cups(), drawn(FLOOR), bindings=Bindings(assumed=frozenset({"held"})))
    assert (result.goal_reached, outcomes(result)[1]) == (True, "pick: 2")


def test_what_no_sensor_tells_is_unknown_and_never_a_success() -> None:
    result, _ = pursued(cups(), drawn(FLOOR), bindings=Bindings(assumed=frozenset({"held", "floor", "table"})))
    assert outcomes(result) == ["go: succeeded", "pick: 1 or 2 or 3"]
    assert not result.goal_reached
    assert "(held mug) is unknown" in result.reason


def test_a_goal_that_an_outcome_reaches_in_passing_ends_the_task() -> None:
    result, _ = pursued(cups("(or (held mug) (floor mug))"), drawn(FLOOR))
    assert (result.goal_reached, outcomes(result)) == (True, ["go: succeeded", "pick: 2"])


class Known(Memory):
    """Has every plan come with this policy. The mutable state is how often a planner was asked."""

    def __init__(self, policy: Policy) -> None:
        self.policy, self.asked = policy, 0

    def plan(self, problem: Problem, timeout: float, search: Callable[[float], PlanningResult]) -> PlanningResult:
        self.asked += 1
        return replace(search(timeout), policy=self.policy)


class Picks:
    """Lifts what has fallen, and picks what stands."""

    entries, chance, is_proved, problem = (), 1.0, False, cups()

    @property
    def policies(self) -> tuple[Picks, ...]:
        return (self,)

    def follow(self, policy: object, /) -> None:
        pass

    def stretch(self, state: State, /) -> Plan | None:
        lifted = (PlanStep("lift", ("mug",)),) if state.value(("floor", "mug")) else ()
        return Plan((*lifted, PlanStep("pick", ("mug",), float(len(lifted)))))


def test_a_policy_goes_on_without_a_planner() -> None:
    known = Known(Picks())
    result, _ = pursued(cups(), drawn(FLOOR, NOTHING, FLOOR), Settings(memory=known))
    assert (result.goal_reached, known.asked, result.plans, result.replans) == (True, 1, 1, 0)
    assert [call.call.action.name for call in result.calls] == ["go", "pick", "lift", "pick", "pick", "lift", "pick"]
    assert [decision_words(episode.decision) for episode in result.episodes[:2]] == [
        "pick(mug): 2: going on with 2 calls",
        "pick(mug): 3: going on with 1 call",
    ]


def test_what_a_policy_wants_and_cannot_be_done_is_planned_anew() -> None:
    known = Known(Picks())
    gone = HiddenChange({("at", "kitchen"): False, ("at", "hall"): True}, moment="end", what="pick(mug)")
    faults = drawn(NOTHING)
    result, _ = pursued(cups(), replace(faults, changes=(gone,)), Settings(memory=known))
    assert (result.goal_reached, known.asked) == (True, 2)


def test_all_who_tell_of_a_run_tell_the_outcome(tmp_path: Path) -> None:
    files = [str(written(tmp_path / name, text)) for name, text in (("domain.pddl", CUPS), ("problem.pddl", PROBLEM))]
    faults = written(tmp_path / "faults.yaml", 'faults: [{action: pick, outcome: "2", times: 1}, {action: pick, outcome: "1", after: 1}]\n')
    journal = str(tmp_path / "journal")
    done = pnm("run", *files, "--faults", str(faults), "--journal", journal, "--json")
    assert [call["outcome"] for call in json.loads(done.stdout.splitlines()[-1])["calls"]] == ["succeeded", "2", "succeeded", "1"]
    (timeline,) = timelines(journal)
    assert [call.declared for plan in timeline.plans for call in plan.calls] == ["", "2", "", "1"]
    assert ">2</text>" in timeline_svg(timeline)
    reader = Reader(tmp_path / "journal")
    view = reader.at(reader.newest().number, view_of)
    assert view is not None
    assert [request["declared"] for request in view.requests.values()] == ["", "2", "", "1"]
    why = pnm("why", "--journal", journal, "--call", "pick(mug)").output
    assert "what follows #1 pick(mug) goes by its outcome, which may be 1 (33%), 2 (33%) and 3 (33%)" in why
    assert "it has come to its outcome 1" in why
    assert "pick(mug): 2: going on with 2 calls" in pnm("why", "--journal", journal).output
    shown = pnm("run", *files, "--faults", str(faults)).output
    assert "found  pick(mug): 2\nnext      pick(mug): 2: going on with 2 calls\n" in shown
