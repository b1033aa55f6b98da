"""The arm stretched in the physics world, which judges what the controller computes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from omniman_ros.control.dynamics import PlatformDynamics
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.stability import SupportModel
from omniman_ros.description.arm_mass import ArmMass
from omniman_ros.robots import robot_parameters

pytest.importorskip("mujoco")

from test.closed_loop.arm_drive import drive
from test.simulation.world.support import ideal

POSTURES = ([math.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0], [2.0, -math.pi / 3, 1.0, -0.5, 0.7, 0.3])
PLANT_GRAVITY = 9.81
PAYLOAD = {"arm.mass": 23.4}  #: Mass of a UR5 with the whole payload of its data sheet [kg]
TRACK = 0.74  #: Track of the narrow platform over that of the robot [-]
HIGH = {
    "body.com_z": 0.45,
    "mount.z": 0.8,
    "limits.linear_acceleration": 2.0,
    "limits.linear_deceleration": 3.0,
}  #: What is higher on the narrow platform [m], and limits that it does not bear [m/s^2]


def support(bench, posture):
    arm = ArmMass(bench.robot.arm, bench.description.mount).at(np.array(posture))
    robot = replace(bench.robot, arm=arm)
    kinematics = PlatformKinematics(robot.wheels)
    return SupportModel(robot, kinematics, PlatformDynamics(robot, kinematics).mass_matrix)


@pytest.mark.parametrize("posture", POSTURES)
def test_the_wheels_bear_what_the_controller_computes_at_rest_and_in_acceleration(posture):
    bench = ideal("omniman", arm__tool_centre=[0.05, 0.0, 0.1], arm__mass=23.4)
    bench.world.arm.place(posture)
    model, twist, loads, twists = support(bench, posture), np.zeros(3), [], []
    bench.wait(0.5)
    at_rest = bench.world.wheel_loads * 9.80665 / PLANT_GRAVITY
    np.testing.assert_allclose(at_rest, model.loads(np.zeros(3)), rtol=0.01)
    acceleration = np.array([0.8, -1.0, 0.6])
    for _ in range(100):
        twist = twist + 0.005 * acceleration
        bench.drive(twist, 0.005)
        loads.append(bench.world.wheel_loads.copy())
        twists.append(bench.world.twist)
    settled = slice(40, 100)
    measured = (twists[-1] - twists[40]) / (0.005 * 59)
    np.testing.assert_allclose(measured, acceleration, atol=0.05)
    turn = np.mean([t[2] for t in twists[settled]])
    speed = np.mean(twists[settled], axis=0)
    measured += turn * np.array([-speed[1], speed[0], 0.0])  # base_link turns
    expected = model.loads(measured, turn)
    found = np.mean(loads[settled], axis=0) * 9.80665 / PLANT_GRAVITY
    assert np.abs(found - model.loads(np.zeros(3))).max() > 60.0
    np.testing.assert_allclose(found, expected, atol=12.0)


def test_a_robot_that_lifted_wheels_in_a_stop_keeps_them_on_the_floor_on_the_same_way():
    known = robot_parameters("omniman")
    narrow = {**known, **PAYLOAD, "wheels.y": [TRACK * y for y in known["wheels.y"]], **HIGH}
    before, after = (
        drive(narrow, [(0.0, 1.0, 0.0)], 1.2, knows_posture=knows) for knows in (False, True)
    )
    assert before.lifted > 0.3 and before.tilt > math.radians(1.5)
    assert after.lifted == 0.0 and after.least_load > 80.0 and after.tilt < math.radians(0.15)
    assert after.stop_way <= 1.02 * before.stop_way


@pytest.mark.exhaustive
@pytest.mark.parametrize("mode", ["torque", "velocity"])
def test_the_feed_forward_with_the_posture_follows_better(mode):
    robot = {**robot_parameters("omniman"), **PAYLOAD, "drive.mode": mode}
    twists = [(0.0, 0.8, 0.0), (0.0, 0.0, 1.0), (0.5, 0.0, -0.8)]
    fixed, moved = (drive(robot, twists, 1.0, knows_posture=knows) for knows in (False, True))
    assert moved.speed_error < 0.85 * fixed.speed_error
    assert moved.yaw_error < 0.8 * fixed.yaw_error
