import math
import random
import struct
from dataclasses import replace

import pytest

from omniman_ros.can_drives.axis import (
    REST,
    AxisState,
    Demand,
    DriveAxis,
    DriveSetpoint,
    Receipt,
    WrappingCounter,
)
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.control.wheel_cascade import DriveMode
from omniman_ros.core.errors import InputError
from test.can_drives.fuzz import settings

SPAN = 1 << 32


def wrapped(number, bits=32):
    half = 1 << (bits - 1)
    return (number + half) % (1 << bits) - half


def test_first_reading_is_the_origin():
    assert WrappingCounter().update(-5) == -5


@pytest.mark.parametrize(
    "readings, total",
    [
        ((2**31 - 2, 2**31 - 1, -(2**31), -(2**31) + 3), 2**31 + 3),
        ((-(2**31), 2**31 - 1), -(2**31) - 1),
        ((0, 2**31 - 1), 2**31 - 1),
        ((0, -(2**31)), -(2**31)),
    ],
)
def test_position_is_continuous_over_wraps_in_both_directions(readings, total):
    counter = WrappingCounter()
    for reading in readings:
        value = counter.update(reading)
    assert value == counter.value == total


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_any_walk_with_steps_below_half_the_span_is_followed(bits):
    chance = random.Random(bits)
    counter, number = WrappingCounter(bits), 0
    counter.update(0)
    most = (1 << (bits - 1)) - 1
    for _ in range(2000):
        number += chance.randint(-most, most)
        assert counter.update(wrapped(number, bits)) == number


def test_unsigned_readings_give_the_same_steps_as_signed_ones():
    signed, unsigned = WrappingCounter(), WrappingCounter()
    for number in (0, -1, -(2**31), 5):
        assert signed.update(wrapped(number)) == unsigned.update(number % SPAN)


def test_next_reading_after_a_restart_continues_the_last_position():
    counter = WrappingCounter()
    counter.update(0)
    counter.update(100_000)
    counter.restart()
    assert counter.update(7) == 100_000
    assert counter.update(10) == 100_003


def test_first_reading_is_the_origin_after_an_earlier_restart():
    counter = WrappingCounter()
    counter.restart()
    assert counter.update(42) == 42


class PlainAxis(DriveAxis):
    """Reports a velocity in one frame; its frames are kept as setpoints."""

    def __init__(self):
        super().__init__(settings(), [0x100], {0x180: self._on_report}, extended=True)

    def _on_report(self, data, now):
        (velocity,) = struct.unpack("<d", data)
        if not math.isfinite(velocity):
            return False
        return self.feedback.measure(0.0, velocity, now)

    def frames(self, demand, setpoint, now):
        return [setpoint]


@pytest.mark.parametrize("state", AxisState)
@pytest.mark.parametrize("demand", Demand)
def test_a_setpoint_reaches_the_frames_of_an_enabled_drive_only(state, demand):
    axis, asked = PlainAxis(), DriveSetpoint(DriveMode.VELOCITY, 1.0)
    axis.state = state
    moves = state is AxisState.ENABLED and demand is not Demand.IDLE
    assert axis.tick(demand, asked, 0.0) == [asked if moves else REST]
    for bad in (math.nan, math.inf, -math.inf):
        for setpoint in (replace(asked, value=bad), replace(asked, feedforward=bad)):
            with pytest.raises(InputError, match="must be finite"):
                axis.tick(demand, setpoint, 0.0)


@pytest.mark.parametrize("state", AxisState)
def test_power_is_wanted_to_drive_without_a_fault_and_to_stop_what_has_it(state):
    axis = PlainAxis()
    axis.state = state
    has_power = state in (AxisState.ENABLED, AxisState.STOPPING)
    assert axis.wants_power(Demand.DRIVE)
    assert axis.wants_power(Demand.STOP) == has_power
    assert not axis.wants_power(Demand.IDLE)
    axis.fail(state, "hot")
    assert not axis.wants_power(Demand.DRIVE)
    assert axis.wants_power(Demand.STOP) == has_power


@pytest.mark.parametrize(
    ("frame", "receipt"),
    [
        (CanFrame(0x180, struct.pack("<d", 2.0), extended=True), Receipt.ACCEPTED),
        (CanFrame(0x180, struct.pack("<d", math.nan), extended=True), Receipt.MALFORMED),
        (CanFrame(0x180, bytes(7), extended=True), Receipt.MALFORMED),
        (CanFrame(0x180, bytes(8)), Receipt.FOREIGN),
        (CanFrame(0x180, b"", extended=True, remote=True), Receipt.FOREIGN),
        (CanFrame(0x100, bytes(8), extended=True), Receipt.FOREIGN),
    ],
)
def test_the_handler_of_an_id_says_whether_the_data_are_valid(frame, receipt):
    axis = PlainAxis()
    assert axis.receive(frame, 1.0) is receipt
    assert axis.feedback.count == (receipt is Receipt.ACCEPTED)
