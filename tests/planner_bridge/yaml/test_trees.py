"""Behaviour trees: a plan as a tree keeps its calls and their order, and a tree as a plan; the rest is refused by name and place."""

from __future__ import annotations

import asyncio
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from pathlib import Path
from random import Random
from uuid import UUID

import pytest
from hypothesis import given, settings
from hypothesis.strategies import integers

from planner_bridge.pipeline.achieve import carry_out
from planner_bridge.planning.policies.policy import policies
from planner_bridge.yaml.trees import plan_tree, policy_tree, read_tree
from pnm.core.logic.conditions import TRUE
from pnm.core.machine.plan_graph import ActionCall, GroundAction, Moment, Ordering, PlanEvent, PlanGraph
from pnm.core.machine.requests import Accepted, Ended, Outcome, OutcomeKind, Reporter, Request
from pnm.core.net.net import closure
from pnm.errors import InputError
from pnm.language.plan import read_plans
from tests.support.e2e.command_line import pnm
from tests.support.files import ROOT
from tests.support.pddl.chance import random_problem
from tests.support.runs.mutation.machines import random_plan

ROOT_TAG = '<root BTCPP_format="4">\n<BehaviorTree ID="MainTree">\n%s\n</BehaviorTree>\n</root>'


def plan_of(text: str, folder: Path, name: str = "MainTree") -> PlanGraph:
    file = folder / "plan.yaml"
    file.write_text(text, encoding="utf-8")
    return read_plans(file)[name].graph


def random_order(random: Random) -> PlanGraph:
    """Calls in a random order."""
    calls = tuple(ActionCall(number, GroundAction(f"a{number}", (f"x{number}",), ("what",))) for number in range(random.randint(1, 6)))
    pairs = [(one, other) for one in range(len(calls)) for other in range(one) if random.random() < 0.4]
    orderings = tuple(Ordering(PlanEvent(other, Moment.END), PlanEvent(one, Moment.START)) for one, other in pairs)
    return PlanGraph(calls, orderings, TRUE)


def order_of(graph: PlanGraph) -> set[tuple[str, str]]:
    """Which calls come before which."""
    calls = [call.action.name for call in graph.calls]
    position = {event.call: number for number, event in enumerate(one for one in graph.order if one.moment is Moment.START)}
    before: list[list[int]] = [[] for _ in position]
    for one in graph.orderings:
        before[position[one.after.call]].append(position[one.before.call])
    names = {number: calls[call] for call, number in position.items() if call < len(calls)}
    earlier = closure(before)
    return {(names[a], names[b]) for b in names for a in names if earlier[b] >> a & 1}


@settings(deadline=None, max_examples=60)
@given(integers(0, 10**6))
def test_a_plan_that_was_a_tree_keeps_its_calls_and_their_order(number: int) -> None:
    graph = random_order(Random(number))
    tree = plan_tree(graph)
    read = plan_of(read_tree(tree.text, "plan.xml"), FOLDER, "Plan")
    assert sorted(str(call.action) for call in read.calls) == sorted(str(call.action) for call in graph.calls)
    order, wanted = order_of(read), order_of(graph)
    assert wanted <= order
    assert (wanted == order) is not any("concurrency" in lost for lost in tree.lost)


FOLDER = Path()


@pytest.fixture(autouse=True, scope="module")
def _folder(tmp_path_factory: pytest.TempPathFactory) -> None:
    global FOLDER
    FOLDER = tmp_path_factory.mktemp("trees")


@settings(deadline=None, max_examples=60)
@given(integers(0, 10**6))
def test_every_plan_is_a_tree_whose_leaves_the_model_knows(number: int) -> None:
    graph = random_plan(Random(number))
    written = plan_tree(graph)
    root = ET.fromstring(written.text)
    assert root.attrib == {"BTCPP_format": "4", "main_tree_to_execute": "Plan"}
    model = {node.get("ID") for node in root.find("TreeNodesModel") or ()}
    tree = root.find("BehaviorTree")
    assert tree is not None
    leaves = [node for node in tree.iter() if node.tag in ("Action", "Condition")]
    assert {leaf.get("ID") for leaf in leaves} <= model
    left_out = {str(call) for call in graph.calls} - {leaf.get("name") for leaf in leaves}
    assert not left_out or any("recoveries after other failures" in lost for lost in written.lost)
    for node in tree.iter():
        match node.tag:
            case "Inverter" | "RetryUntilSuccessful" | "Timeout" | "Repeat" | "ForceSuccess" | "ForceFailure" | "BehaviorTree":
                assert len(node) == 1
            case "IfThenElse":
                assert len(node) in (2, 3)
            case "Sequence" | "Fallback" | "Parallel":
                assert len(node) > 1
            case _:
                assert not len(node)


def test_a_policy_is_a_tree_of_its_entries_until_the_goal_holds() -> None:
    found = ([*policies(problem := random_problem(seed), 60.0), problem] for seed in range(20))
    *_, policy, problem = max(found, key=lambda each: len(each[-2].entries) if len(each) > 1 else 0)  # type: ignore[union-attr]
    root = ET.fromstring(policy_tree(policy.as_json(), problem.goal).text)  # type: ignore[union-attr]
    actions = [node.get("ID") for node in root.iterfind("BehaviorTree//Action")]
    assert actions == [entry.action for entry in policy.entries]  # type: ignore[union-attr]
    asked = [node.get("condition") for node in root.iterfind("BehaviorTree//Condition")]
    assert asked[0] == str(problem.goal)  # type: ignore[union-attr]


class Robots:
    """An action client whose actions abort so often. The mutable state is what they were told, and how often they still do."""

    def __init__(self, failures: Mapping[str, int]) -> None:
        self.told: list[str] = []
        self._left = dict(failures)

    def goal_fields(self, action: GroundAction, /) -> tuple[str, ...] | None:
        return None

    def send(self, request: Request, report: Reporter, /) -> None:
        name, loop = request.action.name, asyncio.get_running_loop()
        self.told.append(name)
        self._left[name] = self._left.get(name, 0) - 1
        end = OutcomeKind.ABORTED if self._left[name] >= 0 else OutcomeKind.SUCCEEDED
        loop.call_soon(report, Accepted(request.id))
        loop.call_soon(report, Ended(request.id, Outcome(end)))

    def cancel(self, request: UUID, /) -> None:
        raise AssertionError("nothing takes so long")


def random_program(random: Random) -> str:
    """A plan by hand, of calls one after the other with recoveries."""
    steps = []
    for number in range(random.randint(1, 4)):
        chain, times = random.choice(["", f"{{b{number}: }}, "]), random.randint(1, 3)
        ways = [f"{{do: [{chain}{end}], times: {many}}}" for end, many in (("retry", times), ("skip_action", 1), ("fail", 1))]
        found = ways[: random.randint(1, 2)] if random.random() < 0.5 else [random.choice(ways)]
        recoveries = f"\n    recoveries: {{during: {{aborted: [{', '.join(found)}]}}}}"
        options = random.choice(["", recoveries, recoveries, f"\n    retries: {random.randint(1, 3)}"])
        steps.append(f"  - a{number}:{options}")
    actions = "".join(f"  a{number}: \n  b{number}: \n" for number in range(4))
    return f"actions:\n{actions}plan:\n" + "\n".join(steps) + "\n"


@settings(deadline=None, max_examples=60)
@given(integers(0, 10**6))
def test_a_plan_that_was_a_tree_tells_robots_the_same(number: int) -> None:
    random = Random(number)
    file, other = FOLDER / "by_hand.yaml", FOLDER / "back.yaml"
    file.write_text(random_program(random), encoding="utf-8")
    (plan,) = read_plans(file).values()
    failures = {f"a{step}": random.choice([0, 0, 1, 2, 3, 5]) for step in range(4)}
    other.write_text(read_tree(plan_tree(plan.graph).text, "tree.xml"), encoding="utf-8")
    robots = Robots(failures), Robots(failures)
    ends = [carry_out(path, name, actions=each).goal_reached for path, name, each in ((file, None, robots[0]), (other, "Plan", robots[1]))]
    assert (ends[0], robots[0].told) == (ends[1], robots[1].told), file.read_text(encoding="utf-8")


def refusals() -> Iterator[tuple[str, str]]:
    yield "<ReactiveSequence><A/></ReactiveSequence>", "3:1: <ReactiveSequence> is not read: it asks again while others run"
    yield "<Sequence>\n  <ReactiveFallback><A/></ReactiveFallback></Sequence>", "4:3: <ReactiveFallback> is not read"
    yield "<Inverter><A/></Inverter>", "3:1: <Inverter> is not read"
    yield "<Sequense><A/></Sequense>", "3:1: <Sequense> has nodes inside, and is not known; did you mean 'Sequence'?"
    yield '<SubTree ID="MainTree"/>', "3:1: the tree 'MainTree' calls itself"
    yield '<SubTree ID="MainTre"/>', "3:1: there is no tree 'MainTre'; did you mean 'MainTree'?"
    yield "<SubTree/>", "3:1: <SubTree> lacks its attribute 'ID'"
    yield "<RetryUntilSuccessful><A/></RetryUntilSuccessful>", "3:1: <RetryUntilSuccessful> lacks its attribute 'num_attempts'"
    yield '<RetryUntilSuccessful num_attempts="-1"><A/></RetryUntilSuccessful>', "num_attempts of <RetryUntilSuccessful> is '-1'"
    yield '<Timeout msec="1"><A/><B/></Timeout>', "3:1: <Timeout> has 2 nodes; expected one"
    yield '<Parallel success_count="1"><A/><B/></Parallel>', "3:1: <Parallel> is read if all of its nodes must succeed"
    yield '<A to="{b.c}"/>', "3:1: '{b.c}' is not read"
    yield '<A _skipIf="x"/>', "3:1: _skipIf is not read"
    yield "<if/>", "3:1: an action cannot be called 'if' in a plan"
    yield "<Sequence>", "4:3: not XML: mismatched tag"


@pytest.mark.parametrize(("inside", "error"), [*refusals()])
def test_what_is_not_read_is_refused_by_name_and_place(inside: str, error: str) -> None:
    with pytest.raises(InputError) as caught:
        read_tree(ROOT_TAG % inside, "tree.xml")
    assert str(caught.value).startswith("tree.xml:")
    assert error in str(caught.value)


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("<root><BehaviorTree ID='a'/></root>", "expected <root BTCPP_format="),
        ('<root BTCPP_format="4"/>', "expected a <BehaviorTree>"),
        ('<root BTCPP_format="4" main_tree_to_execute="b"><BehaviorTree ID="a"/></root>', "there is no tree 'b'"),
        ('<!DOCTYPE r [<!ENTITY a "aaa">]><root BTCPP_format="4"/>', "expected no document type"),
    ],
)
def test_what_is_no_file_of_trees_is_refused(text: str, error: str) -> None:
    with pytest.raises(InputError) as caught:
        read_tree(text, "tree.xml")
    assert error in str(caught.value)


def test_a_leaf_that_the_model_does_not_know_is_refused_with_the_nearest_one() -> None:
    model = '<TreeNodesModel><Action ID="Navigate"><input_port name="to"/><output_port name="took"/></Action></TreeNodesModel></root>'
    text = (ROOT_TAG % "<Sequence><Navigate to='a' took='{time}'/><Say what='{time}'/></Sequence>").replace("</root>", model)
    with pytest.raises(InputError, match="'Say' is not in the <TreeNodesModel>"):
        read_tree(text, "tree.xml")
    graph = plan_of(read_tree(text.replace("<Say what", "<Navigate to"), "tree.xml"), FOLDER)
    assert [call.store for call in graph.calls] == [(("took", "time"),), ()]


def refusal(text: str) -> InputError | None:
    try:
        read_tree(text, "tree.xml")
    except InputError as error:
        return error
    return None


def test_damaged_and_huge_trees_are_refused_in_sentences_or_are_plans() -> None:
    whole = plan_tree(random_plan(Random(3))).text
    for seed in range(200):
        random, letters = Random(seed), [*whole]
        for _ in range(random.randint(1, 3)):
            place = random.randrange(len(letters))
            letters[place : place + random.randint(0, 3)] = random.choice(["", "<", '"', "/>", "{x}", "Sequence", "\x00"])
        error = refusal("".join(letters))
        assert error is None or (error.position and error.position.line), f"seed {seed}: {error}"
    called = "".join(f'<BehaviorTree ID="t{number}"><SubTree ID="t{number + 1}"/></BehaviorTree>' for number in range(5_000))
    assert "nested too deeply" in str(
        refusal(f'<root BTCPP_format="4" main_tree_to_execute="t0">{called}<BehaviorTree ID="t5000"/></root>')
    )
    often = '<Repeat num_cycles="100">' * 4 + "<A/>" + "</Repeat>" * 4
    assert "the plan has more than" in str(refusal(ROOT_TAG % often))


def test_limits_and_tries_are_those_of_calls() -> None:
    tries = '<RetryUntilSuccessful num_attempts="4"><A/></RetryUntilSuccessful><Timeout msec="1500"><B/></Timeout>'
    graph = plan_of(read_tree(ROOT_TAG % f"<Sequence>{tries}<Repeat num_cycles='3'><C n='2'/></Repeat></Sequence>", "tree.xml"), FOLDER)
    assert [(call.action.name, call.retries, call.timeout) for call in graph.calls][:2] == [("A", 3, None), ("B", 0, 1.5)]
    assert [call.action.name for call in graph.calls][2:] == ["C"] * 3


def test_the_commands_write_a_tree_and_read_one(tmp_path: Path) -> None:
    domain, problem = ROOT / "domains/patrol/domain.pddl", ROOT / "problems/patrol/p01.pddl"
    done = pnm("export", str(domain), str(problem), "--format", "btcpp", "--improve", "0", "-o", str(tmp_path / "plan.xml"))
    assert done.returncode == 0
    assert "lost     preconditions" in done.stderr
    done = pnm("import", str(tmp_path / "plan.xml"), "-o", str(tmp_path / "plans"))
    assert done.returncode == 0
    run = pnm("run", "--plan", str(tmp_path / "plans/plan.yaml"))
    assert "goal     holds" in run.stdout
    by_hand = pnm("export", str(tmp_path / "plans/plan.yaml"), "--format", "btcpp")
    assert ET.fromstring(by_hand.stdout).find("BehaviorTree") is not None
    assert pnm("export", str(domain), str(problem), "--name", "x").returncode == 2
