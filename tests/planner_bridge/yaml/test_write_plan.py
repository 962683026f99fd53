"""Plans as steps: blocks where their order is series-parallel, lists of what steps wait for where it is not."""

from __future__ import annotations

from dataclasses import replace

import pytest
import yaml
from hypothesis import given, strategies as st

from planner_bridge.model.plan import Plan, PlanStep
from planner_bridge.ordering.plan_to_graph import plan_graph
from planner_bridge.yaml.writer import Block, Mesh, Parallel, Series, blocks, plan_entries, write_problem, written
from pnm.core.machine.plan_graph import ActionCall, Junction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.net.net import reduced
from pnm.language.plan import read_plans
from tests.support.pddl.problems import matches, rooms


def closed(edges: set[tuple[int, int]]) -> set[tuple[int, int]]:
    found = set(edges)
    while more := {(a, d) for a, b in found for c, d in edges if b == c} - found:
        found |= more
    return found


@pytest.mark.parametrize(
    ("size", "edges", "block"),
    [
        (1, [], 0),
        (3, [(0, 1), (1, 2), (0, 2)], Series((0, 1, 2))),
        (2, [], Parallel((0, 1))),
        (4, [(0, 1), (0, 2), (1, 3), (2, 3)], Series((0, Parallel((1, 2)), 3))),
        (4, [(0, 2), (0, 3), (1, 2), (1, 3)], Series((Parallel((0, 1)), Parallel((2, 3))))),
        (4, [(0, 2), (1, 2), (1, 3)], Mesh({0: (), 1: (), 2: (0, 1), 3: (1,)})),
        (5, [(0, 2), (1, 2), (1, 3)], Parallel((Mesh({0: (), 1: (), 2: (0, 1), 3: (1,)}), 4))),
    ],
)
def test_blocks(size: int, edges: list[tuple[int, int]], block: Block) -> None:
    assert blocks(reduced(size, edges)) == block


def moving(robot: str, start: str, end: str) -> PlanStep:
    return PlanStep("move", (robot, start, end))


def steps(graph: PlanGraph, problem: object) -> object:
    return yaml.safe_load(written(plan_entries(graph, problem.domain)))["plan"]  # type: ignore[attr-defined]


def test_a_sequence_and_what_is_beside_it() -> None:
    problem = rooms()
    plan = Plan((moving("r1", "a", "b"), moving("r2", "a", "d"), moving("r1", "b", "c"), moving("r2", "d", "c")))
    text = written(plan_entries(plan_graph(problem, plan), problem.domain))
    assert text == (
        "\n"
        "plan:\n"
        "  - concurrent_actions:\n"
        "      - sequence:\n"
        "          - move: {r: r1, a: a, b: b}\n"
        "          - move: {r: r1, a: b, b: c}\n"
        "      - sequence:\n"
        "          - move: {r: r2, a: a, b: d}\n"
        "          - move: {r: r2, a: d, b: c}\n"
    )


def test_nothing_to_do() -> None:
    assert steps(PlanGraph(()), rooms()) == []


def order_of(graph: PlanGraph) -> set[tuple[int, int]]:
    """Which call comes before which, whatever meets in between."""
    edges = {(one.before.call, one.after.call) for one in graph.orderings}
    kept = {step.index for step in graph.steps if not isinstance(step, Junction)}
    return {(a, b) for a, b in closed(edges) if a in kept and b in kept}


ORDERS = st.sets(st.tuples(st.integers(0, 5), st.integers(0, 5)).filter(lambda edge: edge[0] < edge[1]), max_size=7)
PLACES = ("ab", "bc", "ad", "dc", "ba", "cb")


@given(ORDERS)
def test_the_language_reads_the_same_order(tmp_path_factory: pytest.TempPathFactory, edges: set[tuple[int, int]]) -> None:
    problem = rooms()
    graph = plan_graph(problem, Plan(tuple(moving("r1", *places) for places in PLACES)))
    orderings = tuple(Ordering(PlanEvent(a, Moment.END), PlanEvent(b, Moment.START)) for a, b in sorted(edges))
    graph = replace(graph, orderings=orderings)
    file = tmp_path_factory.getbasetemp() / "plan.yaml"
    file.write_text(write_problem(problem, plan=plan_entries(graph, problem.domain)), encoding="utf-8")
    (found,) = read_plans(file).values()
    assert len(found.graph.calls) == len(PLACES)
    assert shape(found.graph) == shape(graph)
    assert str(found.goal) == str(problem.goal)


def shape(graph: PlanGraph) -> list[tuple[str, str]]:
    return sorted((str(graph.calls[a].action), str(graph.calls[b].action)) for a, b in order_of(graph))


def test_starts_and_ends_that_wait_are_said() -> None:
    problem = matches(1)
    plan = Plan((PlanStep("strike", ("m0",), 0.0, 8.0), PlanStep("mend", ("f0", "m0"), 0.001, 5.0)), temporal=True)
    assert steps(plan_graph(problem, plan), problem) == [
        {"strike": {"m": "m0"}, "id": "strike", "after": [], "end_after": ["mend"]},
        {"mend": {"f": "f0", "m": "m0"}, "id": "mend", "after": [{"start": "strike"}]},
    ]


def test_times_are_said() -> None:
    problem = rooms()
    graph = plan_graph(problem, Plan((moving("r1", "a", "b"),)))
    (call,) = graph.calls
    assert isinstance(call, ActionCall)
    late = replace(graph, steps=(replace(call, release=2.5, deadline=9.0),))
    assert steps(late, problem) == [{"move": {"r": "r1", "a": "a", "b": "b"}, "after": [], "release": 2.5, "deadline": 9}]
