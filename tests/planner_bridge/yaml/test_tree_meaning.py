"""Behaviour trees as plans: robots are told what BehaviorTree.CPP would tell them."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Final
from uuid import UUID

import pytest
from click.testing import CliRunner

from planner_bridge.cli.convert import from_yaml
from planner_bridge.pipeline.achieve import carry_out
from planner_bridge.yaml.trees import Tree, plan_tree, read_tree
from pnm.core.logic.conditions import TRUE
from pnm.core.machine.plan_graph import ActionCall, GroundAction, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.errors import InputError
from pnm.language.plan import read_plans


def told_as(value: object) -> str:
    """Return a value as it is written here: a word as it is, and what might be no text as it is in Python."""
    return value if isinstance(value, str) and value[0].isalpha() else repr(value)


class Robots:
    """An action client. The mutable state is what robots were told, and which of them still work."""

    def __init__(self, failing: frozenset[str]) -> None:
        self.told: list[str] = []
        self._failing = failing
        self._working: dict[UUID, tuple[str, Reporter]] = {}

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return None

    def send(self, request: Request, report: Reporter, /) -> None:
        name, loop = request.action.name, asyncio.get_running_loop()
        self.told.append(" ".join((name, *(told_as(request.goal[one]) for one in request.action.parameters))))
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
        loop.call_soon(report, Ended(request.id, Outcome(end, {"where": f"place{len(self.told)}"})))

    def cancel(self, request: UUID, /) -> None:
        self.told.append(f"cancel {self._working[request][0]}")
        asyncio.get_running_loop().call_soon(self._end, request, OutcomeKind.CANCELED)

    def _end(self, request: UUID, kind: OutcomeKind) -> None:
        if request in self._working:
            self._working.pop(request)[1](Ended(request, Outcome(kind)))


def told(trees: str, folder: Path, failing: str = "") -> tuple[bool, list[str]]:
    """Carry out trees; return whether the main one succeeds, and what robots are told."""
    file, robots = folder / "plan.yaml", Robots(frozenset(failing.split()))
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


MODEL: Final = """<TreeNodesModel><Action ID="Find"><output_port name="where"/></Action><Action ID="Go"><input_port name="to"/></Action>
<Action ID="B"/></TreeNodesModel>"""


def test_what_a_tree_stores_is_that_of_its_caller_under_the_callers_name(tmp_path: Path) -> None:
    inner = tree('<Sequence><Find where="{pose}"/><Go to="{pose}"/></Sequence>', "S") + MODEL
    text = tree('<Sequence><SubTree ID="S" pose="{y}"/><Go to="{y}"/></Sequence>') + inner
    assert told(text, tmp_path) == (True, ["Find", "Go place1", "Go place1"])
    text = tree('<SubTree ID="T" pose="{y}"/>') + tree('<Sequence><SubTree ID="S" pose="{x}"/><Go to="{x}"/></Sequence>', "T") + inner
    assert told(text, tmp_path) == (True, ["Find", "Go place1", "Go place1"])
    again = tree('<RetryUntilSuccessful num_attempts="2"><SubTree ID="S" pose="{y}"/></RetryUntilSuccessful>')
    assert told(again + inner, tmp_path) == (True, ["Find", "Go place1"])


def test_a_tree_keeps_what_its_caller_does_not_ask_for(tmp_path: Path) -> None:
    """A variable of another tree has nothing to do with one that has the same name."""
    text = tree('<Sequence><Find where="{pose}"/><SubTree ID="S"/><Go to="{pose}"/></Sequence>')
    inner = tree('<Sequence><Look where="{pose}"/></Sequence>', "S")
    model = MODEL.replace('<Action ID="B"/>', '<Action ID="Look"><output_port name="where"/></Action>')
    robots = read_tree(f'<root BTCPP_format="4" main_tree_to_execute="M">{text}{inner}{model}</root>', "tree.xml")
    assert told(text + inner + model, tmp_path)[1] == ["Find", "Look", "Go place1"], robots


def test_a_variable_that_is_made_inside_is_not_demanded_from_outside(tmp_path: Path) -> None:
    part = '<RetryUntilSuccessful num_attempts="2"><Sequence><Go to="{x}"/><B/></Sequence></RetryUntilSuccessful>'
    text = tree('<SubTree ID="S"/>') + tree(f'<Sequence><Find where="{{x}}"/>{part}</Sequence>', "S") + MODEL
    assert told(text, tmp_path) == (True, ["Find", "Go place1", "B"])


def test_a_port_that_is_asked_and_told_is_refused(tmp_path: Path) -> None:
    model = '<TreeNodesModel><Action ID="Inc">\n<inout_port name="val"/></Action></TreeNodesModel>'
    with pytest.raises(InputError, match=r"tree.xml:2:1: 'val' of 'Inc' is an inout_port"):
        told(tree('<Inc val="{n}"/>') + model, tmp_path)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        (tree("<A/>") + "\n" + tree("<B/>"), "tree.xml:2:1: there are two trees 'M'; the other one is at tree.xml:1:"),
        ('\n<include path="other.xml"/>' + tree("<A/>"), "tree.xml:2:1: <include> is not read here; expected a <BehaviorTree>"),
        (tree("<A/>") + "\n" + tree("<B/>", "keep"), "tree.xml:2:1: a tree cannot be called 'keep': it is a word of the language"),
        (tree("<A/>") + "\n" + tree("<B/>", "if"), "tree.xml:2:1: a tree cannot be called 'if'"),
        (tree("<A/>") + "\n" + tree("<B/>", "actions"), "tree.xml:2:1: a tree cannot be called 'actions'"),
        (tree("<A/>") + "\n" + tree("<Inverter><B/></Inverter>", "N").replace(">", ">\n", 1), "tree.xml:3:1: <Inverter> is not read"),
    ],
)
def test_no_tree_is_left_out_silently(text: str, error: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        told(text, tmp_path)
    assert str(caught.value).startswith(error)


def test_a_tree_that_none_calls_is_a_plan_too() -> None:
    text = read_tree(f'<root BTCPP_format="4" main_tree_to_execute="M">{tree("<B/>", "A")}{tree("<C/>")}</root>', "tree.xml")
    assert text.index("\nM:") < text.index("\nA:")


def test_ports_that_are_not_given_have_their_defaults(tmp_path: Path) -> None:
    model = """<TreeNodesModel><Action ID="Go"><input_port name="to" default="dock"/></Action>
      <SubTree ID="S"><input_port name="place" default="hall"/></SubTree></TreeNodesModel>"""
    text = tree('<Sequence><Go/><Go to="shop"/><SubTree ID="S"/></Sequence>') + tree('<Go to="{place}"/>', "S") + model
    assert told(text, tmp_path) == (True, ["Go dock", "Go shop", "Go hall"])


def test_a_tree_is_one_in_capitals_as_well(tmp_path: Path) -> None:
    (tmp_path / "M.XML").write_text(f'<root BTCPP_format="4">{tree("<A/>")}</root>', encoding="utf-8")
    assert CliRunner().invoke(from_yaml, [str(tmp_path / "M.XML"), "-o", str(tmp_path / "plans")]).exit_code == 0
    assert (tmp_path / "plans/plan.yaml").is_file()


@pytest.mark.parametrize("text", ["010", "00123", "-01", "1_0", "0x10", "12:30:00", "null", "yes", "~", "١٢", "1e3", "+1", ".5", "5."])
def test_what_looks_like_a_number_to_yaml_is_the_text_that_it_is(text: str, tmp_path: Path) -> None:
    assert told(tree(f'<A code="{text}"/>'), tmp_path) == (True, [f"A {told_as(text)}"])


@pytest.mark.parametrize(("text", "number"), [("0", 0), ("-12", -12), ("1.5", 1.5), ("0.25", 0.25)])
def test_numbers_are_numbers(text: str, number: float, tmp_path: Path) -> None:
    assert told(tree(f'<A code="{text}"/>'), tmp_path) == (True, [f"A {number!r}"])


def written(plan: str, folder: Path) -> Tree:
    """Return a plan by hand as a tree."""
    (folder / "plan.yaml").write_text(plan, encoding="utf-8")
    (read,) = read_plans(folder / "plan.yaml").values()
    return plan_tree(read.graph)


def test_a_text_in_braces_is_a_loss() -> None:
    call = ActionCall(0, GroundAction("say", ("{name}",), ("text",)))
    assert [lost for lost in plan_tree(PlanGraph((call,), (), TRUE)).lost if "texts in braces" in lost]
    call = ActionCall(0, GroundAction("say", ("{name",), ("text",)))
    assert not [lost for lost in plan_tree(PlanGraph((call,), (), TRUE)).lost if "texts in braces" in lost]


@pytest.mark.parametrize(("seconds", "msec"), [("0.0001", "1"), ("0.0015", "2"), ("16.1", "16100"), ("8.2", "8200"), ("2", "2000")])
def test_a_limit_is_never_none(seconds: str, msec: str, tmp_path: Path) -> None:
    """BehaviorTree.CPP has no limit where a node says 0 milliseconds."""
    assert f'msec="{msec}"' in written(f"actions: {{say: }}\nplan:\n  - say:\n    timeout: {seconds}\n", tmp_path).text
    waiting = f"plan:\n  - wait_until: {{condition: {{Comparison: [eq, [1, 1]]}}, limit: {seconds}}}\n"
    assert f'msec="{msec}"' in written(waiting, tmp_path).text


@pytest.mark.parametrize("msec", ["1", "1234567", "1000000000"])
def test_a_limit_is_read_to_the_millisecond(msec: str, tmp_path: Path) -> None:
    text = read_tree(f'<root BTCPP_format="4">{tree(f"<Timeout msec={msec!r}><A/></Timeout>")}</root>', "tree.xml")
    assert f'msec="{msec}"' in written(text, tmp_path).text
