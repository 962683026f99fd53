"""The net of a policy: it is safe, goes the ways of the policy and no others, and is sure of the goal exactly if the policy is proved."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from pathlib import Path

import pytest
from hypothesis import example, given, settings, strategies as st

from planner_bridge.model.rates import Basis, Chance, Rests
from planner_bridge.planning.policies import steps as steps_module
from planner_bridge.planning.policies.net import FAILURE, PolicyNet, steps_dot, steps_svg
from planner_bridge.planning.policies.policy import PolicySearch, policies
from planner_bridge.planning.policies.steps import GOAL, MOST, NO_WAY_OUT, Branch, Step
from planner_bridge.planning.policies.task import PolicyAction
from planner_bridge.tasks.result import PolicyNote
from pnm.core.logic.effects import Alternative
from pnm.core.machine.plan_graph import GroundAction
from pnm.core.net.net import Marking, PetriNet, enabled, fire
from pnm.errors import InputError
from tests.support.e2e.command_line import pnm
from tests.support.pddl.chance import Exact, State, random_problem

TRIED = PolicyAction("try", (), (), ())


def net_of(*then: Sequence[int]) -> PolicyNet:
    """Return the net of steps, each with outcomes that lead to these."""
    return PolicyNet([Step(at, TRIED, 1.0, tuple(Branch(str(one), 0.5, (one,)) for one in its)) for at, its in enumerate(then, 1)])


@settings(max_examples=150)
@given(st.integers(0, 10**9), st.sampled_from([5_000, 2]))
@example(241922462, 5_000)  # an entry beside the way cannot be proved
def test_the_net_goes_where_the_policy_does(seed: int, states: int) -> None:
    problem = random_problem(seed)
    *_, best = [None, *policies(problem, 60.0)]
    if best is None:
        return
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(steps_module, "_STATES", states)
        net, exact = PolicyNet(best.steps()), Exact(problem)
    assert net.is_sure is best.is_proved
    assert net.is_sure or not net.unproved((GOAL, FAILURE, NO_WAY_OUT))
    numbers = {(str(step.action), step.expected): step.number for step in net.steps}

    if len(numbers) < len(net.steps):  # which steps are taken cannot be seen
        return

    def place(state: State) -> str:
        entry = best.entry(exact.knowledge(state))
        return "goal" if exact.is_goal(state) else "no way out" if entry is None else net.places[numbers[str(entry), entry.expected]]

    arcs, walked = {(a, b) for name in net.ways for a in net.net.inputs[name] for b in net.net.outputs[name] if b != "failure"}, set()
    waiting, seen = [exact.initial], {exact.initial}
    for state in waiting:
        entry = best.entry(exact.knowledge(state))
        if entry is not None and not exact.is_goal(state):
            after = exact.turn_outs(state, entry.action, entry.arguments)
            assert after is not None
            walked |= {(place(state), place(one)) for one in after}
            waiting += (new := after.keys() - seen)
            seen |= new
    assert net.initial == Marking([place(exact.initial)])
    assert walked <= arcs
    assert walked == arcs or states == 2


def uneven(action: GroundAction, ways: Sequence[Alternative]) -> Chance:
    """As learned: for each action other chances."""
    first = len(str(action))
    return Chance({way.name: float(first + number) for number, way in enumerate(ways)}, Rests(Basis.LEARNED, 20))


@settings(max_examples=100)
@given(st.integers(0, 10**9), st.booleans(), st.booleans(), st.booleans())
def test_a_policy_that_was_noted_has_the_same_steps(seed: int, counts: bool, derives: bool, learns: bool) -> None:
    problem = random_problem(seed, counts=counts, derives=derives)
    for policy in PolicySearch(problem, chances=uneven if learns else None).policies(60.0):
        noted = PolicyNote.of(policy).policy(problem)
        assert noted is not None
        assert [(step.as_json(), step.entry) for step in noted.steps()] == [(step.as_json(), step.entry) for step in policy.steps()]


def test_one_token_moves_and_ends() -> None:
    net = net_of((2, 1), (GOAL, 2, NO_WAY_OUT))
    waiting, seen = [net.initial], {net.initial}
    for marking in waiting:
        assert [*marking.values()] == [1]
        after = {fire(net.net, marking, name) for name in enabled(net.net, marking)}
        assert after or next(iter(marking)) in ("goal", "failure", "no way out")
        waiting += (new := after - seen)
        seen |= new
    assert len(seen) == len(net.net.places) == 5


@pytest.mark.parametrize(
    ("then", "is_sure", "claim"),
    [
        (((2, 1), (GOAL, 1)), True, "proved: whatever the outcomes, it ends in the goal or in a failure; in the goal if"),
        (((2, 1), (GOAL, NO_WAY_OUT)), False, "proved: whatever the outcomes, it ends in the goal, in a failure, or without a way out"),
        (((2, 1), (1, 2)), False, "not proved: it ends in {'#1 try()': 1}"),
        (((2, GOAL), (3,), (2,)), False, "not proved: it ends in {'#2 try()': 1}"),
    ],
)
def test_what_goes_round_for_ever_is_not_proved(then: tuple[tuple[int, ...], ...], is_sure: bool, claim: str) -> None:
    net = net_of(*then)
    assert net.is_sure is is_sure
    assert net.claim.startswith(claim)


def test_what_depends_on_what_was_before_is_no_way_to_rely_on() -> None:
    both = Step(1, TRIED, 1.0, (Branch("1", 1.0, (GOAL, 1)),))
    net = PolicyNet([both])
    assert [*net.net.transitions] == ["#1.1 done -> goal", "#1.1 done -> #1", "#1 fails"]
    assert not net.is_sure


def test_an_outcome_is_no_failure() -> None:
    net = net_of((2, 1), (GOAL, FAILURE))
    assert not net.unproved((GOAL, FAILURE))
    assert not net.is_sure


def test_a_net_is_that_of_its_steps() -> None:
    net = net_of((2, 1), (GOAL, 1))
    wrong = PetriNet(net.net.places, net.net.inputs, {**net.net.outputs, "#1.2 1": {"failure": 1}})
    vars(net)["_built"] = wrong, net.ways
    assert net.claim == "not proved: the net is not that of its steps"


def test_a_net_has_so_many_steps_and_no_more() -> None:
    line = [*((at + 1,) for at in range(1, MOST)), (GOAL,)]
    net = net_of(*line)
    assert net.is_sure
    assert net.distances([GOAL])[1] == MOST
    with pytest.raises(InputError, match="the policy has 201 steps, and there are nets of 200 at most"):
        net_of(*line, (GOAL,))
    steps = [Step(at, TRIED, 1.0, (Branch("1", 1.0, (at + 1 if at < 250 else GOAL,)),)) for at in range(1, 251)]
    assert "50 more steps" in steps_svg(steps, "")


def test_pictures_have_every_step_and_every_outcome() -> None:
    net = net_of((2, 1), (GOAL, NO_WAY_OUT))
    root = ET.fromstring(steps_svg(net.steps, "a policy"))
    assert len(root.findall(".//{*}g")) == 2
    assert [one.get("class") for one in root.findall("{*}path")] == ["", "back", "goal", "lost"]
    arrow = re.compile(r"^ .*->", re.MULTILINE)
    assert len(arrow.findall(steps_dot(net.steps))) == 4
    assert len(arrow.findall(net.dot())) == len(net.net.arcs) == 12


@pytest.mark.parametrize("options", [(), ("--format", "dot", "--level", "net"), ("--format", "dot"), ("--format", "svg")])
def test_pnm_net_writes_the_net_of_a_policy(options: tuple[str, ...], tmp_path: Path) -> None:
    domain, problem = tmp_path / "d.pddl", tmp_path / "p.pddl"
    domain.write_text(
        "(define (domain d) (:requirements :non-deterministic) (:predicates (near) (far))"
        " (:action jump :precondition (near) :effect (oneof (and (far) (not (near))) (and))))"
    )
    problem.write_text("(define (problem p) (:domain d) (:init (near)) (:goal (far)))")
    done = pnm("net", str(domain), str(problem), *options)
    assert done.returncode == 0
    (line,) = done.stderr.splitlines()
    assert line.startswith("proved: whatever the outcomes, it ends in the goal or in a failure; in the goal if no call fails")
    if not options:
        data = json.loads(done.stdout)
        assert data["places"] == [
            {"name": "#1 jump()", "role": "", "tokens": 1},
            {"name": "goal", "role": "goal", "tokens": 0},
            {"name": "failure", "role": "failure", "tokens": 0},
        ]
        assert [(one["name"], one["chance"]) for one in data["transitions"]] == [("#1.1 1", 0.5), ("#1.2 2", 0.5), ("#1 fails", None)]
        (step,) = data["steps"]
        assert step["outcomes"] == [{"outcome": "1", "chance": 0.5, "then": [0]}, {"outcome": "2", "chance": 0.5, "then": [1]}]
        assert (step["number"], step["action"], step["distance"], step["expected"]) == (1, "jump", 1, 2.0)
        assert json.loads(pnm("plan", str(domain), str(problem), "--json").stdout)["policy"]["steps"] == [
            {key: value for key, value in step.items() if key != "distance"}
        ]
    assert "jump" in done.stdout
