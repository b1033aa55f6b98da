"""Faults that drives do not report themselves."""

import math

import pytest

from omniman_ros.can_drives.axis import Feedback
from omniman_ros.can_drives.monitor import (
    MAX_REPORT_INTERVAL,
    MIN_COMPARED_SPEED,
    RUNAWAY_SPEED,
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
    assert after == pytest.approx(0.5 / abs(speed), abs=3 * PERIOD)


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
    assert MAX_REPORT_INTERVAL * 4.0 < 0.5


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
    wheel.until_reported(4.0, 0.0, patience=0.12)
    wheel.monitor.restart()
    said, after = wheel.until_reported(4.0, 0.0)
    assert said
    assert after >= 0.5 / 4.0
