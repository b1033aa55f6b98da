"""Drive, controller, path interpolator, planner, arm, and joint states of one robot.

ros2 launch omniman_ros platform.launch.py robot:=ig42 namespace:=robot1
ros2 launch omniman_ros platform.launch.py arm:=simulated rviz:=true
ros2 launch omniman_ros platform.launch.py world:=workshop use_sim_time:=true

Transforms are published on tf and tf_static in the namespace: frames have no prefix, so that the
transforms of two robots would mix on one /tf. All robots of a ROS domain share /diagnostics, where
each node appears with its full name, and /clock: in simulated time, a domain can hold only one
robot.
"""

from ament_index_python.packages import get_package_prefix
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition, UnlessCondition
from launch.substitutions import (
    AndSubstitution,
    Command,
    EqualsSubstitution,
    LaunchConfiguration,
    NotSubstitution,
    PathJoinSubstitution,
    PythonExpression,
)
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage, FindPackageShare


def has_robot_state_publisher() -> bool:
    """Return whether robot_state_publisher is installed, which the robot itself does not need."""
    try:
        get_package_prefix("robot_state_publisher")
    except LookupError:
        return False
    return True


TF = [("/tf", "tf"), ("/tf_static", "tf_static")]
"""Remappings of every node that publishes or receives transforms."""
BUS = ("239.74.163.2", 43113)
"""Multicast group and port of the first robot's bus, a UDP bus of python-can."""
UR_PORTS = {
    "dashboard": 29999,
    "primary": 30001,
    "secondary": 30002,
    "realtime": 30003,
    "rtde": 30004,
}
"""Ports of a UR controller, which the simulated controller of the first robot uses as well."""
ARM_PORT = 30110
"""Port at which the world of the first robot moves its arm."""
SERVO_LAG = 0.042
"""Lag of a simulated arm whose joints are its own [s]."""
WORLD_SERVO_LAG = 0.062
"""Lag of a simulated arm whose joints are in a world [s]."""

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
        "world",
        default_value="",
        description="Scene of the robot's physics world, with drive:=simulated: a name in "
        "share/omniman_ros/config/worlds, or path of a YAML file; empty: no world",
    ),
    DeclareLaunchArgument(
        "installation",
        default_value=PathJoinSubstitution(
            [FindPackageShare("omniman_ros"), "config", "can", "cia402.yaml"]
        ),
        description="Path of the YAML file of the drives on the bus, with drive:=can or real",
    ),
    DeclareLaunchArgument(
        "arm",
        default_value="none",
        description="What moves the arm; ur: the controller that `controller` describes",
        choices=["none", "simulated", "ur"],
    ),
    DeclareLaunchArgument(
        "controller",
        default_value=PathJoinSubstitution(
            [FindPackageShare("omniman_ros"), "config", "ur", "ur5.yaml"]
        ),
        description="Path of the YAML file of the arm's controller, with arm:=ur",
    ),
    DeclareLaunchArgument(
        "odometry",
        default_value="controller",
        description="What publishes odom, /tf and coupling_error; node: a process of its own",
        choices=["controller", "node"],
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
    DeclareLaunchArgument(
        "rviz",
        default_value="false",
        description="Whether to start RViz with share/omniman_ros/rviz/omniman.rviz",
        choices=["true", "false"],
    ),
    DeclareLaunchArgument(
        "number",
        default_value="0",
        description="Number of this robot among those simulated on this machine, which gives it a "
        "bus (drive:=can) and ports of its arm's controller (arm:=simulated) of its own",
        choices=[str(number) for number in range(10)],
    ),
    DeclareLaunchArgument(
        "description",
        default_value="true" if has_robot_state_publisher() else "false",
        description="Whether to start robot_state_publisher with the URDF; if not, only the URDF "
        "is published, on robot_description",
        choices=["true", "false"],
    ),
]


def generate_launch_description() -> LaunchDescription:
    """Return the arguments and the nodes."""
    robot = ParameterValue(LaunchConfiguration("robot"), value_type=str)
    sim_time = ParameterValue(LaunchConfiguration("use_sim_time"), value_type=bool)

    # In simulated time, the drive publishes the clock that the other nodes run on.
    is_simulated = EqualsSubstitution(LaunchConfiguration("drive"), "simulated")
    has_no_world = EqualsSubstitution(LaunchConfiguration("world"), "")
    simulated_drive = Node(
        package="omniman_ros",
        executable="simulated_drive",
        namespace=LaunchConfiguration("namespace"),
        parameters=[{"robot": robot, "publish_clock": sim_time}],
        remappings=TF,
        output="screen",
        condition=IfCondition(AndSubstitution(is_simulated, has_no_world)),
    )
    scene = ParameterValue(LaunchConfiguration("world"), value_type=str)
    # The joints of a simulated arm are in the world, if there is one.
    is_arm_simulated = EqualsSubstitution(LaunchConfiguration("arm"), "simulated")
    is_arm_in_world = AndSubstitution(
        AndSubstitution(is_simulated, NotSubstitution(has_no_world)), is_arm_simulated
    )
    arm_port = _chosen(is_arm_in_world, f"{ARM_PORT} + ", LaunchConfiguration("number"), "0", int)
    servo_lag = _chosen(is_arm_in_world, str(WORLD_SERVO_LAG), "", str(SERVO_LAG), float)
    simulated_world = Node(
        package="omniman_ros",
        executable="simulated_world",
        namespace=LaunchConfiguration("namespace"),
        parameters=[
            {"robot": robot, "publish_clock": sim_time, "scene": scene, "arm_port": arm_port}
        ],
        remappings=TF,
        output="screen",
        condition=IfCondition(AndSubstitution(is_simulated, NotSubstitution(has_no_world))),
    )
    # With drive:=can, simulated drives are on a bus of UDP multicast on this machine.
    installation = LaunchConfiguration("installation")
    group, port = BUS
    private_bus = {
        "can.interface": "udp_multicast",
        "can.channel": group,
        "can.port": _numbered(port, 1000),
    }
    bridge = {
        "package": "omniman_ros",
        "executable": "can_bridge",
        "output": "screen",
        "namespace": LaunchConfiguration("namespace"),
    }
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
    # Only one of the two nodes below publishes the odometry.
    separate_odometry = EqualsSubstitution(LaunchConfiguration("odometry"), "node")
    publish_odom = ParameterValue(NotSubstitution(separate_odometry), value_type=bool)
    platform_controller = Node(
        package="omniman_ros",
        executable="platform_controller",
        namespace=LaunchConfiguration("namespace"),
        parameters=[{"robot": robot, "use_sim_time": sim_time, "publish_odom": publish_odom}],
        remappings=TF,
        output="screen",
    )
    odometry = Node(
        package="omniman_ros",
        executable="odometry",
        namespace=LaunchConfiguration("namespace"),
        parameters=[{"robot": robot, "use_sim_time": sim_time}],
        remappings=TF,
        output="screen",
        condition=IfCondition(separate_odometry),
    )
    streamer = {
        "package": "omniman_ros",
        "executable": "arm_streamer",
        "output": "screen",
        "namespace": LaunchConfiguration("namespace"),
    }
    arm_streamer = Node(
        **streamer,
        parameters=[LaunchConfiguration("controller")],
        condition=IfCondition(EqualsSubstitution(LaunchConfiguration("arm"), "ur")),
    )
    ports = {name: _numbered(port, 10) for name, port in UR_PORTS.items()}
    arm_streamer_of_simulated_ur = Node(
        **streamer,
        parameters=[
            {
                "ur.host": "127.0.0.1",
                "ur.dashboard_port": ports["dashboard"],
                "ur.script_port": ports["secondary"],
                "ur.rtde_port": ports["rtde"],
                "ur.reverse_port": 0,
                "use_sim_time": sim_time,
                "simulated_controller": True,
                "ur.servo_lag": servo_lag,
            }
        ],
        condition=IfCondition(is_arm_simulated),
    )
    simulated_ur = Node(
        package="omniman_ros",
        executable="simulated_ur",
        namespace=LaunchConfiguration("namespace"),
        parameters=[
            {
                **{f"ports.{name}": port for name, port in ports.items()},
                "use_sim_time": sim_time,
                "simulated_arm.world_port": arm_port,
            }
        ],
        output="screen",
        condition=IfCondition(is_arm_simulated),
    )
    # The interpolator plans within the arm's limits, which the controller's file sets.
    interpolator = {
        "package": "omniman_ros",
        "executable": "path_interpolator",
        "namespace": LaunchConfiguration("namespace"),
        "output": "screen",
    }
    with_ur = EqualsSubstitution(LaunchConfiguration("arm"), "ur")
    path_interpolator = Node(
        **interpolator,
        parameters=[{"robot": robot, "use_sim_time": sim_time}],
        condition=UnlessCondition(with_ur),
    )
    path_interpolator_with_ur = Node(
        **interpolator,
        parameters=[LaunchConfiguration("controller"), {"robot": robot, "use_sim_time": sim_time}],
        condition=IfCondition(with_ur),
    )
    # Only one of the two nodes below publishes the URDF on robot_description.
    description = LaunchConfiguration("description")
    of_joints = {
        "robot": robot,
        "use_sim_time": sim_time,
        "publish_description": ParameterValue(NotSubstitution(description), value_type=bool),
    }
    broadcaster = {
        "package": "omniman_ros",
        "executable": "joint_state_broadcaster",
        "namespace": LaunchConfiguration("namespace"),
        "output": "screen",
    }
    joint_state_broadcaster = Node(
        **broadcaster, parameters=[of_joints], condition=UnlessCondition(with_ur)
    )
    joint_state_broadcaster_with_ur = Node(
        **broadcaster,
        parameters=[LaunchConfiguration("controller"), of_joints],
        condition=IfCondition(with_ur),
    )
    # The quotes are needed because launch splits the line into words as a shell does.
    urdf = [
        "'",
        ExecutableInPackage(executable="omniman", package="omniman_ros"),
        "'",
        " urdf --robot '",
        LaunchConfiguration("robot"),
        "'",
    ]
    publisher = {
        "package": "robot_state_publisher",
        "executable": "robot_state_publisher",
        "namespace": LaunchConfiguration("namespace"),
        "output": "screen",
        "remappings": TF,
    }
    robot_state_publisher = Node(
        **publisher,
        parameters=[{"robot_description": _text_of(urdf), "use_sim_time": sim_time}],
        condition=IfCondition(AndSubstitution(description, NotSubstitution(with_ur))),
    )
    of_controller = [*urdf, " --params-file '", LaunchConfiguration("controller"), "'"]
    robot_state_publisher_with_ur = Node(
        **publisher,
        parameters=[{"robot_description": _text_of(of_controller), "use_sim_time": sim_time}],
        condition=IfCondition(AndSubstitution(description, with_ur)),
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
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        namespace=LaunchConfiguration("namespace"),
        arguments=[
            "-d",
            PathJoinSubstitution([FindPackageShare("omniman_ros"), "rviz", "omniman.rviz"]),
        ],
        parameters=[{"use_sim_time": sim_time}],
        remappings=TF,
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    return LaunchDescription(
        [
            *ARGUMENTS,
            simulated_drive,
            simulated_world,
            can_bridge,
            can_bridge_on_private_bus,
            simulated_can_drives,
            arm_streamer,
            arm_streamer_of_simulated_ur,
            simulated_ur,
            platform_controller,
            odometry,
            path_interpolator,
            path_interpolator_with_ur,
            joint_state_broadcaster,
            joint_state_broadcaster_with_ur,
            robot_state_publisher,
            robot_state_publisher_with_ur,
            mpc_planner,
            viewer,
            rviz,
        ]
    )


def _numbered(first: int, step: int) -> ParameterValue:
    """Return `first + step * number`, which is different for each robot on this machine."""
    number = PythonExpression([f"{first} + {step} * ", LaunchConfiguration("number")])
    return ParameterValue(number, value_type=int)


def _chosen(
    condition: object, first: str, number: object, other: str, kind: type
) -> ParameterValue:
    """Return the value of an expression if a condition holds, and of another one if not.

    Args:
        condition: Is "true" or "false".
        first: Expression if it holds, before `number`.
        number: End of that expression.
        other: Expression if it does not hold.
        kind: Type of the value.
    """
    choice = PythonExpression([first, number, " if '", condition, f"' == 'true' else {other}"])
    return ParameterValue(choice, value_type=kind)


def _text_of(command: list[object]) -> ParameterValue:
    """Return the output of a command; without the type, launch would parse a URDF as YAML."""
    return ParameterValue(Command(command, on_stderr="warn"), value_type=str)
