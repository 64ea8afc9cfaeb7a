"""Plant, estimator, controller and reference as separate processes in lockstep; `model` is a file that fit wrote."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the launch description."""
    parameters = [LaunchConfiguration("parameters"), LaunchConfiguration("model")]
    default = PathJoinSubstitution([FindPackageShare("vo2_control"), "config", "loop.yaml"])
    nodes = [
        ("vo2_plant_sim", "plant"),
        ("vo2_estimation", "estimator"),
        ("vo2_control", "controller"),
        ("vo2_control", "reference"),
    ]
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="/vo2", description="Namespace of the loop."),
            DeclareLaunchArgument(
                "parameters", default_value=default, description="Parameter file of the nodes."
            ),
            DeclareLaunchArgument(
                "model",
                default_value=default,
                description="Model file (YAML with model.*) that fit or identifier wrote.",
            ),
            *(
                Node(
                    package=package,
                    executable=executable,
                    namespace=LaunchConfiguration("namespace"),
                    parameters=parameters,
                    output="screen",
                )
                for package, executable in nodes
            ),
        ]
    )
