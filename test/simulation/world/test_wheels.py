"""Wheels of the world against statics, rolling without slip, and the plant."""

import math

import numpy as np
import pytest

from omniman_ros.simulation.world.model.wheels import roller_half_length
from omniman_ros.simulation.world.scene import Load, Scene
from test import robots
from test.simulation.world.support import Bench, ideal, rollers
from test.tiers import combinations

GRAVITY = 9.81
AHEAD, LEFT, TURN = (0.3, 0.0, 0.0), (0.0, 0.3, 0.0), (0.0, 0.0, 0.5)


def spring_loads(x, y, com, weight):
    """Loads of equal springs under a rigid body: n_i = a + b x_i + c y_i in balance."""
    basis = np.column_stack([np.ones(len(x)), x, y])
    target = weight * np.array([1.0, *com])
    return basis @ np.linalg.solve(basis.T @ basis, target)


@pytest.mark.parametrize("make", [ideal, rollers])
@pytest.mark.parametrize("name", ["ig42", "omni3", "mecanum6"])
def test_loads_at_rest_are_those_of_statics(make, name):
    bench = make(name, arm__mass=0.0)
    bench.wait(1.0)
    robot = bench.robot
    weight = robot.body.mass * GRAVITY
    loads = bench.world.wheel_loads
    assert loads.sum() == pytest.approx(weight, rel=1e-3)
    com = (robot.body.com_x, robot.body.com_y)
    expected = spring_loads(robot.wheels.x, robot.wheels.y, com, weight)
    np.testing.assert_allclose(loads, expected, rtol=0.02)


def test_a_load_on_the_platform_weighs_on_the_wheels_below_it():
    """The moment of the loads about base_link is that of the box."""
    box = Load(name="box", x=0.2, y=-0.1, mass=10.0, length=0.2, width=0.2)
    plain, laden = ideal("ig42"), ideal("ig42", Scene(loads=(box,)))
    plain.wait(1.0)
    laden.wait(1.0)
    added = laden.world.wheel_loads - plain.world.wheel_loads
    assert added.sum() == pytest.approx(10.0 * GRAVITY, rel=1e-3)
    for values, place in ((laden.robot.wheels.x, 0.2), (laden.robot.wheels.y, -0.1)):
        assert added @ np.array(values) == pytest.approx(10.0 * GRAVITY * place, rel=0.02)


def steady(bench, twist):
    """Return electrical power [W] and twist over the last of three seconds."""
    bench.drive(twist, 2.0)
    start, before = bench.drives.ground_truth()[0], bench.drives.electrical()[:, 2].sum()
    bench.drive(twist, 1.0)
    moved = bench.drives.ground_truth()[0] - start
    return bench.drives.electrical()[:, 2].sum() - before, moved


@pytest.mark.parametrize(
    ("name", "twist"), combinations(["omniman", "ig42", "omni3"], [AHEAD, LEFT, TURN])
)
def test_ideal_wheels_draw_the_power_of_the_plant_at_its_speed(name, twist):
    power, moved = steady(ideal(name), twist)
    plant_power, plant_moved = steady(Bench(name, plant=True), twist)
    assert plant_power > 0.5
    assert power == pytest.approx(plant_power, rel=0.1)
    axis = int(np.argmax(np.abs(twist)))
    assert moved[axis] == pytest.approx(plant_moved[axis], rel=0.01)


@pytest.mark.parametrize(("name", "twist"), combinations(robots.ALL, [LEFT, TURN, AHEAD]))
def test_wheels_of_any_mounting_move_the_platform_as_they_roll(name, twist):
    bench = rollers(name)
    bench.drive(twist, 1.0)
    start, angles = bench.world.pose, bench.drives.wheel_states(bench.now).position
    bench.drive(twist, 1.5)
    moved = bench.world.pose - start
    rolled = np.linalg.pinv(bench.inverse) @ (
        bench.drives.wheel_states(bench.now).position - angles
    )
    axis = int(np.argmax(np.abs(twist)))
    assert moved[axis] == pytest.approx(rolled[axis], rel=0.04)
    assert abs(moved[axis]) > 0.2


def test_rollers_lose_way_sideways_as_their_axes_are_level_in_the_middle_only():
    """Along the axis of a roller at the angle t on the wheel, tan(45) becomes tan(45) / cos(t)."""
    bench = rollers("omniman", world__tyre_stiffness=5e6)
    bench.drive(LEFT, 1.0)
    start, angles = bench.world.pose, bench.drives.wheel_states(bench.now).position
    bench.drive(LEFT, 3.0)
    rolled = np.linalg.pinv(bench.inverse) @ (
        bench.drives.wheel_states(bench.now).position - angles
    )
    turns = np.linspace(-math.pi / 12, math.pi / 12, 1001)
    lost = 1.0 - np.cos(turns).mean()
    assert 1.0 - (bench.world.pose - start)[1] / rolled[1] == pytest.approx(lost, abs=0.004)


@pytest.mark.parametrize("angle", [0.0, math.pi / 4, -0.9])
def test_a_roller_reaches_the_floor_at_its_middle_and_where_it_hands_over(angle):
    """Depth of an ellipsoid below its centre: sqrt(sum of (axis_z half-length)^2)."""
    radius, middle, count = 0.127, 0.02, 12
    half = roller_half_length(radius, middle, angle, count)
    for turn in (0.0, math.pi / count):
        axis_z = math.cos(angle) * math.sin(turn)
        below = math.sqrt((half * axis_z) ** 2 + middle**2 * (1.0 - axis_z**2))
        assert (radius - middle) * math.cos(turn) + below == pytest.approx(radius, rel=1e-12)


def test_a_wheel_on_a_slippery_patch_has_no_grip():
    """With mu = 0 below all wheels, the wheels turn and the robot stays."""
    patch = {"patch_x_min": -2.0, "patch_x_max": 2.0, "patch_y_min": -2.0, "patch_y_max": 2.0}
    changes = {f"plant__{key}": value for key, value in patch.items()}
    bench = ideal("ig42", plant__patch_mu=0.0, **changes)
    bench.drive(AHEAD, 1.0)
    assert np.abs(bench.drives.wheel_states(bench.now).velocity).min() > 2.0
    assert abs(bench.world.pose[0]) < 0.01


def test_a_blocked_wheel_stands():
    bench = rollers("ig42", faults__stuck_wheel=["rear_left"])
    bench.drive(AHEAD, 1.0)
    assert abs(bench.world.wheels[2].angle) < 2e-3
    assert abs(bench.world.wheels[0].angle) > 1.0


def test_a_wheel_held_by_friction_does_not_creep():
    """A torque below the Coulomb friction, behind the gear, moves nothing."""
    bench = ideal("ig42")
    bench.wait(0.5)
    stall = 0.5 * 0.25 / 0.66 / (0.0325 * 24) * 1.85
    bench.volts([stall] * 4, 2.0)
    assert np.abs([wheel.angle for wheel in bench.world.wheels]).max() < 2e-3
