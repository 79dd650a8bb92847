"""A bag through a fresh set of estimators: `ros2 launch squeal_rig replay.launch.py bag:=FOLDER`."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, SetEnvironmentVariable, Shutdown
from launch.conditions import IfCondition
from launch.events.process import ProcessExited
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ESTIMATORS = ("friction_estimator", "stability", "squeal_detector")


def _ended(event: ProcessExited, _context: LaunchContext) -> Shutdown:
    """End the rest with the player. `ros2 launch` itself knows the exit codes 0 and 1 only: 1 where it failed."""
    if event.returncode != 0:
        raise RuntimeError(f"{event.process_name} ended with exit code {event.returncode}")
    return Shutdown(reason="the bag has been played")


def generate_launch_description() -> LaunchDescription:
    """Arguments and processes; everything else is in the parameters file."""
    config = PathJoinSubstitution([FindPackageShare("squeal_rig"), "config", "rig.yaml"])
    parameters = LaunchConfiguration("params_file")
    started = {
        "package": "squeal_rig",
        "namespace": LaunchConfiguration("namespace"),
        "output": "screen",
    }
    # The player begins when the estimators listen, so that their first windows are those of the recorded run.
    bag = {
        "bag": ParameterValue(LaunchConfiguration("bag"), value_type=str),
        "wait_for_subscribers": 10.0,
        "clock": ParameterValue(LaunchConfiguration("clock"), value_type=bool),
    }
    clock = {"use_sim_time": ParameterValue(LaunchConfiguration("clock"), value_type=bool)}
    # Keep to this machine, unless the user has said how far the graph reaches.
    reach = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    domain = EnvironmentVariable("ROS_DOMAIN_ID", default_value="0")
    return LaunchDescription(
        [
            SetEnvironmentVariable(reach, EnvironmentVariable(reach, default_value="LOCALHOST")),
            LogInfo(msg=["ROS_DOMAIN_ID ", domain, ", ", reach, " ", EnvironmentVariable(reach)]),
            DeclareLaunchArgument("bag", description="folder or file to replay"),
            DeclareLaunchArgument("params_file", default_value=config, description="parameters of all nodes"),
            DeclareLaunchArgument("namespace", default_value="", description="the namespace of the recorded rig"),
            DeclareLaunchArgument("clock", default_value="false", description="recorded time on /clock, for all nodes"),
            DeclareLaunchArgument("view", default_value="false", description="small topics for plotting tools"),
            DeclareLaunchArgument("record", default_value="false", description="write the results to a new bag"),
            *(Node(executable=name, parameters=[parameters, clock], **started) for name in ESTIMATORS),
            Node(
                executable="view",
                parameters=[parameters, clock],
                condition=IfCondition(LaunchConfiguration("view")),
                **started,
            ),
            Node(
                executable="recorder",
                parameters=[parameters, clock],
                condition=IfCondition(LaunchConfiguration("record")),
                **started,
            ),
            Node(executable="player", parameters=[parameters, bag], on_exit=_ended, **started),
        ]
    )
