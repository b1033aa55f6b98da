import math
from itertools import pairwise

import pytest

from omniman_ros.simulation.plant.encoder import Encoder

STEP = 0.001
IG42 = 480
COUNT = 2 * math.pi / IG42


def turn(encoder, angle, seconds, start=0.0):
    """Turn a wheel by a function of time, at constant speed per step; return the readings."""
    seen = []
    for k in range(round(seconds / STEP)):
        t0, t1 = start + k * STEP, start + (k + 1) * STEP
        encoder.update(t0, t1, angle(t0), angle(t1))
        seen.append((t1, encoder.velocity))
    return seen


def encoder(counts=IG42):
    return Encoder(counts, window=0.004, timeout=0.25)


@pytest.mark.parametrize("speed", [0.1, 0.37, 1.0, 3.3, 10.0, 29.5, -0.2, -7.0])
@pytest.mark.parametrize("counts", [480, 50000])
def test_constant_speed_is_measured_without_bias(speed, counts):
    wheel = encoder(counts)
    seen = turn(wheel, lambda t: speed * t, 1.0)
    for time, velocity in seen:
        if time > 0.02 + 2.1 * 2 * math.pi / counts / abs(speed):
            assert velocity == pytest.approx(speed, rel=1e-6)


@pytest.mark.parametrize(("speed", "lag"), [(10.0, 0.004), (3.0, 0.009), (1.0, 0.021)])
def test_velocity_lag_equals_the_documented_lag(speed, lag):
    """On a slow ramp, measured(t) = speed(t - lag)."""
    slope = 0.2
    wheel = encoder()

    def angle(t):
        return speed * (t - 0.5) + 0.5 * slope * (t - 0.5) ** 2

    behind = [
        (speed + slope * (time - 0.5) - velocity) / slope
        for time, velocity in turn(wheel, angle, 1.0)
        if 0.4 < time < 0.6
    ]
    assert sum(behind) / len(behind) < lag
    assert min(behind) > 0.0015
    assert max(behind) < lag + COUNT / speed


def test_velocity_decays_when_the_wheel_stops_and_is_zero_after_the_timeout():
    wheel = encoder()
    turn(wheel, lambda t: 5.0 * t, 0.5)
    seen = turn(wheel, lambda t: 2.5, 0.5, start=0.5)
    values = [velocity for _, velocity in seen]
    assert all(a >= b for a, b in pairwise(values))
    for time, velocity in seen[5:]:
        assert velocity <= COUNT / (time - 0.5) * 1.01
    assert [velocity for time, velocity in seen if time > 0.5 + 0.251] == [0.0] * 249
    # the measurement restarts after the rest
    seen = turn(wheel, lambda t: 2.5 + 4.0 * (t - 1.0), 0.1, start=1.0)
    assert seen[-1][1] == pytest.approx(4.0)


def test_velocity_has_the_right_sign_after_a_reversal():
    wheel = encoder()
    turn(wheel, lambda t: 2.0 * t, 0.5)
    seen = turn(wheel, lambda t: 1.0 - 2.0 * (t - 0.5), 0.5, start=0.5)
    edge_time = COUNT / 2.0
    for time, velocity in seen:
        if time > 0.5 + edge_time + STEP:
            assert velocity <= 0.0
        if time > 0.5 + 2 * edge_time + 0.004 + STEP:
            assert velocity == pytest.approx(-2.0)


def test_jitter_about_an_edge_gives_no_velocity():
    wheel = encoder()
    seen = turn(wheel, lambda t: 1e-4 * math.sin(2 * math.pi * 100 * t), 0.5)
    assert max(abs(velocity) for _, velocity in seen) < 0.2
    assert wheel.count in (-1, 0)


def test_frozen_encoder_keeps_count_and_velocity():
    wheel = encoder()
    turn(wheel, lambda t: 5.0 * t, 0.5)
    before = wheel.count, wheel.velocity
    wheel.frozen = True
    turn(wheel, lambda t: 2.5 - 9.0 * (t - 0.5), 0.5, start=0.5)
    assert (wheel.count, wheel.velocity) == before
    wheel.frozen = False
    turn(wheel, lambda t: -2.0 - 9.0 * (t - 1.0), 0.5, start=1.0)
    assert wheel.position == pytest.approx(-6.5, abs=COUNT)
    assert wheel.velocity == pytest.approx(-9.0)
