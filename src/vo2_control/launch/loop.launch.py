"""Plant, estimator, controller and reference as separate processes; `model` is a file that fit wrote."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

NODES = (
    ("vo2_plant_sim", "plant"),
    ("vo2_estimation", "estimator"),
    ("vo2_control", "controller"),
    ("vo2_control", "reference"),
)


def _nodes(context: LaunchContext) -> list[Node]:
    """The nodes; the preset, where one is given, goes before that of the parameter file."""
    given = {
        "time": LaunchConfiguration("time"),
        "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool),
        "clock": ParameterValue(LaunchConfiguration("clock"), value_type=bool),
    }
    if LaunchConfiguration("preset").perform(context):
        given["preset"] = LaunchConfiguration("preset")
    return [
        Node(
            package=package,
            executable=executable,
            namespace=LaunchConfiguration("namespace"),
            parameters=[LaunchConfiguration("parameters"), LaunchConfiguration("model"), given],
            output="screen",
        )
        for package, executable in NODES
    ]


def generate_launch_description() -> LaunchDescription:
    """Return the launch description."""
    default = PathJoinSubstitution([FindPackageShare("vo2_control"), "config", "loop.yaml"])
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="/vo2", description="Namespace of the loop."),
            DeclareLaunchArgument(
                "time",
                default_value="lockstep",
                choices=["lockstep", "wall"],
                description="Simulated time, as fast as the loop answers, or wall time.",
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                description="Whether the nodes' clocks follow /clock, which the plant publishes in lockstep.",
            ),
            DeclareLaunchArgument(
                "clock",
                default_value="true",
                description="Whether the plant publishes /clock in lockstep; false for all loops but one on a host.",
            ),
            DeclareLaunchArgument(
                "parameters", default_value=default, description="Parameter file of the nodes."
            ),
            DeclareLaunchArgument(
                "model",
                default_value=default,
                description="Model file (YAML with model.*) that fit or identifier wrote.",
            ),
            DeclareLaunchArgument(
                "preset",
                default_value="",
                description="Preset or path of a device file; by default what the parameter file says.",
            ),
            OpaqueFunction(function=_nodes),
        ]
    )
