"""Faults that drives do not report themselves."""

import math

import pytest

from omniman_ros.can_drives.axis import Feedback
from omniman_ros.can_drives.wheel_feedback import (
    MAX_REPORT_INTERVAL,
    MIN_COMPARED_SPEED,
    MIN_INTEGRATED_ANGLE,
    RUNAWAY_SPEED,
    UNMOVED_REPORTS,
    WheelMonitor,
)

RATIO, MAX_SPEED = -20.0, 10.0
PERIOD = 0.005


class Wheel:
    """Reports of one wheel, a period at a time."""

    def __init__(self):
        self.monitor = WheelMonitor()
        self.now = self.position = 0.0

    def report(self, speed, moved=None, period=PERIOD, supply=math.nan, min_supply=0.0):
        self.now += period
        self.position += speed * period if moved is None else moved
        feedback = Feedback(
            position=self.position * RATIO,
            velocity=speed * RATIO,
            bus_voltage=supply,
            at=self.now,
            count=1,
        )
        return self.monitor.check(feedback, RATIO, MAX_SPEED, min_supply)

    def until_reported(self, speed, moved, patience=2.0, **more):
        start = self.now
        while self.now - start < patience:
            if said := self.report(speed, moved, **more):
                return said, self.now - start
        return "", patience


@pytest.mark.parametrize("speed", [1.0, -1.0])
def test_wheel_runs_away_beyond_one_and_a_half_times_the_largest_speed(speed):
    assert Wheel().report(speed * RUNAWAY_SPEED * MAX_SPEED) == ""
    assert Wheel().report(speed * 15.1) == (
        f"runs away at {speed * 15.1:.1f} rad/s, the limit is 10.0 rad/s"
    )


@pytest.mark.parametrize(
    ("supply", "said"),
    [
        (math.nan, ""),
        (18.0, ""),
        (17.9, "supply 17.9 V, at least 18.0 V are needed"),
        (-1.0, "supply -1.0 V, at least 18.0 V are needed"),
    ],
)
def test_supply_that_is_known_must_suffice(supply, said):
    assert Wheel().report(0.0, supply=supply, min_supply=18.0) == said


@pytest.mark.parametrize("speed", [4.0, -4.0, 0.6])
def test_encoder_that_stands_while_its_drive_reports_a_speed_is_dead(speed):
    said, after = Wheel().until_reported(speed, 0.0)
    assert said == f"its encoder moved 0.000 rad while it reported {speed:.1f} rad/s"
    assert after == pytest.approx(MIN_INTEGRATED_ANGLE / abs(speed), abs=2.5 * PERIOD)


@pytest.mark.parametrize("driven", [0.3, 0.337, 0.371])
def test_encoder_that_freezes_in_motion_is_dead_after_the_same_travel(driven):
    wheel = Wheel()
    assert wheel.until_reported(4.0, None, patience=driven)[0] == ""
    said, after = wheel.until_reported(4.0, 0.0)
    assert said
    assert after == pytest.approx(MIN_INTEGRATED_ANGLE / 4.0, abs=2.5 * PERIOD)


def test_encoder_that_creeps_while_its_drive_reports_a_speed_is_dead():
    said, after = Wheel().until_reported(4.0, 0.05 * 4.0 * PERIOD)
    assert said.startswith("its encoder moved 0.01")
    assert after < 2.0 * MIN_INTEGRATED_ANGLE / 4.0


@pytest.mark.parametrize("steps_per_turn", [42, 90, 4096])
def test_coarse_steps_of_an_encoder_are_plausible(steps_per_turn):
    wheel, step = Wheel(), math.tau / steps_per_turn
    for k in range(2000):
        true = 2.0 * PERIOD * k
        moved = step * math.floor(true / step) - wheel.position
        assert wheel.report(2.0 * 1.2, moved) == "", "a speed that is reported a fifth too high"


@pytest.mark.parametrize("held_up", [0.05, 0.2, 0.5])
def test_reports_that_arrive_late_and_together_are_plausible(held_up):
    wheel, late = Wheel(), round(held_up / PERIOD)
    for _ in range(20):
        assert wheel.until_reported(10.0, None, patience=10 * PERIOD)[0] == ""
        for k in range(late):
            period = held_up if k == 0 else 1e-5
            assert wheel.report(10.0, 10.0 * PERIOD, period=period) == ""


def test_few_reports_are_no_evidence_however_far_apart():
    wheel = Wheel()
    for _ in range(UNMOVED_REPORTS):
        assert wheel.report(10.0, 0.0, period=0.05) == ""
    assert wheel.report(10.0, 0.0, period=0.05)


@pytest.mark.parametrize(
    ("speed", "moved"),
    [
        (4.0, None),
        (-4.0, None),
        (0.9 * MIN_COMPARED_SPEED, 0.0),
        (0.0, 0.1),
        (4.0, 4.0 * PERIOD * 0.3),
    ],
    ids=["forward", "backward", "slow", "pushed", "late"],
)
def test_moving_or_resting_encoder_is_plausible(speed, moved):
    assert Wheel().until_reported(speed, moved)[0] == ""


def test_one_report_after_a_silence_does_not_cover_the_silence():
    wheel = Wheel()
    wheel.report(4.0)
    assert wheel.report(4.0, 0.0, period=60.0) == ""
    assert MAX_REPORT_INTERVAL * 4.0 <= MIN_INTEGRATED_ANGLE


def test_time_that_goes_back_or_stands_causes_no_alarm():
    wheel = Wheel()
    for period in (PERIOD, -5.0, 0.0, 0.0, -1.0, 7.0, PERIOD):
        assert wheel.report(4.0, period=period) == ""


def test_unknown_speeds_and_positions_cause_no_alarm_and_are_forgotten():
    wheel = Wheel()
    for speed, moved in ((math.nan, 0.0), (4.0, 0.0), (4.0, math.nan)):
        assert wheel.report(speed, moved) == ""
    wheel.position = 0.0
    assert wheel.until_reported(4.0, None)[0] == ""
    assert wheel.until_reported(4.0, 0.0)[0].startswith("its encoder moved 0.0")


def test_restart_clears_the_monitor_state():
    wheel = Wheel()
    wheel.until_reported(4.0, 0.0, patience=0.04)
    wheel.monitor.restart()
    said, after = wheel.until_reported(4.0, 0.0)
    assert said
    assert after >= MIN_INTEGRATED_ANGLE / 4.0
