"""The worker of this project and of plain Python: `python -m tests.support.benchmarks.executives.ours`."""

from __future__ import annotations

from pnm.clock import short_pauses
from tests.support.benchmarks.executives import calls, plans, tasks
from tests.support.benchmarks.peers.worker import serve

if __name__ == "__main__":
    with short_pauses():  # as in every process of ours
        serve(calls.MEASURES | plans.MEASURES | tasks.MEASURES)
