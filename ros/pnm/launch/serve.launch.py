"""Starts the node that takes goals; its parameters are arguments, `ros2 launch pnm serve.launch.py --show-args` lists them."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue

from planner_bridge.node.options import PARAMETERS
from pnm.ros.node.parameters import NodeParameter


def generate_launch_description() -> LaunchDescription:
    """Return the node, and an argument for each of its parameters."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("name", default_value="pnm", description="name of the node"),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of the node, such as a robot's"),
            DeclareLaunchArgument("params_file", default_value="", description="file of parameters; arguments come before it"),
            *map(_argument, PARAMETERS),
            OpaqueFunction(function=_node),
        ]
    )


def _node(context: LaunchContext) -> list[LifecycleNode]:
    """Return the node, with the arguments that are given; all others are left to the file of parameters, and to the node."""
    values = {one: context.launch_configurations[one.name] for one in PARAMETERS}
    given = {
        one.name: ParameterValue(LaunchConfiguration(one.name), value_type=type(one.default))
        for one, value in values.items()
        if value != _default(one)
    }
    file = context.launch_configurations["params_file"]
    node = LifecycleNode(
        package="pnm",
        executable="serve",
        name=LaunchConfiguration("name"),
        namespace=LaunchConfiguration("namespace"),
        parameters=[*([file] if file else []), *([given] if given else [])],
        output="screen",
    )
    return [node]


def _default(parameter: NodeParameter) -> str:
    return str(parameter.default).lower() if isinstance(parameter.default, bool) else str(parameter.default)


def _argument(parameter: NodeParameter) -> DeclareLaunchArgument:
    choices = list(parameter.choices) or None
    return DeclareLaunchArgument(parameter.name, default_value=_default(parameter), description=parameter.description, choices=choices)
