"""Plant, estimator and identifier; call `/vo2/identifier/start` (std_srvs/srv/Trigger) to identify the device."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue


def generate_launch_description() -> LaunchDescription:
    """Return the launch description."""
    space = LaunchConfiguration("namespace")
    preset = LaunchConfiguration("preset")
    seed = ParameterValue(LaunchConfiguration("seed"), value_type=int)
    model = ParameterValue(LaunchConfiguration("model_file"), value_type=str)
    # `time` to all of them: how a node without this parameter joins the graph goes by it too
    clock = {
        "time": LaunchConfiguration("time"),
        "use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool),
    }
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="/vo2", description="Namespace of the loop."),
            DeclareLaunchArgument(
                "preset", default_value="integrated", description="Preset or path of a device file."
            ),
            DeclareLaunchArgument("seed", default_value="1", description="Seed of the simulated device."),
            DeclareLaunchArgument(
                "time",
                default_value="lockstep",
                choices=["lockstep", "wall"],
                description="Simulated time, as fast as the identifier answers, or wall time.",
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                description="Whether the nodes' clocks follow /clock, which the plant publishes in lockstep.",
            ),
            DeclareLaunchArgument(
                "model_file", default_value="model.yaml", description="Where the model is saved."
            ),
            Node(
                package="vo2_plant_sim",
                executable="plant",
                namespace=space,
                parameters=[{"preset": preset, "seed": seed}, clock],
                output="screen",
            ),
            Node(
                package="vo2_estimation",
                executable="estimator",
                namespace=space,
                parameters=[{"preset": preset}, clock],
                output="screen",
            ),
            Node(
                package="vo2_identification",
                executable="identifier",
                namespace=space,
                parameters=[{"preset": preset, "model_file": model}, clock],
                output="screen",
            ),
        ]
    )
