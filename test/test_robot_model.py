"""A robot as one object."""

import numpy as np
import pytest

import omniman_ros as om
from omniman_ros.robots import robot_parameters
from test.robots import ALL, path


@pytest.mark.parametrize("name", ALL)
def test_every_robot_is_loaded_whole(name):
    robot = om.load_robot(path(name))
    assert robot.values == robot_parameters(path(name))
    assert robot.platform == robot.controller.robot == robot.planner.robot == robot.paths.robot
    assert robot.description.robot.wheels == robot.wheels
    np.testing.assert_allclose(robot.kinematics.T @ robot.kinematics.J, 0.0, atol=1e-9)


def test_a_changed_value_is_in_every_set_that_has_it():
    robot = om.load_robot("omniman")
    slower = robot.changed({"limits.linear_velocity": 0.2, "horizon.steps": 10})
    assert slower.limits.linear_velocity == slower.planner.limits.linear_velocity == 0.2
    assert slower.planner.horizon.steps == 10
    assert robot.limits.linear_velocity == 1.0
    assert slower.changed({"limits.linear_velocity": 1.0}).limits == robot.limits


@pytest.mark.parametrize(
    ("values", "error", "text"),
    [
        ({"horizon.stepps": 10}, om.ParameterError, "did you mean 'horizon.steps'"),
        ({"wheels.radus": 0.1}, om.ParameterError, "'wheels.radus' = 0.1 is refused"),
        ({"wheels.radius": [-0.1]}, om.ParameterError, "below the minimum 0.005 m"),
        ({"weights.energy": float("nan")}, om.ParameterError, "not a finite number"),
        ({"wheels.roller_angle": [1.5707]}, om.GeometryError, "cannot drive"),
    ],
)
def test_what_a_file_could_not_say_is_refused(values, error, text):
    with pytest.raises(error, match=text):
        om.load_robot("omniman").changed(values)


def test_the_values_cannot_be_changed_in_place():
    with pytest.raises(TypeError):
        om.load_robot("omniman").values["body.mass"] = 1.0
