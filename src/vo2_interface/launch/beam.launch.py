"""The bending cantilever as TF: robot_state_publisher takes the measurement as its joint states; add RobotModel in RViz."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import Command, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the launch description."""
    namespace = LaunchConfiguration("namespace")
    urdf = PathJoinSubstitution([FindPackageShare("vo2_interface"), "urdf", "cantilever.urdf"])
    description = ParameterValue(Command(["cat ", urdf]), value_type=str)
    sim_time = ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="/vo2", description="Namespace of the loop."),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                description="Whether the node's clock follows /clock, which the plant publishes in lockstep.",
            ),
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                namespace=namespace,
                parameters=[
                    {"robot_description": description, "publish_frequency": 50.0, "use_sim_time": sim_time}
                ],
                remappings=list({"joint_states": "measurement"}.items()),
            ),
        ]
    )
