import random

import pytest

from omniman_ros.can_drives.axis import WrappingCounter

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
