"""Drive, controller, path interpolator and planner of one platform.

ros2 launch omniman_ros platform.launch.py robot:=ig42 namespace:=robot1
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import EqualsSubstitution, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

ARGUMENTS = [
    DeclareLaunchArgument(
        "robot",
        default_value="omniman",
        description="Name of a robot in share/omniman_ros/config, or path of a YAML file",
    ),
    DeclareLaunchArgument(
        "namespace", default_value="", description="Namespace of all nodes and topics"
    ),
    DeclareLaunchArgument(
        "use_sim_time",
        default_value="false",
        description="Run on the time of /clock, which the simulated drive then publishes",
        choices=["true", "false"],
    ),
    DeclareLaunchArgument(
        "drive",
        default_value="simulated",
        description="What turns the wheels",
        choices=["simulated", "can", "real"],
    ),
    DeclareLaunchArgument(
        "installation",
        default_value=PathJoinSubstitution(
            [FindPackageShare("omniman_ros"), "config", "can", "cia402.yaml"]
        ),
        description="Path of the YAML file of the drives on the bus, with drive:=can or real",
    ),
    DeclareLaunchArgument(
        "mpc",
        default_value="true",
        description="Whether to start the planner among obstacles; needs casadi",
        choices=["true", "false"],
    ),
    DeclareLaunchArgument(
        "viewer",
        default_value="false",
        description="Whether to serve the page for a browser; needs viser",
        choices=["true", "false"],
    ),
]


def generate_launch_description() -> LaunchDescription:
    """Describe the arguments and the nodes."""
    robot = ParameterValue(LaunchConfiguration("robot"), value_type=str)
    sim_time = ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)

    # The simulated drive makes the time that the others run on.
    simulated_drive = Node(
        package="omniman_ros",
        executable="simulated_drive",
        namespace=LaunchConfiguration("namespace"),
        parameters=[{"robot": robot, "publish_clock": sim_time}],
        output="screen",
        condition=IfCondition(EqualsSubstitution(LaunchConfiguration("drive"), "simulated")),
    )
    # can: the bus is UDP multicast on this machine, and the drives on it are simulated.
    installation = LaunchConfiguration("installation")
    private_bus = {"can.interface": "udp_multicast", "can.channel": "239.74.163.2"}
    bridge = {"package": "omniman_ros", "executable": "can_bridge", "output": "screen",
              "namespace": LaunchConfiguration("namespace")}  # fmt: skip
    can_bridge = Node(
        **bridge,
        parameters=[installation, {"robot": robot}],
        condition=IfCondition(EqualsSubstitution(LaunchConfiguration("drive"), "real")),
    )
    can_bridge_on_private_bus = Node(
        **bridge,
        parameters=[installation, {"robot": robot, **private_bus}],
        condition=IfCondition(EqualsSubstitution(LaunchConfiguration("drive"), "can")),
    )
    simulated_can_drives = Node(
        package="omniman_ros",
        executable="simulated_can_drives",
        namespace=LaunchConfiguration("namespace"),
        parameters=[installation, {"robot": robot, **private_bus}],
        output="screen",
        condition=IfCondition(EqualsSubstitution(LaunchConfiguration("drive"), "can")),
    )
    platform_controller = Node(
        package="omniman_ros",
        executable="platform_controller",
        namespace=LaunchConfiguration("namespace"),
        parameters=[{"robot": robot, "use_sim_time": sim_time}],
        output="screen",
    )
    path_interpolator = Node(
        package="omniman_ros",
        executable="path_interpolator",
        namespace=LaunchConfiguration("namespace"),
        parameters=[{"robot": robot, "use_sim_time": sim_time}],
        output="screen",
    )
    mpc_planner = Node(
        package="omniman_ros",
        executable="mpc_planner",
        namespace=LaunchConfiguration("namespace"),
        parameters=[{"robot": robot, "use_sim_time": sim_time}],
        output="screen",
        condition=IfCondition(LaunchConfiguration("mpc")),
    )
    viewer = Node(
        package="omniman_ros",
        executable="viewer",
        namespace=LaunchConfiguration("namespace"),
        parameters=[{"robot": robot, "use_sim_time": sim_time}],
        output="screen",
        condition=IfCondition(LaunchConfiguration("viewer")),
    )
    return LaunchDescription(
        [
            *ARGUMENTS,
            simulated_drive,
            can_bridge,
            can_bridge_on_private_bus,
            simulated_can_drives,
            platform_controller,
            path_interpolator,
            mpc_planner,
            viewer,
        ]
    )
