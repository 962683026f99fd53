"""Hand-written plans among the tasks of a node: what they are given, and how others see what they do."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from io import StringIO
from pathlib import Path
from uuid import UUID

import pytest

from planner_bridge.cli.console import SafeConsole
from planner_bridge.cli.run_console import TaskConsole
from planner_bridge.pipeline.carry_out import carry_out
from planner_bridge.tasks.settings import Settings
from pnm.actions.faults import NO_FAULTS, Fault, FaultKind, Faults
from pnm.core.machine.bindings import Binding, Bindings
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.language.plan import HandWrittenPlan, parse_plans
from pnm.language.runner import Program
from pnm.tasks import Code, TaskListener
from tests.support.pddl.problems import fleet
from tests.support.tasks.simulation import TaskSimulation, simulate_tasks

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


def simulate_trip(scenario: Callable[[TaskSimulation], Awaitable[None]]) -> None:
    programs = {name: Program.of(plan) for name, plan in parse_plans(TRIP).items()}
    simulate_tasks(scenario, chosen=Settings(), programs=programs)


def test_a_plan_whose_parameter_has_no_value_is_refused_before_anything_of_it_begins() -> None:
    async def scenario(simulation: TaskSimulation) -> None:
        task = simulation.want("trip", is_plan=True)
        assert await simulation.ended_with(task) == [Code.INVALID_GOAL]
        assert simulation.endings[task].message.startswith("trip needs a value for its parameter 'robot'; expected {robot: …} among")
        assert simulation.sent(task) == []

    simulate_trip(scenario)


def test_the_steps_of_a_plan_have_the_values_that_are_known() -> None:
    async def scenario(simulation: TaskSimulation) -> None:
        task = simulation.want("trip", is_plan=True, parameters={"robot": "r0"})
        await simulation.sees(task, "sent")
        assert [str(step) for step in simulation.master.plan(task)[1]] == ["move(r0, a0, a1)", "move(r0, a1, ?to)"]
        run = simulation.runner.going_on[0].executor.run
        run.knowledge.local.store({"far": "a3", "home": "a0"})
        assert [str(step) for step in simulation.master.plan(task)[1]] == ["move(r0, a0, a1)", "move(r0, a3, a0)"]
        run.knowledge.local.store({"far": "a1"})
        assert await simulation.ended_with(task) == [Code.GOAL_REACHED], simulation.endings[task]

    simulate_trip(scenario)


def test_people_read_with_which_parameters_a_plan_is_carried_out() -> None:
    shown = StringIO()

    async def scenario(simulation: TaskSimulation) -> None:
        simulation.master.listen(TaskConsole(SafeConsole(file=shown, width=200)))
        one = simulation.want("trip", is_plan=True, parameters={"robot": "r0", "far": ["a1", 2]})
        other, goal = simulation.want("trip", is_plan=True), simulation.want("(at r0 a0)")
        await simulation.ended_with(one, other, goal)

    simulate_trip(scenario)
    goals = [line.split("goal", 1)[1].strip() for line in shown.getvalue().splitlines() if "  goal  " in line]
    assert goals == ['trip(robot: r0, far: ["a1", 2])', "trip", "(at r0 a0)"]


def test_what_goals_are_and_why_calls_have_failed_is_said_once() -> None:
    shown = StringIO()

    async def scenario(simulation: TaskSimulation) -> None:
        simulation.master.listen(TaskConsole(SafeConsole(file=shown, width=200)))
        await simulation.ended_with(simulation.want("(at r0 nowhere)"), simulation.want("(at r0 a1)"))

    simulate_tasks(scenario, chosen=Settings(), faults=Faults((Fault("move(r0, a0, a1)", FaultKind.ABORT, times=2, message="no way"),)))
    said = [line.split("  ")[-1].strip() for line in shown.getvalue().splitlines() if "  goal  " in line or "  failed  " in line]
    assert said == ["(at r0 nowhere)", "(at r0 a1)", "move(r0, a0, a1)#0: it is not tried again in this plan"]
    assert shown.getvalue().count("no way") == 2, "once for each attempt"


def test_goals_share_resources_with_the_capacities_that_plans_give_them() -> None:
    plan = HandWrittenPlan(
        "spare", PlanGraph((ActionCall(0, GroundAction("move", resources=("lift",))),), capacities={"lift": 2}), Bindings()
    )
    chosen = Settings(bindings=Bindings({"move": Binding(resources=("lift",))}))

    async def scenario(simulation: TaskSimulation) -> None:
        simulation.backend.robots.capacities = {"lift": 2}
        task = simulation.want("(and (at r0 a1) (at r1 a2) (at r2 a3))")
        await simulation.reaches(task)
        first, second, third = (one.time for one in simulation.seen(task, "sent", "move"))
        assert first == second < third

    simulate_tasks(scenario, fleet(robots=3), chosen=chosen, programs={"spare": Program.of(plan)})


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


def simulate_tour(scenario: Callable[[TaskSimulation], Awaitable[None]], faults: Faults = NO_FAULTS) -> None:
    programs = {name: Program.of(plan) for name, plan in parse_plans(TOUR).items()}
    simulate_tasks(scenario, chosen=Settings(), programs=programs, faults=faults)


def test_calls_and_restarts_of_a_plan_are_counted_and_told() -> None:
    async def scenario(simulation: TaskSimulation) -> None:
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

    simulate_tour(scenario, Faults((Fault("go(b)", FaultKind.ABORT, times=1),)))


def test_a_pause_does_not_use_up_the_time_of_a_plan() -> None:
    async def scenario(simulation: TaskSimulation) -> None:
        task = await simulation.begun("short", is_plan=True)
        await simulation.master.pause(task, at_once=True)
        await asyncio.sleep(100.0)
        await simulation.master.resume(task)
        await simulation.reaches(task)

    simulate_tour(scenario)


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


def test_facts_change_by_themselves_for_a_plan_of_a_node_as_well() -> None:
    (plan,) = parse_plans(TIDE).values()

    async def scenario(simulation: TaskSimulation) -> None:
        task = simulation.want("beach", is_plan=True)
        assert await simulation.ended_with(task) == [Code.GOAL_REACHED], simulation.endings[task]

    simulate_tasks(scenario, chosen=Settings(), programs={"beach": Program.of(plan)})
