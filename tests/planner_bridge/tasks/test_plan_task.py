"""Hand-written plans among the tasks of a node: what comes in and goes out with a goal, and how others see what they do."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from io import StringIO
from pathlib import Path
from uuid import UUID

import pytest
from hypothesis import given, strategies as st

from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.run_console import TaskConsole
from planner_bridge.model.grounding import initial_knowledge
from planner_bridge.pipeline.achieve import carry_out
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.core.net.block_net import BlockNet
from pnm.errors import InputError
from pnm.language.plan import HandWrittenPlan, parse_plans, read_plans
from pnm.language.runner import Program
from pnm.ros.tasks.executor_topics import read_parameters, result_fields
from pnm.tasks import Code, TaskListener
from tests.support.pddl.problems import fleet
from tests.support.tasks.node import simulated
from tests.support.tasks.simulation import TaskSimulation

TRIP = """
actions:
  move: {params: [r, from, to], duration: 1}
trip:
  params: [robot, far]
  initial_knowledge: {far: a1}
  plan:
    - move: {r: {LocalQuery: robot}, from: a0, to: {LocalQuery: far}}
    - move: {r: {LocalQuery: robot}, from: {LocalQuery: far}, to: {LocalQuery: home}}
"""


def loaded(text: str, faults: Faults = NO_FAULTS) -> Callable[..., Callable[..., None]]:
    """Run a test with the tasks of a node that has loaded these plans, in simulation."""
    programs = {name: Program.of(plan) for name, plan in parse_plans(text).items()}
    return simulated(chosen=Settings(), programs=programs, faults=faults)


@loaded(TRIP)
async def test_a_plan_whose_parameter_has_no_value_is_refused_before_anything_of_it_begins(simulation: TaskSimulation) -> None:
    task = simulation.want("trip", is_plan=True)
    assert await simulation.ended_with(task) == [Code.INVALID_GOAL]
    assert simulation.endings[task].message.startswith("trip needs a value for its parameter 'robot'; expected {robot: …} among")
    assert simulation.sent(task) == []


@loaded(TRIP)
async def test_the_steps_of_a_plan_have_the_values_that_are_known(simulation: TaskSimulation) -> None:
    task = simulation.want("trip", is_plan=True, parameters={"robot": "r0"})
    await simulation.sees(task, "sent")
    assert [str(step) for step in simulation.master.plan(task)[1]] == ["move(r0, a0, a1)", "move(r0, a1, ?to)"]
    run = simulation.runner.going_on[0].run
    run.knowledge.local.store({"far": "a3", "home": "a0"})
    assert [str(step) for step in simulation.master.plan(task)[1]] == ["move(r0, a0, a1)", "move(r0, a3, a0)"]
    run.knowledge.local.store({"far": "a1"})
    assert await simulation.ended_with(task) == [Code.GOAL_REACHED], simulation.endings[task]


def shown(simulation: TaskSimulation) -> StringIO:
    """Return what people read of the tasks from now on."""
    file = StringIO()
    simulation.master.listen(TaskConsole(SafeConsole(file=file, width=200)))
    return file


@loaded(TRIP)
async def test_people_read_with_which_parameters_a_plan_is_carried_out(simulation: TaskSimulation) -> None:
    seen = shown(simulation)
    one = simulation.want("trip", is_plan=True, parameters={"robot": "r0", "far": ["a1", 2]})
    other, goal = simulation.want("trip", is_plan=True), simulation.want("(at r0 a0)")
    await simulation.ended_with(one, other, goal)
    goals = [line.split("goal", 1)[1].strip() for line in seen.getvalue().splitlines() if "  goal  " in line]
    assert goals == ['trip(robot: r0, far: ["a1", 2])', "trip", "(at r0 a0)"]


@simulated(chosen=Settings(), faults=Faults((Fault("move(r0, a0, a1)", FaultKind.ABORT, times=2, message="no way"),)))
async def test_what_goals_are_and_why_calls_have_failed_is_said_once(simulation: TaskSimulation) -> None:
    seen = shown(simulation)
    await simulation.ended_with(simulation.want("(at r0 nowhere)"), simulation.want("(at r0 a1)"))
    said = [line.split("  ")[-1].strip() for line in seen.getvalue().splitlines() if "  goal  " in line or "  failed  " in line]
    assert said == ["(at r0 nowhere)", "(at r0 a1)", "move(r0, a0, a1)#0: it is not tried again in this plan"]
    assert seen.getvalue().count("no way") == 2, "once for each attempt"


LIFT = ActionCall(0, GroundAction("move", resources=("lift",)))
SPARE = HandWrittenPlan("spare", PlanGraph((LIFT,), capacities={"lift": 2}), Bindings())
NEEDS_LIFT = Settings(bindings=Bindings({"move": Binding(resources=("lift",))}))


@simulated(fleet(robots=3), chosen=NEEDS_LIFT, programs={"spare": Program.of(SPARE)})
async def test_goals_share_resources_with_the_capacities_that_plans_give_them(simulation: TaskSimulation) -> None:
    simulation.backend.robots.capacities = {"lift": 2}
    task = simulation.want("(and (at r0 a1) (at r1 a2) (at r2 a3))")
    await simulation.reaches(task)
    first, second, third = (one.time for one in simulation.seen(task, "sent", "move"))
    assert first == second < third


TOUR = """
actions: {go: {params: [place], duration: 5}}
tour:
  restarts: 2
  results: [n]
  initial_knowledge: {n: 3}
  plan:
    - go: {place: a}
    - go: {place: b}
      recoveries: {during: {aborted: restart_plan}}
short:
  timeout: 20
  plan: [go: {place: a}, go: {place: b}]
"""


@loaded(TOUR, Faults((Fault("go(b)", FaultKind.ABORT, times=1),)))
async def test_calls_and_restarts_of_a_plan_are_counted_and_told(simulation: TaskSimulation) -> None:
    statuses = list[tuple[int, int, tuple[str, ...]]]()

    class Counts(TaskListener):
        def changed(self, task: UUID) -> None:
            (status,) = simulation.master.status()
            statuses.append((status.ended, status.restarts, status.running))

    simulation.master.listen(Counts())
    task = simulation.want("tour", is_plan=True)
    await simulation.reaches(task)
    assert (simulation.endings[task].results, simulation.endings[task].cause) == ({"n": 3}, "")
    assert list(dict.fromkeys(one[:2] for one in statuses)) == [(0, 0), (1, 0), (2, 0), (2, 1), (3, 1), (4, 1)]
    assert {running for *_, running in statuses} == {(), ("go(a)",), ("go(b)",)}


def test_of_transitions_that_nobody_asks_about_no_names_are_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file, named = tmp_path / "plan.yaml", list[int]()
    file.write_text("actions: {act: {}}\nplan: [act: {}, act: {}]\n")
    monkeypatch.setattr(BlockNet, "transition_name", lambda net, transition: named.append(transition) or "")
    assert carry_out(file).goal_reached
    assert not named


@loaded(TOUR)
async def test_a_pause_does_not_use_up_the_time_of_a_plan(simulation: TaskSimulation) -> None:
    task = await simulation.begun("short", is_plan=True)
    await simulation.master.pause(task, at_once=True)
    await asyncio.sleep(100.0)
    await simulation.master.resume(task)
    await simulation.reaches(task)


SHOP = """
requirements: [durative-actions, timed-initial-literals]
predicates: [(open), (bought), (ready)]
actions:
  knock: {duration: %d, effects: {at_end: [(ready)]}}
  buy: {duration: 3, preconditions: {over_all: [(open)]}, effects: {at_end: [(bought)]}}
problem:
  init: [{at: 10, facts: [(open)]}, {at: 20, facts: [(not (open))]}]
  goal: (bought)
plan:
  - knock: {}
    recoveries: {during: {aborted: [replan]}}
  - buy: {}
"""


@pytest.mark.parametrize(("duration", "bought"), [(2, [10.0]), (38, [])])
def test_a_planner_that_takes_over_knows_which_facts_are_still_to_change_by_themselves(
    duration: int, bought: list[float], tmp_path: Path
) -> None:
    file = tmp_path / "shop.yaml"
    file.write_text(SHOP % duration)
    result = carry_out(file, faults=Faults((Fault("knock", FaultKind.ABORT),)))
    assert result.goal_reached is bool(bought), result.reason
    assert [call.started for call in result.calls if call.call.action.name == "buy" and call.outcome == "succeeded"] == bought


TIDE = """
predicates: [(tide), (wet)]
actions: {wave: {duration: 1, effects: [(wet)]}}
problem: {init: [{at: 5, facts: [(tide)]}], goal: [(tide), (wet)]}
plan: [wave: ]
"""


@simulated(chosen=Settings(), programs={"beach": Program.of(*parse_plans(TIDE).values())})
async def test_facts_change_by_themselves_for_a_plan_of_a_node_as_well(simulation: TaskSimulation) -> None:
    task = simulation.want("beach", is_plan=True)
    assert await simulation.ended_with(task) == [Code.GOAL_REACHED], simulation.endings[task]


# --- what comes in with a goal, and what goes out ---


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("3", "expected a mapping such as {shop: bakery} as parameters, found '3'"),
        ("[a]", "expected a mapping such as {shop: bakery} as parameters, found '[a]'"),
        ("shop", "expected a mapping"),
        ("{shop: bakery", "parameters:1:"),
        ("{a: 1}\n---\n{b: 2}\n", "parameters:3:1: a second document begins here"),
        ("{a: 1, a: 2}", "parameters:1:8: "),
        ("? [a]\n: 1", "parameters:1:"),
        ("a: !!python/name:os.system", "parameters:1:4: "),
        ("[" * 100_000, "parameters:1:"),
        ("{a: &a [1], b: &b [*a, *a, *a], c: [*b, *b, *b, *d]}", "parameters:1:"),
    ],
    ids=lambda value: value[:20],
)
def test_what_is_no_mapping_is_no_parameters(text: str, said: str) -> None:
    with pytest.raises(InputError) as error:
        read_parameters(text)
    assert said in str(error.value)


@pytest.mark.parametrize("text", ["", "  \n", "{}"])
def test_nothing_is_no_parameters(text: str) -> None:
    assert read_parameters(text) == {}


def test_yaml_will_do() -> None:
    assert read_parameters("shop: bakery\nfloors: [1, 2.5]\nopen: true\n") == {"shop": "bakery", "floors": [1, 2.5], "open": True}


@given(st.dictionaries(st.text(), JSON, max_size=4))
def test_parameters_written_as_json_come_in_as_they_were(parameters: dict[str, object]) -> None:
    assert read_parameters(json.dumps(parameters)) == parameters


@given(st.dictionaries(st.text(), JSON, max_size=4))
def test_results_are_json(results: dict[str, object]) -> None:
    fields = result_fields(True, "goal", "done", results)
    assert json.loads(str(fields["results"])) == results
    assert fields["message"] == "done"


def test_a_result_that_json_cannot_say_is_told_of() -> None:
    fields = result_fields(True, "goal", "done\x1b", {"a": float("nan"), "b": 1})
    assert fields["results"] == '{"b": 1}'
    assert str(fields["message"]).startswith("done\N{REPLACEMENT CHARACTER}; a is left out: JSON cannot say nan")


def test_a_world_begins_as_all_of_its_plans_say(tmp_path: Path) -> None:
    file = tmp_path / "plan.yaml"
    file.write_text("one: {facts: [(open door1)], plan: []}\ntwo: {facts: [(open door1), (= (n) 2)], plan: []}\n")
    assert initial_knowledge(*read_plans(file).values()).facts() == {("open", "door1"): True, ("n",): 2.0}
    file.write_text("one: {facts: [(open door1)], plan: []}\ntwo: {facts: [(not (open door1))], plan: []}\n")
    with pytest.raises(InputError, match=r"one and two begin with different values of \(open door1\): True, False"):
        initial_knowledge(*read_plans(file).values())
