"""The live page of a running loop; `namespace` and `preset` are the loop's."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    """Return the launch description."""
    clock = {"use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)}
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="/vo2", description="Namespace of the loop."),
            DeclareLaunchArgument("preset", default_value="integrated", description="Device of the loop."),
            DeclareLaunchArgument("port", default_value="8765", description="Port on 127.0.0.1, 0 for any."),
            DeclareLaunchArgument(
                "model", default_value="", description="Model file to compare with, or none."
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                description="Whether the node's clock follows /clock, which the plant publishes in lockstep.",
            ),
            Node(
                package="vo2_interface",
                executable="live",
                namespace=LaunchConfiguration("namespace"),
                parameters=[
                    {name: LaunchConfiguration(name) for name in ("preset", "port", "model")},
                    clock,
                ],
                output="screen",
            ),
        ]
    )
