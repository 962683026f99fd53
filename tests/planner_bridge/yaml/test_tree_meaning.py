"""Behaviour trees as plans: robots are told what BehaviorTree.CPP would tell them."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path
from uuid import UUID

from planner_bridge.pipeline.achieve import carry_out
from planner_bridge.yaml.trees import read_tree
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request


class Robots:
    """An action client. The mutable state is what robots were told, and which of them still work."""

    def __init__(self, failing: frozenset[str], results: Mapping[str, object]) -> None:
        self.told: list[str] = []
        self._failing = failing
        self._results = results
        self._working: dict[UUID, tuple[str, Reporter]] = {}

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return None

    def send(self, request: Request, report: Reporter, /) -> None:
        name, loop = request.action.name, asyncio.get_running_loop()
        self.told.append(" ".join((name, *(str(request.goal[one]) for one in request.action.parameters))))
        loop.call_soon(report, Accepted(request.id))
        if name == "Slow":  # until it is cancelled; a plan that waits for it sees it end at last
            self._working[request.id] = name, report
            for late, other in [(key, one[1]) for key, one in self._working.items() if one[0] == "Late"]:
                loop.call_soon(other, Ended(late, Outcome(OutcomeKind.ABORTED)))
            loop.call_later(10, self._end, request.id, OutcomeKind.SUCCEEDED)
            return
        if name == "Late":  # it fails when the slow one works
            self._working[request.id] = name, report
            return
        end = OutcomeKind.ABORTED if name in self._failing else OutcomeKind.SUCCEEDED
        loop.call_soon(report, Ended(request.id, Outcome(end, self._results)))

    def cancel(self, request: UUID, /) -> None:
        self.told.append(f"cancel {self._working[request][0]}")
        asyncio.get_running_loop().call_soon(self._end, request, OutcomeKind.CANCELED)

    def _end(self, request: UUID, kind: OutcomeKind) -> None:
        if request in self._working:
            self._working.pop(request)[1](Ended(request, Outcome(kind)))


def told(trees: str, folder: Path, failing: str = "", **results: object) -> tuple[bool, list[str]]:
    """Carry out trees; return whether the main one succeeds, and what robots are told."""
    file, robots = folder / "plan.yaml", Robots(frozenset(failing.split()), results)
    file.write_text(read_tree(f'<root BTCPP_format="4" main_tree_to_execute="M">{trees}</root>', "tree.xml"), encoding="utf-8")
    return carry_out(file, "M", actions=robots).goal_reached, robots.told


def tree(inside: str, name: str = "M") -> str:
    return f'<BehaviorTree ID="{name}">{inside}</BehaviorTree>'


def test_a_choice_of_two_nodes_fails_as_its_condition_does(tmp_path: Path) -> None:
    text = tree("<Sequence><IfThenElse><IsOpen/><Go to='a'/></IfThenElse><Take/></Sequence>")
    assert told(text, tmp_path) == (True, ["IsOpen", "Go a", "Take"])
    assert told(text, tmp_path, "IsOpen") == (False, ["IsOpen"])


def test_nodes_beside_one_that_fails_are_halted(tmp_path: Path) -> None:
    slow = tree("<Sequence><Slow/><Never/></Sequence>", "S")
    for other in ("<Slow/>", "<Sequence><Slow/><Never/></Sequence>", '<SubTree ID="S"/>', '<Fallback><SubTree ID="S"/><Never/></Fallback>'):
        text = tree(f"<Fallback><Parallel><Late/>{other}</Parallel><C/></Fallback>") + slow
        assert told(text, tmp_path) == (True, ["Late", "Slow", "cancel Slow", "C"]), other
    assert told(tree("<Parallel><Late/><Slow/></Parallel>"), tmp_path) == (False, ["Late", "Slow", "cancel Slow"])
