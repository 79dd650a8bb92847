"""The virtual or real rig with its estimators: `ros2 launch squeal_rig rig.launch.py [record:=true]`."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare

ALWAYS = ("rig", "friction_estimator", "stability", "squeal_detector")


def generate_launch_description() -> LaunchDescription:
    """Arguments and processes; everything else is in the parameters file."""
    config = PathJoinSubstitution([FindPackageShare("squeal_rig"), "config", "rig.yaml"])
    started = {
        "package": "squeal_rig",
        "namespace": LaunchConfiguration("namespace"),
        "parameters": [LaunchConfiguration("params_file")],
        "output": "screen",
    }
    return LaunchDescription(
        [
            DeclareLaunchArgument("params_file", default_value=config, description="parameters of all nodes"),
            DeclareLaunchArgument("namespace", default_value="", description="moves the whole rig"),
            DeclareLaunchArgument("record", default_value="false", description="write a bag"),
            *(Node(executable=name, **started) for name in ALWAYS),
            Node(executable="recorder", condition=IfCondition(LaunchConfiguration("record")), **started),
        ]
    )
