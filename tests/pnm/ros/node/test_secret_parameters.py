"""Parameters are read by every node of the domain: one that has a password is shown without it."""

from __future__ import annotations

import asyncio

from pnm.ros.node.parameters import NodeParameter, declare
from pnm.ros.node.ros_thread import RosThread

URL = "postgresql://ada:sekret@database/fleet"
JOURNAL = NodeParameter("journal", "", "where tasks are kept")


def test_a_password_is_used_and_not_shown() -> None:
    async def use(given: dict[str, bool | int | float | str], arguments: list[str]) -> None:
        async with RosThread("secretive", args=arguments) as ros:
            values = await ros.ask(lambda: declare(ros.node, [JOURNAL], given))
            assert values == {"journal": URL}
            assert ros.node.get_parameter("journal").value == "postgresql://ada@database/fleet"

    asyncio.run(use({"journal": URL}, []))
    asyncio.run(use({}, ["--ros-args", "-p", f"journal:={URL}"]))
