"""Drive, controller, path interpolator, planner, arm, and joint states of one robot.

ros2 launch omniman_ros platform.launch.py robot:=ig42 namespace:=robot1
ros2 launch omniman_ros platform.launch.py arm:=simulated rviz:=true
ros2 launch omniman_ros platform.launch.py world:=workshop use_sim_time:=true

Transforms are published on tf and tf_static in the namespace: frames have no prefix, so that the
transforms of two robots would mix on one /tf. All robots of a ROS domain share /diagnostics, where
each node appears with its full name, and /clock: in simulated time, a domain can hold only one
robot.

All that can be wrong with the arguments is looked up before the first node starts. supervision.py
says what happens when a node ends.
"""

import os
import subprocess
from collections.abc import Mapping
from functools import partial
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_prefix, get_package_share_directory
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import ExecutableInPackage

_SPEC = spec_from_file_location("omniman_supervision", Path(__file__).with_name("supervision.py"))
supervision = module_from_spec(_SPEC)
_SPEC.loader.exec_module(supervision)

PACKAGE = "omniman_ros"
"""Name of this package."""
BOOLEANS = ["true", "false", "True", "False"]
"""Values of an argument that is true or false."""
TF = [("/tf", "tf"), ("/tf_static", "tf_static")]
"""Remappings that keep the transforms of a robot in its namespace."""
TRANSPORTS_VARIABLE = "FASTDDS_BUILTIN_TRANSPORTS"
"""Environment variable that selects the transports of Fast DDS."""
BUS = ("239.74.163.2", 43113)
"""Multicast group and port of the first robot's bus, a UDP bus of python-can."""
BUS_TIMEOUTS = {
    "can.missed_periods": 40,
    "can.drive_heartbeat": 0.1,
    "can.heartbeat_timeout": 0.3,
}
"""Timeouts of the bus for simulated drives, which may have to wait on a busy machine."""
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
        "params_file",
        default_value="",
        description="Path of a ROS parameter file, whose values take precedence; its keys select "
        "the nodes, such as /**/platform_controller",
    ),
    DeclareLaunchArgument(
        "use_sim_time",
        default_value="false",
        description="Run on the time of /clock, which the simulated drive then publishes",
        choices=BOOLEANS,
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
        default_value="cia402",
        description="Drives on the bus, with drive:=can or real: a name in "
        "share/omniman_ros/config/can, or path of a YAML file",
    ),
    DeclareLaunchArgument(
        "arm",
        default_value="none",
        description="What moves the arm; ur: the controller that `controller` describes",
        choices=["none", "simulated", "ur"],
    ),
    DeclareLaunchArgument(
        "controller",
        default_value="ur5",
        description="The arm's controller, with arm:=ur: a name in share/omniman_ros/config/ur, "
        "or path of a YAML file",
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
        choices=BOOLEANS,
    ),
    DeclareLaunchArgument(
        "collision_monitor",
        default_value="false",
        description="Whether to limit the speed before contact, and to stop where the monitor is "
        "silent",
        choices=BOOLEANS,
    ),
    DeclareLaunchArgument(
        "obstacle_tracker",
        default_value="false",
        description="Whether to turn the scans on `scan` into obstacles and a map; needs scipy",
        choices=BOOLEANS,
    ),
    DeclareLaunchArgument(
        "whole_body_planner",
        default_value="false",
        description="Whether platform and arm dodge what is around them on paths of the tool; "
        "needs casadi",
        choices=BOOLEANS,
    ),
    DeclareLaunchArgument(
        "viewer",
        default_value="false",
        description="Whether to serve the page for a browser; needs viser",
        choices=BOOLEANS,
    ),
    DeclareLaunchArgument(
        "rviz",
        default_value="false",
        description="Whether to start RViz with share/omniman_ros/rviz/omniman.rviz",
        choices=BOOLEANS,
    ),
    DeclareLaunchArgument(
        "number",
        default_value="0",
        description="Number of this robot among those simulated on this machine, which gives it a "
        "bus (drive:=can) and ports of its arm's controller (arm:=simulated) of its own",
        choices=[str(number) for number in range(10)],
    ),
    DeclareLaunchArgument(
        "transports",
        default_value="auto",
        description="Transports of Fast DDS; UDPv4: no shared memory, in which a process that is "
        "killed may block the others; auto: UDPv4 on real time, unless the environment variable "
        f"{TRANSPORTS_VARIABLE} is set",
        choices=["auto", "UDPv4", "DEFAULT"],
    ),
    DeclareLaunchArgument(
        "description",
        default_value="auto",
        description="Whether to start robot_state_publisher with the URDF; if not, only the URDF "
        "is published, on robot_description; auto: if it is installed",
        choices=["auto", *BOOLEANS],
    ),
    DeclareLaunchArgument(
        "respawn",
        default_value="false",
        description="Whether a node that moves nothing is started again when it has ended; the "
        "end of any other one stops the robot",
        choices=BOOLEANS,
    ),
    DeclareLaunchArgument(
        "respawn_delay",
        default_value="2.0",
        description="Time before a node is started again, in seconds",
    ),
]


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, and the function that makes the nodes once they are known."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=start)])


def start(context: LaunchContext) -> list[Any]:
    """Return the nodes of the robot.

    Raises:
        RuntimeError: An argument names a robot, a file or a package that does not exist.
    """
    names = [argument.name for argument in ARGUMENTS]
    given = {name: context.launch_configurations[name] for name in names}
    robot = _name_or_path(given, "robot", "")
    has_description = _has_description(given)
    if _is_true(given, "rviz"):
        _require_package("rviz:=true", "rviz2")
    own = [_file(given, "params_file", None)] if given["params_file"] else []
    common = {"robot": _text(robot), "use_sim_time": _is_true(given, "use_sim_time")}
    node = partial(_node, supervision.Crew(), given, own)
    nodes = [*_drive(given, node, robot), *_arm(given, node)]

    # Only one node publishes the odometry.
    is_separate = given["odometry"] == "node"
    limited = _limited(given)
    of_platform = {**common, **limited, "publish_odom": not is_separate}
    nodes.append(node("platform_controller", of_platform))
    if is_separate:
        nodes.append(node("odometry", common))
    # These nodes know the arm's limits, which the file of its controller sets.
    limits = [_file(given, "controller", "ur")] if given["arm"] == "ur" else []
    dodges = _is_true(given, "whole_body_planner")
    left_out = {"takes_tool_paths": False} if dodges else {}
    nodes.append(node("path_interpolator", *limits, {**common, **limited, **left_out}))
    # Nodes that wait for the obstacles of the tracker, whatever becomes of it.
    is_tracked = _is_true(given, "obstacle_tracker")
    seeing = {**common, "obstacles.required": True} if is_tracked else common
    if dodges:
        nodes.append(node("whole_body_planner", *limits, {**seeing, **limited}))
    if _is_true(given, "collision_monitor"):
        nodes.append(node("collision_monitor", *limits, seeing, essential=False))
    if is_tracked:
        nodes.append(node("obstacle_tracker", *limits, common, essential=False))
    # The URDF has joints that somebody publishes only, and one node publishes it.
    is_armed = given["arm"] != "none"
    of_joints = {"publish_description": not has_description, "describe_arm": is_armed}
    nodes.append(node("joint_states_merger", *limits, {**common, **of_joints}, essential=False))
    if _is_true(given, "mpc"):
        nodes.append(node("mpc_planner", seeing))
    if _is_true(given, "viewer"):
        nodes.append(node("viewer", common, essential=False))
    sim_time = {"use_sim_time": common["use_sim_time"]}
    watching = partial(node, essential=False)
    if has_description:
        urdf = {"robot_description": _text(_urdf(context, robot, limits, is_armed))}
        publisher = "robot_state_publisher"
        nodes.append(watching(publisher, {**urdf, **sim_time}, package=publisher))
    if _is_true(given, "rviz"):
        view = str(Path(get_package_share_directory(PACKAGE), "rviz", "omniman.rviz"))
        nodes.append(watching("rviz2", sim_time, package="rviz2", arguments=["-d", view]))
    return nodes


def _drive(given: Mapping[str, str], node: Any, robot: str) -> list[Any]:
    """Return the nodes that turn the wheels; in simulated time, they publish the clock."""
    simulated = {"robot": _text(robot), "publish_clock": _is_true(given, "use_sim_time")}
    if given["drive"] == "simulated" and given["world"]:
        world = {
            "scene": _text(_name_or_path(given, "world", "worlds")),
            "arm_port": _arm_port(given),
        }
        return [node("simulated_world", {**simulated, **world}, stage=3)]
    if given["drive"] == "simulated":
        return [node("simulated_drive", simulated, stage=3)]
    installation = _file(given, "installation", "can")
    on_bus: dict[str, Any] = {"robot": _text(robot)}
    if given["drive"] == "real":
        return [node("can_bridge", installation, on_bus, stage=1)]
    # Simulated drives are on a bus of UDP multicast on this machine.
    group, port = BUS
    on_bus["can.interface"] = "udp_multicast"
    on_bus["can.channel"] = _text(group)
    on_bus["can.port"] = port + 1000 * int(given["number"])
    on_bus |= BUS_TIMEOUTS
    return [
        node("simulated_can_drives", installation, on_bus, stage=2),
        node("can_bridge", installation, on_bus, stage=1),
    ]


def _arm(given: Mapping[str, str], node: Any) -> list[Any]:
    """Return the nodes that move the arm."""
    if given["arm"] == "ur":
        return [node("arm_streamer", _file(given, "controller", "ur"), _limited(given), stage=1)]
    if given["arm"] == "none":
        return []
    sim_time = {"use_sim_time": _is_true(given, "use_sim_time")}
    ports = {name: port + 10 * int(given["number"]) for name, port in UR_PORTS.items()}
    world_port = _arm_port(given)
    controller = {f"ports.{name}": port for name, port in ports.items()}
    client = {
        "ur.host": "127.0.0.1",
        "ur.dashboard_port": ports["dashboard"],
        "ur.script_port": ports["secondary"],
        "ur.rtde_port": ports["rtde"],
        "ur.reverse_port": 0,
        "simulated_controller": True,
        "ur.servo_lag": WORLD_SERVO_LAG if world_port else SERVO_LAG,
    }
    return [
        node(
            "simulated_ur",
            {**controller, **sim_time, "simulated_arm.world_port": world_port},
            stage=2,
        ),
        node("arm_streamer", {**client, **sim_time, **_limited(given)}, stage=1),
    ]


def _limited(given: Mapping[str, str]) -> dict[str, bool]:
    """Return the parameter of the nodes that obey a collision monitor."""
    return {"collision_monitor.use": _is_true(given, "collision_monitor")}


def _arm_port(given: Mapping[str, str]) -> int:
    """Return the port at which a world moves the joints of a simulated arm; 0 if it does not."""
    is_in_world = given["drive"] == "simulated" and given["world"] and given["arm"] == "simulated"
    return ARM_PORT + int(given["number"]) if is_in_world else 0


def _node(
    crew: Any,
    given: Mapping[str, str],
    own: list[str],
    executable: str,
    *parameters: Any,
    stage: int = 0,
    essential: bool = True,
    package: str = PACKAGE,
    **options: Any,
) -> Any:
    """Return a node; the parameters in the files `own` take precedence over the others."""
    if not essential:
        options["respawn"] = _is_true(given, "respawn")
        options["respawn_delay"] = float(given["respawn_delay"])
    if transports := _transports(given):
        options["additional_env"] = {TRANSPORTS_VARIABLE: transports}
    return supervision.SupervisedNode(
        crew=crew,
        stage=stage,
        essential=essential,
        is_ours=package == PACKAGE,
        package=package,
        executable=executable,
        namespace=given["namespace"],
        parameters=[*parameters, *own],
        remappings=TF,
        output="screen",
        **options,
    )


def _transports(given: Mapping[str, str]) -> str:
    """Return the transports of the nodes; empty for those of the environment."""
    if given["transports"] != "auto":
        return given["transports"]
    is_chosen = TRANSPORTS_VARIABLE in os.environ or _is_true(given, "use_sim_time")
    return "" if is_chosen else "UDPv4"


def _is_true(given: Mapping[str, str], name: str) -> bool:
    """Return the value of an argument that is true or false."""
    return given[name].lower() == "true"


def _text(value: str) -> ParameterValue:
    """Return a parameter of type string; without the type, launch would parse it as YAML."""
    return ParameterValue(value, value_type=str)


def _file(given: Mapping[str, str], name: str, folder: str | None) -> str:
    """Return the path of the file that an argument names, by its path or by its name.

    Args:
        given: The arguments.
        name: Name of the argument.
        folder: Folder in share/omniman_ros/config of the files that have a name; None for none.

    Raises:
        RuntimeError: There is no such file.
    """
    path = Path(given[name]).expanduser()
    if folder is None or path.suffix in (".yaml", ".yml"):
        if path.is_file():
            return str(path.resolve())
        raise RuntimeError(f"{name}:={given[name]}: there is no such file")
    shared = Path(get_package_share_directory(PACKAGE), "config", folder)
    known = {file.stem: file for file in sorted(shared.glob("*.yaml"))}
    if given[name] not in known:
        names = ", ".join(known)
        raise RuntimeError(
            f"{name}:={given[name]}: must be one of {names}, or path of a YAML file"
        )
    return str(known[given[name]])


def _name_or_path(given: Mapping[str, str], name: str, folder: str) -> str:
    """Return the value of an argument whose file the nodes find themselves; see :func:`_file`."""
    path = _file(given, name, folder)
    return path if Path(given[name]).suffix else given[name]


def _has_description(given: Mapping[str, str]) -> bool:
    """Return whether robot_state_publisher is started.

    Raises:
        RuntimeError: It is to be started, but is not installed.
    """
    if given["description"] != "auto":
        if _is_true(given, "description"):
            _require_package("description:=true", "robot_state_publisher")
        return _is_true(given, "description")
    try:
        get_package_prefix("robot_state_publisher")
    except LookupError:
        return False
    return True


def _require_package(argument: str, package: str) -> None:
    """Raise RuntimeError if a package that an argument needs is not installed."""
    try:
        get_package_prefix(package)
    except LookupError as error:
        name = f"ros-jazzy-{package.replace('_', '-')}"
        raise RuntimeError(
            f"{argument}: the package {package} is not installed: apt install {name}"
        ) from error


def _urdf(context: LaunchContext, robot: str, limits: list[str], is_armed: bool) -> str:
    """Return the URDF of the robot.

    Raises:
        RuntimeError: It cannot be made.
    """
    program = ExecutableInPackage(executable="omniman", package=PACKAGE).perform(context)
    files = [word for file in limits for word in ("--params-file", file)]
    command = [program, "urdf", "--robot", robot, *files]
    command += ["-p", f"describe_arm:={str(is_armed).lower()}"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"no URDF: {done.stderr.strip() or done.stdout.strip()}")
    return done.stdout
