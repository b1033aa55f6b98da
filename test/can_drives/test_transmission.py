"""Conversion between wheels and motors."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from omniman_ros.can_drives.axis import DriveSetpoint, Feedback
from omniman_ros.can_drives.transmission import (
    Transmission,
    axis_settings,
    max_wheel_speed,
    transmissions,
)
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.core.platform import Platform
from omniman_ros.robots import robot_parameters

GEAR = Transmission(
    ratio=-20.0,
    efficiency=0.8,
    torque_constant=0.05,
    resistance=0.5,
    max_voltage=24.0,
    max_torque=8.0,
)
ROBOT = build(Platform, robot_parameters("omniman"))
INSTALLATION = CanParameters(nodes=(1, 2, 3, 4), direction=(1.0, -1.0, 1.0, -1.0))
torques = st.floats(-8.0, 8.0)
wheel_speeds = st.floats(-30.0, 30.0)


@given(torque=torques, speed=wheel_speeds)
@example(torque=-0.5, speed=5e-324)
@settings(max_examples=200, deadline=None)
def test_torque_at_the_wheel_is_the_same_there_and_back(torque, speed):
    assert GEAR.to_wheel(GEAR.to_motor(torque, speed), speed) == pytest.approx(torque)


@given(torque=torques, speed=wheel_speeds)
@settings(max_examples=200, deadline=None)
def test_gear_never_makes_power(torque, speed):
    motor = GEAR.to_motor(torque, speed) * speed * GEAR.ratio
    assert torque * speed <= motor + 1e-9


def test_gear_loss_is_taken_from_the_driving_side():
    assert GEAR.to_motor(4.0, 1.0) == pytest.approx(4.0 / 0.8 / -20.0)
    assert GEAR.to_motor(4.0, -1.0) == pytest.approx(4.0 * 0.8 / -20.0)


@pytest.mark.parametrize(("torque", "most"), [(1e308, 8.0), (-1e308, -8.0), (9.0, 8.0)])
def test_torques_are_clipped_at_the_wheel(torque, most):
    assert GEAR.to_motor(torque, 0.0) == pytest.approx(most / 0.8 / -20.0)


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        (DriveMode.VELOCITY, DriveSetpoint(DriveMode.VELOCITY, -60.0, 4.0 / 0.8 / -20.0)),
        (DriveMode.TORQUE, DriveSetpoint(DriveMode.TORQUE, 4.0 / 0.8 / -20.0)),
        (DriveMode.VOLTAGE, DriveSetpoint(DriveMode.VOLTAGE, -4.0)),
    ],
)
def test_setpoints_are_those_of_the_motors_shaft(mode, expected):
    assert GEAR.setpoint(mode, 3.0, 4.0, 1.0) == expected


def voltage(volts, **feedback):
    return GEAR.voltage_to_torque(
        DriveSetpoint(DriveMode.VOLTAGE, volts), Feedback(**feedback)
    ).value


def test_voltage_becomes_the_torque_of_the_motors_law():
    assert voltage(10.0, velocity=100.0, bus_voltage=24.0) == pytest.approx(
        min(0.05 * (10.0 - 0.05 * 100.0) / 0.5, 8.0 / 20.0)
    )


@pytest.mark.parametrize(
    ("supply", "limit"),
    [(6.0, 6.0), (48.0, 24.0), (math.nan, 24.0), (0.0, 24.0), (-3.0, 24.0), (math.inf, 24.0)],
)
def test_voltage_is_within_the_measured_supply_and_the_motors_limit(supply, limit):
    loose = replace(GEAR, max_torque=1e6)
    for sign in (1.0, -1.0):
        torque = loose.voltage_to_torque(
            DriveSetpoint(DriveMode.VOLTAGE, sign * 1e308),
            Feedback(velocity=0.0, bus_voltage=supply),
        )
        assert torque == DriveSetpoint(DriveMode.TORQUE, pytest.approx(sign * 0.05 * limit / 0.5))


@pytest.mark.parametrize("velocity", [math.nan, math.inf, -math.inf])
def test_unknown_speed_gives_a_finite_torque(velocity):
    assert math.isfinite(voltage(5.0, velocity=velocity))


def test_voltage_at_the_motor_is_reported_or_that_of_the_motor_model():
    told = Feedback(velocity=100.0, current=2.0, voltage=7.0)
    assert GEAR.electrical(told) == pytest.approx((-7.0, -2.0))
    assert GEAR.electrical(Feedback(velocity=100.0, current=2.0)) == pytest.approx((-6.0, -2.0))
    assert all(math.isnan(value) for value in GEAR.electrical(Feedback()))


def test_each_wheel_has_its_direction_and_the_robots_gear_unless_the_installation_names_one():
    motor = ROBOT.motor
    assert [gear.ratio for gear in transmissions(ROBOT, INSTALLATION)] == pytest.approx(
        [motor.gear_ratio, -motor.gear_ratio, motor.gear_ratio, -motor.gear_ratio]
    )
    other = replace(INSTALLATION, gear_ratio=5.0, max_torque=3.0, direction=(-1.0,))
    assert [(gear.ratio, gear.max_torque) for gear in transmissions(ROBOT, other)] == [
        (-5.0, 3.0)
    ] * 4


def test_limits_of_the_axes_are_those_of_the_wheels_at_the_motors_shaft():
    p = replace(INSTALLATION, gear_ratio=5.0, max_torque=3.0, max_speed=8.0, velocity_scale=0.0)
    for settings_, node in zip(axis_settings(ROBOT, p), p.nodes, strict=True):
        assert settings_.node == node
        assert settings_.max_speed == pytest.approx(40.0)
        assert settings_.max_torque == pytest.approx(3.0 / (5.0 * ROBOT.motor.gear_efficiency))
        assert settings_.quick_stop_deceleration == pytest.approx(5.0 * p.quick_stop_deceleration)
        assert settings_.velocity_scale == settings_.counts
    speed = max_wheel_speed(ROBOT, INSTALLATION)
    assert speed == pytest.approx(1.2 * ROBOT.motor.max_speed)
    assert np.isfinite(speed)


def test_installation_with_too_few_drives_is_refused():
    with pytest.raises(ParameterError, match="must have 4 node ids, one per wheel, has 3"):
        axis_settings(ROBOT, replace(INSTALLATION, nodes=(1, 2, 3)))
