from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from omniman_ros.control.dynamics import GRAVITY, PlatformDynamics
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.core.platform import Platform
from omniman_ros.planning.mpc.model import PlanningModel
from test import robots
from test.planning.support import model

#: Changes of a robot without dry friction
DRY = {"friction.coulomb": [0.0], "friction.roller": [0.0]}


def rate_of(planning: PlanningModel) -> ca.Function:
    """Return the function from twist and motor currents to the derivative of the twist."""
    twist, currents = ca.SX.sym("twist", 3), ca.SX.sym("currents", planning.wheel_count)
    return ca.Function("rate", [twist, currents], [planning.twist_rate(twist, currents)])


def rate(planning: PlanningModel, twist, currents):
    return np.asarray(rate_of(planning)(twist, currents)).ravel()


def dynamics(robot: Platform) -> PlatformDynamics:
    return PlatformDynamics(robot, PlatformKinematics(robot.wheels))


@pytest.mark.parametrize("name", robots.ALL)
def test_acceleration_is_the_inverse_of_the_dynamics_module(name):
    robot = robots.robot(name, DRY)
    planning, core = PlanningModel.of(robot), dynamics(robot)
    viscous, random = np.array(robot.friction.viscous), np.random.default_rng(1)
    for _ in range(20):
        twist = random.uniform(-1, 1, 3) * [1.5, 1.5, 3.0]
        currents = random.uniform(-10, 10, planning.wheel_count)
        found = rate(planning, twist, currents)
        driving = planning.efficiency * planning.emf * currents - viscous * (planning.J @ twist)
        # There are more wheels than degrees of freedom: internal torques are undetermined.
        np.testing.assert_allclose(
            planning.J.T @ core.platform_torque(twist, found), planning.J.T @ driving, atol=1e-9
        )


@pytest.mark.parametrize("name", robots.ALL)
def test_dry_friction_equals_the_dynamics_module_away_from_zero_speed(name):
    robot = robots.robot(name)
    planning, smooth = PlanningModel.of(robot), PlanningModel.of(robots.robot(name, DRY))
    core, random = dynamics(robot), np.random.default_rng(2)
    none, compared = np.zeros(planning.wheel_count), 0
    while compared < 10:
        twist = 1e3 * random.uniform(-1, 1, 3)
        wheels = planning.J @ twist
        speeds, _, width = planning.dry_speeds(ca.DM(twist))
        if (np.abs(np.asarray(speeds).ravel()) < 300 * width).any():
            continue  # near zero the two sign functions are smoothed differently
        torque = core.friction_torque(twist, wheels) - planning.viscous * wheels
        slowed = rate(planning, twist, none) - rate(smooth, twist, none)
        force = planning.inertia @ slowed
        np.testing.assert_allclose(force, -planning.J.T @ torque, rtol=0.02, atol=0.02)
        compared += 1


@pytest.mark.parametrize("name", ["ig42", "omniman", "skewed4"])
def test_motor_power_equals_friction_power_plus_rate_of_kinetic_energy(name):
    planning, random = model(name), np.random.default_rng(3)
    for _ in range(20):
        twist = random.uniform(-1, 1, 3)
        currents = random.uniform(-10, 10, planning.wheel_count)
        wheels = planning.J @ twist
        speeds, strength, width = planning.dry_speeds(ca.DM(twist))
        s = np.asarray(speeds).ravel()
        lost = strength @ (np.sqrt(s**2 + width**2) - width) + planning.viscous @ wheels**2
        gained = twist @ planning.inertia @ rate(planning, twist, currents)
        driving = planning.efficiency * planning.emf * currents @ wheels
        assert gained + lost == pytest.approx(driving, abs=1e-9)


def test_friction_is_zero_at_rest_and_always_opposes_motion():
    planning = model("ig42")
    none = np.zeros(4)
    np.testing.assert_allclose(rate(planning, np.zeros(3), none), 0.0, atol=1e-12)
    for twist in np.random.default_rng(4).uniform(-1, 1, (20, 3)):
        assert twist @ planning.inertia @ rate(planning, twist, none) < 0.0


def test_force_on_a_robot_with_an_off_centre_arm_causes_yaw_acceleration():
    robot = robots.robot("omniman")
    planning, arm = PlanningModel.of(robot), robot.arm
    assert arm.mass * arm.com_x > 1.0
    assert planning.inertia[1, 2] == pytest.approx(arm.mass * arm.com_x)
    bare = PlanningModel.of(replace(robot, arm=replace(arm, mass=0.0)))
    # The same force to the left, without a moment about the origin of base_link.
    push = 5.0 * planning.J @ [0.0, 1.0, 0.0]
    assert rate(planning, np.zeros(3), push)[2] < -0.05
    assert rate(bare, np.zeros(3), push)[2] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("name", robots.ALL)
def test_kinetic_energy_is_the_sum_over_bodies_and_wheels(name):
    robot, twists = robots.robot(name), np.random.default_rng(5).uniform(-1, 1, (7, 3))
    planning = PlanningModel.of(robot)
    found = planning.kinetic_energy(twists)
    assert found.shape == (7,)
    for twist, energy in zip(twists, found, strict=True):
        expected = 0.5 * np.array(robot.wheels.inertia) @ (planning.J @ twist) ** 2
        for body in (robot.body, robot.arm):
            velocity = twist[:2] + twist[2] * np.array([-body.com_y, body.com_x])
            expected += 0.5 * (body.mass * velocity @ velocity + body.inertia * twist[2] ** 2)
        assert energy == pytest.approx(expected)


@pytest.mark.parametrize("name", robots.ALL)
def test_voltage_is_resistive_drop_plus_back_emf(name):
    robot, random = robots.robot(name), np.random.default_rng(6)
    planning, motor = PlanningModel.of(robot), robot.motor
    currents = random.uniform(-9, 9, (5, planning.wheel_count))
    twists = random.uniform(-1, 1, (5, 3))
    found = planning.voltages(currents, twists)
    assert found.shape == (5, planning.wheel_count)
    for volts, amps, twist in zip(found, currents, twists, strict=True):
        turning = robots.kinematics(name).J @ twist
        back = motor.gear_ratio * motor.torque_constant * turning
        np.testing.assert_allclose(volts, motor.resistance * amps + back)
        np.testing.assert_allclose(planning.voltages(amps, twist), volts)


def test_ig42_wheel_slips_above_2_6_newton_metres():
    planning = model("ig42")
    torque = planning.efficiency * planning.emf * planning.max_current
    grip = 0.6 * 25.0 * GRAVITY / 4 * 0.1016 * np.cos(np.pi / 4)
    np.testing.assert_allclose(torque, grip)
    assert torque[0] == pytest.approx(2.6, abs=0.05)


@pytest.mark.parametrize("name", robots.ALL)
def test_current_limit_is_the_lower_of_traction_and_amplifier(name):
    robot = robots.robot(name)
    for mu in (0.01, 5.0):
        slippery = replace(robot, friction=replace(robot.friction, mu=mu))
        planning, wheels = PlanningModel.of(slippery), robot.wheels
        grip = mu * dynamics(robot).loads * wheels.radius * np.cos(wheels.roller_angle)
        slips = grip / (planning.efficiency * planning.emf)
        np.testing.assert_allclose(
            planning.max_current, np.minimum(slips, robot.motor.max_current)
        )
        assert (slips < robot.motor.max_current).all() == (mu == 0.01)


def test_box_holds_half_the_dimensions_of_the_body():
    np.testing.assert_allclose(model("ig42").half, [0.4, 0.25])
