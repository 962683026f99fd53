"""A managed node as the services of its life cycle see it, nodes of the same name, and parameters."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncIterator
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from typing import Any

import pytest

from pnm.errors import InputError, RosError
from pnm.ros.node import services as request_services
from pnm.ros.node.lifecycle import Lifecycle, check_alone
from pnm.ros.node.parameters import NodeParameter, declare
from pnm.ros.node.ros_thread import RosThread
from tests.support.processes import LIMIT
from tests.support.ros.child_process import Within, run_bounded
from tests.support.ros.task_client import TaskClient

NUMBERS = count()


@dataclass
class Work:
    """Notes what it is told to do; waits in a transition that is in `slow` until it is let go, fails in one that is in `wrong`."""

    done: list[str] = field(default_factory=list)
    wrong: dict[str, Exception] = field(default_factory=dict)
    slow: dict[str, asyncio.Event] = field(default_factory=dict)
    begun: asyncio.Event = field(default_factory=asyncio.Event)

    async def configure(self) -> None:
        await self._do("configure")

    async def activate(self) -> None:
        await self._do("activate")

    async def deactivate(self) -> None:
        await self._do("deactivate")

    async def cleanup(self) -> None:
        await self._do("cleanup")

    async def _do(self, what: str) -> None:
        self.done.append(what)
        self.begun.set()
        if what in self.slow:
            await self.slow[what].wait()
        if what in self.wrong:
            raise self.wrong.pop(what)


@dataclass
class ManagedNode:
    ros: RosThread
    work: Work
    lifecycle: Lifecycle
    client: TaskClient

    async def ask(self, wanted: str | int) -> bool:
        transition = {"label" if isinstance(wanted, str) else "id": wanted}
        answer = await self.client.call("pnm/change_state", "lifecycle_msgs/srv/ChangeState", transition=transition)
        return bool(answer["success"])

    async def state(self) -> str:
        return str((await self.client.call("pnm/get_state", "lifecycle_msgs/srv/GetState"))["current_state"]["label"])


@asynccontextmanager
async def node_and_client(**options: Any) -> AsyncIterator[tuple[RosThread, TaskClient]]:
    """A node with the name `pnm`, and a client of it, in a namespace that nobody else has."""
    namespace = f"managed{next(NUMBERS)}"
    async with RosThread("pnm", namespace=namespace, **options) as ros, RosThread("client", namespace=namespace) as other:
        client = TaskClient(other)
        try:
            yield ros, client
        finally:
            await client.close()


@asynccontextmanager
async def managed_node() -> AsyncIterator[ManagedNode]:
    async with node_and_client(managed=True) as (ros, client):
        work = Work()
        one = ManagedNode(ros, work, Lifecycle(ros, work), client)
        await one.lifecycle.open()
        await one.state()  # the first answer may get lost, so a transition is not the first that is asked for
        yield one
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(request_services, "ARRIVAL", 0.0)  # nobody waits for an answer any more
            await one.lifecycle.close()


@pytest.fixture
def one() -> Within:
    return Within(managed_node())


async def test_a_node_goes_through_its_states_and_ends(one):
    states = [await one.state()]
    for wanted in ("configure", "activate", "deactivate", 3, 4, "cleanup", 1, "shutdown"):
        assert await one.ask(wanted), wanted
        states.append(await one.state())
    assert states == [
        "unconfigured", "inactive", "active", "inactive", "active", "inactive", "unconfigured", "inactive", "finalized",
    ]  # fmt: skip
    await asyncio.wait_for(one.lifecycle.finalized.wait(), LIMIT)
    assert one.work.done[-3:] == ["cleanup", "configure", "cleanup"]


async def test_what_cannot_be_done_in_a_state_is_refused(caplog):
    async with managed_node() as one:
        for label in ("activate", "deactivate", "cleanup", "on_configure_success", "transition_success", "spam", ""):
            assert not await one.ask(label), label
        assert await one.state() == "unconfigured"
        assert one.work.done == []
    assert caplog.text.count("cannot be made: the node is unconfigured; expected one of configure, shutdown") == 7


async def test_a_transition_that_fails_says_why_and_leaves_the_state(caplog):
    async with managed_node() as one:
        one.work.wrong["configure"] = InputError("problem.pddl:1:1: expected (define")
        assert not await one.ask("configure")
        assert await one.state() == "unconfigured"
        assert await one.ask("configure")
        one.work.wrong["activate"] = RosError("not now")
        assert not await one.ask("activate")
        assert await one.state() == "inactive"
    assert "the transition configure has failed: problem.pddl:1:1: expected (define" in caplog.text
    assert "the transition activate has failed: not now" in caplog.text


async def test_an_error_of_ours_cleans_up(caplog):
    async with managed_node() as one:
        assert await one.ask("configure")
        one.work.wrong["activate"] = ZeroDivisionError("a bug")
        assert not await one.ask("activate")
        assert await one.state() == "unconfigured"
        assert one.work.done == ["configure", "activate", "cleanup"]
        assert await one.ask("configure")
    assert "a bug" in caplog.text


async def test_one_transition_at_a_time_and_the_node_goes_on_answering(one):
    go_on = one.work.slow["configure"] = asyncio.Event()
    asked = asyncio.ensure_future(one.ask("configure"))
    await one.work.begun.wait()
    assert await one.state() == "configuring"
    for label in ("configure", "shutdown", "transition_success"):
        assert not await one.ask(label)
    with pytest.raises(RosError, match="the node is configuring; wait until that is over"):
        await one.lifecycle.change("activate")
    go_on.set()
    assert await asked
    assert await one.state() == "inactive"


async def test_closing_in_the_middle_of_a_transition_cleans_up(one):
    one.work.slow["configure"] = asyncio.Event()
    asked = asyncio.ensure_future(one.ask("configure"))
    await one.work.begun.wait()
    await one.lifecycle.close()
    assert not await asked
    assert one.work.done[-1] == "cleanup"
    assert await one.state() == "finalized"


async def test_a_transition_that_is_cancelled_when_it_is_done_comes_to_its_end(one):
    await one.lifecycle.change("configure")
    go, busy = one.work.slow.setdefault("activate", asyncio.Event()), threading.Event()
    one.work.begun.clear()
    activating = asyncio.create_task(one.lifecycle.change("activate"))
    await one.work.begun.wait()
    one.ros.call(lambda: busy.wait(LIMIT))
    go.set()
    for _ in range(5):
        await asyncio.sleep(0)
    activating.cancel()  # as a signal does in the moment in which the node says that it is ready
    await asyncio.wait((activating,))
    busy.set()
    await one.lifecycle.change("deactivate")


@pytest.mark.parametrize("count", [2, 3])
async def test_of_nodes_of_a_name_that_start_at_the_same_time_the_first_goes_on(count):
    with ExitStack() as cleanup:
        nodes = [RosThread("twin", namespace=f"twins{count}", managed=True) for _ in range(count)]
        for node in nodes:
            cleanup.callback(node.close)
        first, *others = await asyncio.gather(*(check_alone(node, ()) for node in nodes), return_exceptions=True)
    assert first is None
    assert [type(other) for other in others] == [RosError] * (count - 1)
    assert f"there is a node /twins{count}/twin already" in str(others[0])


# --- parameters ------------------------------------------------------------------------------

PARAMETERS = (
    NodeParameter("planner", "kairos", "who looks for plans"),
    NodeParameter("limit", 2.5, "seconds", least=0.5),
    NodeParameter("tasks", 8, "so many", least=1),
    NodeParameter("on_failure", "drain", "what is done", choices=("drain", "cancel")),
    NodeParameter("autostart", True, "whether"),
)


def declared(given: dict[str, Any], *overrides: str) -> tuple[dict[str, Any], dict[str, Any], Any]:
    """Return the values, and what the parameter services say about some."""

    async def main():
        arguments = ["--ros-args", *(part for one in overrides for part in ("-p", one))]
        async with node_and_client(args=arguments) as (ros, client):
            values = await ros.ask(partial(declare, ros.node, PARAMETERS, given))
            found = await client.call("pnm/describe_parameters", "rcl_interfaces/srv/DescribeParameters", names=["limit", "on_failure"])
            change = {"name": "limit", "value": {"type": 3, "double_value": 9.0}}
            answer = await client.call("pnm/set_parameters", "rcl_interfaces/srv/SetParameters", parameters=[change])
            return values, found, answer["results"][0]

    return run_bounded(main())


def test_options_come_before_what_ros_says_and_this_before_defaults():
    values, described, changed = declared({"planner": "aries", "tasks": 2}, "planner:=race", "limit:=0.5")
    assert values == {"planner": "aries", "limit": 0.5, "tasks": 2, "on_failure": "drain", "autostart": True}
    limit, on_failure = described["descriptors"]
    assert (limit["description"], limit["read_only"], limit["floating_point_range"][0]["from_value"]) == ("seconds", True, 0.5)
    assert on_failure["additional_constraints"] == "one of drain, cancel"
    assert not changed["successful"], "it is read when the node starts"


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("limit:=5", "the parameter limit is wrong: Trying to set parameter 'limit' to '5' of type 'INTEGER', expecting type 'DOUBLE'"),
        ("limit:=0.1", "the parameter limit is wrong: "),
        ("tasks:=0", "the parameter tasks is wrong: "),
        ("tasks:=many", "the parameter tasks is wrong: "),
        ("on_failure:=canzel", "the parameter on_failure is 'canzel'; expected one of drain, cancel; did you mean 'cancel'?"),
    ],
)
def test_a_parameter_that_is_wrong_is_named(override, said):
    with pytest.raises(InputError) as error:
        declared({}, override)
    assert said in str(error.value)


def test_a_parameter_that_is_not_there_is_warned_about_with_the_nearest_name(caplog):
    declared({}, "planer:=race", "use_sim_time:=false", "qos_overrides./clock.subscription.depth:=1", "far.away:=1")
    said = [record.message for record in caplog.records if "there is no parameter" in record.message]
    assert said[0].startswith("there is no parameter far.away; it is ignored; ")
    assert said[1:] == ["there is no parameter planer; it is ignored; did you mean 'planner'?"]


@pytest.mark.parametrize("is_option", [True, False])
async def test_a_password_is_used_and_not_shown_to_the_nodes_of_the_domain(is_option):
    url = "postgresql://ada:sekret@database/fleet"
    async with RosThread("secretive", args=() if is_option else ["--ros-args", "-p", f"journal:={url}"]) as ros:
        given, journal = {"journal": url} if is_option else {}, NodeParameter("journal", "", "where tasks are kept")
        assert await ros.ask(lambda: declare(ros.node, [journal], given)) == {"journal": url}
        assert ros.node.get_parameter("journal").value == "postgresql://ada@database/fleet"
