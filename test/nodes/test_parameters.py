"""Parameter sets as ROS parameters: unknown names and robots from files."""

import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.parameters import unknown_names
from omniman_ros.nodes.platform_controller import PlatformControllerNode
from omniman_ros.nodes.registry import NODES, known_names, node_specs
from omniman_ros.robots import robot_file
from test.nodes.harness import World


def test_mistyped_name_is_reported_with_the_closest_known_one():
    (sentence,) = unknown_names(["coupling.k_epsilonn", "limits.linear_jerk"], known_names())
    assert "coupling.k_epsilonn" in sentence and "'coupling.k_epsilon'" in sentence
    assert unknown_names(["use_sim_time", "robot"], known_names()) == []


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


def test_names_are_unique_and_every_parameter_has_a_description():
    for node in NODES:
        names = [spec.name for spec in node_specs(node)]
        assert len(names) == len(set(names))
        assert all(spec.doc.endswith(".") for spec in node_specs(node)), node
