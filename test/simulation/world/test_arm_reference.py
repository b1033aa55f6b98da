"""The motion that the arm's joints in a world are told to make."""

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.simulation.arm_link.frames import ArmSetpoint
from omniman_ros.simulation.world.arm_reference import (
    COASTING_TIME,
    DECELERATION,
    ArmReference,
)

STEP = 0.001
CYCLE = 0.008


def setpoint(k, position, velocity, **flags):
    """Setpoint for the end of cycle k: joint 0 at a position, joint 1 at its negative."""
    angles = (position, -position, 0.0, 0.0, 0.0, 0.0)
    speeds = (velocity, -velocity, 0.0, 0.0, 0.0, 0.0)
    return ArmSetpoint(k, k * CYCLE, angles, speeds, **flags)


class Run:
    """A reference that is advanced step by step, and its track of joint 0."""

    def __init__(self):
        self.reference = ArmReference(np.zeros(6))
        self.steps, self.rows = 0, []

    def advance(self, count):
        for _ in range(count):
            self.steps += 1
            r = self.reference
            r.advance(self.steps * STEP)
            np.testing.assert_array_equal(r.positions[1], -r.positions[0])
            self.rows.append((r.positions[0], r.velocities[0], r.accelerations[0]))

    @property
    def track(self):
        return np.array(self.rows)


def test_constant_acceleration_from_setpoint_to_setpoint_is_that_of_the_reference():
    run, a = Run(), 12.0
    for k in range(1, 11):
        t = k * CYCLE
        run.reference.add(setpoint(k, 0.5 * a * t * t, a * t))
        run.advance(8)
    t = STEP * np.arange(1, 81)
    np.testing.assert_allclose(run.track[:, 0], 0.5 * a * t * t, atol=1e-12)
    np.testing.assert_allclose(run.track[:, 1], a * t, atol=1e-10)
    inner = (np.arange(1, 81) % 8) != 0  # at a setpoint, the next one is not known yet
    np.testing.assert_allclose(run.track[inner, 2], a, atol=1e-6)


def test_each_setpoint_is_passed_at_its_instant_at_its_speed():
    run, rng = Run(), np.random.default_rng(5)
    points = rng.uniform(-0.1, 0.1, (20, 2))
    for k, (position, velocity) in enumerate(points, 1):
        run.reference.add(setpoint(k, position, velocity))
    run.advance(160)
    np.testing.assert_allclose(run.track[7::8, :2], points, atol=1e-9)


def test_without_a_next_setpoint_the_joints_go_on_and_then_brake_on_their_path():
    run = Run()
    run.reference.add(setpoint(1, 0.0, 0.0))
    run.reference.add(setpoint(2, 0.004, 1.0))
    run.advance(16)
    coasting = round(COASTING_TIME / STEP)
    run.advance(coasting)
    assert run.track[-1, 1] == pytest.approx(1.0)
    run.advance(200)
    speeds = run.track[16 + coasting :, 1]
    assert np.diff(speeds).min() >= -DECELERATION * STEP - 1e-12
    assert speeds[-1] == 0.0 and run.track[-1, 2] == 0.0
    way = 0.004 + 1.0 * COASTING_TIME + 0.5 / DECELERATION
    assert run.track[-1, 0] == pytest.approx(way, abs=2e-3)


def test_an_abandoned_reference_brakes_at_once():
    run = Run()
    run.reference.add(setpoint(1, 0.004, 1.0))
    run.reference.add(setpoint(2, 0.012, 1.0))
    run.advance(8)
    run.reference.abandon()
    run.advance(1)
    assert run.track[-1, 2] == pytest.approx(-DECELERATION)
    run.advance(100)
    assert run.track[-1, 1] == 0.0


def test_a_setpoint_that_begins_anew_is_reached_from_elsewhere_without_a_way():
    run = Run()
    run.reference.add(setpoint(1, 0.0, 0.0))
    run.reference.add(setpoint(2, 1.0, 0.5, begins_anew=True))
    run.advance(9)
    assert run.track[-1, 0] == pytest.approx(1.0 - 7 * STEP * 0.5)
    assert np.abs(run.track[:, 2]).max() < 1e-6


def test_the_brakes_are_on_as_long_as_setpoints_say_so():
    run = Run()
    run.reference.add(setpoint(1, 0.0, 0.0, braked=True))
    run.advance(1)
    assert run.reference.is_braked
    run.advance(50)
    assert run.reference.is_braked, "nobody has released them"
    run.reference.add(setpoint(8, 0.0, 0.0))
    run.advance(1)
    assert not run.reference.is_braked


def test_a_setpoint_that_is_late_counts_as_passed():
    run = Run()
    run.advance(30)
    run.reference.add(setpoint(2, 0.001, 0.0))
    run.advance(1)
    assert run.track[-1, 0] == pytest.approx(0.001)


def test_a_setpoint_of_an_earlier_time_is_refused():
    run = Run()
    run.advance(10)
    with pytest.raises(InputError, match=r"due in -2.410 s: the controller's time is another one"):
        run.reference.add(setpoint(-300, 0.5, 0.0))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (setpoint(3, 0.5, 0.0), "setpoint 3 is due before the one before it"),
        (setpoint(2, 0.5, 0.0), "due before the one before it"),
        (setpoint(300, 0.5, 0.0), "due in 2.399 s: the controller's time is another one"),
    ],
)
def test_a_setpoint_out_of_order_or_of_another_time_is_refused(wrong, message):
    run = Run()
    run.reference.add(setpoint(3, 0.0, 0.0))
    run.advance(1)
    with pytest.raises(InputError, match=message):
        run.reference.add(wrong)
    run.advance(100)
    assert not run.track.any()
