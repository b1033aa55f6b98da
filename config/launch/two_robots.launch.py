"""Two simulated robots side by side, in the namespaces robot1 and robot2.

ros2 launch omniman_ros two_robots.launch.py
ros2 run teleop_twist_keyboard teleop_twist_keyboard --ros-args -r cmd_vel:=robot2/cmd_vel

Each has all topics and transforms in its own namespace; see platform.launch.py for what they
share. Each starts at the origin of its own odom, and neither knows of the other: who wants them to
avoid each other publishes the one's place on the other's `obstacles`. There is no simulated time:
both drives would make it.
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
        description="What turns the wheels; can: on a bus of each robot's own",
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
        choices=["true", "false"],
    ),
    DeclareLaunchArgument(
        "viewer",
        default_value="false",
        description="Whether to serve a page of each; the second takes the next free port",
        choices=["true", "false"],
    ),
    DeclareLaunchArgument(
        "rviz",
        default_value="false",
        description="Whether to start RViz for each",
        choices=["true", "false"],
    ),
]
"""Arguments, which go to both robots."""


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and the two robots."""
    return LaunchDescription([*BOTH, *map(_robot, range(len(NAMESPACES)))])


def _robot(number: int) -> GroupAction:
    """A robot; the group keeps its arguments from the other."""
    file = PathJoinSubstitution([FindPackageShare("omniman_ros"), "launch", "platform.launch.py"])
    arguments = {argument.name: LaunchConfiguration(argument.name) for argument in BOTH}
    arguments |= {"namespace": NAMESPACES[number], "number": str(number), "use_sim_time": "false"}
    included = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(file), launch_arguments=arguments.items()
    )
    return GroupAction([included])
