"""`pnm init`, `pnm check` and `pnm odds`: what there is before a robot moves."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import click
from rich.text import Text

from planner_bridge.cli import options
from planner_bridge.cli.console import SafeConsole
from planner_bridge.model.determinization import untold
from planner_bridge.model.guards import relied_on
from planner_bridge.pipeline.achieve import readiness, readiness_for_plan
from planner_bridge.pipeline.loading import bindings_for, rates_for
from planner_bridge.pipeline.roll_outs import SECONDS, odds_of_goal, odds_of_plan
from planner_bridge.tasks.settings import DEFAULTS, Settings
from pnm.actions.bindings_file import read_bindings
from pnm.clock import run_async
from pnm.core.machine.bindings import NO_BINDINGS
from pnm.core.readiness import Readiness, ReadyState
from pnm.errors import InputError
from pnm.files.yaml_nodes import MAX_BYTES

_STYLES: Final = {ReadyState.READY: "green", ReadyState.UNFIT: "bold red"}


TEMPLATES: Final = ("dialogue", "nav2", "pick-place", "two-robots-door-battery")
"""The names of small worlds that run in simulation at once."""


@click.command(epilog="Examples: pnm init my_robot; pnm init my_robot --template nav2")
@click.argument("folder", type=options.FILE)
@click.option("--template", type=click.Choice(TEMPLATES), help="write a small world that runs in simulation at once, to be edited")
@click.option(
    "--poses", type=options.FILE, help="a file of places and their poses: `shelf: [x, y, yaw]` or `shelf: {pixel: [column, row]}`"
)
@click.option("--map", "map_file", type=options.FILE, help="the YAML file of a map of Nav2, for pixels, and on which all poses must be")
@options.force_option
@options.command
def init(folder: Path, template: str | None, poses: Path | None, map_file: Path | None, force: bool) -> int:
    """Write first files for a running robot.

    Writes a domain, a problem, bindings and sensors for the ROS graph into FOLDER.
    They pass `pnm check`. Every line that needs your decision has a comment with the word `decide`.
    With --template, writes files of that world instead, without a look at the ROS graph.
    """
    if (template and poses) or (map_file and not poses):
        raise InputError("--map belongs to --poses, and poses to the files for a running robot; expected --poses, and no --template")
    if template:
        from planner_bridge.cli.demo import examples  # here, because robots need no examples

        parts = sorted((examples() / "domains" / "templates" / template).iterdir())
        _write({part.name: part.read_text(encoding="utf-8") for part in parts}, folder, force=force)
        world = f"{folder / 'domain.pddl'} {folder / 'problem.pddl'}"
        print(f"next: pnm run {world}; the same over ROS 2: pnm simulate {world}, and in another terminal pnm run {world} --actions ros2")
        return 0
    name = re.sub(r"\W", "-", folder.resolve().name.lower()).strip("-") or "robot"

    places: dict[str, str] = {}
    if poses:
        from pnm.actions.pose_table import read_map, read_poses  # here, because most robots have their poses in no file

        places = {place: pose.row for place, pose in read_poses(poses, read_map(map_file) if map_file else None).items()}

    async def look() -> dict[str, str]:
        from pnm.ros.node.ros_thread import RosThread  # here, because rclpy is an extra

        async with RosThread("pnm_init") as ros:
            from pnm.ros.first_files import first_files  # needs rclpy, which is there by now
            from pnm.ros.node.graph import snapshot

            await ros.settled()
            return first_files(await ros.ask(lambda: snapshot(ros.node)), name, places)

    texts = run_async(look())
    _write(texts, folder, force=force)
    decisions = sum(text.count("decide: ") for text in texts.values())
    files = f"{folder / 'domain.pddl'} {folder / 'problem.pddl'}"
    print(f"{decisions} lines need a decision: look for `decide`. Then: pnm check {files} --sensing {folder / 'sensing.yaml'}")
    return 0


def _write(texts: Mapping[str, str], folder: Path, *, force: bool) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: not a folder, and none can be made there: {error.strerror}") from error
    options.write_files({folder / name: text for name, text in texts.items()}, force=force)


@click.command(epilog="Examples: pnm pose add shelf; pnm pose add dock --topic /r1/amcl_pose --bindings r1.yaml")
@click.argument("what", type=click.Choice(["add"]))
@click.argument("place")
@click.option("--topic", default="", help="where the robot's pose is published; by default the only such topic, or amcl_pose")
@click.option("--bindings", type=options.FILE, default=Path("bindings.yaml"), show_default=True, help="the file with the table of poses")
@click.option("--action", default="", help="the action whose table it is; by default all that have one")
@click.option("--seconds", type=options.Seconds(0), default=10.0, show_default=True, help="seconds for a message to come")
@options.command
def pose(what: str, place: str, topic: str, bindings: Path, action: str, seconds: float) -> int:
    """Write where a robot is now as the pose of a place.

    Drive it there first. PLACE gets a row in the table of poses of the bindings, in place of that it has; the rest of the file stays.
    The topic has messages of geometry_msgs PoseStamped or PoseWithCovarianceStamped, or of nav_msgs Odometry.
    """
    from pnm.actions.pose_table import Pose, with_row  # here, because most commands write no poses
    from pnm.files.text import read_text

    if not re.fullmatch(r"[A-Za-z][\w-]*", place):
        raise InputError(f"{place!r} cannot be a place of PDDL; expected letters, digits, - and _")

    def written(row: str) -> str:
        return with_row(read_text(bindings, MAX_BYTES), str(bindings), place, row, action)

    written(Pose(0.0, 0.0).row)  # says what is wrong before the robot is listened to

    async def hear() -> Pose:
        from pnm.ros.node.ros_thread import RosThread  # here, because rclpy is an extra

        async with RosThread("pnm_pose") as ros:
            from pnm.ros.node_client import heard_pose  # needs rclpy, which is there by now

            return Pose(*await heard_pose(ros, topic, seconds))

    found = run_async(hear())
    options.write_files({bindings: written(found.row)}, force=True)
    print(f"{place}: {found.row}")
    return 0


@click.command(epilog="Example: pnm check domain.pddl problem.pddl --sensing sensing.yaml")
@options.files_or_plan
@options.set_option
@options.bindings_option
@options.sensing_option
@click.option("--wait", type=options.Seconds(0), default=0.0, help="seconds for missing servers and sensors to appear")
@options.as_json_option
@options.command
def check(
    *,
    domain: Path | None,
    problem: Path | None,
    plan_file: Path | None,
    name: str | None,
    given: tuple[str, ...],
    bindings: Path | None,
    sensing: Path | None,
    wait: float,
    as_json: bool,
) -> int:
    """Check servers and sensors in the ROS graph.

    Sends nothing. Exit status: 0 everything is ready, 1 something is missing, there twice or silent, 2 something can never work.
    """
    chosen = options.chosen_files(domain, problem, plan_file)
    if isinstance(chosen, Path):
        sensors = options.sensing_in(sensing, None)
        settings = Settings(bindings=read_bindings(bindings) if bindings else NO_BINDINGS, sensing=sensors)
        rows = readiness_for_plan(chosen, name, settings, wait, options.plan_parameters(given))
    else:
        loaded = options.problem_in(*chosen)
        sensors = options.sensing_in(sensing, loaded.vocabulary)
        settings = Settings(bindings=bindings_for(chosen[0], bindings, loaded.vocabulary), sensing=sensors)
        rows = readiness(loaded, settings, wait)
        for resource, actions in relied_on(loaded.domain, settings.bindings).items():
            advice = f"only this keeps calls of {' and '.join(actions)} apart: the domain would have them at the same time"
            rows += (Readiness("resource", resource, "", ReadyState.READY, advice),)
        seen = sensors.names if sensing else frozenset(loaded.domain.fluents)
        unseen = frozenset(loaded.domain.fluents.keys() - seen) | settings.bindings.assumed
        for action, ways, names in untold(loaded, settings.bindings, unseen):
            advice = f"nothing tells {' and '.join(ways)} apart: no test of the result, and no sensor of {', '.join(names)}"
            rows += (Readiness("outcomes", action, "", ReadyState.READY, advice),)
    if as_json:
        options.print_json({"ready": all(row.state is ReadyState.READY for row in rows), "rows": [row.as_json() for row in rows]})
    else:
        print_table(SafeConsole(), rows)
    states = {row.state for row in rows}
    return 2 if ReadyState.UNFIT in states else 1 if states - {ReadyState.READY} else 0


def print_table(console: SafeConsole, rows: Sequence[Readiness]) -> None:
    """Print a line for each row; the advice comes last, because it may be long."""
    lines = [("what", "name", "type", "state", "what to do")]
    lines += [(row.what, row.name, row.type, row.state.value, row.where + row.advice) for row in rows]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    for number, (*parts, advice) in enumerate(lines):
        *plain, state = (part.ljust(width) for part, width in zip(parts, widths, strict=False))
        style = _STYLES.get(rows[number - 1].state, "yellow") if number else ""
        line = Text("  ".join((*plain, ""))).append(state, style).append(f"  {advice}")
        line.rstrip()
        console.print(line)


# --- odds -----------------------------------------------------------------------------------------
# The chance and the time of a goal.


@click.command(epilog="Example: pnm odds domain.pddl problem.pddl --faults faults.yaml")
@options.files_or_plan
@options.set_option
@options.bindings_option
@options.faults_option
@options.rates_option
@options.planning
@click.option(
    "--replans", type=click.IntRange(0), default=DEFAULTS.limits.replans, show_default=True, help="new machines after the first, at most"
)
@click.option("--seconds", type=options.Seconds(0), default=SECONDS, show_default=True, help="seconds of processor time for roll-outs")
@options.as_json_option
@options.command
def odds(
    *,
    domain: Path | None,
    problem: Path | None,
    plan_file: Path | None,
    name: str | None,
    given: tuple[str, ...],
    bindings: Path | None,
    faults: Path | None,
    rates: Path | None,
    planner: str,
    planner_timeout: float,
    improve: float | None,
    replans: int,
    seconds: float,
    as_json: bool,
) -> int:
    """Say how likely and how soon a goal is reached.

    The chance is exact as long as nothing is planned anew. What new plans add is found by roll-outs: runs of the machine on simulated
    robots. Chances of single attempts are those that --faults declares for simulated robots, or else the learned ones of --rates; what
    is not known is assumed. What follows the outcomes of actions that have several is as their policy says.
    """
    chosen = options.chosen_files(domain, problem, plan_file)
    settings = Settings(planner, planner_timeout, limits=replace(DEFAULTS.limits, replans=replans))
    if isinstance(chosen, Path):
        settings = replace(settings, bindings=bindings_for(None, bindings, None), learned=rates_for(None, rates))
        known, parameters = options.faults_in(faults, None), options.plan_parameters(given)
        found = odds_of_plan(chosen, name, parameters, settings, known, seconds=seconds)
    else:
        if name or given:
            raise InputError("--name and --set belong to hand-written plans; expected --plan and a file")
        loaded, result, bound, learned = options.planned(chosen, bindings, rates, planner, planner_timeout, improve)
        if result.plan is None:
            SafeConsole(stderr=as_json).print_reason("no plan:", result.reason)
            if as_json:
                options.print_json({"chance": None, "alone": None, "with_new_plans": None, "reason": result.reason})
            return 1
        settings = replace(settings, bindings=bound or DEFAULTS.bindings, learned=learned or DEFAULTS.learned)
        known = options.faults_in(faults, loaded.vocabulary)
        found = odds_of_goal(loaded, result.plan, settings, known, policy=result.policy, seconds=seconds)
    if as_json:
        options.print_json(found.as_json())
    else:
        print(*found.lines(), sep="\n")
    return 0
