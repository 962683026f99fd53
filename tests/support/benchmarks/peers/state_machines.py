"""SMACH: states that check two facts before and an effect after, in a row, and concurrent ones, each in a thread of its own."""

from __future__ import annotations

import logging
from typing import Any

from tests.support.benchmarks.peers import worker


def _states(count: int) -> tuple[list[Any], dict[str, bool]]:
    import smach

    smach.set_loggers(*(lambda _: None for _ in range(3)), logging.getLogger("smach").error)
    known = worker.known(count)

    class Clean(smach.State):  # type: ignore[misc, name-defined]
        def __init__(self, robot: str) -> None:
            super().__init__(outcomes=["done", "failed"])
            self.ready, self.done = f"ready {robot}", f"done {robot}"

        def execute(self, _: object) -> str:
            if not (known.get(self.ready) and known.get("free kitchen")):
                return "failed"
            known[self.done] = True
            return "done" if known.get(self.done) else "failed"

    return [Clean(f"r{number}") for number in range(count)], known


def in_a_row(size: int) -> float:
    import smach

    states, known = _states(size)
    machine = smach.StateMachine(outcomes=["done", "failed"])
    with machine:
        for number, state in enumerate(states):
            smach.StateMachine.add(f"r{number}", state, {"done": f"r{number + 1}" if number + 1 < size else "done", "failed": "failed"})
    return worker.each_done(lambda: machine.execute(), size, known)


def parallel(size: int) -> float:
    import smach

    states, known = _states(size)
    together = smach.Concurrence(
        outcomes=["done", "failed"], default_outcome="failed", outcome_map={"done": {f"r{n}": "done" for n in range(size)}}
    )
    with together:
        for number, state in enumerate(states):
            smach.Concurrence.add(f"r{number}", state)
    return worker.each_done(lambda: together.execute(), size, known)
