"""The figures of the demo's emergency stop, from what was heard."""

import math

import numpy as np
import pytest

from omniman_ros.cli.recorder import Recording
from omniman_ros.cli.score import faults, judge
from omniman_ros.cli.stop_leg import DrivenStop, figures

from .test_score import perfect

PRESSED, RESET, END = 10.0, 12.0, 13.0
STOP = DrivenStop(PRESSED, RESET, END)
SPEED, BRAKING, LATE = 0.3, 1.5, 0.04
ARM_RATE, ARM_BRAKING = 0.8, 4.0


def travelled(times, speed, braking, late=LATE):
    """Way (k,) and speed (k,) of something that brakes evenly, a little after the stop."""
    since = np.clip(times - PRESSED - late, 0.0, speed / braking)
    way = speed * (np.minimum(times, PRESSED + late) + since) - 0.5 * braking * since**2
    return way, speed - braking * since


def stopped(creep=0.0, arm_creep=0.0):
    """A robot that stops, and perhaps creeps after the reset."""
    said = Recording()
    times = np.arange(8.0, 14.0, 0.01)
    way, speed = travelled(times, SPEED, BRAKING)
    way = way + creep * np.maximum(times - RESET, 0.0)
    for t, x, v in zip(times, way, speed, strict=True):
        said.odom.append((t, x, 0.0, 0.0, v, 0.0, 0.0))
    times = np.arange(8.0, 14.0, 0.008)
    angle, _ = travelled(times, ARM_RATE, ARM_BRAKING)
    angle = angle + arm_creep * np.maximum(times - RESET, 0.0)
    for t, q in zip(times, angle, strict=True):
        said.arm.append((t, 0.5, -q))
    return said


def test_rest_is_told_from_the_button_on():
    got = figures(stopped(), STOP)
    assert got["speed_m_s"] == pytest.approx(SPEED)
    assert got["rest_s"] == pytest.approx(LATE + SPEED / BRAKING, abs=0.02)
    assert got["way_mm"] == pytest.approx(1e3 * (SPEED * LATE + SPEED**2 / 2 / BRAKING), abs=4.0)
    assert got["arm_rate_rad_s"] == pytest.approx(ARM_RATE, rel=0.01)
    braked = LATE + ARM_RATE / ARM_BRAKING
    assert braked - 0.02 < got["arm_rest_s"] < braked + 0.06, "angles of 50 ms make a speed"
    assert got["moved_mm"] == got["arm_moved_mrad"] == 0.0


def test_what_moves_after_the_reset_is_seen():
    got = figures(stopped(creep=0.005, arm_creep=0.002), STOP)
    assert got["moved_mm"] == pytest.approx(5.0, abs=0.1)
    assert got["arm_moved_mrad"] == pytest.approx(2.0, abs=0.1)


def test_a_robot_that_does_not_stop_never_rests():
    said = stopped()
    said.odom = [(t, x, y, a, SPEED, 0.0, 0.0) for t, x, y, a, *_ in said.odom]
    assert figures(said, STOP)["rest_s"] == math.inf


def test_a_robot_that_is_not_heard_after_the_reset_counts_as_moved():
    said = stopped()
    said.odom = [row for row in said.odom if row[0] <= RESET]
    assert figures(said, STOP)["moved_mm"] == math.inf


def test_a_robot_without_an_arm_has_no_figures_of_one():
    said = stopped()
    said.arm.clear()
    assert not any(name.startswith("arm") for name in figures(said, STOP))


@pytest.mark.parametrize(
    ("figure", "value", "says"),
    [
        ("rest_s", math.inf, "at rest after an emergency stop, s: inf"),
        ("arm_rest_s", 1.2, "arm at rest after an emergency stop, s"),
        ("moved_mm", 2.0, "moved after the reset, mm"),
        ("arm_moved_mrad", 3.0, "arm moved after the reset, mrad"),
    ],
)
def test_every_limit_of_the_stop_is_a_fault_of_its_own(figure, value, says):
    result = judge(*perfect())
    result["emergency_stop"] = figures(stopped(), STOP)
    assert faults(result) == []
    result["emergency_stop"][figure] = value
    (fault,) = faults(result)
    assert fault.startswith(says)
