"""Starts the node that takes goals; its parameters are arguments, `ros2 launch pnm serve.launch.py --show-args` lists them."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue

from planner_bridge.node.options import PARAMETERS
from pnm.ros.node.parameters import NodeParameter


def generate_launch_description() -> LaunchDescription:
    """Return the node, and an argument for each of its parameters."""
    parameters = {one.name: ParameterValue(LaunchConfiguration(one.name), value_type=type(one.default)) for one in PARAMETERS}
    node = LifecycleNode(
        package="pnm",
        executable="serve",
        name=LaunchConfiguration("name"),
        namespace=LaunchConfiguration("namespace"),
        parameters=[parameters],
        output="screen",
    )
    return LaunchDescription(
        [
            DeclareLaunchArgument("name", default_value="pnm", description="name of the node"),
            DeclareLaunchArgument("namespace", default_value="", description="namespace of the node, such as a robot's"),
            *map(_argument, PARAMETERS),
            node,
        ]
    )


def _argument(parameter: NodeParameter) -> DeclareLaunchArgument:
    default = str(parameter.default).lower() if isinstance(parameter.default, bool) else str(parameter.default)
    choices = list(parameter.choices) or None
    return DeclareLaunchArgument(parameter.name, default_value=default, description=parameter.description, choices=choices)
