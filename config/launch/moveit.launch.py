"""MoveIt's move_group for a robot, beside its nodes; see docs/guides/moveit.md.

ros2 launch omniman_ros platform.launch.py robot:=omniman
ros2 launch omniman_ros moveit.launch.py robot:=omniman rviz:=true

The robot's description is that of the package, the semantic one is made from the same parameters.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from omniman_ros.processes.moveit_setup import moveit_configuration

TRANSFORMS = [("/tf", "tf"), ("/tf_static", "tf_static")]
"""Transforms stay in the namespace, as those of platform.launch.py do."""
ARGUMENTS = [
    DeclareLaunchArgument(
        "robot",
        default_value="omniman",
        description="Name of a robot in share/omniman_ros/config, or path of a YAML file",
    ),
    DeclareLaunchArgument(
        "params_file",
        default_value="",
        description="Path of a ROS parameter file for the robot's nodes, whose values go first",
    ),
    DeclareLaunchArgument(
        "namespace", default_value="", description="Namespace of the robot's nodes"
    ),
    DeclareLaunchArgument(
        "use_sim_time",
        default_value="false",
        description="Whether to run on /clock, as the robot's nodes do",
        choices=["true", "false", "True", "False"],
    ),
    DeclareLaunchArgument(
        "rviz",
        default_value="false",
        description="Whether to start RViz with what its MotionPlanning panel needs",
        choices=["true", "false", "True", "False"],
    ),
]


def nodes(context, *_):
    """Return the nodes for the values of the arguments."""
    given = context.launch_configurations
    configuration = moveit_configuration(given["robot"], given["params_file"] or None)
    common = {"use_sim_time": given["use_sim_time"].lower() == "true"}
    made = [
        Node(
            package="moveit_ros_move_group",
            executable="move_group",
            namespace=given["namespace"],
            remappings=TRANSFORMS,
            output="screen",
            parameters=[configuration.move_group, common],
        )
    ]
    if given["rviz"].lower() == "true":
        made.append(
            Node(
                package="rviz2",
                executable="rviz2",
                namespace=given["namespace"],
                remappings=TRANSFORMS,
                parameters=[configuration.panel, common],
            )
        )
    return made


def generate_launch_description():
    """Return the description that `ros2 launch` runs."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=nodes)])
