"""What agents may do at a node, and which of their goals need a person's yes; the node is played."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any, cast
from uuid import UUID, uuid4

import pytest
from mcp import Client

from planner_bridge.node.agents import MAX_GOALS, Agents, Approval, OfferedNode, read_approval, server_of
from planner_bridge.node.node_journal import latest_journal
from planner_bridge.pddl import write_domain, write_problem
from planner_bridge.pipeline.loading import load
from pnm.errors import InputError
from pnm.knowledge.people import APPROVAL
from pnm.ros.tasks.executor_topics import made_fields
from pnm.tasks import Code, MadePlan, StepState, TaskOdds, TaskState, TaskStep
from tests.support.files import ROOT, written
from tests.support.logic.agents import asked

PROBLEM = load(ROOT / "domains/delivery/domain.pddl", ROOT / "problems/delivery/p01.pddl")
OTHERS = uuid4()
"""A task that somebody else has sent."""


def task(id: UUID, state: TaskState = TaskState.RUNNING) -> SimpleNamespace:
    odds = SimpleNamespace(chance=-1.0)
    known = {"goal": "", "priority": 0, "code": 0, "reason": "", "running": [], "feedback": [], "ended": 0, "replans": 0, "odds": odds}
    return SimpleNamespace(id=SimpleNamespace(uuid=id.bytes), state=int(state), OVER=int(TaskState.OVER), **known)


@dataclass
class PlayedNode:
    """A node that plans at once, and carries out nothing."""

    chance: float | None = None
    code: Code = Code.GOAL_REACHED
    tasks: dict[UUID, SimpleNamespace] = field(default_factory=lambda: {OTHERS: task(OTHERS)})
    done: list[tuple[str, Any]] = field(default_factory=list)
    taken: list[dict[str, Any]] = field(default_factory=list)

    async def ask(self, kind: str, service: str, request: Mapping[str, object]) -> SimpleNamespace:
        return SimpleNamespace(domain=write_domain(PROBLEM.domain), problem=write_problem(PROBLEM))

    async def plan(self, goal: str, *, with_new_plans: bool) -> SimpleNamespace:
        steps = (TaskStep("move", ("r1", "store", "hall"), 0.0, 4.0, StepState.WAITING),)
        odds = None if self.chance is None else TaskOdds(self.chance, 1.0, 2.0, "assumed")
        return SimpleNamespace(result=made_fields(MadePlan(self.code, "as it is played", "(at r1 hall)", steps, odds)))

    async def status(self) -> SimpleNamespace:
        return SimpleNamespace(paused=False, tasks=[*self.tasks.values()])

    async def task(self, prefix: str) -> UUID:
        return next(id for id in self.tasks if id.hex.startswith(prefix.replace("-", "")))

    async def command(self, command: str, task: UUID, **fields: object) -> None:
        self.done.append((command, task))

    async def hands(self) -> list[dict[str, Any]]:
        return self.taken

    async def put(self, name: str, said: Mapping[str, str] | None) -> str:
        self.taken = [hand for hand in self.taken if hand["name"] != name] + ([{"name": name, **said}] if said else [])
        return ""

    async def send(self, server: str, goal: Mapping[str, object], id: UUID) -> None:
        self.tasks[id] = task(id)
        self.done.append((server, goal["goal"]))

    async def answer(self, question: str, text: str) -> None:
        self.done.append((question, text))


class Heard(asyncio.Queue[Any]):
    """Messages, and whether all have been heard."""

    def __init__(self) -> None:
        super().__init__()
        self.all = asyncio.Event()

    async def get(self) -> Any:
        if self.empty():
            self.all.set()
        return await super().get()


def at(node: PlayedNode, approval: Approval | None, work: Callable[[Client, OfferedNode], Awaitable[Any]]) -> Any:
    """Do the work with a client of the tools at a node."""

    async def connected() -> Any:
        offered = OfferedNode(cast(Any, node), node.answer)
        async with Client(server_of(Agents(offered, latest_journal, approval))) as client:
            return await work(client, offered)

    return asyncio.run(connected())


@pytest.mark.parametrize(
    ("policy", "chance", "needs_yes"),
    [
        ("", 1.0, True),
        ("confirm: always", 1.0, True),
        ("confirm: never", None, False),
        ("confirm: odds below 0.9", 0.95, False),
        ("confirm: odds   below .9", 0.85, True),
        ("confirm: odds below 0.9", None, True),
        ("confirm: odds below 1", 1.0, False),
    ],
)
def test_the_policy_says_which_goals_need_a_persons_yes(tmp_path, policy, chance, needs_yes):
    approval = read_approval(written(tmp_path / "policy.yaml", policy)) if policy else Approval()
    node = PlayedNode(chance)
    sent = at(node, approval, lambda client, _: asked(client, "send_goal", goal="(at r1 hall) ; approved"))
    assert sent["needs_yes"] is needs_yes
    assert node.done == [("propose_goal" if needs_yes else "achieve_goal", "(at r1 hall)")]


@pytest.mark.parametrize(
    ("policy", "says"),
    [
        ("confirm: allways", "policy.yaml:1:10: there is no policy 'allways' under 'confirm'; did you mean 'always'?"),
        ("confirm: odds below 90 %", "expected always, never, or odds below a chance such as 0.9"),
        ("confirm: odds below 1.5", "expected always, never, or odds below a chance such as 0.9"),
        ("confirm: true", "expected a text under 'confirm', found True"),
        ("confirms: never", "unknown key 'confirms'; did you mean 'confirm'?"),
        ("{}", "there is no policy ''"),
    ],
)
def test_a_policy_that_means_nothing_is_refused(tmp_path, policy, says):
    with pytest.raises(InputError, match=r".*") as refused:
        read_approval(written(tmp_path / "policy.yaml", policy))
    assert says in str(refused.value)


def test_nothing_is_sent_without_a_plan_nor_where_nothing_may_be_sent():
    for node, approval, says in (
        (PlayedNode(code=Code.NO_PLAN), Approval(0.0), "it is not sent: as it is played"),
        (PlayedNode(code=Code.INVALID_GOAL), Approval(0.0), "as it is played"),
        (PlayedNode(), None, "this server only reads; a person starts `pnm mcp` with --allow-goals"),
    ):
        assert says in at(node, approval, lambda client, _: asked(client, "send_goal", goal="(at r1 hall)"))
        assert not node.done


def test_an_agent_has_no_more_goals_at_once_than_that():
    async def send(client: Client, _: OfferedNode) -> list[Any]:
        return [await asked(client, "send_goal", goal="(at r1 hall)") for _ in range(MAX_GOALS + 1)]

    *sent, refused = at(PlayedNode(), Approval(0.0), send)
    assert all("task" in one for one in sent)
    assert "goals from here are not over" in refused


def test_an_agent_ends_its_own_goals_and_continues_only_what_it_has_paused():
    node = PlayedNode()

    async def act(client: Client, _: OfferedNode) -> list[Any]:
        own = (await asked(client, "send_goal", goal="(at r1 hall)"))["task"]
        others = OTHERS.hex
        said = [await asked(client, tool, task=others) for tool in ("cancel", "resume", "pause", "resume")]
        node.tasks[OTHERS].state = int(TaskState.PAUSED)  # by a person
        said += [await asked(client, "pause", task=others), await asked(client, "resume", task=others)]
        return [*said, await asked(client, "cancel", task=own)]

    cancel, resume, paused, resumed, _, by_others, ended = at(node, Approval(0.0), act)
    assert "was not sent from here" in cancel
    assert "was not paused from here" in resume
    assert (paused["is"], resumed["is"], ended["is"]) == ("paused", "going on", "cancelled")
    assert "was not paused from here" in by_others
    assert [command for command, _ in node.done] == ["achieve_goal", "pause", "resume", "pause", "cancel"]


def test_an_agent_gives_back_what_it_has_taken_and_nothing_else():
    node = PlayedNode(taken=[{"name": "r2", "by": "ada", "reason": ""}])

    async def act(client: Client, _: OfferedNode) -> list[Any]:
        taken = await asked(client, "take", robot="r1", reason="it is in the way")
        in_hands = (await asked(client, "status"))["in_hands"]
        return [taken, in_hands, *[await asked(client, "give", robot=robot) for robot in ("r2", "r1", "r1")]]

    taken, in_hands, by_others, given, again = at(node, Approval(0.0), act)
    assert (taken["is"], given["is"]) == ("taken", "given back")
    assert "r2 was not taken from here" in by_others
    assert "r1 was not taken from here" in again
    assert [hand["name"] for hand in in_hands] == ["r2", "r1"]
    assert "only reads" in at(node, None, lambda client, _: asked(client, "take", robot="r1"))


def test_an_agent_answers_questions_but_approves_nothing():
    node = PlayedNode()

    async def act(client: Client, offered: OfferedNode) -> list[Any]:
        heard = Heard()
        hearing = asyncio.create_task(offered.hear(heard))
        for id, name in (("a", APPROVAL), ("b", "drink"), ("c", "help")):
            heard.put_nowait(SimpleNamespace(id=id, name=name, text=f"{name}?\x1b[2J", kind=0, ASK=0))
        heard.put_nowait(SimpleNamespace(id="c", kind=1, ASK=0))
        await heard.all.wait()
        hearing.cancel()
        listed = (await asked(client, "questions"))["questions"]
        return [listed, *[await asked(client, "answer", question=id, text="yes") for id in ("a", "b", "c", "A")]]

    listed, approval, drink, withdrawn, unknown = at(node, Approval(0.0), act)
    assert listed[1] == {"id": "b", "name": "drink", "text": "drink?\ufffd[2J", "is_for_people": False}
    assert [one["is_for_people"] for one in listed] == [True, False]
    assert "for a person to say" in approval
    assert drink == {"question": "b", "is": "answered"}
    assert "no question 'c' is open here" in withdrawn
    assert "no question 'A' is open here" in unknown
    assert node.done == [("b", "yes")]
