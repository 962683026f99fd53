"""Whether a managed node is the only one of its name. Of several that start at the same time the one that was started first goes on."""

from __future__ import annotations

from typing import Final

from pnm.errors import RosError
from pnm.ros.node.graph import processes
from pnm.ros.node.managed_node import STARTED
from pnm.ros.node.ros_thread import RosThread

_ADVICE: Final = "(one that was killed is remembered for up to 20 s)"


async def check_alone(ros: RosThread, servers: tuple[str, ...]) -> None:
    """Check that no other process has the name of the node, or of one of these action servers, or that it was started later.

    Raises:
        RosError: there is one.
    """

    def is_first() -> bool:
        """Return whether all other nodes of the name, if there are any, show that they were started later."""
        for name in servers:
            if processes(ros.node, name):
                raise RosError(f"there is an action server {name} already; another process offers it {_ADVICE}")
        own = (ros.node.get_name(), ros.node.get_namespace())
        prefix = ros.node.resolve_topic_name(STARTED)
        starts = [topic for topic, _ in ros.node.get_topic_names_and_types() if topic.startswith(prefix)]
        rivals = ros.node.get_node_names_and_namespaces().count(own) - 1
        return rivals < 1 or bool(len(starts) > rivals and min(starts) == prefix + ros.node.start)

    for _ in range(2):  # of a node that is being started, its name may be seen before its start
        await ros.settled()
        if await ros.ask(is_first):
            return
    name = await ros.ask(ros.node.get_fully_qualified_name)
    raise RosError(f"there is a node {name} already; is this being served? {_ADVICE}")
