"""Servers in processes of their own, and a client whose reports can be awaited.

Everything runs in a ROS domain that belongs to this test process. A killed server stays in its graph for
20 s, so servers never share a name.
"""

from __future__ import annotations

import asyncio
import os
import select
import subprocess
import sys
from collections.abc import Awaitable, Callable, Coroutine, Iterator
from contextlib import ExitStack
from itertools import count
from typing import Any
from uuid import UUID

import pytest

from pnm.core.machine.bindings import Binding
from pnm.ros.node.ros_thread import RosThread
from tests.support.files import ROOT
from tests.support.processes import LIMIT, ros_domain
from tests.support.ros.child_process import ORDERLY, ChildProcess
from tests.support.ros.recording_client import RecordingClient

# Fast DDS 2.14 may block for ever when one of two participants of a process is destroyed while it delivers directly to the other.
os.environ.setdefault("FASTRTPS_DEFAULT_PROFILES_FILE", str(ROOT / "tests/pnm/ros/one_process.xml"))

# Before the first ROS context of this process, and inherited by all of its servers. Killed processes leave
# shared memory behind, so everything goes over UDP.
_own = ExitStack()  # until this process ends
os.environ["ROS_DOMAIN_ID"] = str(_own.enter_context(ros_domain()))
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["FASTDDS_BUILTIN_TRANSPORTS"] = "UDPv4"


class ServerProcess:
    """An action server in another process."""

    def __init__(self, *arguments: str, **environment: str) -> None:
        command = [sys.executable, "-m", "tests.support.ros.server", *arguments]
        self.process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, env={**os.environ, **environment})
        assert self.process.stdout is not None
        ready, _, _ = select.select([self.process.stdout], [], [], LIMIT)
        assert ready, "the server did not start"
        assert self.process.stdout.readline() == "ready\n"

    def kill(self) -> None:
        """End the process at once, as a crash would."""
        self.process.kill()
        self.process.communicate(timeout=LIMIT)

    def stop(self) -> None:
        """End the process in order; it is killed if the middleware in it does not come to its end, as happens once in a hundred times."""
        self.process.terminate()
        try:
            self.process.communicate(timeout=ORDERLY)
        except subprocess.TimeoutExpired:
            self.kill()


@pytest.fixture(scope="session")
def ros() -> Iterator[RosThread]:
    thread = RosThread("test")
    yield thread
    assert thread.close()


@pytest.fixture(scope="session")
def names() -> Callable[[], str]:
    """Return new names for servers."""
    numbers = count()
    return lambda: f"server{next(numbers)}"


@pytest.fixture
def start() -> Iterator[Callable[..., ServerProcess]]:
    """Start servers that end with the test."""
    servers: list[ServerProcess] = []

    def begin(*arguments: str, **environment: str) -> ServerProcess:
        servers.append(ServerProcess(*arguments, **environment))
        return servers[-1]

    yield begin
    for server in servers:
        server.kill()


@pytest.fixture
def begin() -> Iterator[Callable[..., ChildProcess]]:
    """Start scripts of this folder that end with the test."""
    scripts: list[ChildProcess] = []

    def start_script(*arguments: str) -> ChildProcess:
        scripts.append(ChildProcess(*arguments))
        return scripts[-1]

    yield start_script
    for process in scripts:
        process.kill()


@pytest.fixture(scope="session")
def shared(names: Callable[[], str]) -> Iterator[str]:
    """Return the name of a server for all tests that do it no harm."""
    name = names()
    server = ServerProcess(name)
    yield name
    server.kill()


Scenario = Callable[[RecordingClient], Coroutine[Any, Any, None]]


@pytest.fixture
def with_client(ros: RosThread) -> Callable[..., None]:
    """Run a test's coroutine with a client that has the given bindings."""

    def run(
        scenario: Scenario, limit: float = LIMIT, ended: Callable[[UUID], Awaitable[object]] | None = None, **bindings: Binding
    ) -> None:
        async def whole() -> None:
            client = RecordingClient(ros, ended, **bindings)
            try:
                await asyncio.wait_for(scenario(client), limit)
            finally:
                client.ros2.close()

        asyncio.run(whole())

    return run
