"""Two simulated robots side by side, in the namespaces robot1 and robot2.

ros2 launch omniman_ros two_robots.launch.py
ros2 run teleop_twist_keyboard teleop_twist_keyboard --ros-args -r cmd_vel:=robot2/cmd_vel

Each robot has all its topics and transforms in its own namespace; platform.launch.py says what
they share. Each starts at the origin of its own odom, and neither knows of the other: to make them
avoid each other, publish the position of one on the `obstacles` of the other. Simulated time is
not available, since both drives would publish the clock.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

NAMESPACES = ("robot1", "robot2")
BOTH = [
    DeclareLaunchArgument(
        "robot",
        default_value="omniman",
        description="Name of a robot in share/omniman_ros/config, or path of a YAML file",
    ),
    DeclareLaunchArgument(
        "drive",
        default_value="simulated",
        description="What turns the wheels; can: each robot has a bus of its own",
        choices=["simulated", "can"],
    ),
    DeclareLaunchArgument(
        "arm",
        default_value="none",
        description="What moves the arm",
        choices=["none", "simulated"],
    ),
    DeclareLaunchArgument(
        "mpc",
        default_value="true",
        description="Whether to start the planners among obstacles; they need casadi",
        choices=["true", "false", "True", "False"],
    ),
    DeclareLaunchArgument(
        "viewer",
        default_value="false",
        description="Whether to serve a page for each robot; the second takes the next free port",
        choices=["true", "false", "True", "False"],
    ),
    DeclareLaunchArgument(
        "rviz",
        default_value="false",
        description="Whether to start RViz for each robot",
        choices=["true", "false", "True", "False"],
    ),
    DeclareLaunchArgument(
        "transports",
        default_value="auto",
        description="Transports of Fast DDS; see platform.launch.py",
        choices=["auto", "UDPv4", "DEFAULT"],
    ),
    DeclareLaunchArgument(
        "respawn",
        default_value="false",
        description="Whether a node that moves nothing is started again when it has ended; the "
        "end of any other one stops both robots",
        choices=["true", "false", "True", "False"],
    ),
    DeclareLaunchArgument(
        "params_file",
        default_value="",
        description="Path of a ROS parameter file, whose values take precedence; its keys select "
        "the nodes, such as /robot1/platform_controller",
    ),
]
"""Arguments that are passed on to both robots."""


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the two robots."""
    return LaunchDescription([*BOTH, *map(_robot, range(len(NAMESPACES)))])


def _robot(number: int) -> GroupAction:
    """Return a robot; the group keeps its arguments from reaching the other one."""
    file = PathJoinSubstitution([FindPackageShare("omniman_ros"), "launch", "platform.launch.py"])
    arguments = {argument.name: LaunchConfiguration(argument.name) for argument in BOTH}
    arguments |= {"namespace": NAMESPACES[number], "number": str(number), "use_sim_time": "false"}
    included = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(file), launch_arguments=arguments.items()
    )
    return GroupAction([included])
