"""Nav2 for a robot, beside its nodes; see docs/guides/nav2.md.

ros2 launch omniman_ros platform.launch.py robot:=omniman world:=workshop mpc:=false
ros2 launch omniman_ros nav2.launch.py robot:=omniman map:=workshop.yaml

The parameters are made from those of the robot. Nav2's own launch file starts its collision
monitor under the name of the robot's, and knows no zones to keep out of; hence this one.
"""

import tempfile

import yaml
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.actions import Node

from omniman_ros.processes.nav2_setup import nav2_parameters

TRANSFORMS = [("/tf", "tf"), ("/tf_static", "tf_static")]
"""Transforms stay in the namespace, as those of platform.launch.py do."""
NAVIGATION = {
    "controller_server": ("nav2_controller", "controller_server"),
    "smoother_server": ("nav2_smoother", "smoother_server"),
    "planner_server": ("nav2_planner", "planner_server"),
    "behavior_server": ("nav2_behaviors", "behavior_server"),
    "velocity_smoother": ("nav2_velocity_smoother", "velocity_smoother"),
    "bt_navigator": ("nav2_bt_navigator", "bt_navigator"),
    "waypoint_follower": ("nav2_waypoint_follower", "waypoint_follower"),
}
"""Package and executable of each node that drives, in the order in which they are activated."""
MONITOR = {"nav2_collision_monitor": ("nav2_collision_monitor", "collision_monitor")}
"""Nav2's collision monitor, which reads the scan; the robot's own may run as well."""
MAP = {"map_server": ("nav2_map_server", "map_server")}
"""Node that publishes a map from a file."""
AMCL = {"amcl": ("nav2_amcl", "amcl")}
"""Node that publishes where `odom` is in `map`."""
KEEPOUT = {
    "filter_mask_server": ("nav2_map_server", "map_server"),
    "costmap_filter_info_server": ("nav2_map_server", "costmap_filter_info_server"),
}
"""Nodes that publish the zones to keep out of."""
BOOLEANS = ["true", "false", "True", "False"]
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
        "nav2_params_file",
        default_value="",
        description="Path of a ROS parameter file for Nav2's nodes, whose values go first",
    ),
    DeclareLaunchArgument(
        "map",
        default_value="",
        description="Path of a map's YAML file; empty if somebody else publishes a map",
    ),
    DeclareLaunchArgument(
        "amcl",
        default_value="true",
        description="Whether AMCL localises the robot; false if somebody else does",
        choices=BOOLEANS,
    ),
    DeclareLaunchArgument(
        "keepout",
        default_value="",
        description="Path of the YAML file of a map of zones to keep out of; empty for none",
    ),
    DeclareLaunchArgument(
        "monitor",
        default_value="true",
        description="Whether Nav2's collision monitor limits what Nav2 sends",
        choices=BOOLEANS,
    ),
    DeclareLaunchArgument(
        "namespace", default_value="", description="Namespace of the robot's nodes"
    ),
    DeclareLaunchArgument(
        "use_sim_time",
        default_value="false",
        description="Whether to run on /clock, as the robot's nodes do",
        choices=BOOLEANS,
    ),
]


def nodes(context, *_):
    """Return the nodes for the values of the arguments."""
    given = context.launch_configurations
    is_monitored = given["monitor"].lower() == "true"
    localisation = MAP if given["map"] else {}
    if given["amcl"].lower() == "true":
        localisation = localisation | AMCL
    if given["keepout"]:
        localisation = localisation | KEEPOUT
    navigation = NAVIGATION | (MONITOR if is_monitored else {})
    common = {"use_sim_time": given["use_sim_time"].lower() == "true"}
    files = [_parameter_file(given), *filter(None, [given["nav2_params_file"]])]
    own = {
        "map_server": {"yaml_filename": given["map"]},
        "filter_mask_server": {"yaml_filename": given["keepout"]},
    }
    remappings = {
        "controller_server": [("cmd_vel", "cmd_vel_nav")],
        "behavior_server": [("cmd_vel", "cmd_vel_nav")],
        "velocity_smoother": [("cmd_vel", "cmd_vel_nav")]
        + ([] if is_monitored else [("cmd_vel_smoothed", "cmd_vel")]),
    }
    made = [
        Node(
            package=package,
            executable=executable,
            name=name,
            namespace=given["namespace"],
            remappings=TRANSFORMS + remappings.get(name, []),
            output="screen",
            parameters=[*files, common, *filter(None, [own.get(name)])],
        )
        for name, (package, executable) in (localisation | navigation).items()
    ]
    for manager, managed in ("localization", localisation), ("navigation", navigation):
        if managed:
            made.append(
                Node(
                    package="nav2_lifecycle_manager",
                    executable="lifecycle_manager",
                    name=f"lifecycle_manager_{manager}",
                    namespace=given["namespace"],
                    output="screen",
                    parameters=[common, {"autostart": True, "node_names": list(managed)}],
                )
            )
    return made


def _parameter_file(given):
    """Write the parameters of Nav2's nodes; return the path of the file."""
    parameters = nav2_parameters(
        given["robot"],
        given["params_file"] or None,
        namespace=given["namespace"],
        keeps_out=bool(given["keepout"]),
    )
    with tempfile.NamedTemporaryFile(
        "w", prefix="omniman_nav2_", suffix=".yaml", delete=False, encoding="utf-8"
    ) as file:
        yaml.safe_dump(parameters, file, sort_keys=False)
    return file.name


def generate_launch_description():
    """Return the description that `ros2 launch` runs."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=nodes)])
