"""The launch file against small stand-ins for `launch` and `launch_ros`, which PyPI lacks."""

import runpy
import shlex
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree as xml

import pytest
import setuptools

from omniman_ros.cli.main import main

ROOT = Path(__file__).resolve().parents[1]
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
    """What launch would run, instead of what that prints."""

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
        assert self.value_type in (str, bool)
        text = value(self.raw, arguments)
        return {"true": True, "false": False}[text] if self.value_type is bool else text


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
    output: str = "log"
    condition: Any = None


@dataclass
class LaunchDescription:
    entities: list


def value(item, arguments):
    """What launch would make of a plain value or a substitution."""
    return item.value(arguments) if hasattr(item, "value") else item


STAND_INS = {
    "launch": [LaunchDescription],
    "launch.actions": [DeclareLaunchArgument],
    "launch.conditions": [IfCondition, UnlessCondition],
    "launch.substitutions": [
        AndSubstitution, Command, EqualsSubstitution, LaunchConfiguration, NotSubstitution,
        PathJoinSubstitution,
    ],
    "launch_ros": [],
    "launch_ros.actions": [Node],
    "launch_ros.parameter_descriptions": [ParameterValue],
    "launch_ros.substitutions": [ExecutableInPackage, FindPackageShare],
}  # fmt: skip


@pytest.fixture
def installed():
    """Packages of others on this machine; a test adds to it before it launches."""
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


def launch(file, **given):
    """Arguments of a launch file with their values, and its nodes that would start."""
    entities = runpy.run_path(str(file))["generate_launch_description"]().entities
    declared = [e for e in entities if isinstance(e, DeclareLaunchArgument)]
    arguments = {argument.name: value(argument.default_value, {}) for argument in declared}
    assert set(given) <= set(arguments)
    arguments |= given
    nodes = {}
    for node in (e for e in entities if isinstance(e, Node)):
        if node.condition is None or value(node.condition, arguments):
            parameters = {}
            for group in node.parameters:
                parameters |= group if isinstance(group, dict) else {"file": group}
            assert node.executable not in nodes
            nodes[node.executable] = (
                value(node.namespace, arguments),
                {name: value(v, arguments) for name, v in parameters.items()},
            )
            others = {"robot_state_publisher"}
            assert node.package == ("omniman_ros" if node.executable not in others
                                    else node.executable)  # fmt: skip
    return arguments, nodes


def test_there_is_a_launch_file():
    assert "platform.launch.py" in [file.name for file in LAUNCH_FILES]


@pytest.mark.parametrize("file", LAUNCH_FILES, ids=lambda file: file.name)
def test_every_argument_in_use_is_declared_and_every_executable_exists(file, monkeypatch):
    monkeypatch.setattr(setuptools, "setup", lambda **arguments: None)
    executables = runpy.run_path(str(ROOT / "setup.py"))["EXECUTABLES"]
    # An argument that is not declared raises a KeyError in `launch`.
    _, nodes = launch(file)
    assert nodes
    assert set(nodes) <= set(executables)  # those of others are not started by default


@pytest.fixture
def platform():
    (file,) = (file for file in LAUNCH_FILES if file.name == "platform.launch.py")
    return lambda **given: launch(file, **given)


def test_platform_starts_the_simulated_drive_and_the_controller_by_default(platform):
    arguments, nodes = platform()
    assert arguments == {
        "robot": "omniman",
        "namespace": "",
        "use_sim_time": "false",
        "drive": "simulated",
        "installation": "/share/omniman_ros/config/can/cia402.yaml",
        "arm": "none",
        "controller": "/share/omniman_ros/config/ur/ur5.yaml",
        "mpc": "true",
        "viewer": "false",
        "description": "false",
    }
    assert nodes == {
        "simulated_drive": ("", {"robot": "omniman", "publish_clock": False}),
        "platform_controller": ("", {"robot": "omniman", "use_sim_time": False}),
        "path_interpolator": ("", {"robot": "omniman", "use_sim_time": False}),
        "joint_state_broadcaster": (
            "", {"robot": "omniman", "use_sim_time": False, "publish_description": True}
        ),
        "mpc_planner": ("", {"robot": "omniman", "use_sim_time": False}),
    }  # fmt: skip


def test_platform_passes_robot_and_namespace_to_every_node(platform):
    _, nodes = platform(robot="/tmp/mine.yaml", namespace="robot1", viewer="true")
    for namespace, parameters in nodes.values():
        assert namespace == "robot1"
        assert parameters["robot"] == "/tmp/mine.yaml"


def test_in_simulated_time_the_drive_makes_the_clock_and_the_others_follow_it(platform):
    _, nodes = platform(use_sim_time="true")
    _, drive = nodes.pop("simulated_drive")
    assert drive["publish_clock"] is True
    assert "use_sim_time" not in drive
    for _, parameters in nodes.values():
        assert parameters["use_sim_time"] is True


def test_the_viewer_is_started_where_it_is_asked_for(platform):
    _, nodes = platform(viewer="true", use_sim_time="true")
    assert nodes["viewer"] == ("", {"robot": "omniman", "use_sim_time": True})


BUS = {"can.interface": "udp_multicast", "can.channel": "239.74.163.2"}


def test_real_drives_have_a_bridge_with_their_installation_and_no_simulation(platform):
    _, nodes = platform(drive="real", mpc="false", installation="/mine.yaml")
    assert set(nodes) == {
        "platform_controller", "path_interpolator", "joint_state_broadcaster", "can_bridge"
    }  # fmt: skip
    assert nodes["can_bridge"] == ("", {"file": "/mine.yaml", "robot": "omniman"})


def test_simulated_drives_on_a_bus_share_installation_and_bus_with_the_bridge(platform):
    _, nodes = platform(drive="can", mpc="false", robot="ig42")
    assert "simulated_drive" not in nodes
    file = "/share/omniman_ros/config/can/cia402.yaml"
    expected = ("", {"file": file, "robot": "ig42", **BUS})
    assert nodes["can_bridge"] == nodes["simulated_can_drives"] == expected


def test_a_simulated_arm_has_its_controller_beside_it(platform):
    _, nodes = platform(arm="simulated", mpc="false", namespace="robot1")
    assert nodes["arm_streamer"] == nodes["simulated_ur"] == ("robot1", {})


def test_a_real_arm_and_who_knows_its_limits_have_the_controllers_file(platform):
    _, nodes = platform(arm="ur", mpc="false", controller="/mine.yaml")
    assert "simulated_ur" not in nodes
    assert nodes["arm_streamer"] == ("", {"file": "/mine.yaml"})
    assert nodes["path_interpolator"][1] == {
        "file": "/mine.yaml", "robot": "omniman", "use_sim_time": False
    }  # fmt: skip
    assert nodes["joint_state_broadcaster"][1]["file"] == "/mine.yaml"


OMNIMAN = "/my ws/lib/omniman_ros/omniman"


def test_robot_state_publisher_is_started_where_it_is_installed(platform, installed):
    installed.add("robot_state_publisher")
    arguments, nodes = platform()
    assert arguments["description"] == "true"
    assert "robot_state_publisher" in nodes
    assert "robot_state_publisher" not in platform(description="false")[1]


def test_robot_state_publisher_has_the_urdf_of_the_same_robot_in_the_same_namespace(platform):
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


def test_the_command_that_launch_runs_is_one_that_prints_a_urdf(platform, capsys):
    _, nodes = platform(description="true", arm="ur", controller=str(ROOT / "config/ur/ur5.yaml"))
    program, *words = nodes["robot_state_publisher"][1]["robot_description"]
    assert Path(program).name == "omniman"
    assert main(words) == 0
    assert xml.fromstring(capsys.readouterr().out).tag == "robot"
