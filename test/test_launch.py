"""The launch file against small stand-ins for `launch` and `launch_ros`, which PyPI lacks."""

import runpy
import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import setuptools

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
    "launch.substitutions": [EqualsSubstitution, LaunchConfiguration, PathJoinSubstitution],
    "launch_ros": [],
    "launch_ros.actions": [Node],
    "launch_ros.parameter_descriptions": [ParameterValue],
    "launch_ros.substitutions": [FindPackageShare],
}


@pytest.fixture(autouse=True)
def stand_ins(monkeypatch):
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
            assert node.package == "omniman_ros"
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
    assert set(nodes) <= set(executables)


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
    }
    assert nodes == {
        "simulated_drive": ("", {"robot": "omniman", "publish_clock": False}),
        "platform_controller": ("", {"robot": "omniman", "use_sim_time": False}),
        "path_interpolator": ("", {"robot": "omniman", "use_sim_time": False}),
        "mpc_planner": ("", {"robot": "omniman", "use_sim_time": False}),
    }


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
    assert set(nodes) == {"platform_controller", "path_interpolator", "can_bridge"}
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


def test_a_real_arm_and_who_plans_for_it_have_the_controllers_file(platform):
    _, nodes = platform(arm="ur", mpc="false", controller="/mine.yaml")
    assert "simulated_ur" not in nodes
    assert nodes["arm_streamer"] == ("", {"file": "/mine.yaml"})
    assert nodes["path_interpolator"][1] == {
        "file": "/mine.yaml", "robot": "omniman", "use_sim_time": False
    }  # fmt: skip
