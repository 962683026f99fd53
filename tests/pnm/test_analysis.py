"""Nets as arrays and graphs say the same as the nets."""

from __future__ import annotations

from pathlib import Path
from random import Random

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.strategies import integers

from planner_bridge.planning.policies.net import PolicyNet
from planner_bridge.planning.policies.policy import policies
from pnm.analysis import arrays, read_pnml, to_networkx
from pnm.core.machine.plan_graph import flows, necessary
from pnm.core.net.net import NetBuilder, enabled, fire
from pnm.core.pictures.export import as_data
from pnm.core.pictures.pnml import to_pnml
from pnm.errors import InputError
from tests.support.pddl.chance import random_problem
from tests.support.runs.mutation.machines import random_machine


@settings(deadline=None, max_examples=60)
@given(integers(0, 10**6))
def test_the_state_equation_says_what_firing_leads_to(number: int) -> None:
    machine, random = random_machine(number), Random(number)
    found, marking, fired = arrays(machine), machine.initial, list[str]()
    for _ in range(30):
        ready = enabled(machine.net, marking)
        assert found.enabled(found.vector(marking)) == ready
        if not ready:
            break
        fired.append(random.choice(ready))
        marking = fire(machine.net, marking, fired[-1])
        assert found.marking(found.after(found.counts(fired))) == marking


@settings(deadline=None, max_examples=40)
@given(integers(0, 10**6))
def test_graphs_have_the_nodes_and_edges_of_what_they_are_of(number: int) -> None:
    machine = random_machine(number)
    net, plan = to_networkx(machine), to_networkx(machine.plan)
    kinds = nx.get_node_attributes(net, "kind")
    assert [node for node, kind in kinds.items() if kind == "place"] == [*machine.net.places]
    assert [node for node, kind in kinds.items() if kind == "transition"] == [*machine.net.transitions]
    assert {(a, b): data["weight"] for a, b, data in net.edges(data=True)} == {
        (one.source, one.target): one.weight for one in machine.net.arcs
    }
    assert [*plan] == [step.index for step in machine.plan.every_step]
    all_flows = (machine.plan.flow, *(flow for step in machine.plan.every_step for flow in flows(step)))
    assert plan.number_of_edges() == sum(len(necessary(flow)) for flow in all_flows)


def test_a_policy_is_a_graph_from_its_first_step_to_its_goal() -> None:
    found = ([*policies(random_problem(seed), 60.0)] for seed in range(20))
    whole = max((PolicyNet(each[-1].steps()) for each in found if each), key=lambda net: len(net.places))
    graph = to_networkx(whole)
    assert len(graph) == len(whole.net.places) + len(whole.net.transitions)
    assert all(nx.has_path(graph, place, "goal") for place, tokens in whole.initial.items() if tokens)


def test_arrays_that_no_memory_holds_are_refused() -> None:
    builder = NetBuilder()
    for number in range(10_001):
        builder.transition(f"t{number}", {builder.place(f"p{number}"): 1}, {})
    with pytest.raises(InputError, match="10001 places and 10001 transitions; expected"):
        arrays(builder.build())


def test_files_in_pnml_are_read(tmp_path: Path) -> None:
    machine, file = random_machine(5), tmp_path / "net.pnml"
    file.write_text(to_pnml(as_data(machine)), encoding="utf-8")
    assert np.array_equal(arrays(read_pnml(file)).incidence, arrays(machine).incidence)
    file.write_text("<pnml", encoding="utf-8")
    with pytest.raises(InputError, match=r"net\.pnml:1:\d+: not XML"):
        read_pnml(file)
