"""Figures of the emergency stop, from what the robot published."""

import math

import numpy as np
import pytest

from omniman_ros.demo.recorder import Recording
from omniman_ros.demo.stop_leg import DrivenStop, stop_figures

PRESSED, RESET, END = 10.0, 12.0, 13.0
STOP = DrivenStop(PRESSED, RESET, END)
SPEED, BRAKING, DELAY = 0.3, 1.5, 0.04
ARM_SPEED, ARM_BRAKING = 0.8, 4.0


def braking_motion(times, speed, braking, delay=DELAY):
    """Position (k,) and speed (k,) of a motion that brakes evenly, a little after the stop."""
    since = np.clip(times - PRESSED - delay, 0.0, speed / braking)
    position = speed * (np.minimum(times, PRESSED + delay) + since) - 0.5 * braking * since**2
    return position, speed - braking * since


def stopped_robot(creep=0.0, arm_creep=0.0):
    """Recording of a robot that stops; after the reset it creeps [m/s, rad/s]."""
    recording = Recording()
    times = np.arange(8.0, 14.0, 0.01)
    position, speed = braking_motion(times, SPEED, BRAKING)
    position = position + creep * np.maximum(times - RESET, 0.0)
    for t, x, v in zip(times, position, speed, strict=True):
        recording.odom.append((t, x, 0.0, 0.0, v, 0.0, 0.0))
    times = np.arange(8.0, 14.0, 0.008)
    angle, _ = braking_motion(times, ARM_SPEED, ARM_BRAKING)
    angle = angle + arm_creep * np.maximum(times - RESET, 0.0)
    for t, q in zip(times, angle, strict=True):
        recording.arm.append((t, 0.5, -q))
    return recording


def test_the_time_to_rest_counts_from_the_press_of_the_stop():
    figures = stop_figures(stopped_robot(), STOP)
    assert figures["speed_m_s"] == pytest.approx(SPEED)
    assert figures["rest_s"] == pytest.approx(DELAY + SPEED / BRAKING, abs=0.02)
    way = SPEED * DELAY + SPEED**2 / 2 / BRAKING
    assert figures["way_mm"] == pytest.approx(1e3 * way, abs=4.0)
    assert figures["arm_rate_rad_s"] == pytest.approx(ARM_SPEED, rel=0.01)
    rest = DELAY + ARM_SPEED / ARM_BRAKING
    assert rest - 0.02 < figures["arm_rest_s"] < rest + 0.06, "the speed is a mean over 50 ms"
    assert figures["moved_mm"] == figures["arm_moved_mrad"] == 0.0


def test_motion_after_the_reset_is_measured():
    figures = stop_figures(stopped_robot(creep=0.005, arm_creep=0.002), STOP)
    assert figures["moved_mm"] == pytest.approx(5.0, abs=0.1)
    assert figures["arm_moved_mrad"] == pytest.approx(2.0, abs=0.1)


def test_a_robot_that_does_not_stop_never_rests():
    recording = stopped_robot()
    recording.odom = [(t, x, y, a, SPEED, 0.0, 0.0) for t, x, y, a, *_ in recording.odom]
    assert stop_figures(recording, STOP)["rest_s"] == math.inf


def test_a_robot_without_odometry_after_the_reset_counts_as_moved():
    recording = stopped_robot()
    recording.odom = [row for row in recording.odom if row[0] <= RESET]
    assert stop_figures(recording, STOP)["moved_mm"] == math.inf


def test_a_robot_without_an_arm_has_no_figures_of_the_arm():
    recording = stopped_robot()
    recording.arm.clear()
    assert not any(name.startswith("arm") for name in stop_figures(recording, STOP))
