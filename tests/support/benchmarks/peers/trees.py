"""py_trees: leaves that check two facts before and an effect after, in a sequence and in parallel."""

from __future__ import annotations

from typing import Any

from tests.support.benchmarks.peers import worker


def _leaves(count: int, ticks: int) -> tuple[list[Any], dict[str, bool]]:
    """Return leaves that are running for so many ticks before they succeed, and what they know."""
    import py_trees

    known = worker.known(count)

    class Clean(py_trees.behaviour.Behaviour):  # type: ignore[misc, name-defined]
        def __init__(self, robot: str) -> None:
            super().__init__(robot)
            self.robot, self.ready, self.done, self.left = robot, f"ready {robot}", f"done {robot}", ticks

        def update(self) -> Any:
            if self.left == ticks and not (known.get(self.ready) and known.get("free kitchen")):
                return py_trees.common.Status.FAILURE
            if self.left:
                self.left -= 1
                return py_trees.common.Status.RUNNING
            known[self.done] = True
            return py_trees.common.Status.SUCCESS if known.get(self.done) else py_trees.common.Status.FAILURE

    return [Clean(f"r{number}") for number in range(count)], known


def in_a_row(size: int) -> float:
    return _sequence(size, 0)


def running(size: int) -> float:
    """The same with leaves that run for one tick each, as an action of a robot does: every tick looks at all that went before."""
    return _sequence(size, 1)


def _sequence(size: int, ticks: int) -> float:
    import py_trees

    leaves, known = _leaves(size, ticks)
    root = py_trees.composites.Sequence("root", memory=True, children=leaves)
    return worker.each_done(lambda: _tick(root), size, known)


def parallel(size: int) -> float:
    import py_trees

    leaves, known = _leaves(size, 1)
    root = py_trees.composites.Parallel("root", policy=py_trees.common.ParallelPolicy.SuccessOnAll(), children=leaves)
    return worker.each_done(lambda: _tick(root), size, known)


def _tick(root: Any) -> None:
    import py_trees

    root.tick_once()
    while root.status is py_trees.common.Status.RUNNING:
        root.tick_once()
