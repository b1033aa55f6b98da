"""The arm on the platform."""

import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.description.ur5 import ARM_MASS, BASE, TOOL_CENTRE, links
from omniman_ros.simulation.world.world import World
from test.simulation.world.support import STEP, ideal

GRAVITY = 9.81
HALF_TURN = np.diag([-1.0, -1.0, 1.0])


def rotation(rpy):
    """Fixed axes x, y, z, as in a URDF."""
    result = np.eye(3)
    for axis, angle in enumerate(rpy):
        c, s = math.cos(angle), math.sin(angle)
        turn = np.eye(3)
        i, j = (axis + 1) % 3, (axis + 2) % 3
        turn[i, i], turn[i, j], turn[j, i], turn[j, j] = c, -s, s, c
        result = turn @ result
    return result


TOOL_MASS = 2.0


def masses_and_centres(q, mount):
    """Masses of the arm's links and of the tool, and where they are in base_link."""
    place, turn = np.array([mount.x, mount.y, mount.z]), HALF_TURN
    found = [(BASE.mass, place + turn @ np.array(BASE.centre))]
    for link, angle in zip(links(), q, strict=True):
        place = place + turn @ np.array(link.place)
        turn = turn @ rotation(link.rpy) @ rotation((0.0, 0.0, angle))
        found.append((link.mass, place + turn @ np.array(link.centre)))
    found.append((TOOL_MASS, place + turn @ np.array(TOOL_CENTRE)))
    return found


POSTURES = [
    [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    [math.pi / 2, -0.3, 0.4, 0.2, 0.1, 0.0],
    [2.0, -math.pi / 2, 1.0, -0.5, 0.7, 0.3],
]


@pytest.mark.parametrize("q", POSTURES)
def test_the_wheels_carry_the_arm_where_it_is(q):
    """Weight and both moments of the wheel loads are those of body and links."""
    bench = ideal("omniman")
    bench.world.arm.place(q)
    bench.wait(1.0)
    robot = bench.robot
    parts = masses_and_centres(q, bench.description.mount)
    parts.append((robot.body.mass, np.array([robot.body.com_x, robot.body.com_y, 0.0])))
    loads = bench.world.wheel_loads
    assert loads.sum() == pytest.approx(GRAVITY * sum(mass for mass, _ in parts), rel=1e-3)
    for axis, values in enumerate((robot.wheels.x, robot.wheels.y)):
        moment = GRAVITY * sum(mass * centre[axis] for mass, centre in parts)
        assert loads @ np.array(values) == pytest.approx(moment, abs=0.5)


def test_the_arm_and_its_tool_have_the_mass_that_the_planar_plant_has():
    """The manufacturer's data sheet has 18.4 kg."""
    bench = ideal("omniman")
    mount = bench.description.mount
    parts = [mass for mass, _ in masses_and_centres(POSTURES[0], mount)]
    assert sum(parts) == pytest.approx(bench.robot.arm.mass)
    assert sum(parts) - TOOL_MASS == pytest.approx(ARM_MASS) == pytest.approx(18.4)
    bench.wait(1.0)
    weight = GRAVITY * (bench.robot.body.mass + bench.robot.arm.mass)
    assert bench.world.wheel_loads.sum() == pytest.approx(weight, rel=1e-3)


def test_the_torque_of_the_second_joint_holds_the_stretched_arm():
    bench = ideal("omniman")
    bench.world.arm.place(POSTURES[0])
    bench.wait(1.0)
    shoulder = bench.description.mount.x
    moment = sum(
        mass * (centre[0] - shoulder)
        for mass, centre in masses_and_centres(POSTURES[0], bench.description.mount)[2:]
    )
    assert abs(bench.world.arm.torques[1]) == pytest.approx(GRAVITY * moment, rel=1e-3)
    np.testing.assert_allclose(bench.world.arm.positions, 0.0, atol=1e-5)


def lift(world: World, seconds: float, height: float):
    """Lift the stretched arm from rest to rest; return the sums of the wheel loads."""
    sums = []
    steps = round(seconds / STEP)
    for k in range(steps + 500):
        s = min(k / steps, 1.0)
        angle = -height * (10.0 - 15.0 * s + 6.0 * s * s) * s**3
        world.arm.command([0.0, angle, 0.0, 0.0, 0.0, 0.0])
        world.step([0.0] * 4)
        sums.append(world.wheel_loads.sum())
    return np.array(sums)


def test_lifting_the_arm_presses_the_wheels_to_the_floor_and_then_relieves_them():
    """From rest to rest, the mean load is the weight: no momentum remains."""
    bench = ideal("omniman")
    bench.world.arm.place(POSTURES[0])
    bench.wait(1.0)
    weight = bench.world.wheel_loads.sum()
    sums = lift(bench.world, 0.6, 0.5)
    assert sums[:300].max() > 1.02 * weight
    assert sums[300:600].min() < 0.98 * weight
    assert (sums - weight).sum() * STEP == pytest.approx(0.0, abs=0.2)


def test_a_swinging_arm_turns_a_platform_without_grip_the_other_way():
    """No torque from outside about the vertical: the angular momentum stays zero."""
    bench = ideal("omniman", friction__mu=0.01)
    bench.world.arm.place(POSTURES[0])
    bench.wait(0.5)
    bench.world.arm.command([0.4, 0.0, 0.0, 0.0, 0.0, 0.0])
    for _ in range(60):
        bench.world.step([0.0] * 4)
    assert bench.world.pose[2] < -0.005


def test_joint_torques_keep_their_limits():
    bench = ideal("omniman")
    bench.world.arm.command([3.0, -3.0, 2.5, 3.0, -3.0, 3.0])
    largest = np.zeros(6)
    for _ in range(200):
        bench.world.step([0.0] * 4)
        largest = np.maximum(largest, np.abs(bench.world.arm.torques))
    assert (largest <= [150.0, 150.0, 150.0, 28.0, 28.0, 28.0]).all()
    assert largest[0] == 150.0


@pytest.mark.parametrize("wrong", [[0.0] * 5, [math.nan] * 6, [math.inf, 0, 0, 0, 0, 0]])
def test_wrong_setpoints_move_nothing(wrong):
    bench = ideal("omniman")
    before = bench.world.arm.positions
    for call in (bench.world.arm.command, bench.world.arm.place):
        with pytest.raises(InputError, match="six finite"):
            call(wrong)
    bench.wait(0.2)
    np.testing.assert_allclose(bench.world.arm.positions, before, atol=1e-4)


def test_a_robot_without_an_arm_has_none():
    assert ideal("ig42").world.arm is None
