"""`pnm init`: first files for the robot that is there."""

from __future__ import annotations

import re
from pathlib import Path

import click

from planner_bridge.cli.options import FILE, command, force_option, write_files
from pnm.clock import run_async
from pnm.errors import InputError


@click.command(epilog="Example: pnm init my_robot")
@click.argument("folder", type=FILE)
@force_option
@command
def init(folder: Path, force: bool) -> int:
    """Write first files for the robot that is there.

    A domain, a problem, bindings and sensors for what is in the ROS graph, into FOLDER.
    They pass `pnm check`; every line that needs a decision of yours has a comment with the word `decide`.
    """
    name = re.sub(r"\W", "-", folder.resolve().name.lower()).strip("-") or "robot"

    async def look() -> dict[str, str]:
        from pnm.ros.node.ros_thread import RosThread  # here, because rclpy is an extra

        async with RosThread("pnm_init") as ros:
            from pnm.ros.first_files import first_files  # needs rclpy, which is there by now
            from pnm.ros.node.graph import snapshot

            await ros.settled()
            return first_files(await ros.ask(lambda: snapshot(ros.node)), name)

    texts = run_async(look())
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: not a folder, and none can be made there: {error.strerror}") from error
    write_files({folder / name: text for name, text in texts.items()}, force=force)
    decisions = sum(text.count("decide: ") for text in texts.values())
    files = f"{folder / 'domain.pddl'} {folder / 'problem.pddl'}"
    print(f"{decisions} lines need a decision: look for `decide`. Then: pnm check {files} --sensing {folder / 'sensing.yaml'}")
    return 0
