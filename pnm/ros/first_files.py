"""First files for a robot that is there: a domain, a problem, bindings and sensors from what the ROS graph has.

They pass `pnm check`, and every line that needs a decision has a comment. Nothing in them is known but names and types: what
actions need and change is for people to say.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from pnm.core.message_fields import parse_field
from pnm.errors import InputError
from pnm.ros.node.graph import GraphSnapshot
from pnm.ros.node.messages import NUMBER, find_field, import_type

_OURS: Final = "pnm_interfaces/action/"
_POSES: Final = {
    "geometry_msgs/PoseStamped": "{header: {frame_id: map}, pose: {position: {x: 0.0, y: 0.0}, orientation: {w: 1.0}}}",
    "geometry_msgs/Pose": "{position: {x: 0.0, y: 0.0}, orientation: {w: 1.0}}",
    "geometry_msgs/Pose2D": "{x: 0.0, y: 0.0, theta: 0.0}",
    "geometry_msgs/PointStamped": "{header: {frame_id: map}, point: {x: 0.0, y: 0.0}}",
    "geometry_msgs/Point": "{x: 0.0, y: 0.0}",
}
"""Types of goal fields that are places, and what a row of a table for one looks like."""
_NOWHERE: Final[Mapping[str, str]] = {}
_SETTING: Final = re.compile(r"behavior_tree|\w+_id")
"""Names of texts in goals that choose how something is done, and are no objects: those of Nav2."""
_VERDICTS: Final = frozenset({"success", "succeeded", "ok", "is_success"})
_CODES: Final = frozenset({"error_code", "result_code", "return_code", "status", "code", "val"})
_FINE: Final = ("SUCCESS", "SUCCEEDED", "STATUS_SUCCEEDED", "DONE", "OK", "NONE", "NO_ERROR")
"""Constants of codes that mean success."""
_REASONS: Final = frozenset({"message", "error_msg", "error_message", "error_string", "reason"})
_MESSAGE: Final = re.compile(r"\w+/\w+")
_DEPTH: Final = 2
"""The depth to which fields of results are looked at."""


@dataclass
class DraftAction:
    """The lines of one action in the files, being written."""

    name: str
    type: str
    server: str
    parameters: dict[str, str] = field(default_factory=dict)
    """For every parameter its type."""
    goal: list[str] = field(default_factory=list)
    verdict: list[str] = field(default_factory=list)

    @property
    def variables(self) -> str:
        """The parameters as PDDL declares them."""
        return "".join(f" ?{name} - {kind}" for name, kind in self.parameters.items())

    @property
    def fact(self) -> str:
        """The fact that the action has been done."""
        return f"({' '.join((f'done_{self.name}', *(f'?{name}' for name in self.parameters)))})"


def first_files(graph: GraphSnapshot, name: str, places: Mapping[str, str] = _NOWHERE) -> dict[str, str]:
    """Return the texts of the first files by their names; raise `InputError` if of no action server the type is installed.

    Args:
        places: the stamped poses of places, as rows of tables.
    """
    actions, left_out, objects = actions_in(graph, places)
    if not actions:
        found = "; ".join(left_out) or "there is no action server in the ROS graph (is the robot on, and ROS_DOMAIN_ID the same?)"
        raise InputError(f"no files without an action server: {found}")
    sensors, facts = sensors_in(graph, objects.get("robot", []))
    return {
        "domain.pddl": domain_text(name, actions, facts),
        "problem.pddl": problem_text(name, actions, objects),
        "bindings.yaml": bindings_text(actions, left_out),
        "sensing.yaml": sensors,
    }


def actions_in(graph: GraphSnapshot, places: Mapping[str, str]) -> tuple[list[DraftAction], list[str], dict[str, list[str]]]:
    """Return actions, what was left out and why, and the objects by their types."""
    groups: dict[tuple[str, str], list[str]] = {}
    left_out: list[str] = []
    for server, types in sorted(graph.servers.items()):
        if len(types) != 1:
            left_out.append(f"{server} has several types: {', '.join(types)}")
        elif not types[0].startswith(_OURS) or types[0].endswith("/GroundAction"):
            groups.setdefault((server.rpartition("/")[2], types[0]), []).append(server)
    robots = sorted({server.split("/")[1] for servers in groups.values() for server in servers if server.count("/") == 2})
    actions: list[DraftAction] = []
    objects: dict[str, list[str]] = {}
    for (base, type_name), servers in groups.items():
        # One action for all robots needs a server of every robot.
        is_every_robots = bool(robots) and {f"/{robot}/{base}" for robot in robots} <= {*servers}
        alone = [server for server in servers if not (is_every_robots and server.count("/") == 2)]
        for pattern in [*([f"/{{robot}}/{base}"] if is_every_robots else []), *alone]:
            words = (re.sub(r"\W", "_", text) for text in (base, pattern.strip("/").replace("{robot}", "robot")))
            action = DraftAction(next(word for word in words if word not in {other.name for other in actions}), type_name, pattern)
            try:
                action_type = import_type(type_name)
            except InputError as error:
                left_out.append(f"{pattern}: {error.message}")
                continue
            if "{robot}" in pattern:
                action.parameters["robot"] = "robot"
                objects["robot"] = robots
            bind_goal(action, action_type.Goal, objects, places)
            action.verdict.extend(verdict_lines(action_type.Result))
            actions.append(action)
    return actions, left_out, objects


def bind_goal(action: DraftAction, goal: Any, objects: dict[str, list[str]], places: Mapping[str, str]) -> None:
    """Write the lines about the fields of the goal, with parameters and objects for names and places."""
    for name, kind in goal.get_fields_and_field_types().items():
        if name in action.parameters:
            action.goal.append(f'      {name}: "?{name}"')
        elif kind in _POSES:
            action.parameters[name] = "place"
            objects["place"] = [*places] or ["somewhere"]
            turn = "; turned by an angle a: orientation: {z: sin(a/2), w: cos(a/2)}" if "w:" in _POSES[kind] else ""
            action.goal += [f"      {name}:", f'        of: "?{name}"', f"        table:   # decide: a row for every place{turn}"]
            rows = places if "header" in _POSES[kind] and "pose" in _POSES[kind] else {}
            action.goal += [f"          {place}: {rows.get(place, _POSES[kind])}" for place in objects["place"]]
        elif kind.startswith("string") and not _SETTING.fullmatch(name):
            action.parameters[name] = f"{name}_name"
            objects[f"{name}_name"] = [f"some_{name}"]
            action.goal.append(f'      {name}: "?{name}"   # decide: the name of the object is sent; or a constant, or a table')
        elif kind.startswith("string"):
            action.goal.append(f'      {name}: ""   # decide: a constant')
        elif kind == "boolean":
            action.goal.append(f"      {name}: false   # decide: true or false; if it is both, two actions with the same server")
        elif NUMBER.fullmatch(kind):
            action.goal.append(f'      {name}: {getattr(goal(), name)}   # decide: a number, or a function of the domain: "(speed)"')
        else:
            parts = leaves(import_type(kind.replace("/", "/msg/")), 1) if _MESSAGE.fullmatch(kind) else ()
            inner = ", ".join(f"{path}: {its}" for path, its in [*parts][:12])
            action.goal.append(f"      # {name}: {{{inner}}}   # decide: a {kind}; its default is sent")


def verdict_lines(result: Any) -> Iterator[str]:
    """Yield lines about success and reason, as far as names of fields suggest them."""
    found = list(leaves(result, _DEPTH))
    verdict = next((path for path, kind in found if path.rpartition(".")[2] in _VERDICTS and kind == "boolean"), None)
    code = next((path for path, kind in found if path.rpartition(".")[2] in _CODES and "int" in kind), None)
    reason = next((path for path, kind in found if path.rpartition(".")[2] in _REASONS and kind.startswith("string")), None)
    constants = find_field(result, parse_field(code)).constants if code else {}
    fine = next((name for name in _FINE if name in constants), next((name for name, value in constants.items() if value == 0), "0"))
    if verdict:
        yield f"    success: {{field: {verdict}}}   # decide: the server may report failure inside of a success"
    elif code:
        which = ", ".join(f"{name} ({value})" for name, value in list(constants.items())[:12])
        yield f"    success: {{field: {code}, eq: {fine}}}   # decide: which {'of ' + which if which else 'number'} is a success"
    elif found:
        paths = ", ".join(path for path, _ in found[:8])
        yield f"    # success: {{field: ..., eq: ...}}   # decide: only if one of these tells success: {paths}"
    if reason:
        yield f"    reason: {reason}"
    elif words := [f"{name}: {name.lower().replace('_', ' ')}" for name in constants if name != fine]:
        yield f"    reason: {{field: {code}, table: {{{', '.join(words)}}}}}   # decide: the words that people read"


def leaves(message: Any, depth: int) -> Iterator[tuple[str, str]]:
    """Yield the paths and types of fields that are no messages themselves, down to a depth."""
    for name, kind in message.get_fields_and_field_types().items():
        if not _MESSAGE.fullmatch(kind):
            yield name, kind
        elif depth > 1:
            yield from ((f"{name}.{path}", its) for path, its in leaves(import_type(kind.replace("/", "/msg/")), depth - 1))


def sensors_in(graph: GraphSnapshot, robots: list[str]) -> tuple[str, dict[str, str]]:
    """Return the text about sensors, and what the domain declares for them."""
    lines, others, declared = dict[str, str](), list[str](), dict[str, str]()
    for topic, types in sorted(graph.topics.items()):
        parts = topic.strip("/").split("/")
        is_robots = len(parts) == 2 and parts[0] in robots
        pattern, variable = (f"/{{robot}}/{parts[1]}", " ?robot") if is_robots else (topic, "")
        word = re.sub(r"\W", "_", parts[-1]).lower()
        scope = "    for: {robot: robot}\n" if is_robots else ""
        head = f"  - topic: {pattern}\n    type: {types[0]}\n{scope}    facts:\n"
        term = f"({word}{variable}{' - robot' if is_robots else ''})"
        if types == ("std_msgs/msg/Bool",):
            lines[pattern] = f"{head}      - fact: ({word}{variable})   # decide: its name\n        when: {{field: data, eq: true}}\n"
            declared[term] = "predicate"
        elif types == ("sensor_msgs/msg/BatteryState",):
            lines[pattern] = f"{head}      - number: ({word}{variable})\n        field: percentage\n"
            declared[term] = "function"
        elif not types[0].startswith(("rcl_interfaces/", "pnm_interfaces/", "action_msgs/")):
            others.append(f"# {topic}   {types[0]}\n")
    text = "# What topics and services say of the world. Facts that nothing reports are assumed to come true as actions say.\n\n"
    text += f"sensors:\n{''.join(lines.values())}" if lines else "sensors: []\n"
    if others:
        text += "\n# decide: which of these say something that goals or actions are about; docs/guides/sensing.md has the entries\n"
        text += "".join(others)
    return text, declared


def domain_text(name: str, actions: list[DraftAction], sensed: Mapping[str, str]) -> str:
    """Return the domain: nothing is known of what actions need and change."""
    types = " ".join(sorted({kind for action in actions for kind in action.parameters.values()}))
    facts = [f"    {fact}" for fact, kind in sensed.items() if kind == "predicate"]
    facts += [f"    (done_{action.name}{action.variables})" for action in actions]
    numbers = [fact for fact, kind in sensed.items() if kind == "function"]
    text = f"; What the robot can do. Actions may have other names, and more parameters, than their servers.\n(define (domain {name})\n"
    text += f"  (:requirements :adl{' :numeric-fluents' if numbers else ''})\n"
    text += f"  (:types {types})\n" if types else ""
    text += "  (:predicates   ; decide: the facts that matter, such as (at ?place - place)\n" + "\n".join(facts) + ")\n"
    text += f"  (:functions {' '.join(numbers)})\n" if numbers else ""
    for action in actions:
        text += f"\n  (:action {action.name}   ; {action.server}, {action.type}\n    :parameters ({action.variables.strip()})\n"
        text += "    :precondition (and)   ; decide: facts that it needs, such as (at ?from), with ?from among the parameters\n"
        text += f"    :effect (and {action.fact}))   ; decide: facts that it makes true or false, such as (not (at ?from))\n"
    return f"{text})\n"


def problem_text(name: str, actions: list[DraftAction], objects: Mapping[str, list[str]]) -> str:
    """Return the problem: the objects, and the first action for a goal."""
    declared = "\n".join(f"    {' '.join(names)} - {kind}   ; decide: which there are" for kind, names in objects.items())
    first = actions[0]
    chosen = " ".join((f"done_{first.name}", *(objects[kind][0] for kind in first.parameters.values())))
    text = f"; The world and the goal.\n(define (problem first)\n  (:domain {name})\n"
    text += f"  (:objects\n{declared}\n  )\n" if declared else ""
    return text + f"  (:init)   ; decide: initial facts without a sensor\n  (:goal ({chosen})))   ; decide: the goal\n"


def bindings_text(actions: list[DraftAction], left_out: list[str]) -> str:
    """Return the bindings, with what was left out."""
    text = "# Which action server carries out which action, and with which goal.\n\nactions:\n"
    for action in actions:
        server = f'"{action.server}"' if "{" in action.server else action.server
        text += f"  {action.name}:\n    server: {server}\n    type: {action.type}\n"
        is_bound = any(not line.lstrip().startswith("#") for line in action.goal)
        empty = " {}" if not action.goal else " {}   # decide: in place of the braces, some of these lines"
        text += "".join(f"{line}\n" for line in (f"    goal:{'' if is_bound else empty}", *action.goal))
        text += "".join(f"{line}\n" for line in action.verdict)
        text += "    timeout: 60   # decide: seconds after which it has failed\n"
        text += '    resources: ["{robot}"]   # a robot does one thing at a time\n' if "robot" in action.parameters else ""
    return text + "".join(f"# left out: {reason}\n" for reason in left_out)
