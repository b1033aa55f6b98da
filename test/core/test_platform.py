import math
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import flatten
from omniman_ros.core.platform import Platform, Wheels
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


def test_joints_of_wheels_are_named_as_such_once():
    made = robot(changes={"wheels.names": ["left", "right_joint", "x_wheel_joint", "rear"]})
    assert made.wheels.joints == (
        "left_wheel_joint",
        "right_joint",
        "x_wheel_joint",
        "rear_wheel_joint",
    )


def test_robot_is_immutable():
    made = robot()
    with pytest.raises(FrozenInstanceError):
        made.wheels = made.wheels
    with pytest.raises(FrozenInstanceError):
        made.body.mass = 1.0


def test_broadcasting_twice_changes_nothing():
    made = robot("skewed4")
    again = Platform(made.wheels, made.body, made.arm, made.motor, made.friction)
    assert again == made


@pytest.mark.parametrize("n", range(3, 9))
def test_random_robots_are_valid(n):
    assert random_robot(np.random.default_rng(n), n).wheel_count == n


def test_errors_contain_name_and_value():
    made = robot()
    with pytest.raises(ParameterError, match="3 values, 4 wheels") as caught:
        replace(made, wheels=replace(made.wheels, x=(0.1, 0.2, 0.3)))
    assert (caught.value.name, caught.value.value) == ("Wheels.x", (0.1, 0.2, 0.3))


@pytest.mark.parametrize(
    ("x", "y", "message"),
    [
        ([0.1, 0.2], [0.1], "has 1 values"),
        ([0.1, 0.2], [0.1, 0.2], "needs 3 to 64 corners"),
        ([0.0, 0.6, 0.0], [0.0, 0.0, 0.3], "ends at 0.5 m"),
        ([0.0, 0.4, 0.0], [0.0, 0.0, 0.36], "ends at 0.35 m"),
        ([0.0, 0.3, 0.3, 0.0], [0.0, 0.3, 0.0, 0.3], "cross or touch"),
        ([0.0, 0.3, 0.0], [0.0, 0.0, 0.01], "smaller than 0.0025"),
    ],
)
def test_an_outline_that_is_none_is_refused(x, y, message):
    with pytest.raises(ParameterError, match=message) as caught:
        robot(changes={"body.outline_x": x, "body.outline_y": y})
    assert caught.value.name.startswith("body.outline_")


def test_the_corners_of_an_outline_are_counter_clockwise_in_either_order():
    x, y = [0.0, 0.3, 0.0], [0.0, 0.0, 0.3]
    one = robot(changes={"body.outline_x": x, "body.outline_y": y}).body.outline
    other = robot(changes={"body.outline_x": x[::-1], "body.outline_y": y[::-1]}).body.outline
    np.testing.assert_array_equal(one, np.column_stack((x, y)))
    np.testing.assert_array_equal(other, one)
    assert robot().body.outline is None


def test_one_value_holds_for_all_wheels():
    made = Wheels(
        names=["a", "b", "c"],
        x=(1, 0, -1),
        y=(0, 1, 0),
        roller_angle=[0],
        radius=[0.1],
        inertia=np.array([0.01]),
    )
    assert (made.radius, made.inertia) == ((0.1,) * 3, (0.01,) * 3)
    assert made.heading == made.roller_angle == (0.0,) * 3


def test_mecanum_wheels_are_those_of_the_platform_of_the_paper():
    made = Wheels.mecanum(wheelbase=0.72, track=0.54, radius=0.127, inertia=0.08)
    known = robot("omniman").wheels
    assert made.names == known.names
    for name in ("x", "y", "heading", "roller_angle", "radius", "inertia"):
        assert getattr(made, name) == pytest.approx(getattr(known, name)), name


@pytest.mark.parametrize(
    ("change", "name"),
    [
        ({"count": 2}, "Wheels.count"),
        ({"count": 3.0}, "Wheels.count"),
        ({"distance": -0.2}, "Wheels.distance"),
        ({"radius": math.nan}, "Wheels.radius"),
        ({"inertia": "much"}, "Wheels.inertia"),
    ],
)
def test_an_impossible_layout_is_refused(change, name):
    with pytest.raises(ParameterError) as caught:
        Wheels.omni(**{"count": 3, "distance": 0.2, "radius": 0.06, "inertia": 0.004, **change})
    assert caught.value.name == name


def test_the_outline_or_the_bounding_box_is_placed_at_a_pose():
    pose = np.array([1.0, 2.0, 0.5 * np.pi])
    box = robot().body.outline_at(pose)  # 1.0 m by 0.7 m
    np.testing.assert_allclose(box, [[0.65, 2.5], [0.65, 1.5], [1.35, 1.5], [1.35, 2.5]])
    changes = {"body.outline_x": [0.0, 0.3, 0.0], "body.outline_y": [0.0, 0.0, 0.3]}
    triangle = robot(changes=changes).body.outline_at(pose)
    np.testing.assert_allclose(triangle, [[1.0, 2.0], [1.0, 2.3], [0.7, 2.0]])
