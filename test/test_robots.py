from pathlib import Path

import numpy as np
import pytest
import yaml

from omniman_ros.control.platform import PlatformController
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build, specs
from omniman_ros.core.platform import Platform
from omniman_ros.motion.whole_body.model import Mount
from omniman_ros.robots import robot_file, robot_parameters
from omniman_ros.share import share_path
from omniman_ros.simulation.plant.parameters import SimulationParameters
from omniman_ros.simulation.ur.arm import UrArmParameters
from test import robots

FILES = sorted(share_path("config").glob("*.yaml")) + sorted(robots.CONFIG.glob("*.yaml"))
GROUPS = (
    *specs(PlatformParameters),
    *specs(SimulationParameters),
    *specs(Mount, "mount."),
    *specs(UrArmParameters, "simulated_arm."),
)
KNOWN = {spec.name: spec for spec in GROUPS}


def test_all_robots_are_here():
    assert {path.stem for path in FILES} == set(robots.ALL)


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
class TestEachFile:
    def test_every_key_is_a_parameter_with_a_value_it_takes(self, path):
        # rclpy ignores a mistyped name in a file without a word.
        values = robot_parameters(str(path))
        assert values
        for name, value in values.items():
            assert name in KNOWN, f"{path.name}: no parameter '{name}'"
            KNOWN[name].check(value)

    def test_it_gives_all_that_has_no_default(self, path):
        values = robot_parameters(str(path))
        assert not [name for name, spec in KNOWN.items() if spec.required and name not in values]
        build(PlatformParameters, values)

    def test_it_is_a_ros_parameter_file_for_all_nodes(self, path):
        assert list(yaml.safe_load(path.read_text())) == ["/**"]

    def test_arrays_have_values_of_one_type(self, path):
        # ROS has no mixed arrays, and none without a type.
        for name, value in robot_parameters(str(path)).items():
            if isinstance(value, list):
                assert value, name
                assert {type(item) for item in value} == {KNOWN[name].item}, name
            elif KNOWN[name].kind is float:
                assert isinstance(value, float), f"{name}: ROS would declare an integer"

    def test_it_moves_every_way_within_its_wheels_and_motors(self, path):
        made = build(PlatformParameters, robot_parameters(str(path)))
        controller = PlatformController(made)
        limits, motor = made.limits, made.robot.motor
        for axis, (speed, rate) in enumerate(
            [(limits.linear_velocity, limits.linear_acceleration)] * 2
            + [(limits.angular_velocity, limits.angular_acceleration)]
        ):
            twist = speed * np.eye(3)[axis]
            assert abs(controller.cascade.kinematics.J @ twist).max() <= motor.max_speed
            torque = controller.cascade.dynamics.platform_torque(twist, rate * np.eye(3)[axis])
            speeds = controller.cascade.kinematics.J @ twist
            torque = torque + controller.cascade.dynamics.friction_torque(twist, speeds)
            assert (abs(torque) <= controller.cascade.dynamics.torque_limit).all()

    def test_its_box_holds_its_wheels(self, path):
        made = build(Platform, robot_parameters(str(path)))
        assert max(map(abs, made.wheels.x)) <= made.body.length / 2
        assert max(map(abs, made.wheels.y)) <= made.body.width / 2


def test_the_configurations_cover_what_they_are_for():
    shape = {name: robots.kinematics(name) for name in robots.ALL}
    assert {model.wheel_count for model in shape.values()} == {3, 4, 6, 8}
    assert not any(robots.robot("omni3").wheels.roller_angle)
    first = robots.robot("mecanum6").wheels
    assert len(set(first.roller_angle[:3])) == 1
    assert np.linalg.matrix_rank(shape["mecanum6"].J[:3]) == 2
    skewed = robots.robot("skewed4").wheels
    assert len(set(skewed.radius)) == 4
    assert len(set(skewed.heading)) == 4


def test_known_names_are_offered_where_there_is_no_such_robot():
    with pytest.raises(ParameterError, match="ig42, omniman, or the path"):
        robot_parameters("omnimann")
    with pytest.raises(ParameterError, match="no such file"):
        robot_parameters("nowhere/at_all.yaml")


@pytest.mark.parametrize("name", ["", "../config/omniman", "launch/platform", "/etc/passwd"])
def test_a_name_is_no_way_out_of_the_folder(name):
    with pytest.raises(ParameterError):
        robot_file(name)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "a: 1",
        "/**: 1",
        "/**:\n  ros__parameters: 5",
        "/**:\n  ros__parameters:",
        "[1]",
        "/**:\n  other: {}",
    ],
)
def test_a_file_of_another_kind_is_refused(tmp_path: Path, text):
    path = tmp_path / "robot.yaml"
    path.write_text(text)
    with pytest.raises(ParameterError, match="ros__parameters"):
        robot_parameters(str(path))


def test_a_robot_is_read_anew_after_a_change_of_what_was_read_or_of_the_file(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(robot_file("ig42").read_text())
    first = robot_parameters(str(path))
    first["wheels.y"].append(1.0)
    assert robot_parameters(str(path))["wheels.y"] == first["wheels.y"][:-1]
    path.write_text(path.read_text().replace("mass: 25.0", "mass: 26.5"))
    assert robot_parameters(str(path))["body.mass"] == 26.5
