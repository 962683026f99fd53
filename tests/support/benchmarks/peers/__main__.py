"""The worker of the peers, run by the Python of their virtual environment: `python -m tests.support.benchmarks.peers`."""

from __future__ import annotations

from functools import partial

from tests.support.benchmarks.peers import bridge, nets, state_machines, trees
from tests.support.benchmarks.peers.worker import Measure, serve

MEASURES: dict[str, Measure] = {
    "snakes-chain": partial(nets.snakes, nets.chain),
    "snakes-fork": partial(nets.snakes, nets.fork_join),
    "pm4py-chain": partial(nets.pm4py, nets.chain),
    "pm4py-fork": partial(nets.pm4py, nets.fork_join),
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
