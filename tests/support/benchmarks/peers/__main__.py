"""The worker of the peers, run by the Python of their virtual environment: `python -m tests.support.benchmarks.peers`."""

from __future__ import annotations

from tests.support.benchmarks.peers import bridge, nets, state_machines, trees
from tests.support.benchmarks.peers.worker import Measure, serve

MEASURES: dict[str, Measure] = {
    "snakes-chain": nets.snakes_chain,
    "snakes-fork": nets.snakes_fork,
    "pm4py-chain": nets.pm4py_chain,
    "pm4py-fork": nets.pm4py_fork,
    "esb-row": bridge.in_a_row,
    "esb-graph": bridge.graph,
    "up-partial-order": bridge.partial_order,
    "trees-row": trees.in_a_row,
    "trees-running": trees.running,
    "trees-parallel": trees.parallel,
    "smach-row": state_machines.in_a_row,
    "smach-parallel": state_machines.parallel,
}

if __name__ == "__main__":
    serve(MEASURES)
