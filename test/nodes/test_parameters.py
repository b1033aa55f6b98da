"""Parameter sets as ROS parameters: unknown names and robots from files."""

import subprocess
import sys

import pytest
import rclpy
from rclpy.parameter import Parameter

from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.registry import NODES, known_names, node_specs, unknown_names
from omniman_ros.nodes.simulated_drive import SimulatedDriveNode
from omniman_ros.robots import robot_file
from test.nodes.harness import World, free_domain


def test_mistyped_name_is_reported_with_the_closest_known_one():
    (sentence,) = unknown_names(["coupling.k_epsilonn", "limits.linear_jerk"])
    assert "coupling.k_epsilonn" in sentence and "'coupling.k_epsilon'" in sentence
    assert unknown_names(["use_sim_time", "robot"]) == []


def test_the_names_of_all_nodes_are_known():
    assert unknown_names(known_names()) == []


def test_a_start_does_not_import_the_parameters_of_all_nodes():
    """To import them took as much time as to make the node."""
    code = (
        "import sys, rclpy; from omniman_ros.nodes.platform_controller import *; rclpy.init(); "
        "PlatformControllerNode().destroy_node(); rclpy.shutdown(); "
        "print([name for name in sys.modules if name.endswith('parameters')])"
    )
    ended = subprocess.run(
        [sys.executable, "-c", code], check=True, timeout=60, capture_output=True, text=True
    )
    assert "omniman_ros.nodes.platform_controller_parameters" in ended.stdout
    assert "omniman_ros.planning.parameters" not in ended.stdout


def test_robot_file_with_a_mistyped_name_is_rejected(tmp_path):
    text = robot_file("ig42").read_text().replace("linear_jerk", "linear_jrek")
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ParameterError, match=r"limits.linear_jrek.*limits.linear_jerk"):
        World(PlatformControllerNode, parameters={"robot": str(path)})


@pytest.mark.parametrize("text", ["", "a: [", "/**: {}", "- 1", "/**: {ros__parameters: 3}"])
def test_file_without_parameters_is_rejected(tmp_path, text):
    path = tmp_path / "mine.yaml"
    path.write_text(text)
    with pytest.raises(ParameterError, match="robot"):
        World(PlatformControllerNode, parameters={"robot": str(path)})


def test_robot_file_of_the_user_is_accepted(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(robot_file("ig42").read_text().replace("mass: 25.0", "mass: 26.5"))
    with World(PlatformControllerNode, parameters={"robot": str(path)}) as world:
        assert world.nodes[0].settings.value.platform.robot.body.mass == 26.5


EMPTY = [
    Parameter("x", Parameter.Type.BOOL_ARRAY, []),  # what `ros2 param set` makes of `[]`
    Parameter("x", Parameter.Type.BYTE_ARRAY, []),
    Parameter("x", Parameter.Type.DOUBLE_ARRAY, []),
    Parameter("x", Parameter.Type.STRING_ARRAY, []),
    Parameter("x", Parameter.Type.STRING_ARRAY, [""]),
]


@pytest.mark.parametrize("empty", EMPTY, ids=lambda given: f"{given.type_.name}-{given.value}")
def test_an_empty_array_of_any_type_means_none(empty):
    stuck = {"faults.stuck_wheel": ["front_left"]}
    with World(SimulatedDriveNode, parameters=stuck) as world:
        (node,) = world.nodes
        assert node.get_parameter("faults.stuck_wheel").value == ["front_left"]
        none = Parameter("faults.stuck_wheel", empty.type_, empty.value)
        result = node.set_parameters_atomically([none])
        assert result.successful, result.reason
        assert list(node.get_parameter("faults.stuck_wheel").value) == []


def node_with(arguments):
    """Return the parameters of a node with a command line."""
    context = rclpy.Context()
    context.init(args=["--ros-args", *arguments], domain_id=free_domain())
    try:
        node = SimulatedDriveNode(context=context)
        value = node.settings.value
        node.destroy_node()
    finally:
        context.shutdown()
    return value


@pytest.mark.parametrize("text", ["[]", "['']"])
def test_an_empty_array_on_the_command_line_means_none(text):
    assert node_with(["-p", f"faults.stuck_wheel:={text}"]).simulation.faults.stuck_wheel == ()
    with pytest.raises(ParameterError, match=r"'wheels\.radius' = \(\)"):
        node_with(["-p", f"wheels.radius:={text}"])


def test_a_wrong_type_that_is_not_empty_is_still_refused():
    with World(SimulatedDriveNode) as world:
        (node,) = world.nodes
        wrong = Parameter("faults.stuck_wheel", value=[True])
        assert "Wrong parameter type" in node.set_parameters_atomically([wrong]).reason


def test_an_integer_is_taken_for_a_double_as_in_a_robot_file():
    given = ["-p", "body.mass:=31", "-p", "friction.coulomb:=[1]"]
    robot = node_with(given).robot
    assert (robot.body.mass, robot.friction.coulomb[0]) == (31.0, 1.0)
    with World(SimulatedDriveNode) as world:
        (node,) = world.nodes
        change = Parameter("body.mass", value=32)
        result = node.set_parameters_atomically([change])
        assert result.successful, result.reason
        assert node.get_parameter("body.mass").value == 32.0


def test_the_clock_of_a_running_node_is_fixed():
    with World(PlatformControllerNode) as world:
        (node,) = world.nodes
        other = Parameter("use_sim_time", value=False)
        result = node.set_parameters_atomically([other])
        assert not result.successful
        assert "read-only" in result.reason
        assert node.get_parameter("use_sim_time").value is True


def test_names_are_unique_and_every_parameter_has_a_description():
    for node in NODES:
        names = [spec.name for spec in node_specs(node)]
        assert len(names) == len(set(names))
        assert all(spec.doc.endswith(".") for spec in node_specs(node)), node


@pytest.mark.processes
def test_a_parameter_file_that_rcl_cannot_read_is_named_with_the_line(tmp_path):
    file = tmp_path / "broken.yaml"
    file.write_text("/**:\n  ros__parameters:\n    a: [1\n")
    code = "import sys; from omniman_ros.nodes import odometry; sys.exit(odometry.main(sys.argv))"
    command = [sys.executable, "-c", code, "--ros-args", "--params-file", str(file)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 1
    assert f"cannot start: {file}:4: did not find expected" in ended.stderr
