"""Scripts in processes of their own, clients whose reports can be awaited, sensors that listen, and nodes.

Everything runs in a ROS domain that belongs to this test process. A killed server stays in its graph for
20 s, so servers never share a name.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from inspect import iscoroutinefunction, signature
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from pnm.knowledge.sensor_file import read_sensing
from pnm.knowledge.sensor_model import Sensing
from pnm.ros.node.ros_thread import RosThread
from tests.support.files import written
from tests.support.pddl.sensed_world import PROBLEM
from tests.support.processes import ros_domain
from tests.support.ros.child_process import OURS, ChildProcess, Within, run_bounded, run_within
from tests.support.ros.middleware import middleware
from tests.support.ros.recording_client import RecordingClient
from tests.support.ros.serving_node import serving_node

# Before the first ROS context of this process, and inherited by all of its servers. Fast DDS 2.14 may block for ever when one of two
# participants of a process is destroyed while it delivers directly to the other.
_own = ExitStack()  # until this process ends
os.environ |= middleware(Path(_own.enter_context(TemporaryDirectory())), _own.enter_context(ros_domain()), within=False)


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem: pytest.Function) -> bool | None:
    """Run a test that is a coroutine for as long as a busy machine needs, and no longer."""
    if not iscoroutinefunction(pyfuncitem.obj):
        return None
    run_bounded(run_within(pyfuncitem.obj, {name: pyfuncitem.funcargs[name] for name in signature(pyfuncitem.obj).parameters}))
    return True


@pytest.fixture(scope="session")
def ros() -> Iterator[RosThread]:
    thread = RosThread("test")
    yield thread
    assert thread.close()


@pytest.fixture(scope="session")
def names() -> Callable[[], str]:
    """Return new names for servers, topics and namespaces."""
    numbers = count()
    return lambda: f"server{next(numbers)}"


@pytest.fixture
def name(names: Callable[[], str]) -> str:
    """A new name."""
    return names()


@pytest.fixture
def two(names: Callable[[], str]) -> Iterator[tuple[RosThread, RosThread]]:
    """A node and another for its client, in a namespace that nobody else has: what was there before is remembered for a while."""
    namespace = names()
    threads = RosThread("pnm", namespace=namespace), RosThread("client", namespace=namespace)
    yield threads
    assert all(thread.close() for thread in threads)


@pytest.fixture
def one(two: tuple[RosThread, RosThread]) -> Within:
    """A node whose tasks do as their goals say, and a client of it."""
    return Within(serving_node(two))


@pytest.fixture
def begin() -> Iterator[Callable[..., ChildProcess]]:
    """Start scripts of `tests.support.ros` that end with the test."""
    scripts: list[ChildProcess] = []

    def start_script(*arguments: str, **environment: str) -> ChildProcess:
        scripts.append(ChildProcess(*arguments, **environment))
        return scripts[-1]

    yield start_script
    for process in scripts:
        process.kill()


@pytest.fixture
def start(begin: Callable[..., ChildProcess], names: Callable[[], str]) -> Callable[..., ChildProcess]:
    """Start action servers that end with the test, by default with new names."""
    return lambda *options, name="", **environment: begin("server", name or names(), *options, **environment)


@pytest.fixture
def sensors(begin: Callable[..., ChildProcess]) -> Callable[..., ChildProcess]:
    """Start publishers and services that sensors hear of."""
    return lambda *which: begin("sensors", *map(json.dumps, which))


@pytest.fixture(scope="session")
def shared(names: Callable[[], str]) -> Iterator[str]:
    """Return the name of an action server for all tests that do it no harm."""
    server = ChildProcess("server", names())
    yield server.name
    server.kill()


@pytest.fixture(scope="session")
def server(names: Callable[[], str]) -> Iterator[str]:
    """Return the name of a server that asks as its goals say, in one process with its like; one thread spins it."""
    process = ChildProcess("asking_server", names())
    yield process.name
    assert OURS not in process.stop()


@pytest.fixture
def connect(ros: RosThread) -> Iterator[Callable[..., RecordingClient]]:
    """Make clients of action servers, with a binding for each name of an action; they end with the test."""
    clients: list[RecordingClient] = []

    def make(thread: RosThread = ros, **options: Any) -> RecordingClient:
        clients.append(RecordingClient(thread, **options))
        return clients[-1]

    yield make
    for client in clients:
        client.ros2.close()


@pytest.fixture
def sensing(tmp_path: Path) -> Callable[[str], Sensing]:
    """Read sensors of the sensed world."""
    return lambda text: read_sensing(written(tmp_path / "sensing.yaml", text), PROBLEM.vocabulary)
