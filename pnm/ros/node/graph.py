"""The ROS graph: action servers with their types and processes, topics, services; only to be used on the ROS thread."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from typing import Any

from pnm.errors import InputError, Position

_STATUS = "/_action/status"
_FEEDBACK = "/_action/feedback"


def server_name(node: Any, server: str, position: Position | None = None) -> str:
    """Return the full name of an action server, relative to the node's namespace and remapped; `InputError` if it is not valid in ROS.

    The position is that of the name in a file. Names in ROS have no hyphens, names in PDDL often do: ``pick-up`` becomes ``pick_up``.
    """
    if "\0" in server:  # where `rclpy` would cut the name off: another server would get the goal
        raise InputError(f"not a name for an action server: {server!r} (it contains a zero character)", position)
    topic = server.replace("-", "_") + _STATUS
    return resolved(lambda _: node.resolve_topic_name(topic), server, "an action server", position).removesuffix(_STATUS)


def resolved(resolve: Callable[[str], object], name: str, what: str, position: Position | None) -> str:
    """Return the full name of something; raise an `InputError` if it is not valid in ROS."""
    try:
        return str(resolve(name))
    except Exception as error:
        reason = (str(error).strip().splitlines() or [repr(error)])[0]
        raise InputError(f"not a name for {what}: {name!r} ({reason})", position) from error


def processes(node: Any, server: str) -> frozenset[bytes]:
    """Return the processes that serve the action, by the GID of their status publisher; a killed one stays for its lease of 20 s."""
    return frozenset(bytes(info.endpoint_gid) for info in node.get_publishers_info_by_topic(server + _STATUS))


def types(node: Any, server: str) -> tuple[str, ...]:
    """Return the types of the server; several only if there are several servers of the name.

    They are those of the feedback publishers: the graph's own list of actions has the types that clients expect as well.
    """
    publishers = node.get_publishers_info_by_topic(server + _FEEDBACK)
    return tuple(sorted({info.topic_type.removesuffix("_FeedbackMessage") for info in publishers}))


@dataclass(frozen=True, slots=True)
class GraphSnapshot:
    """The ROS graph at a moment, with its types: action servers, topics that have publishers, services."""

    servers: Mapping[str, tuple[str, ...]]
    topics: Mapping[str, tuple[str, ...]]
    services: Mapping[str, tuple[str, ...]]
    processes: Mapping[str, int] = field(default_factory=dict)
    """The number of processes that offer an action server, including recently killed ones."""


def snapshot(node: Any) -> GraphSnapshot:
    """Return the present ROS graph."""
    named = [name for name, _ in node.get_topic_names_and_types() if "/_" not in name]  # the others are hidden: parts of actions
    topics = {name: {info.topic_type for info in node.get_publishers_info_by_topic(name)} for name in named}
    services = {name: tuple(kinds) for name, kinds in node.get_service_names_and_types() if "/_" not in name and node.count_services(name)}
    known = servers(node)
    counts = {name: len(processes(node, name)) for name in known}
    return GraphSnapshot(known, {name: tuple(sorted(kinds)) for name, kinds in topics.items() if kinds}, services, counts)


def servers(node: Any) -> dict[str, tuple[str, ...]]:
    """Return the types of all action servers by name."""
    from rclpy.action import get_action_names_and_types  # here, because rclpy is an extra

    known = {name: types(node, name) for name, _ in get_action_names_and_types(node)}
    return {name: its_types for name, its_types in known.items() if its_types}


def absence(known: Mapping[str, tuple[str, ...]], server: str, wanted: str | None) -> str:
    """Return why a server cannot be used, in a sentence, with similar ones of the action servers that are there."""
    if server in known:
        there = ", ".join(known[server])
        if wanted and wanted not in known[server]:
            return f"the action server {server} has the type {there}, the binding says {wanted}"
        return f"the action server {server} ({there}) is not ready, or its type is not installed here"
    return f"there is no action server {server}{f' of type {wanted}' if wanted else ''}{similar(server, known)}"


def similar(name: str, known: Iterable[str]) -> str:
    """Return the end of a sentence about a name that is not in the graph: which ones are near, or what there is at all."""
    names = sorted(known)
    if not names:
        return ", nor any other in the ROS graph (is ROS_DOMAIN_ID the same?)"
    near = get_close_matches(name, names, n=4, cutoff=0.5)
    near += [other for other in names if other not in near and other.rsplit("/", 1)[-1] == name.rsplit("/", 1)[-1]]
    return f"; {'similar' if near else 'there'} are {', '.join(near or names[:8])}"
