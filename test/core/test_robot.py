from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import flatten
from omniman_ros.core.robot import Robot
from test.robots import ALL, random_robot, robot

COUNTS = {"omniman": 4, "ig42": 4, "omni3": 3, "mecanum6": 6, "skewed4": 4, "mecanum8": 8}


@pytest.mark.parametrize("name", ALL)
def test_arrays_have_one_entry_per_wheel(name):
    made = robot(name)
    n = COUNTS[name]
    assert made.wheel_count == n
    for group in (made.wheels, made.friction):
        for key, value in flatten(group).items():
            if isinstance(value, tuple):
                assert len(value) == n, key


def test_robot_is_immutable():
    made = robot()
    with pytest.raises(FrozenInstanceError):
        made.wheels = made.wheels
    with pytest.raises(FrozenInstanceError):
        made.body.mass = 1.0


def test_broadcasting_twice_changes_nothing():
    made = robot("skewed4")
    again = Robot(made.wheels, made.body, made.arm, made.motor, made.friction)
    assert again == made


@pytest.mark.parametrize("n", range(3, 9))
def test_random_robots_are_valid(n):
    assert random_robot(np.random.default_rng(n), n).wheel_count == n


def test_errors_contain_name_and_value():
    made = robot()
    with pytest.raises(ParameterError, match="3 values, 4 wheels") as caught:
        replace(made, wheels=replace(made.wheels, x=(0.1, 0.2, 0.3)))
    assert (caught.value.name, caught.value.value) == ("wheels.x", (0.1, 0.2, 0.3))
