"""Objects that results name, and that nobody knew: they are there from then on, for goals, rules, planners and journals."""

from __future__ import annotations

from asyncio import get_running_loop
from pathlib import Path
from typing import Any
from unittest.mock import Mock
from uuid import UUID

import pytest
from hypothesis import given, strategies as st

from planner_bridge import achieve
from planner_bridge.model.grounding import initial_knowledge, problem_now
from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.model.problem import Problem
from planner_bridge.node.world_queries import SharedWorld
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.pddl import parse_domain, parse_problem
from planner_bridge.tasks.replanning import History, Limits, NextStretch, Progress, followed, next_stretch
from planner_bridge.tasks.result import TASKS, TaskResult
from planner_bridge.tasks.settings import OnChange, Settings
from planner_bridge.yaml.writer import write_bindings
from pnm.actions.bindings_file import read_bindings
from pnm.actions.faults import Faults
from pnm.core.knowledge_base import KnowledgeBase
from pnm.core.logic.conditions import evaluate
from pnm.core.machine.bindings import Found
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.core.message_fields import parse_field
from pnm.journal.resume import replayed
from pnm.knowledge.state_reports import StateReports
from tests.support.files import written
from tests.support.runs.files import FINDS, TIDY
from tests.support.runs.simulated import in_virtual_time

PROBLEM = parse_problem(TIDY[1], parse_domain(TIDY[0]))
FOUND = Found(parse_field("objects"), ("cup", "item"), (("in", "?found", "?room"),))
HOLDS = "(and (held ?i) (not (in ?i ?r)) (not (free)))"
MUG = {("exists", "mug", "cup"): True, ("exists", "mug", "item"): True}


def pursue(
    folder: Path, bindings: str = FINDS, *, on_change: OnChange = OnChange.LAZY, problem: Problem = PROBLEM, **how: Any
) -> TaskResult:
    read = read_bindings(written(folder / "bindings.yaml", bindings), problem.vocabulary)
    return achieve(problem.domain, problem, settings=Settings(bindings=read, on_change=on_change), journal=folder / "journal", **how)


def facts_in(named: object, world: KnowledgeBase) -> tuple[dict[Any, Any], list[str]]:
    facts, wrong = FOUND.facts_in({"objects": named}, GroundAction("search", ("kitchen",), ("room",)), world)
    return facts, [f"{what}: {why}" for what, why in wrong.items()]


@pytest.mark.parametrize("on_change", OnChange)
def test_a_goal_is_about_what_was_found_as_well(tmp_path: Path, on_change: OnChange) -> None:
    result = pursue(tmp_path, on_change=on_change)
    assert (result.goal_reached, result.failures) == (True, ()), result
    calls = {str(call.call.action) for call in result.calls if call.outcome == "succeeded"}
    assert calls >= {"search(kitchen)", "search(hall)", "wash(mug)", "wash(glass_2)", "wash(cup_7)"}
    world = replayed(tmp_path / "journal", TASKS).world
    assert (world.objects(("cup",)), world.objects(("plate",))) == (("cup_7", "glass_2", "mug"), ())
    assert evaluate(PROBLEM.goal, world) is True


class Servers:
    """Action servers of somebody else: all succeed at once, and nothing reports what they change."""

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...]:
        return action.parameters

    def send(self, request: Request, report: Reporter, /) -> None:
        seen = {"kitchen": [{"name": "mug"}], "hall": [{"name": "mug"}, {"name": "jar"}]}.get(request.action.arguments[0], [])
        ended = Ended(request.id, Outcome(OutcomeKind.SUCCEEDED, {"detected_objects": seen}))
        get_running_loop().call_soon(report, ended)

    def reattach(self, request: Request, report: Reporter, /, *, accepted: bool) -> None:
        self.send(request, report)

    def cancel(self, request: UUID, /) -> None:
        pass


def test_results_alone_tell_what_is_there(tmp_path: Path) -> None:
    result = pursue(tmp_path, actions=Servers())
    assert (result.goal_reached, result.failures) == (True, ()), result
    assert replayed(tmp_path / "journal", TASKS).world.found() == {"jar": ("cup", "item"), "mug": ("cup", "item")}


def test_a_policy_is_one_for_what_is_there(tmp_path: Path) -> None:
    domain = TIDY[0].replace(":adl", ":adl :non-deterministic").replace(HOLDS, f"(oneof {HOLDS} (and))")
    problem = TIDY[1].replace("hall - room", "hall - room jar - cup").replace("(free)", "(free) (in jar hall)")
    result = pursue(tmp_path, problem=parse_problem(problem, parse_domain(domain)), faults=Faults(seed=1))
    assert (result.goal_reached, result.failures) == (True, ()), result
    assert {"wash(jar)", "wash(mug)", "wash(glass_2)", "wash(cup_7)"} <= {str(call.call.action) for call in result.calls}


def test_a_policy_says_nothing_of_what_was_found_since() -> None:
    steps = tuple(PlanStep("search", (room,), float(number)) for number, room in enumerate(("hall", "kitchen")))
    world, policy = initial_knowledge(PROBLEM), Mock(problem=PROBLEM, stretch=lambda state: Plan(steps))
    progress, known = Progress.beginning(plan_graph(PROBLEM, Plan())), (History(), Limits(), {})
    _, plan = followed((policy,), now := problem_now(PROBLEM, world), world)
    before, _ = next_stretch(now, progress, world, *known, plan)
    world.update({**MUG, ("clean", "mug"): True})  # so that the plan would work all the same
    _, plan = followed((policy,), now := problem_now(PROBLEM, world), world)
    after, _ = next_stretch(now, progress, world, *known, plan)
    assert isinstance(before, NextStretch)
    assert before.rest is not None
    assert isinstance(after, NextStretch)
    assert after.rest is None


def test_a_call_that_finds_what_cannot_be_has_failed_and_says_why(tmp_path: Path) -> None:
    result = pursue(tmp_path, FINDS.replace("7", "-") + "assumed: [searched]\n")
    assert not result.goal_reached
    assert "(exists '-' cup)" in str(result.failures[0])
    assert "'-' names no object" in str(result.failures[0])


def test_bindings_are_written_as_they_were_read(tmp_path: Path) -> None:
    bindings = read_bindings(written(tmp_path / "bindings.yaml", FINDS), PROBLEM.vocabulary)
    again = read_bindings(written(tmp_path / "again.yaml", write_bindings(bindings)), PROBLEM.vocabulary)
    assert again.actions == bindings.actions


@given(st.permutations(["mug", "Mug", "kitchen cup", 7]), st.randoms(use_true_random=False))
def test_the_order_of_what_is_found_does_not_matter(named, random) -> None:
    one, other = initial_knowledge(PROBLEM), initial_knowledge(PROBLEM)
    facts, wrong = facts_in(named, one)
    assert not wrong
    assert {fluent[1] for fluent in facts if fluent[0] == "exists"} == {"Mug", "cup_7", "kitchen_cup"}
    one.update(facts)
    shuffled = list(facts.items())
    random.shuffle(shuffled)
    for fluent, value in shuffled:
        other.update({fluent: value})
    assert one.objects_by_type() == other.objects_by_type() == problem_now(PROBLEM, one).objects_by_type
    assert problem_now(PROBLEM, one) == problem_now(PROBLEM, other)


@pytest.mark.parametrize(
    ("named", "why"),
    [
        (["mug", "Kitchen"], "(exists kitchen cup): kitchen is no cup"),
        (["mug", "--"], "(exists '--' cup): '--' names no object"),
        (["mug", None], "(exists ?found cup): None names no object"),
        ([{"label": "mug"}], "(exists ?found cup): there is no name"),
        ([f"cup{number}" for number in range(11)], "(exists cup9 cup): 11 objects of type cup were found then; expected 10 at most"),
    ],
)
def test_what_cannot_be_an_object_is_refused_with_all_else(named: object, why: str) -> None:
    assert facts_in(named, initial_knowledge(PROBLEM)) == ({}, [why])


def test_the_limit_counts_what_was_found_before() -> None:
    world = initial_knowledge(PROBLEM)
    for number in range(10):
        world.update(facts_in([f"cup{number}"], world)[0])
    assert facts_in(["CUP3"], world) == ({("in", "cup3", "kitchen"): True}, [])
    assert facts_in(["cup10"], world)[0] == {}


def test_knowledge_has_objects_as_long_as_they_are_there() -> None:
    world = initial_knowledge(PROBLEM)
    world.update(MUG)
    assert evaluate(PROBLEM.goal, world) is False
    assert problem_now(PROBLEM, world).objects["mug"] == ("cup",)
    copy = KnowledgeBase(world.facts(), objects=world.objects_by_type())
    assert (copy.found(), copy.objects(("item",))) == ({"mug": ("cup", "item")}, ("mug",))
    world.update(dict.fromkeys(MUG, False))
    assert world.objects_by_type() == PROBLEM.objects_by_type
    assert problem_now(PROBLEM, world).objects == PROBLEM.objects


def test_goals_and_questions_name_what_was_found() -> None:
    world = initial_knowledge(PROBLEM)
    shared = SharedWorld(PROBLEM, world)
    world.update(MUG)
    assert str(shared.read_goal("(clean mug)")) == "(clean mug)"
    assert shared.query(["(clean mug)", "(exists (?c - cup) (clean ?c))"]) == [
        ("(clean mug)", "false"),
        ("(exists (?c - cup) (clean ?c))", "false"),
    ]


def test_rules_are_about_what_was_found() -> None:
    rule = "(free) (ready))\n  (:derived (ready) (forall (?i - item) (clean ?i)))\n"
    domain = TIDY[0].replace(":adl", ":adl :derived-predicates").replace("(free))\n", rule, 1)
    world = initial_knowledge(parse_problem(TIDY[1], parse_domain(domain)))
    assert world.value(("ready",)) is True
    world.update({("exists", "mug", "item"): True})
    assert world.value(("ready",)) is False
    world.update({("clean", "mug"): True})
    assert world.value(("ready",)) is True


@in_virtual_time
async def test_reports_may_be_about_what_was_found() -> None:
    world = initial_knowledge(PROBLEM)
    reports = StateReports(world, {}, lag=0.0, known=PROBLEM.vocabulary)
    reports.record(["in", "exists"], {**MUG, ("in", "mug", "hall"): True})
    assert world.value(("in", "mug", "hall")) is True
    world.update({("exists", "jar", "item"): True})
    reports.record(["clean"], {("clean", "jar"): True})
    assert world.value(("clean", "jar")) is True
    reports.record(["exists"], {("exists", "hall", "cup"): True})
    assert "hall" not in world.objects(("cup",))
    reports.close()


def test_a_fact_about_a_new_object_is_so_although_a_sensor_reports_such_facts() -> None:
    world = initial_knowledge(PROBLEM)
    world.sense(["in"])
    facts, _ = facts_in(["mug"], world)
    assert world.assumed(facts) == facts
    world.record(facts)
    assert world.assumed(facts_in(["mug"], world)[0]) == {}
