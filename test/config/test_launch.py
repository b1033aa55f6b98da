"""The launch files against small stand-ins for `launch` and `launch_ros`, which PyPI lacks."""

import re
import runpy
import shlex
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import pytest
import setuptools

from omniman_ros.cli.main import main
from omniman_ros.core.parameters import build, specs
from omniman_ros.nodes import registry
from omniman_ros.nodes.arm_streamer_parameters import ArmStreamerParameters
from omniman_ros.nodes.can_bridge_parameters import CanBridgeParameters
from omniman_ros.nodes.simulated_can_drives_parameters import SimulatedCanDrivesParameters
from omniman_ros.nodes.simulated_drive_parameters import SimulatedDriveParameters
from omniman_ros.nodes.simulated_ur_parameters import SimulatedUrParameters
from omniman_ros.nodes.simulated_world_parameters import SimulatedWorldParameters
from omniman_ros.processes import arm_options
from omniman_ros.ur.parameters import UrParameters

ROOT = Path(__file__).resolve().parents[2]
LAUNCH_FILES = sorted((ROOT / "config" / "launch").glob("*.launch.py"))


@dataclass(frozen=True)
class LaunchConfiguration:
    name: str

    def value(self, arguments):
        return arguments[self.name]


@dataclass(frozen=True)
class EqualsSubstitution:
    left: Any
    right: Any

    def value(self, arguments):
        return str(value(self.left, arguments) == value(self.right, arguments)).lower()


@dataclass(frozen=True)
class NotSubstitution:
    raw: Any

    def value(self, arguments):
        return {"true": "false", "false": "true"}[value(self.raw, arguments)]


@dataclass(frozen=True)
class AndSubstitution:
    left: Any
    right: Any

    def value(self, arguments):
        sides = [value(side, arguments) for side in (self.left, self.right)]
        assert set(sides) <= {"true", "false"}
        return str(sides == ["true", "true"]).lower()


@dataclass(frozen=True)
class Command:
    """Stands for a command: its value is the command line rather than its output."""

    command: list
    on_stderr: str = "fail"

    def value(self, arguments):
        return shlex.split("".join(value(part, arguments) for part in self.command))


@dataclass(frozen=True, kw_only=True)
class ExecutableInPackage:
    executable: str
    package: str

    def value(self, arguments):
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
class PythonExpression:
    expression: list

    def value(self, arguments):
        return str(eval("".join(value(part, arguments) for part in self.expression), {}, {}))


@dataclass(frozen=True)
class IfCondition:
    predicate: Any

    def value(self, arguments):
        return {"true": True, "false": False}[value(self.predicate, arguments)]


@dataclass(frozen=True)
class UnlessCondition:
    predicate: Any

    def value(self, arguments):
        return not IfCondition(self.predicate).value(arguments)


@dataclass(frozen=True)
class ParameterValue:
    raw: Any
    value_type: type

    def __init__(self, value, *, value_type):
        object.__setattr__(self, "raw", value)
        object.__setattr__(self, "value_type", value_type)

    def value(self, arguments):
        text = value(self.raw, arguments)
        if self.value_type is bool:
            return {"true": True, "false": False}[text]
        assert self.value_type in (str, int, float)
        return text if self.value_type is str else self.value_type(text)


@dataclass
class DeclareLaunchArgument:
    name: str
    default_value: Any
    description: str
    choices: list | None = None

    def __post_init__(self):
        assert self.choices is None or self.default_value in self.choices


@dataclass(kw_only=True)
class Node:
    package: str
    executable: str
    namespace: Any = None
    parameters: list = field(default_factory=list)
    arguments: list = field(default_factory=list)
    remappings: list = field(default_factory=list)
    output: str = "log"
    condition: Any = None


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
    "launch": [LaunchDescription],
    "launch.actions": [DeclareLaunchArgument, GroupAction, IncludeLaunchDescription],
    "launch.conditions": [IfCondition, UnlessCondition],
    "launch.launch_description_sources": [PythonLaunchDescriptionSource],
    "launch.substitutions": [
        AndSubstitution,
        Command,
        EqualsSubstitution,
        LaunchConfiguration,
        NotSubstitution,
        PathJoinSubstitution,
        PythonExpression,
    ],
    "launch_ros": [],
    "launch_ros.actions": [Node],
    "launch_ros.parameter_descriptions": [ParameterValue],
    "launch_ros.substitutions": [ExecutableInPackage, FindPackageShare],
}


@pytest.fixture
def installed():
    """Third-party packages that count as installed; a test adds to it before it launches."""
    return set()


@pytest.fixture(autouse=True)
def stand_ins(monkeypatch, installed):
    def get_package_prefix(package):
        if package not in installed:
            raise KeyError(package)
        return "/opt/ros/jazzy"

    index = ModuleType("ament_index_python.packages")
    index.get_package_prefix = get_package_prefix
    monkeypatch.setitem(sys.modules, "ament_index_python.packages", index)
    for name, members in STAND_INS.items():
        module = ModuleType(name)
        for member in members:
            setattr(module, member.__name__, member)
        monkeypatch.setitem(sys.modules, name, module)


THIRD_PARTY_NODES = {"robot_state_publisher", "rviz2"}
"""Executables of third-party packages of the same name."""


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
    nodes = {}
    for node in (e for e in entities if isinstance(e, Node)):
        if node.condition is None or value(node.condition, arguments):
            assert node.executable not in nodes
            package = node.executable if node.executable in THIRD_PARTY_NODES else "omniman_ros"
            assert node.package == package
            nodes[node.executable] = node
    return arguments, nodes


def settings(node, arguments):
    """Return the namespace and the parameters of a node."""
    parameters = {}
    for group in node.parameters:
        parameters |= group if isinstance(group, dict) else {"file": group}
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


def test_there_are_two_launch_files():
    names = [file.name for file in LAUNCH_FILES]
    assert names == ["platform.launch.py", "two_robots.launch.py"]


def test_every_argument_in_use_is_declared_and_every_executable_exists(platform, monkeypatch):
    monkeypatch.setattr(setuptools, "setup", lambda **arguments: None)
    executables = runpy.run_path(str(ROOT / "setup.py"))["EXECUTABLES"]
    # An argument that is not declared raises a KeyError in `launch`.
    _, nodes = platform()
    assert nodes
    assert set(nodes) <= set(executables)  # third-party nodes are not started by default


def test_platform_starts_the_simulated_drive_and_the_controller_by_default(platform):
    arguments, nodes = platform()
    assert arguments == {
        "robot": "omniman",
        "namespace": "",
        "use_sim_time": "false",
        "drive": "simulated",
        "world": "",
        "installation": "/share/omniman_ros/config/can/cia402.yaml",
        "arm": "none",
        "controller": "/share/omniman_ros/config/ur/ur5.yaml",
        "odometry": "controller",
        "mpc": "true",
        "viewer": "false",
        "rviz": "false",
        "number": "0",
        "description": "false",
    }
    assert nodes == {
        "simulated_drive": ("", {"robot": "omniman", "publish_clock": False}),
        "platform_controller": (
            "",
            {"robot": "omniman", "use_sim_time": False, "publish_odom": True},
        ),
        "path_interpolator": ("", {"robot": "omniman", "use_sim_time": False}),
        "joint_state_broadcaster": (
            "",
            {"robot": "omniman", "use_sim_time": False, "publish_description": True},
        ),
        "mpc_planner": ("", {"robot": "omniman", "use_sim_time": False}),
    }


def test_platform_passes_robot_and_namespace_to_every_node(platform):
    _, nodes = platform(robot="/tmp/mine.yaml", namespace="robot1", viewer="true")
    for namespace, parameters in nodes.values():
        assert namespace == "robot1"
        assert parameters["robot"] == "/tmp/mine.yaml"


def test_in_simulated_time_the_drive_publishes_the_clock_and_the_others_follow_it(platform):
    _, nodes = platform(use_sim_time="true")
    _, drive = nodes.pop("simulated_drive")
    assert drive["publish_clock"] is True
    assert "use_sim_time" not in drive
    for _, parameters in nodes.values():
        assert parameters["use_sim_time"] is True


def test_in_a_world_the_world_takes_the_place_of_the_drive(platform):
    _, nodes = platform(world="/my scenes/hall.yaml", use_sim_time="true", robot="ig42")
    assert "simulated_drive" not in nodes
    scene = {"robot": "ig42", "publish_clock": True, "scene": "/my scenes/hall.yaml"}
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


def test_the_odometry_is_a_process_of_its_own_on_request(platform):
    _, nodes = platform(odometry="node", use_sim_time="true", robot="ig42")
    assert nodes["odometry"] == ("", {"robot": "ig42", "use_sim_time": True})
    assert nodes["platform_controller"][1]["publish_odom"] is False


BUS = {"can.interface": "udp_multicast", "can.channel": "239.74.163.2", "can.port": 43113}


def test_real_drives_get_a_bridge_with_their_installation_and_no_simulation(platform):
    _, nodes = platform(drive="real", mpc="false", installation="/mine.yaml")
    assert set(nodes) == {
        "platform_controller",
        "path_interpolator",
        "joint_state_broadcaster",
        "can_bridge",
    }
    assert nodes["can_bridge"] == ("", {"file": "/mine.yaml", "robot": "omniman"})


def test_simulated_drives_on_a_bus_share_installation_and_bus_with_the_bridge(platform):
    _, nodes = platform(drive="can", mpc="false", robot="ig42")
    assert "simulated_drive" not in nodes
    file = "/share/omniman_ros/config/can/cia402.yaml"
    expected = ("", {"file": file, "robot": "ig42", **BUS})
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
            [v for v in parameters.values() if type(v) is int and v > 0]
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


def test_transforms_are_published_and_received_in_the_namespace(file_of):
    source = {file.stem: file.read_text() for file in (ROOT / "omniman_ros/nodes").glob("*.py")}

    def imported(name):
        """Return all modules of the room that a module imports, itself included."""
        found, new = set(), {name}
        while new:
            found |= new
            texts = (source.get(each, "") for each in new)
            new = set(re.findall(r"omniman_ros\.nodes\.(\w+) import", "".join(texts))) - found
        return found

    ours = {
        name
        for name in registry.NODES
        if any("tf2_msgs.msg import" in source.get(each, "") for each in imported(name))
    }
    assert ours == {"platform_controller", "odometry", "simulated_drive", "simulated_world"}
    for arm in ("none", "ur"):
        _, nodes = started(
            file_of("platform"), rviz="true", description="true", arm=arm, odometry="node"
        )
        assert {name for name, node in nodes.items() if node.remappings == TF} == (
            ours & set(nodes)
        ) | THIRD_PARTY_NODES
        assert all(node.remappings in ([], TF) for node in nodes.values())


def test_rviz_is_started_on_request_with_the_installed_configuration(file_of):
    arguments, nodes = started(
        file_of("platform"), rviz="true", namespace="robot1", use_sim_time="true"
    )
    rviz = nodes["rviz2"]
    assert settings(rviz, arguments) == ("robot1", {"use_sim_time": True})
    option, place = (value(word, arguments) for word in rviz.arguments)
    assert (option, place) == ("-d", "/share/omniman_ros/rviz/omniman.rviz")
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


def test_a_real_arm_and_the_nodes_that_know_its_limits_get_the_controllers_file(platform):
    _, nodes = platform(arm="ur", mpc="false", controller="/mine.yaml")
    assert "simulated_ur" not in nodes
    assert nodes["arm_streamer"] == ("", {"file": "/mine.yaml"})
    assert nodes["path_interpolator"][1] == {
        "file": "/mine.yaml",
        "robot": "omniman",
        "use_sim_time": False,
    }
    assert nodes["joint_state_broadcaster"][1]["file"] == "/mine.yaml"


OMNIMAN = "/my ws/lib/omniman_ros/omniman"


def test_robot_state_publisher_is_started_if_it_is_installed(platform, installed):
    installed.add("robot_state_publisher")
    arguments, nodes = platform()
    assert arguments["description"] == "true"
    assert "robot_state_publisher" in nodes
    assert "robot_state_publisher" not in platform(description="false")[1]


def test_robot_state_publisher_gets_the_urdf_of_the_same_robot_in_its_namespace(platform):
    _, nodes = platform(
        description="true", robot="/a b/mine.yaml", namespace="robot1", use_sim_time="true"
    )
    namespace, parameters = nodes["robot_state_publisher"]
    assert namespace == "robot1"
    assert parameters["robot_description"] == [OMNIMAN, "urdf", "--robot", "/a b/mine.yaml"]
    assert parameters["use_sim_time"] is True


def test_the_urdf_of_a_real_arm_has_the_limits_of_the_controllers_file(platform):
    _, nodes = platform(description="true", arm="ur", controller="/my lab.yaml")
    command = nodes["robot_state_publisher"][1]["robot_description"]
    assert command == [OMNIMAN, "urdf", "--robot", "omniman", "--params-file", "/my lab.yaml"]


@pytest.mark.parametrize("arm", ["none", "simulated", "ur"])
@pytest.mark.parametrize("described", ["true", "false"])
def test_the_urdf_is_published_by_one_node(platform, described, arm):
    _, nodes = platform(description=described, arm=arm)
    ours = nodes["joint_state_broadcaster"][1]["publish_description"]
    assert ours is not ("robot_state_publisher" in nodes)


def test_the_command_that_launch_runs_prints_a_urdf(platform, capsys):
    _, nodes = platform(description="true", arm="ur", controller=str(ROOT / "config/ur/ur5.yaml"))
    program, *words = nodes["robot_state_publisher"][1]["robot_description"]
    assert Path(program).name == "omniman"
    assert main(words) == 0
    assert ElementTree.fromstring(capsys.readouterr().out).tag == "robot"
