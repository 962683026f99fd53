"""`pnm serve`: options that are the parameters of a node, and arguments for ROS 2 behind them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import click

from planner_bridge.cli.options import command, options
from planner_bridge.node.options import PARAMETERS
from pnm.ros.node.parameters import NodeParameter, ParameterValue

ROS_ARGUMENTS: Final = "--ros-args"


class RosCommand(click.Command):
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


@click.command(cls=RosCommand)
@click.argument("domain", required=False)
@click.argument("problem", required=False)
@options(*(_option(parameter) for parameter in PARAMETERS if parameter.name not in ("domain", "problem")))
@command
def serve(**given: ParameterValue | None) -> int:
    """Take goals over ROS 2, and pursue them until interrupted: the node that a robot runs.

    Offers actions for goals of DOMAIN and PROBLEM, and for each plan of a world. What follows --ros-args is for ROS 2;
    parameters that are given there come before options.
    """
    # here, because these take their time to import, which `pnm serve --help` need not wait for
    from planner_bridge.cli.console import SafeConsole
    from planner_bridge.cli.node_console import NodeConsole
    from planner_bridge.node.serve import serve

    arguments = click.get_current_context().meta[ROS_ARGUMENTS]
    serve({name: value for name, value in given.items() if value is not None}, arguments, NodeConsole(SafeConsole()))
    return 0
