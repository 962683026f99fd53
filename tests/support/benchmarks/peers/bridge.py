"""UP-ESB, the plan executor of unified-planning: calls with two preconditions and an effect, checked before and after; and its graph."""

from __future__ import annotations

import logging
from typing import Any

from tests.support.benchmarks.peers.worker import each


class Robot:
    """One that is ready."""

    def __init__(self, name: str) -> None:
        self.name = name


class Room:
    """One that is free."""

    def __init__(self, name: str) -> None:
        self.name = name


def _bridge(calls: int) -> tuple[Any, Any, Any, set[str]]:
    """Return a bridge, a plan of calls that clean a room, its problem, and the names of the robots that are done."""
    from unified_planning.plans import ActionInstance, SequentialPlan
    from unified_planning.shortcuts import ObjectExp
    from up_esb import Bridge

    logging.disable(logging.CRITICAL)
    done: set[str] = set()

    def ready(robot: Robot) -> bool:
        return robot.name[0] == "r"

    def free(room: Room) -> bool:
        return room.name == "kitchen"

    def finished(robot: Robot) -> bool:
        return robot.name in done

    def clean(robot: Robot, room: Room) -> bool:
        done.add(robot.name)
        return True

    bridge = Bridge()
    bridge.create_types([Robot, Room])
    is_ready, is_finished = (bridge.create_fluent(one.__name__, _callable=one, robot=Robot) for one in (ready, finished))
    is_free = bridge.create_fluent("free", _callable=free, room=Room)
    kitchen = bridge.create_object("kitchen", Room("kitchen"))
    robots = [bridge.create_object(f"r{number}", Robot(f"r{number}")) for number in range(calls)]
    action, (robot, room) = bridge.create_action("clean", _callable=clean, robot=Robot, room=Room)
    action.add_precondition(is_ready(robot))
    action.add_precondition(is_free(room))
    action.add_effect(is_finished(robot), True)
    problem = bridge.define_problem(objects=[kitchen, *robots])
    plan = SequentialPlan([ActionInstance(action, (ObjectExp(one), ObjectExp(kitchen))) for one in robots])
    return bridge, plan, problem, done


def in_a_row(size: int) -> float:
    from up_esb.plexmo import PlanDispatcher

    bridge, plan, _, done = _bridge(size)
    graph, dispatcher = bridge.get_executable_graph(plan), PlanDispatcher()
    took = each(lambda: dispatcher.execute_plan(plan, graph, dry_run=False), size)
    assert len(done) == size
    return took


def graph(size: int) -> float:
    """Its graph of a plan, which is not proved."""
    bridge, plan, _, _ = _bridge(size)
    return each(lambda: bridge.get_executable_graph(plan), size)


def partial_order(size: int) -> float:
    """The partial order that unified-planning finds for the same plan."""
    from unified_planning.plans import PlanKind

    _, plan, problem, _ = _bridge(size)
    return each(lambda: plan.convert_to(PlanKind.PARTIAL_ORDER_PLAN, problem), size)
