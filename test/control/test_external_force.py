"""The observer of the external force, against motions whose forces are known."""

import numpy as np
import pytest

from omniman_ros.control.dynamics import PlatformDynamics
from omniman_ros.control.held_robot import OBSERVER_TIME, ExternalForceObserver
from omniman_ros.control.kinematics import PlatformKinematics
from test import robots

DT = 0.005
RNG = np.random.default_rng(5)


class Motion:
    """A robot whose wheels do not slip, with motors that balance an external wrench."""

    def __init__(self, name="omniman", idle=()):
        robot = robots.robot(name)
        self.kinematics = PlatformKinematics(robot.wheels, idle)
        self.dynamics = PlatformDynamics(robot, self.kinematics)
        self.observer = ExternalForceObserver(self.kinematics, self.dynamics)
        self.time = 0.0
        self.run(np.zeros(3), np.zeros(3), 0.1)

    def run(self, twist, rate, seconds, external=None):
        """Move with twist(t) = twist + rate t against an external wrench (3,)."""
        wrench = np.zeros(3) if external is None else np.asarray(external, dtype=float)
        forward = self.kinematics.J
        for k in range(1, round(seconds / DT) + 1):
            # In the middle of the step, whose difference of momenta is that of the rate.
            now = twist + rate * (k - 0.5) * DT
            torque = self.dynamics.platform_torque(now, rate)
            torque = torque + self.dynamics.friction_torque(now, forward @ now)
            torque = torque - self.kinematics.J_pinv.T @ wrench
            self.time += DT
            self.observer.update(self.time, forward @ (twist + rate * k * DT), torque)
        return self.observer.external


@pytest.mark.parametrize("name", robots.ALL)
def test_any_motion_of_the_model_needs_no_external_force(name):
    motion = Motion(name)
    twist = np.zeros(3)
    for _ in range(6):
        rate = RNG.uniform(-1.0, 1.0, 3)
        external = motion.run(twist, rate, 0.3)
        np.testing.assert_allclose(external, 0.0, atol=0.02 * np.abs(motion.observer.motors).max())
        twist = twist + 0.3 * rate


@pytest.mark.parametrize("name", robots.ALL)
def test_a_constant_external_wrench_is_estimated(name):
    motion = Motion(name)
    wrench = RNG.uniform(-100.0, 100.0, 3)
    twist = np.array([0.3, -0.2, 0.1])
    motion.run(np.zeros(3), twist / 0.5, 0.5)
    external = motion.run(twist, np.zeros(3), 12.0 * OBSERVER_TIME, wrench)
    np.testing.assert_allclose(external, wrench, atol=0.5)


def test_a_step_of_the_force_is_followed_by_the_time_constant():
    motion = Motion()
    twist = np.array([0.3, 0.0, 0.0])
    motion.run(np.zeros(3), twist / 0.5, 0.5)
    motion.run(twist, np.zeros(3), 1.0)
    external = motion.run(twist, np.zeros(3), OBSERVER_TIME, (-200.0, 0.0, 0.0))
    assert external[0] == pytest.approx(-200.0 * (1.0 - np.exp(-1.0)), rel=0.05)


def test_idle_wheels_take_their_friction_along():
    motion = Motion("mecanum6", idle=(1,))
    twist = np.array([0.3, -0.2, 0.3])
    external = motion.run(np.zeros(3), twist / 0.5, 0.5)
    np.testing.assert_allclose(external, 0.0, atol=0.02 * np.abs(motion.observer.motors).max())


def test_the_maps_of_friction_are_those_of_its_torques():
    for name in robots.ALL:
        motion = Motion(name)
        dynamics, kinematics = motion.dynamics, motion.kinematics
        twist = RNG.uniform(-1.0, 1.0, 3)
        speeds = kinematics.J @ twist
        viscous, dry = dynamics.friction_wrenches()
        assert (viscous.shape, dry.shape) == ((3, len(speeds)), (3, 2 * len(speeds)))
        both = np.concatenate([speeds, dynamics.rolling @ twist])
        smooth = both / np.sqrt(both**2 + 0.05**2)
        expected = kinematics.J.T @ dynamics.friction_torque(twist, speeds)
        np.testing.assert_allclose(viscous @ speeds + dry @ smooth, expected, atol=1e-9)


def test_after_a_restart_nothing_is_known():
    motion = Motion()
    motion.run(np.zeros(3), np.zeros(3), 1.0, (50.0, 0.0, 0.0))
    assert np.abs(motion.observer.external).max() > 10.0
    motion.observer.restart()
    assert not motion.observer.external.any() and not motion.observer.motors.any()
