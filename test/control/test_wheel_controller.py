import numpy as np
import pytest

from omniman_ros.control.dynamics import PlatformDynamics
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.wheel_controller import WheelController, WheelGains
from test.robots import robot

DT = 0.001


def make(name="omniman", **gains):
    made = robot(name)
    model = PlatformKinematics(made.wheels)
    dynamics = PlatformDynamics(made, model)
    return (
        WheelController(dynamics.wheel_inertia, dynamics.torque_limit, WheelGains(**gains)),
        dynamics,
        model,
    )


def simulate(controller, dynamics, reference, seconds, load=0.0, feed=0.0, speed=None):
    """Return the speeds of ideal wheels with true inertia under a constant load torque."""
    speed = np.zeros_like(reference) if speed is None else speed
    inverse, history = np.linalg.inv(dynamics.wheel_inertia), []
    for _ in range(round(seconds / DT)):
        torque = controller.torque(reference, speed, feed + np.zeros_like(speed), DT)
        speed = speed + DT * inverse @ (torque - load)
        history.append(speed)
    return np.array(history)


def test_error_without_integral_part_decays_at_the_bandwidth():
    controller, dynamics, model = make(bandwidth=15.0, integral_time=0.0)
    # One motion of the platform and one against the constraints.
    for direction in (model.J @ np.array([0.02, 0.01, 0.02]), 0.2 * model.T_pinv[:, 0]):
        speeds = simulate(controller, dynamics, direction, 1 / 15)
        np.testing.assert_allclose(speeds[-1], direction * (1 - np.exp(-1)), rtol=0.02)


def test_integral_part_compensates_a_constant_load():
    controller, dynamics, model = make()
    reference = model.J @ np.array([0.1, 0, 0])
    speeds = simulate(controller, dynamics, reference, 3.0, load=np.array([2.0, -1, 0.5, 3]))
    np.testing.assert_allclose(speeds[-1], reference, atol=1e-3)
    bare, _, _ = make(integral_time=0.0)
    left = simulate(bare, dynamics, reference, 3.0, load=np.array([2.0, -1, 0.5, 3]))
    assert abs(left[-1] - reference).max() > 0.01


def test_feed_forward_passes_unscaled_without_speed_error():
    controller, _, _ = make()
    feed = np.array([1.0, -2, 3, 0.5])
    np.testing.assert_array_equal(controller.torque(np.ones(4), np.ones(4), feed, DT), feed)


@pytest.mark.parametrize("sign", [1, -1])
def test_torques_stay_within_their_limits(sign):
    controller, dynamics, _ = make()
    torque = controller.torque(np.full(4, sign * 1e3), np.zeros(4), np.zeros(4), DT)
    np.testing.assert_array_equal(torque, sign * dynamics.torque_limit)


def test_saturated_wheels_do_not_wind_up():
    controller, dynamics, _ = make()
    reference = np.full(4, 8.0)  # all wheels ahead: far more than the current limit allows at once
    blocked = np.zeros(4)
    for _ in range(5000):  # 5 s against a wall
        controller.torque(reference, blocked, np.zeros(4), DT)
    fresh, _, _ = make()
    free = simulate(fresh, dynamics, reference, 2.0)
    after = simulate(controller, dynamics, reference, 2.0)
    assert after.max() <= free.max() + 0.2
    # The reverse direction acts at once: no integral has to unload first.
    torque = controller.torque(-reference, blocked, np.zeros(4), DT)
    np.testing.assert_array_equal(torque, -dynamics.torque_limit)


def test_reset_clears_the_integral_and_configure_keeps_the_integral():
    controller, dynamics, _ = make()
    for _ in range(100):
        controller.torque(np.full(4, 0.1), np.zeros(4), np.zeros(4), DT)
    held = controller.torque(np.zeros(4), np.zeros(4), np.zeros(4), DT)
    assert held.any()
    controller.configure(dynamics.wheel_inertia, dynamics.torque_limit, WheelGains(bandwidth=7.0))
    again = controller.torque(np.zeros(4), np.zeros(4), np.zeros(4), DT)
    np.testing.assert_allclose(again, held)
    controller.reset()
    assert not controller.torque(np.zeros(4), np.zeros(4), np.zeros(4), DT).any()
