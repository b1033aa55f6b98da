"""The launch files against small stand-ins for `launch` and `launch_ros`, which PyPI lacks."""

import logging
import os
import runpy
import subprocess
import sys
from concurrent.futures import Future
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
import setuptools
import yaml

from omniman_ros.cli.main import main
from omniman_ros.core.parameters import build, specs
from omniman_ros.nodes.arm_streamer_parameters import ArmStreamerParameters
from omniman_ros.nodes.can_bridge_parameters import CanBridgeParameters
from omniman_ros.nodes.parent_process import PARENT_VARIABLE
from omniman_ros.nodes.simulated_can_drives_parameters import SimulatedCanDrivesParameters
from omniman_ros.nodes.simulated_drive_parameters import SimulatedDriveParameters
from omniman_ros.nodes.simulated_ur_parameters import SimulatedUrParameters
from omniman_ros.nodes.simulated_world_parameters import SimulatedWorldParameters
from omniman_ros.processes import arm_options
from omniman_ros.processes.drive_options import SIMULATED_BUS_TIMEOUTS
from omniman_ros.processes.robot_setup import ROBOT_NODES
from omniman_ros.ur.parameters import UrParameters

ROOT = Path(__file__).resolve().parents[2]


@dataclass
class LaunchContext:
    launch_configurations: dict
    is_shutdown: bool = False


@dataclass(frozen=True)
class LaunchConfiguration:
    name: str
    default: str = ""

    def value(self, arguments):
        return arguments[self.name]


@dataclass(frozen=True, kw_only=True)
class ExecutableInPackage:
    executable: str
    package: str

    def perform(self, context):
        return f"/my ws/lib/{self.package}/{self.executable}"


@dataclass(frozen=True)
class FindPackageShare:
    package: str

    def value(self, arguments):
        return f"/share/{self.package}"


@dataclass(frozen=True)
class PathJoinSubstitution:
    parts: list

    def value(self, arguments):
        return "/".join(value(part, arguments) for part in self.parts)


@dataclass(frozen=True)
class ParameterValue:
    raw: Any
    value_type: type

    def __init__(self, value, *, value_type):
        assert value_type is str
        object.__setattr__(self, "raw", value)

    def value(self, arguments):
        return self.raw


@dataclass
class DeclareLaunchArgument:
    name: str
    default_value: Any
    description: str
    choices: list | None = None

    def __post_init__(self):
        assert self.choices is None or self.default_value in self.choices


@dataclass
class OpaqueFunction:
    function: Any


class Node:
    """Stands for a process of launch; `end` is what its exit would do."""

    def __init__(self, *, package, executable, on_exit, sigterm_timeout, **options):
        self.package, self.executable, self.on_exit = package, executable, on_exit
        self.namespace = options.pop("namespace")
        self.parameters = options.pop("parameters")
        self.remappings = options.pop("remappings")
        self.arguments = options.pop("arguments", [])
        self.options = options
        self.asked = []
        self._future = None

    def begin(self):
        self._future = Future()

    def get_asyncio_future(self):
        return self._future

    def _shutdown_process(self, context, *, send_sigint):
        self.asked.append(send_sigint)
        return []

    def end(self, context, code):
        """Return the actions that the exit leads to; as in launch, the future is done later."""
        event = SimpleNamespace(process_name=f"{self.executable}-1", returncode=code)
        actions = list(self.on_exit(event, context))
        if not (self.options.get("respawn") and not context.is_shutdown):
            self._future.set_result(None)
        return actions


@dataclass(frozen=True)
class EmitEvent:
    event: Any


@dataclass(frozen=True)
class ShutdownProcess:
    process_matcher: Any


def matches_action(node):
    return node


@dataclass(frozen=True)
class PythonLaunchDescriptionSource:
    path: Any


@dataclass
class IncludeLaunchDescription:
    source: PythonLaunchDescriptionSource
    launch_arguments: Any


@dataclass
class GroupAction:
    actions: list


@dataclass
class LaunchDescription:
    entities: list


def value(item, arguments):
    """Return what launch would make of a plain value or a substitution."""
    return item.value(arguments) if hasattr(item, "value") else item


STAND_INS = {
    "launch": [LaunchContext, LaunchDescription],
    "launch.actions": [
        DeclareLaunchArgument,
        EmitEvent,
        GroupAction,
        IncludeLaunchDescription,
        OpaqueFunction,
    ],
    "launch.events": [matches_action],
    "launch.events.process": [type("ProcessExited", (), {}), ShutdownProcess],
    "launch.launch_description_sources": [PythonLaunchDescriptionSource],
    "launch.logging": [logging.getLogger],
    "launch.substitutions": [LaunchConfiguration, PathJoinSubstitution],
    "launch_ros": [],
    "launch_ros.actions": [Node],
    "launch_ros.parameter_descriptions": [ParameterValue],
    "launch_ros.substitutions": [ExecutableInPackage, FindPackageShare],
}


@pytest.fixture
def installed():
    """Third-party packages that count as installed; a test adds to it before it launches."""
    return set()


@pytest.fixture
def urdf_commands(monkeypatch):
    """Command lines that a launch file has run."""
    commands = []

    def run(command, **options):
        commands.append(command)
        return subprocess.CompletedProcess(command, 0, stdout="<robot/>", stderr="")

    monkeypatch.setattr(subprocess, "run", run)
    return commands


@pytest.fixture(autouse=True)
def stand_ins(monkeypatch, installed):
    def get_package_prefix(package):
        if package not in installed:
            raise KeyError(package)
        return "/opt/ros/jazzy"

    index = ModuleType("ament_index_python.packages")
    index.get_package_prefix = get_package_prefix
    index.get_package_share_directory = lambda package: ROOT
    monkeypatch.setitem(sys.modules, "ament_index_python.packages", index)
    for name, members in STAND_INS.items():
        module = ModuleType(name)
        for member in members:
            setattr(
                module, {"getLogger": "get_logger"}.get(member.__name__, member.__name__), member
            )
        monkeypatch.setitem(sys.modules, name, module)


#: Executables of third-party packages of the same name
THIRD_PARTY_NODES = {"robot_state_publisher", "rviz2"}


def load(file, **given):
    """Return the arguments of a launch file with their values, and all its entities."""
    entities = runpy.run_path(str(file))["generate_launch_description"]().entities
    declared = [e for e in entities if isinstance(e, DeclareLaunchArgument)]
    arguments = {argument.name: value(argument.default_value, {}) for argument in declared}
    assert set(given) <= set(arguments)
    for argument in declared:
        assert argument.choices is None or given.get(argument.name, argument.choices[0]) in (
            argument.choices
        )
    return arguments | given, entities


def started(file, **given):
    """Return the values of the arguments, and the nodes that would start, by executable."""
    arguments, entities = load(file, **given)
    (action,) = (e for e in entities if isinstance(e, OpaqueFunction))
    nodes = {}
    for node in action.function(LaunchContext(arguments)):
        assert node.executable not in nodes
        package = node.executable if node.executable in THIRD_PARTY_NODES else "omniman_ros"
        assert node.package == package
        nodes[node.executable] = node
    return arguments, nodes


def settings(node, arguments):
    """Return the namespace and the parameters of a node."""
    parameters = {}
    for group in node.parameters:
        parameters |= group if isinstance(group, dict) else {"file": Path(group).name}
    return (
        value(node.namespace, arguments),
        {name: value(v, arguments) for name, v in parameters.items()},
    )


def launch(file, **given):
    """Return the values of the arguments, and the settings of the nodes that would start."""
    arguments, nodes = started(file, **given)
    return arguments, {name: settings(node, arguments) for name, node in nodes.items()}


@pytest.fixture
def file_of():
    return lambda name: ROOT / "config" / "launch" / f"{name}.launch.py"


@pytest.fixture
def platform(file_of):
    return lambda **given: launch(file_of("platform"), **given)


@pytest.fixture
def nav2(file_of, monkeypatch):
    """Return the keywords of the nodes that the launch file of Nav2 makes, by their names."""
    monkeypatch.setattr(
        sys.modules["launch_ros.actions"], "Node", lambda **given: SimpleNamespace(**given)
    )

    def start(**given):
        arguments, (*_, action) = load(file_of("nav2"), **given)
        nodes = {node.name: node for node in action.function(LaunchContext(arguments))}
        for node in nodes.values():
            assert node.namespace == arguments["namespace"]
            assert {"use_sim_time": False} in node.parameters
        return nodes

    return start


def managed(nodes, manager):
    """Return the nodes that a lifecycle manager activates."""
    *_, parameters = nodes[f"lifecycle_manager_{manager}"].parameters
    assert parameters["autostart"]
    return parameters["node_names"]


def test_nav2_is_started_with_the_parameters_of_the_robot(nav2):
    nodes = nav2(robot="ig42", map="hall.yaml", namespace="robot1")
    assert managed(nodes, "localization") == ["map_server", "amcl"]
    driving = managed(nodes, "navigation")
    assert {*nodes} == {
        *driving,
        "map_server",
        "amcl",
        "lifecycle_manager_localization",
        "lifecycle_manager_navigation",
    }
    assert "collision_monitor" not in nodes, "the name of a node of the robot"
    assert {"yaml_filename": "hall.yaml"} in nodes["map_server"].parameters
    file, *_ = nodes["controller_server"].parameters
    assert file == nodes["amcl"].parameters[0]
    assert set(driving) <= set(yaml.safe_load(Path(file).read_text())["robot1"])
    Path(file).unlink()


@pytest.mark.parametrize("monitor", ["true", "False"])
def test_one_node_of_nav2_publishes_cmd_vel(nav2, monitor):
    nodes = nav2(monitor=monitor, amcl="false")
    assert managed(nodes, "navigation") == [name for name in nodes if "lifecycle" not in name]
    is_monitored = monitor == "true"
    assert ("nav2_collision_monitor" in nodes) is is_monitored
    renamed = {name: dict(getattr(node, "remappings", [])) for name, node in nodes.items()}
    for name in ("controller_server", "behavior_server", "velocity_smoother"):
        assert renamed[name]["cmd_vel"] == "cmd_vel_nav"
    smoothed = renamed["velocity_smoother"].get("cmd_vel_smoothed", "cmd_vel_smoothed")
    assert smoothed == ("cmd_vel_smoothed" if is_monitored else "cmd_vel")
    Path(nodes["controller_server"].parameters[0]).unlink()


def test_zones_to_keep_out_of_have_servers_and_layers(nav2):
    nodes = nav2(keepout="zones.yaml", amcl="false", nav2_params_file="mine.yaml")
    zones = ["filter_mask_server", "costmap_filter_info_server"]
    assert managed(nodes, "localization") == zones
    assert {"yaml_filename": "zones.yaml"} in nodes["filter_mask_server"].parameters
    file, mine, *_ = nodes["planner_server"].parameters
    assert mine == "mine.yaml"
    costmap = yaml.safe_load(Path(file).read_text())["global_costmap"]["global_costmap"]
    assert costmap["ros__parameters"]["filters"] == ["keepout_filter"]
    Path(file).unlink()


@pytest.mark.parametrize("rviz", ["true", "False"])
def test_moveit_is_started_with_the_descriptions_of_the_robot(file_of, monkeypatch, rviz):
    made = []
    monkeypatch.setattr(
        sys.modules["launch_ros.actions"], "Node", lambda **given: made.append(given) or given
    )
    arguments, (*_, action) = load(file_of("moveit"), rviz=rviz, namespace="robot1")
    nodes = action.function(LaunchContext(arguments))
    assert nodes == made
    executables = ["move_group"] + ["rviz2"] * (rviz == "true")
    assert [node["executable"] for node in nodes] == executables
    assert {node["namespace"] for node in nodes} == {"robot1"}
    for node in nodes:
        assert dict(node["remappings"]) == {"/tf": "tf", "/tf_static": "tf_static"}
    for node in nodes:
        parameters, common = node["parameters"]
        assert common == {"use_sim_time": False}
        assert parameters["robot_description"].startswith("<?xml")
        assert "<virtual_joint" in parameters["robot_description_semantic"]
    assert nodes[0]["parameters"][0]["planning_pipelines"] == ["ompl"]


def test_every_argument_in_use_is_declared_and_every_executable_exists(platform, monkeypatch):
    monkeypatch.setattr(setuptools, "setup", lambda **arguments: None)
    executables = runpy.run_path(str(ROOT / "setup.py"))["EXECUTABLES"]
    # An argument that is not declared raises a KeyError in `launch`.
    _, nodes = platform()
    assert nodes
    assert set(nodes) <= set(executables)  # third-party nodes are not started by default


def test_platform_starts_the_simulated_drive_and_the_controller_by_default(platform):
    _, nodes = platform()
    joints = {"publish_description": True, "describe_arm": False}
    assert nodes == {
        "simulated_drive": ("", {"robot": "omniman", "publish_clock": False}),
        "platform_controller": (
            "",
            {
                "robot": "omniman",
                "use_sim_time": False,
                "publish_odom": True,
                "collision_monitor.use": False,
            },
        ),
        "path_interpolator": (
            "",
            {"robot": "omniman", "use_sim_time": False, "collision_monitor.use": False},
        ),
        "joint_states_merger": (
            "",
            {"robot": "omniman", "use_sim_time": False, **joints},
        ),
        "mpc_planner": ("", {"robot": "omniman", "use_sim_time": False}),
    }


@pytest.fixture
def file(tmp_path):
    """Return the path of an existing YAML file."""
    path = tmp_path / "my own.yaml"
    path.touch()
    return str(path)


def test_platform_passes_robot_and_namespace_to_every_node(platform, file):
    _, nodes = platform(robot=file, namespace="robot1", viewer="true")
    for namespace, parameters in nodes.values():
        assert namespace == "robot1"
        assert parameters["robot"] == file


def test_the_users_parameter_file_comes_last_for_every_node(file_of, file):
    for given in ({"arm": "ur", "drive": "real"}, {"arm": "simulated", "drive": "can"}):
        _, nodes = started(file_of("platform"), params_file=file, **given)
        for node in nodes.values():
            assert node.parameters[-1] == file


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"robot": "nope"}, "robot:=nope: must be one of ig42, omniman"),
        ({"robot": "/no/robot.yaml"}, "robot:=/no/robot.yaml: there is no such file"),
        ({"world": "nowhere"}, "world:=nowhere: must be one of"),
        ({"drive": "real", "installation": "nope"}, "must be one of cia402, odrive, vesc"),
        ({"arm": "ur", "controller": "/no.yaml"}, "controller:=/no.yaml: there is no such file"),
        ({"params_file": "/no.yaml"}, "params_file:=/no.yaml: there is no such file"),
        ({"rviz": "True"}, "apt install ros-jazzy-rviz2"),
        ({"description": "true"}, "apt install ros-jazzy-robot-state-publisher"),
    ],
)
def test_what_does_not_exist_is_named_before_any_node_is_made(file_of, given, message):
    with pytest.raises(RuntimeError, match=message):
        started(file_of("platform"), **given)


def test_booleans_are_accepted_in_either_case(platform):
    assert set(platform(mpc="False", viewer="True")[1]) == set(
        platform(mpc="false", viewer="true")[1]
    )


def test_in_simulated_time_the_drive_publishes_the_clock_and_the_others_follow_it(platform):
    _, nodes = platform(use_sim_time="true")
    _, drive = nodes.pop("simulated_drive")
    assert drive["publish_clock"] is True
    assert "use_sim_time" not in drive
    for _, parameters in nodes.values():
        assert parameters["use_sim_time"] is True


def test_in_a_world_the_world_takes_the_place_of_the_drive(platform, file):
    _, nodes = platform(world=file, use_sim_time="true", robot="ig42")
    assert "simulated_drive" not in nodes
    scene = {"robot": "ig42", "publish_clock": True, "scene": file}
    scene["arm_port"] = 0
    assert nodes["simulated_world"] == ("", scene)


@pytest.mark.parametrize("number", ["0", "3"])
def test_the_joints_of_a_simulated_arm_are_in_the_world(platform, number):
    _, nodes = platform(world="hall", arm="simulated", number=number)
    ports = {
        nodes["simulated_world"][1]["arm_port"],
        nodes["simulated_ur"][1]["simulated_arm.world_port"],
    }
    assert ports == {30110 + int(number)}
    assert nodes["arm_streamer"][1]["ur.servo_lag"] == arm_options.WORLD_SERVO_LAG


def test_without_a_world_a_simulated_arm_has_joints_of_its_own(platform):
    _, nodes = platform(arm="simulated")
    assert nodes["simulated_ur"][1]["simulated_arm.world_port"] == 0
    assert nodes["arm_streamer"][1]["ur.servo_lag"] == build(UrParameters, {}).servo_lag
    _, nodes = platform(world="hall")
    assert nodes["simulated_world"][1]["arm_port"] == 0


def test_drives_on_a_bus_are_in_no_world(platform):
    _, nodes = platform(world="hall", drive="can")
    assert not {"simulated_world", "simulated_drive"} & set(nodes)


def test_the_viewer_is_started_on_request(platform):
    _, nodes = platform(viewer="true", use_sim_time="true")
    assert nodes["viewer"] == ("", {"robot": "omniman", "use_sim_time": True})


@pytest.mark.parametrize("arm", ["simulated", "ur"])
def test_the_controller_needs_the_collision_monitor_where_it_is_started(platform, arm):
    _, nodes = platform(collision_monitor="true", arm=arm, robot="ig42")
    assert nodes["collision_monitor"][1]["robot"] == "ig42"
    assert nodes["platform_controller"][1]["collision_monitor.use"] is True
    _, nodes = platform(arm=arm)
    assert "collision_monitor" not in nodes
    assert nodes["platform_controller"][1]["collision_monitor.use"] is False


def test_the_obstacle_tracker_is_started_on_request(platform):
    _, nodes = platform(obstacle_tracker="true", world="hall", use_sim_time="true")
    assert nodes["obstacle_tracker"] == ("", {"robot": "omniman", "use_sim_time": True})


def test_who_plans_and_limits_awaits_the_obstacles_of_the_tracker_where_it_is_started(platform):
    given = {"mpc": "true", "collision_monitor": "true", "whole_body_planner": "true"}
    for is_tracked in (True, False):
        _, nodes = platform(obstacle_tracker=str(is_tracked).lower(), **given)
        for name in ("mpc_planner", "collision_monitor", "whole_body_planner"):
            assert ("obstacles.required" in nodes[name][1]) == is_tracked


def test_the_whole_body_planner_takes_the_tool_paths_on_request(platform):
    _, nodes = platform(whole_body_planner="true", collision_monitor="true")
    shared = {"robot": "omniman", "use_sim_time": False, "collision_monitor.use": True}
    assert nodes["whole_body_planner"] == ("", shared)
    assert nodes["path_interpolator"] == ("", {**shared, "takes_tool_paths": False})


def test_the_odometry_is_a_process_of_its_own_on_request(platform):
    _, nodes = platform(odometry="node", use_sim_time="true", robot="ig42")
    assert nodes["odometry"] == ("", {"robot": "ig42", "use_sim_time": True})
    assert nodes["platform_controller"][1]["publish_odom"] is False


BUS = {
    "can.interface": "udp_multicast",
    "can.channel": "239.74.163.2",
    "can.port": 43113,
    "can.missed_periods": 40,
    "can.drive_heartbeat": 0.1,
    "can.heartbeat_timeout": 0.3,
}


def test_simulated_drives_have_the_timeouts_of_omniman_up():
    words = [word for word in SIMULATED_BUS_TIMEOUTS if word != "-p"]
    pairs = [word.split(":=") for word in words]
    assert {name: float(value) for name, value in pairs}.items() <= BUS.items()


def test_real_drives_get_a_bridge_with_their_installation_and_no_simulation(platform, file):
    _, nodes = platform(drive="real", mpc="false", installation=file)
    assert set(nodes) == {
        "platform_controller",
        "path_interpolator",
        "joint_states_merger",
        "can_bridge",
    }
    assert nodes["can_bridge"] == ("", {"file": "my own.yaml", "robot": "omniman"})


def test_simulated_drives_on_a_bus_share_installation_and_bus_with_the_bridge(platform):
    _, nodes = platform(drive="can", mpc="false", robot="ig42")
    assert "simulated_drive" not in nodes
    expected = ("", {"file": "cia402.yaml", "robot": "ig42", **BUS})
    assert nodes["can_bridge"] == nodes["simulated_can_drives"] == expected


def test_a_simulated_arm_gets_a_simulated_controller(platform):
    _, nodes = platform(arm="simulated", mpc="false", namespace="robot1")
    client = {
        "ur.host": "127.0.0.1",
        "ur.dashboard_port": 29999,
        "ur.script_port": 30002,
        "ur.rtde_port": 30004,
        "ur.reverse_port": 0,
        "use_sim_time": False,
        "simulated_controller": True,
        "ur.servo_lag": 0.042,
        "collision_monitor.use": False,
    }
    controller = {
        "ports.dashboard": 29999,
        "ports.primary": 30001,
        "ports.secondary": 30002,
        "ports.realtime": 30003,
        "ports.rtde": 30004,
        "use_sim_time": False,
        "simulated_arm.world_port": 0,
    }
    assert nodes["arm_streamer"] == ("robot1", client)
    assert nodes["simulated_ur"] == ("robot1", controller)


NODES = {
    "simulated_drive": SimulatedDriveParameters,
    "simulated_world": SimulatedWorldParameters,
    "simulated_can_drives": SimulatedCanDrivesParameters,
    "can_bridge": CanBridgeParameters,
    "arm_streamer": ArmStreamerParameters,
    "simulated_ur": SimulatedUrParameters,
}
COMMON = {"robot", "file", "use_sim_time"}


@pytest.mark.parametrize("given", [{"drive": "can", "arm": "simulated"}, {}, {"world": "hall"}])
def test_every_parameter_is_known_to_its_node(platform, given):
    # rclpy ignores a parameter of a wrong name silently.
    _, nodes = platform(**given)
    checked = set(NODES) & set(nodes)
    assert checked
    for name in checked:
        known = {entry.name for entry in specs(NODES[name])}
        assert set(nodes[name][1]) - COMMON <= known


def test_simulated_robots_of_two_numbers_share_no_bus_and_no_port(platform):
    def own(number):
        _, nodes = platform(drive="can", arm="simulated", number=number)
        numbers = [
            [v for v in parameters.values() if type(v) is int and v > 1024]
            for _, parameters in nodes.values()
        ]
        return {n for group in numbers for n in group}

    everyone = [own(str(number)) for number in range(10)]
    assert all(len(numbers) == 6 for numbers in everyone)
    assert len(set.union(*everyone)) == 60


def test_the_client_of_a_simulated_arm_uses_the_ports_of_its_controller(platform):
    _, nodes = platform(arm="simulated", number="3")
    client, controller = nodes["arm_streamer"][1], nodes["simulated_ur"][1]
    assert client["ur.dashboard_port"] == controller["ports.dashboard"]
    assert client["ur.script_port"] == controller["ports.secondary"]
    assert client["ur.rtde_port"] == controller["ports.rtde"]


TF = [("/tf", "tf"), ("/tf_static", "tf_static")]


def test_transforms_are_published_and_received_in_the_namespace(file_of, installed, urdf_commands):
    installed.update(THIRD_PARTY_NODES)
    for arm in ("none", "ur"):
        _, nodes = started(
            file_of("platform"), rviz="true", description="true", arm=arm, odometry="node"
        )
        assert set(nodes) > THIRD_PARTY_NODES
        assert all(node.remappings == TF for node in nodes.values())


def test_rviz_is_started_on_request_with_the_installed_configuration(file_of, installed):
    installed.add("rviz2")
    arguments, nodes = started(
        file_of("platform"), rviz="true", namespace="robot1", use_sim_time="true"
    )
    rviz = nodes["rviz2"]
    assert settings(rviz, arguments) == ("robot1", {"use_sim_time": True})
    assert rviz.arguments == ["-d", f"{ROOT}/rviz/omniman.rviz"]
    assert (ROOT / "config" / "rviz" / "omniman.rviz").is_file()
    assert "rviz2" not in started(file_of("platform"))[1]


def included(file, **given):
    """Yield the files that a launch file includes, each with its arguments."""
    arguments, entities = load(file, **given)
    groups = [e for e in entities if isinstance(e, GroupAction)]
    assert len(groups) + len(arguments) == len(entities)
    for group in groups:
        (action,) = group.actions  # alone, so that its arguments reach no other
        passed = {name: value(v, arguments) for name, v in action.launch_arguments}
        yield value(action.source.path, arguments), passed


def test_two_robots_are_two_platforms_with_nothing_in_common(file_of, platform):
    robots = list(included(file_of("two_robots"), drive="can", arm="simulated", robot="ig42"))
    assert [place for place, _ in robots] == ["/share/omniman_ros/launch/platform.launch.py"] * 2
    both = [platform(**given)[1] for _, given in robots]
    assert set(both[0]) == set(both[1]) >= {"simulated_can_drives", "simulated_ur", "mpc_planner"}
    for nodes, namespace in zip(both, ("robot1", "robot2"), strict=True):
        assert {given for given, _ in nodes.values()} == {namespace}
    assert both[0]["platform_controller"][1] == both[1]["platform_controller"][1]
    assert both[0]["platform_controller"][1]["robot"] == "ig42"
    for name in ("can_bridge", "arm_streamer"):
        assert both[0][name][1] != both[1][name][1]


def test_two_robots_pass_on_all_their_arguments(file_of, platform):
    arguments, _ = load(file_of("two_robots"))
    ours, _ = platform()
    assert set(arguments) <= set(ours)
    for _, given in included(file_of("two_robots"), rviz="true", mpc="false"):
        assert (given["rviz"], given["mpc"]) == ("true", "false")
        assert set(arguments) < set(given)


def test_a_real_arm_and_the_nodes_that_know_its_limits_get_the_controllers_file(platform, file):
    _, nodes = platform(arm="ur", mpc="false", controller=file)
    assert "simulated_ur" not in nodes
    streamer = {"file": "my own.yaml", "collision_monitor.use": False}
    assert nodes["arm_streamer"] == ("", streamer)
    assert nodes["path_interpolator"][1] == {
        "file": "my own.yaml",
        "robot": "omniman",
        "use_sim_time": False,
        "collision_monitor.use": False,
    }
    assert nodes["joint_states_merger"][1]["file"] == "my own.yaml"


OMNIMAN = "/my ws/lib/omniman_ros/omniman"


def test_robot_state_publisher_is_started_if_it_is_installed(platform, installed, urdf_commands):
    assert "robot_state_publisher" not in platform()[1]
    installed.add("robot_state_publisher")
    assert "robot_state_publisher" in platform()[1]
    assert "robot_state_publisher" not in platform(description="false")[1]


def test_robot_state_publisher_gets_the_urdf_of_the_same_robot_in_its_namespace(
    platform, installed, urdf_commands, file
):
    installed.add("robot_state_publisher")
    _, nodes = platform(robot=file, namespace="robot1", use_sim_time="true", arm="simulated")
    parameters = {"robot_description": "<robot/>", "use_sim_time": True}
    assert nodes["robot_state_publisher"] == ("robot1", parameters)
    of_arm = ["-p", "describe_arm:=true"]
    assert urdf_commands == [[OMNIMAN, "urdf", "--robot", file, *of_arm]]


def test_the_urdf_of_a_real_arm_has_the_limits_of_the_controllers_file(
    platform, installed, urdf_commands, file
):
    installed.add("robot_state_publisher")
    platform(arm="ur", controller=file)
    words = ["--robot", "omniman", "--params-file", file, "-p", "describe_arm:=true"]
    assert urdf_commands == [[OMNIMAN, "urdf", *words]]


def test_a_urdf_that_cannot_be_made_ends_the_launch(platform, installed, monkeypatch):
    installed.add("robot_state_publisher")
    failed = subprocess.CompletedProcess([], 2, stdout="", stderr="no such wheel")
    monkeypatch.setattr(subprocess, "run", lambda command, **options: failed)
    with pytest.raises(RuntimeError, match="no URDF: no such wheel"):
        platform()


@pytest.mark.parametrize("arm", ["none", "simulated", "ur"])
@pytest.mark.parametrize("described", ["true", "false"])
def test_one_node_publishes_the_urdf_which_has_the_joints_that_are_published(
    platform, installed, urdf_commands, described, arm
):
    installed.add("robot_state_publisher")
    _, nodes = platform(description=described, arm=arm)
    joints = nodes["joint_states_merger"][1]
    assert joints["publish_description"] is not ("robot_state_publisher" in nodes)
    assert joints["describe_arm"] is (arm != "none")
    for command in urdf_commands:
        assert command[-1] == f"describe_arm:={str(arm != 'none').lower()}"


def test_the_command_that_launch_runs_prints_a_urdf(platform, installed, urdf_commands, capsys):
    installed.add("robot_state_publisher")
    platform(arm="ur")
    ((program, *words),) = urdf_commands
    assert Path(program).name == "omniman"
    assert main(words) == 0
    assert ElementTree.fromstring(capsys.readouterr().out).tag == "robot"


# ---- supervision --------------------------------------------------------------------------------


def running(file, **given):
    """Return the context of a launch and its nodes by executable, all of which run."""
    _, nodes = started(file, **given)
    for node in nodes.values():
        node.begin()
    return LaunchContext({}), nodes


def ask_all(nodes, context, *, send_sigint=True):
    """Do what launch does at every shutdown."""
    context.is_shutdown = True
    for node in nodes.values():
        node._shutdown_process(context, send_sigint=send_sigint)


def targets(actions):
    """Return the executables of the nodes that actions shut down."""
    return {action.event.process_matcher.executable for action in actions}


def test_the_stages_of_all_nodes_are_those_of_omniman_up(file_of):
    stages = {kind.name: kind.stage for kind in ROBOT_NODES}
    for given in ({"drive": "can", "arm": "simulated"}, {"drive": "real"}, {"world": "hall"}, {}):
        _, nodes = started(file_of("platform"), viewer="true", odometry="node", **given)
        assert {name: node.stage for name, node in nodes.items()} == {n: stages[n] for n in nodes}


def test_a_stop_reaches_each_stage_once_the_earlier_ones_have_ended(file_of):
    context, nodes = running(file_of("platform"), drive="can", mpc="false")
    ask_all(nodes, context, send_sigint=False)
    first = {"platform_controller", "path_interpolator", "joint_states_merger"}
    assert {name for name, node in nodes.items() if node.asked} == first
    # A terminal's Ctrl-C does not reach our nodes: they get a signal of their own.
    assert all(nodes[name].asked == [True] for name in first)
    assert not targets(nodes["path_interpolator"].end(context, 0)) - first
    assert not targets(nodes["joint_states_merger"].end(context, 0)) - first
    assert targets(nodes["platform_controller"].end(context, 0)) == {"can_bridge"}
    assert targets(nodes["can_bridge"].end(context, 0)) == {"simulated_can_drives"}
    assert not nodes["simulated_can_drives"].end(context, -14)  # at rest, see `nodes.runtime`


def test_the_end_of_a_node_that_the_robot_needs_is_a_failure_of_the_launch(file_of):
    context, nodes = running(file_of("platform"))
    with pytest.raises(
        RuntimeError, match=r"simulated_drive-1 .* exit code 1: stopping the robot"
    ):
        nodes["simulated_drive"].end(context, 1)
    ask_all(nodes, context)
    assert nodes["platform_controller"].asked


def test_a_node_that_does_not_come_to_rest_is_a_failure_once_all_have_ended(file_of):
    context, nodes = running(file_of("platform"), mpc="false")
    ask_all(nodes, context)
    for name in ("path_interpolator", "joint_states_merger"):
        nodes[name].end(context, 0)
    assert targets(nodes["platform_controller"].end(context, 1)) == {"simulated_drive"}
    with pytest.raises(RuntimeError, match="not stopped in order: platform_controller-1"):
        nodes["simulated_drive"].end(context, 0)


def test_only_nodes_that_move_nothing_are_started_again(file_of, installed, urdf_commands):
    installed.update(THIRD_PARTY_NODES)
    given = {"rviz": "true", "viewer": "true", "respawn": "true", "respawn_delay": "3"}
    context, nodes = running(file_of("platform"), **given)
    again = {name for name, node in nodes.items() if node.options.get("respawn")}
    assert again == {"joint_states_merger", "viewer", *THIRD_PARTY_NODES}
    assert {nodes[name].options["respawn_delay"] for name in again} == {3.0}
    viewer = nodes["viewer"]
    assert viewer.end(context, 1) == []  # no exception: the robot runs on
    ask_all(nodes, context)
    assert viewer.asked == [True]


def test_only_our_nodes_are_told_whom_to_follow(file_of, installed, urdf_commands):
    installed.update(THIRD_PARTY_NODES)
    _, nodes = started(file_of("platform"), rviz="true")
    for name, node in nodes.items():
        followed = node.options.get("additional_env", {}).get(PARENT_VARIABLE)
        assert followed == (None if name in THIRD_PARTY_NODES else str(os.getpid()))


@pytest.mark.parametrize(
    ("given", "variable", "expected"),
    [
        ({}, None, "UDPv4"),
        ({}, "SHM", None),
        ({"use_sim_time": "true"}, None, None),
        ({"use_sim_time": "True", "transports": "UDPv4"}, None, "UDPv4"),
        ({"transports": "DEFAULT"}, "SHM", "DEFAULT"),
    ],
)
def test_the_nodes_do_without_shared_memory_on_real_time_as_those_of_omniman_up(
    file_of, installed, urdf_commands, monkeypatch, given, variable, expected
):
    installed.update(THIRD_PARTY_NODES)
    monkeypatch.delenv("FASTDDS_BUILTIN_TRANSPORTS", raising=False)
    if variable is not None:
        monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", variable)
    _, nodes = started(file_of("platform"), rviz="true", **given)
    environments = [node.options.get("additional_env", {}) for node in nodes.values()]
    assert {env.get("FASTDDS_BUILTIN_TRANSPORTS") for env in environments} == {expected}
