import numpy as np
import pytest

from omniman_ros.control.odometry import REST_SPEED
from omniman_ros.control.wheel_cascade import DriveMode, WheelCascade
from test.robots import ALL, parameters

ZERO = np.zeros(3)


def make(name="omniman", **changes):
    p = parameters(name, changes)
    return WheelCascade(p), p


@pytest.mark.parametrize("name", ALL)
def test_velocity_mode_applies_inverse_kinematics_and_computed_torque(name):
    cascade, p = make(name)
    twist, rate = np.array([0.3, -0.1, 0.2]), np.array([0.1, 0.2, -0.3])
    command = cascade.command(
        twist, rate, np.zeros(p.robot.wheel_count), DriveMode.VELOCITY, 0.005
    )
    wheels = cascade.kinematics.J @ twist
    assert command.mode is DriveMode.VELOCITY
    np.testing.assert_allclose(command.velocity, wheels)
    np.testing.assert_array_equal(cascade.reference, command.velocity)
    expected = cascade.dynamics.platform_torque(twist, rate)
    expected = expected + cascade.dynamics.friction_torque(twist, wheels)
    np.testing.assert_allclose(command.effort, expected)


def test_feed_forward_can_be_disabled():
    cascade, _ = make(**{"drive.feed_forward": False})
    command = cascade.command(np.ones(3) * 0.1, ZERO, np.zeros(4), DriveMode.VELOCITY, 0.005)
    assert not command.effort.any()


@pytest.mark.parametrize("mode", [DriveMode.TORQUE, DriveMode.VOLTAGE])
def test_torque_and_voltage_modes_command_no_speed(mode):
    cascade, p = make()
    command = cascade.command(np.array([0.3, 0, 0]), ZERO, np.zeros(4), mode, 0.005)
    assert command.mode is mode
    assert command.velocity is None
    limit = (
        cascade.dynamics.torque_limit if mode is DriveMode.TORQUE else p.robot.motor.max_voltage
    )
    assert (abs(command.effort) <= limit).all()
    assert (command.effort > 0).all()  # ahead, against friction and the speed error


def test_voltages_hold_a_steady_speed_without_feedback_error():
    cascade, _p = make()
    twist = np.array([0.3, 0.1, 0])
    wheels = cascade.kinematics.J @ twist
    command = cascade.command(twist, ZERO, wheels, DriveMode.VOLTAGE, 0.005)
    torque = cascade.dynamics.friction_torque(twist, wheels)
    np.testing.assert_allclose(command.effort, cascade.dynamics.voltage(torque, wheels))


@pytest.mark.parametrize("name", ALL)
def test_too_fast_twist_is_scaled_and_keeps_its_direction(name):
    cascade, p = make(name)
    fast = p.robot.motor.max_speed
    twist = np.array([3.0, -4.0, 5.0]) * 10
    reachable = cascade.reachable(twist)
    assert cascade.saturated
    assert abs(cascade.kinematics.J @ reachable).max() == pytest.approx(fast)
    np.testing.assert_allclose(np.cross(reachable, twist), 0, atol=1e-9)
    np.testing.assert_array_equal(cascade.reachable(twist * 1e-3), twist * 1e-3)
    assert not cascade.saturated


def test_coupling_correction_never_exceeds_the_largest_wheel_speed():
    cascade, p = make()
    cascade.coupling.add(np.array([3.0]))
    twist = cascade.reachable(np.array([9.0, 0, 0]))
    command = cascade.command(twist, ZERO, np.zeros(4), DriveMode.VELOCITY, 0.005)
    assert abs(command.velocity).max() <= p.robot.motor.max_speed * (1 + 1e-9)
    assert np.ptp(command.velocity) > 1  # the correction is still present


def test_correction_changes_the_speeds_and_not_the_twist():
    cascade, _ = make(**{"coupling.k_epsilon": 2.0})
    cascade.coupling.add(np.array([0.05]))
    twist = np.array([0.3, 0.1, 0.1])
    command = cascade.command(twist, ZERO, np.zeros(4), DriveMode.VELOCITY, 0.005)
    np.testing.assert_allclose(cascade.kinematics.J_pinv @ command.velocity, twist)
    np.testing.assert_allclose(cascade.kinematics.T @ command.velocity, [-0.1])


def test_rest_commands_zero_speed_and_clears_the_coupling_error_once_the_wheels_stand():
    cascade, _ = make()
    cascade.coupling.add(np.array([0.2]))
    for measured, error in ((np.full(4, 2 * REST_SPEED), 0.2), (np.zeros(4), 0.0)):
        command = cascade.rest_command(measured)
        assert command.mode is DriveMode.VELOCITY
        np.testing.assert_array_equal(command.velocity, np.zeros(4))
        np.testing.assert_array_equal(command.effort, np.zeros(4))
        assert cascade.coupling.error[0] == error


def test_voltages_pass_through_and_the_cascade_tracks_the_speed():
    cascade, _ = make()
    measured, volts = np.array([1.0, 2, 3, 4]), np.array([5.0, -6, 7, -8])
    command = cascade.voltage_command(volts, measured)
    assert (command.mode, command.velocity) == (DriveMode.VOLTAGE, None)
    np.testing.assert_array_equal(command.effort, volts)
    np.testing.assert_array_equal(cascade.reference, measured)


def test_calibrated_radii_apply_to_commands_and_measurements():
    scale = [1.1, 1.0, 0.9, 1.0]
    cascade, _ = make(**{"odometry.wheel_scale": scale})
    plain, _ = make()
    np.testing.assert_allclose(cascade.kinematics.J, plain.kinematics.J / np.array(scale)[:, None])


@pytest.mark.parametrize("mode", [DriveMode.TORQUE, DriveMode.VOLTAGE])
def test_mode_change_clears_the_integral(mode):
    cascade, _ = make()
    fresh, _ = make()
    twist = np.array([0.2, 0, 0])
    for _ in range(50):
        cascade.command(twist, ZERO, np.zeros(4), mode, 0.005)
    cascade.rest_command(np.zeros(4))
    first = cascade.command(twist, ZERO, np.zeros(4), mode, 0.005)
    np.testing.assert_array_equal(
        first.effort, fresh.command(twist, ZERO, np.zeros(4), mode, 0.005).effort
    )


def test_configure_applies_models_and_keeps_the_state():
    cascade, _ = make()
    cascade.coupling.add(np.array([0.1]))
    cascade.configure(parameters("omniman", {"body.mass": 280.0, "motor.max_speed": 7.0}))
    assert cascade.coupling.error[0] == 0.1
    assert cascade.dynamics.mass_matrix[0, 0] == pytest.approx(300.4)
    reachable = cascade.reachable(np.array([9.0, 0, 0]))
    assert abs(cascade.kinematics.J @ reachable).max() == pytest.approx(7.0)
