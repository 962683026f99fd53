"""`pnm serve`: options that are the parameters of a node, and arguments for ROS 2 behind them."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import click

from planner_bridge.cli.options import FILE, ViewingCommand, announce, command, controlled_by, controls_option, options, view_option
from planner_bridge.node.options import PARAMETERS
from pnm.errors import InputError
from pnm.files.yaml_nodes import load_yaml
from pnm.journal.kept import Fenced
from pnm.ros.node.parameters import NodeParameter, ParameterValue

ROS_ARGUMENTS: Final = "--ros-args"
FENCED: Final = 3
"""The exit status of a node that may not write its journal any more; started again, it stands by, or goes on with what is kept."""


class RosCommand(ViewingCommand):
    """A command whose arguments from ``--ros-args`` on are for ROS 2, as `ros2 run` and `ros2 launch` pass them."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Split off the arguments for ROS 2."""
        end = args.index(ROS_ARGUMENTS) if ROS_ARGUMENTS in args else len(args)
        ctx.meta[ROS_ARGUMENTS] = args[end:]
        return super().parse_args(ctx, args[:end])


def _option(parameter: NodeParameter) -> Callable[[Any], Any]:
    """Return the option for a parameter. It has no default: only what is given overrides that of the parameter."""
    name = (parameter.option or parameter.name).replace("_", "-")
    default = f"  [default: {parameter.default}]" if parameter.default not in ("", True) else ""
    about: dict[str, Any] = {"help": parameter.description + default, "default": None}
    match parameter.default:
        case bool():
            return click.option(f"--{name}/--no-{name}", parameter.name, **about)
        case int():
            return click.option(f"--{name}", parameter.name, type=click.IntRange(int(parameter.least)), **about)
        case float():
            return click.option(f"--{name}", parameter.name, type=click.FloatRange(parameter.least), **about)
        case _ if parameter.choices:
            return click.option(f"--{name}", parameter.name, type=click.Choice(parameter.choices), **about)
        case _:
            return click.option(f"--{name}", parameter.name, metavar="TEXT", **about)


@click.command(cls=RosCommand, epilog="Example: pnm serve domain.pddl problem.pddl --planner-timeout 5 --ros-args -r __ns:=/robot1")
@click.argument("domain", required=False)
@click.argument("problem", required=False)
@click.option("--params-file", "files", multiple=True, type=FILE, help="a ROS file of parameters; may be repeated")
@options(*(_option(parameter) for parameter in PARAMETERS if parameter.name not in ("domain", "problem")))
@view_option
@controls_option
@command
def serve(files: tuple[Path, ...], view: int | None, controls: bool, **given: ParameterValue | None) -> int:
    """Take goals over ROS 2 until interrupted.

    This is the node of a robot. It offers actions for goals of DOMAIN and PROBLEM, and for each plan of a world.
    With --view, a page shows its journal; with --view-controls, people also send goals and control tasks there.
    Arguments after --ros-args are for ROS 2. Options override parameters that are given there, and files of parameters.
    """
    # here, because these take their time to import, which `pnm serve --help` need not wait for
    from planner_bridge.cli.console import SafeConsole
    from planner_bridge.cli.run_console import NodeConsole, NodePage
    from planner_bridge.node.node_journal import NONE
    from planner_bridge.node.node_log import NodeObserver
    from planner_bridge.node.serve import serve
    from planner_bridge.view.commands import Controlled
    from planner_bridge.view.serving import PageProcess
    from pnm.core.broadcast import broadcast

    for file in files:
        load_yaml(file)  # which says where it is wrong; what it means is for ROS
    named = [part for file in files for part in ("--params-file", str(file))]
    arguments = [ROS_ARGUMENTS, *named, *click.get_current_context().meta[ROS_ARGUMENTS]]
    chosen = {name: value for name, value in given.items() if value is not None}
    journal = str(chosen.get("journal", ""))
    if view is not None and journal == NONE:
        raise InputError(f"--view shows the journal; expected one, and not --journal {NONE}")
    controlled = controlled_by(view, Controlled.NODE, controls=controls)
    console: NodeObserver = NodeConsole(SafeConsole())
    try:
        if view is None:
            serve(chosen, arguments, console)
        else:
            with PageProcess(view, controlled) as page:
                announce(page)
                serve(chosen, arguments, broadcast(NodeObserver, (console, NodePage(page, journal))))
    except Fenced as error:
        print(error, file=sys.stderr)
        return FENCED
    return 0
