"""The virtual or real rig with its estimators: `ros2 launch squeal_rig rig.launch.py [record:=true]`."""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo, SetEnvironmentVariable, Shutdown
from launch.conditions import IfCondition
from launch.events.process import ProcessExited
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ESTIMATORS = ("friction_estimator", "stability", "squeal_detector")
FOR_PEOPLE = ("view", "page", "foxglove")


def _ended(event: ProcessExited, _context: LaunchContext) -> Shutdown:
    """End the rest with the rig. `ros2 launch` itself knows the exit codes 0 and 1 only: 1 where it failed."""
    if event.returncode != 0:
        raise RuntimeError(f"{event.process_name} ended with exit code {event.returncode}")
    return Shutdown(reason="the rig has ended")


def generate_launch_description() -> LaunchDescription:
    """Arguments and processes; everything else is in the parameters file."""
    config = PathJoinSubstitution([FindPackageShare("squeal_rig"), "config", "rig.yaml"])
    started = {
        "package": "squeal_rig",
        "namespace": LaunchConfiguration("namespace"),
        "output": "screen",
    }
    parameters = LaunchConfiguration("params_file")
    # Where real_time_factor is not 1 the rig makes the clock and all others follow it.
    clock = {"use_sim_time": ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)}
    # The rig moves only while its supervisor is there.
    required = {"supervisor_required": ParameterValue(LaunchConfiguration("supervisor"), value_type=bool)}
    # Keep to this machine, unless the user has said how far the graph reaches.
    reach = "ROS_AUTOMATIC_DISCOVERY_RANGE"
    domain = EnvironmentVariable("ROS_DOMAIN_ID", default_value="0")
    return LaunchDescription(
        [
            SetEnvironmentVariable(reach, EnvironmentVariable(reach, default_value="LOCALHOST")),
            LogInfo(msg=["ROS_DOMAIN_ID ", domain, ", ", reach, " ", EnvironmentVariable(reach)]),
            DeclareLaunchArgument("params_file", default_value=config, description="parameters of all nodes"),
            DeclareLaunchArgument("namespace", default_value="", description="moves the whole rig"),
            DeclareLaunchArgument("view", default_value="false", description="small topics for plotting tools"),
            DeclareLaunchArgument("page", default_value="false", description="the operator's page"),
            DeclareLaunchArgument("foxglove", default_value="false", description="a server for Foxglove"),
            DeclareLaunchArgument("record", default_value="false", description="write a bag"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="true: follow the rig's /clock"),
            DeclareLaunchArgument("supervisor", default_value="true", description="false: nobody watches the rig"),
            Node(executable="rig", parameters=[parameters, required], on_exit=_ended, **started),
            *(Node(executable=name, parameters=[parameters, clock], **started) for name in ESTIMATORS),
            Node(
                executable="supervisor",
                parameters=[parameters, clock],
                condition=IfCondition(LaunchConfiguration("supervisor")),
                **started,
            ),
            *(
                Node(
                    executable=name,
                    parameters=[parameters, clock],
                    condition=IfCondition(LaunchConfiguration(name)),
                    **started,
                )
                for name in FOR_PEOPLE
            ),
            Node(
                executable="recorder",
                parameters=[parameters, clock],
                condition=IfCondition(LaunchConfiguration("record")),
                **started,
            ),
        ]
    )
