import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.parameters import build
from omniman_ros.surroundings.tracking import (
    CONFIRMATION_TIME,
    ObstacleTrack,
    TrackingParameters,
)

PARAMETERS = TrackingParameters()


def stamps(rng, rate, duration, jitter=0.2, drop_outs=0.1):
    """Return observation times at a rate [Hz], with jitter and dropouts."""
    count = round(duration * rate)
    times = (np.arange(count) + jitter * rng.uniform(-1.0, 1.0, count)) / rate
    return times[rng.random(count) >= drop_outs]


def follow(times, places, parameters=PARAMETERS):
    """Return a track with its velocities (n, 2) and deviations (n,) after each observation."""
    track = ObstacleTrack(parameters, times[0], *places[0])
    velocities, deviations = [track.velocity], [track.velocity_deviation]
    for time, (x, y) in zip(times[1:].tolist(), places[1:].tolist(), strict=True):
        assert track.observe(time, x, y)
        velocities.append(track.velocity)
        deviations.append(track.velocity_deviation)
    return track, np.array(velocities), np.array(deviations)


def line(times, velocity):
    return np.outer(times, velocity) + [5.0, -2.0]


def rms(errors):
    return float(np.sqrt(np.mean(np.square(errors))))


# ---- constant velocity ------------------------------------------------------------------------


@pytest.mark.parametrize("velocity", [(1.0, 0.0), (-0.7, 1.2), (0.0, -2.5), (0.05, 0.0)])
@pytest.mark.parametrize("rate", [10, 20, 30])
def test_two_point_velocity_of_the_paper_is_reproduced_without_noise(rate, velocity):
    times = stamps(np.random.default_rng(rate), rate, 4.0)
    track, velocities, deviations = follow(times, line(times, velocity))
    speed = math.hypot(*velocity)
    assert np.linalg.norm(velocities[2:] - velocity, axis=1).max() < 0.01 * speed
    assert np.linalg.norm(velocities[8:] - velocity, axis=1).max() < 1e-3 * speed
    assert track.position == pytest.approx(line(times[-1:], velocity)[0], abs=1e-4)
    assert track.time == times[-1]
    assert deviations[-1] < 0.02


@pytest.mark.parametrize(
    ("noise", "rate", "bound", "paper"),
    [
        (0.01, 10, 0.05, 0.12),
        (0.01, 20, 0.05, 0.25),
        (0.01, 30, 0.05, 0.35),
        (0.03, 10, 0.12, 0.35),
        (0.03, 20, 0.12, 0.75),
        (0.03, 30, 0.12, 1.1),
    ],
)
@pytest.mark.parametrize("velocity", [(0.0, 0.0), (1.0, -0.5)])
def test_velocity_is_insensitive_to_noise(velocity, noise, rate, bound, paper):
    errors, two_points = [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        times = stamps(rng, rate, 8.0)
        places = line(times, velocity) + noise * rng.normal(size=(len(times), 2))
        _, velocities, _ = follow(times, places)
        errors.append(velocities[rate:] - velocity)
        differences = np.diff(places, axis=0) / np.diff(times)[:, None]
        two_points.append(differences[rate:] - velocity)
    assert rms(np.concatenate(two_points)) > paper
    assert rms(np.concatenate(errors)) < bound


def test_standing_obstacle_with_2_cm_of_noise_appears_slow():
    rng = np.random.default_rng(2)
    times = stamps(rng, 20, 20.0)
    _, velocities, deviations = follow(times, 0.02 * rng.normal(size=(len(times), 2)))
    assert np.quantile(np.linalg.norm(velocities[20:], axis=1), 0.99) < 0.2
    assert rms(velocities[20:]) < 0.05
    assert deviations[20:].mean() < 0.1


def test_deviation_bounds_the_error_of_steady_motion():
    inside = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        times = stamps(rng, 20, 3.0)
        places = line(times, (0.8, 0.3)) + 0.01 * rng.normal(size=(len(times), 2))
        _, velocities, deviations = follow(times, places)
        inside.append(np.abs(velocities[2:] - (0.8, 0.3)) <= 2.0 * deviations[2:, None])
    assert np.concatenate(inside).mean() > 0.95


def test_standing_obstacle_seen_exactly_has_almost_no_deviation():
    times = np.arange(0.0, 6.0, 0.05)
    track, velocities, deviations = follow(times, np.tile([3.0, 4.0], (len(times), 1)))
    assert not velocities.any()
    assert track.velocity_deviation < 0.01
    assert deviations[0] == PARAMETERS.max_speed


@pytest.mark.parametrize("moved", [(1e4, -2e4), (-37.5, 12.25)])
def test_estimate_is_invariant_to_the_origin(moved):
    rng = np.random.default_rng(4)
    times = stamps(rng, 20, 3.0)
    places = line(times, (0.5, 0.0)) + 0.01 * rng.normal(size=(len(times), 2))
    _, here, _ = follow(times, places)
    _, there, _ = follow(times + 1000.0, places + moved)
    np.testing.assert_allclose(there, here, atol=1e-6)


# ---- changes ----------------------------------------------------------------------------------


@pytest.mark.parametrize(("before", "after"), [(1, -1), (0, 1), (1, 0), (0.3, -0.3), (1.5, 0.5)])
@pytest.mark.parametrize("rate", [10, 20])
@pytest.mark.parametrize(("noise", "bound"), [(0.0, 0.05), (0.01, 0.2)])
def test_step_of_velocity_is_tracked_within_0_3_s(before, after, rate, noise, bound):
    errors = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        times = stamps(rng, rate, 4.0, drop_outs=0.0)
        change = times[len(times) // 2] + rng.uniform(0.0, 1.0 / rate)
        way = before * np.minimum(times, change) + after * np.maximum(times - change, 0.0)
        places = np.column_stack([way, 0.0 * way]) + noise * rng.normal(size=(len(times), 2))
        _, velocities, _ = follow(times, places)
        errors.append(velocities[times <= change + 0.3][-1] - (after, 0.0))
    assert rms(errors) < bound


@pytest.mark.parametrize("speed", [0.02, 0.1, 0.2, 0.4, 0.8, 1.6])
def test_obstacle_seen_exactly_that_starts_after_a_long_rest_is_tracked(speed):
    times = np.arange(0.0, 12.0, 0.05)
    way = speed * np.maximum(times - 10.0, 0.0)
    _, velocities, _ = follow(times, np.column_stack([way, 0.0 * way]))
    assert velocities[times <= 10.3][-1] == pytest.approx((speed, 0.0), abs=0.1 * speed)


@pytest.mark.parametrize("size", [0.2, 0.5, 2.0, 50.0])
@pytest.mark.parametrize("velocity", [(0.0, 0.0), (1.0, 0.5)])
def test_single_outlier_barely_changes_the_velocity(velocity, size):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        times = stamps(rng, 20, 4.0)
        places = line(times, velocity) + 0.01 * rng.normal(size=(len(times), 2))
        way = rng.uniform(0.0, math.tau)
        spoiled, at = places.copy(), len(times) // 2
        spoiled[at] += [size * math.cos(way), size * math.sin(way)]
        _, clean, _ = follow(times, places)
        track, velocities, _ = follow(times, spoiled)
        away = np.linalg.norm(velocities - clean, axis=1)
        assert 0.0 < away.max() < 0.3
        assert np.array_equal(velocities[at], velocities[at - 1])
        assert track.position == pytest.approx(places[-1], abs=0.05)


def test_outlier_at_every_fourth_observation_is_tolerated():
    rng = np.random.default_rng(8)
    times = np.arange(0.0, 6.0, 0.05)
    places = line(times, (0.6, -0.4)) + 0.005 * rng.normal(size=(len(times), 2))
    places[40::4] += rng.uniform(-3.0, 3.0, (len(places[40::4]), 2))
    _, velocities, _ = follow(times, places)
    assert rms(velocities[40:] - (0.6, -0.4)) < 0.1


def test_confirmed_position_jump_restarts_the_track_at_rest():
    times = np.arange(0.0, 3.0, 0.05)
    places = line(times, (1.0, 0.0))
    places[40:] += [4.0, 0.0]
    track, _, _ = follow(times[:41], places[:41])
    assert track.position == pytest.approx(places[39], abs=0.01)  # not confirmed
    assert track.doubted == times[40]
    track.observe(times[41], *places[41])
    assert track.position == pytest.approx(places[41], abs=1e-9)
    assert track.velocity == (0.0, 0.0)
    assert track.velocity_deviation == PARAMETERS.max_speed
    assert track.doubted == math.inf
    for time, place in zip(times[42:45], places[42:45], strict=True):
        track.observe(time, *place)
    assert track.velocity == pytest.approx((1.0, 0.0), abs=0.02)


def test_max_speed_distinguishes_a_jump_from_a_fast_obstacle():
    def after_the_dash(max_speed):
        places = [(0.0, 0.0)] * 20 + [(0.25, 0.0), (0.5, 0.0)]  # 5 m/s at 20 Hz
        times = 0.05 * np.arange(len(places))
        track, _, _ = follow(times, np.array(places), TrackingParameters(max_speed=max_speed))
        return track.velocity

    assert after_the_dash(3.0) == (0.0, 0.0)
    assert after_the_dash(6.0) == pytest.approx((5.0, 0.0), abs=0.05)


def test_estimated_speed_is_bounded():
    times = np.arange(0.0, 3.0, 0.05)
    _, velocities, deviations = follow(times, line(times, (2.4, 3.2)))
    assert np.linalg.norm(velocities, axis=1).max() <= 3.0 + 1e-12
    assert deviations.max() <= 3.0
    _, fast, _ = follow(times, line(times, (2.4, 3.2)), TrackingParameters(max_speed=5.0))
    assert fast[-1] == pytest.approx((2.4, 3.2), abs=0.01)


def test_suspected_outlier_without_contradiction_is_accepted():
    times = np.arange(0.0, 1.0, 0.05)
    track, _, _ = follow(times, line(times, (0.0, 0.0)))
    track.observe(1.0, 9.0, 9.0)
    track.settle(1.0 + CONFIRMATION_TIME - 0.01)
    assert track.position == pytest.approx((5.0, -2.0))
    track.settle(1.0 + CONFIRMATION_TIME + 0.01)
    assert (track.position, track.time, track.velocity) == ((9.0, 9.0), 1.0, (0.0, 0.0))
    assert track.velocity_deviation == PARAMETERS.max_speed


def test_inconsistent_observations_do_not_keep_an_old_track_forever():
    times = np.arange(0.0, 2.0, 0.05)
    track, _, _ = follow(times, line(times, (0.0, 0.0)))
    for i, place in enumerate([(50, 0), (0, 50), (-50, 0), (0, -50)]):
        assert track.position == pytest.approx((5.0, -2.0))
        track.observe(times[-1] + 0.05 * (i + 1), *map(float, place))
    assert (track.position, track.velocity) == ((0.0, -50.0), (0.0, 0.0))
    assert track.velocity_deviation == PARAMETERS.max_speed


# ---- irregular times --------------------------------------------------------------------------


def test_observation_that_is_not_newer_is_ignored():
    times = np.arange(0.0, 1.0, 0.05)
    track, _, _ = follow(times, line(times, (1.0, 0.0)))
    before = (track.position, track.velocity, track.velocity_deviation, track.time)
    for time in (times[-1], times[-2], -100.0):
        assert track.observe(time, 0.0, 0.0) is False
    assert before == (track.position, track.velocity, track.velocity_deviation, track.time)
    track.observe(1.0, 50.0, 50.0)  # suspected, but received
    assert track.observe(1.0, 6.0, -2.0) is False
    assert track.observe(1.05, 6.05, -2.0) is True


def test_burst_of_late_messages_is_not_taken_for_motion():
    rng = np.random.default_rng(3)
    sent = np.arange(0.0, 6.0, 0.05)
    times = np.maximum.accumulate(sent + (np.arange(len(sent)) % 5 == 0) * 0.049)
    times += 1e-6 * np.arange(len(times))
    places = 0.01 * rng.normal(size=(len(times), 2))
    _, velocities, _ = follow(times, places)
    assert np.linalg.norm(velocities[20:], axis=1).max() < 0.3


@pytest.mark.parametrize("gap", [0.9, 2.0, 5.0])
def test_deviation_of_the_velocity_grows_with_the_gap(gap):
    times = np.arange(0.0, 2.0, 0.05)
    velocity = (0.4, 0.0)
    track, _, deviations = follow(times, line(times, velocity))
    at = times[-1] + gap
    track.observe(at, *line(np.array([at]), velocity)[0])
    assert track.velocity == pytest.approx(velocity, abs=0.01)
    assert deviations[-1] < track.velocity_deviation < PARAMETERS.max_speed
    longer, _, _ = follow(times, line(times, velocity))
    at = times[-1] + 2.0 * gap
    longer.observe(at, *line(np.array([at]), velocity)[0])
    assert longer.velocity_deviation > track.velocity_deviation


def test_obstacle_moved_during_a_long_gap_stands_at_its_new_position():
    times = np.arange(0.0, 2.0, 0.05)
    track, _, _ = follow(times, line(times, (0.0, 0.0)))
    track.observe(12.0, 9.0, 1.0)
    assert (track.position, track.velocity) == ((9.0, 1.0), (0.0, 0.0))


def test_estimates_are_finite_and_bounded_for_any_times_and_positions():
    rng = np.random.default_rng(11)
    for _ in range(30):
        steps = 10.0 ** rng.uniform(-9, 5, 40)
        scale = 10.0 ** rng.uniform(-6, 6)
        parameters = TrackingParameters(
            noise=10.0 ** rng.uniform(-4, 0),
            acceleration=10.0 ** rng.uniform(-2, 2),
            max_speed=10.0 ** rng.uniform(-2, 2),
        )
        places = scale * rng.normal(size=(40, 2))
        track, velocities, deviations = follow(np.cumsum(steps), places, parameters)
        assert np.isfinite([*track.position, *velocities.ravel()]).all()
        assert np.linalg.norm(velocities, axis=1).max() <= parameters.max_speed * (1 + 1e-9)
        assert (deviations >= 0.0).all() and (deviations <= parameters.max_speed).all()


def test_restarted_track_may_go_back_in_time():
    times = np.arange(10.0, 12.0, 0.05)
    track, _, _ = follow(times, line(times, (1.0, 0.0)))
    track.restart(0.0, 1.0, 2.0)
    assert (track.time, track.position, track.velocity) == (0.0, (1.0, 2.0), (0.0, 0.0))
    assert track.observe(0.05, 1.0, 2.0)


# ---- what is refused --------------------------------------------------------------------------


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", [0, 1, 2])
def test_observation_that_is_not_finite_is_refused_without_effect(bad, place):
    times = np.arange(0.0, 1.0, 0.05)
    track, _, _ = follow(times, line(times, (1.0, 0.0)))
    values = [1.0, 6.0, -2.0]
    values[place] = bad
    with pytest.raises(InputError, match="not finite"):
        track.observe(*values)
    with pytest.raises(InputError, match="not finite"):
        ObstacleTrack(PARAMETERS, *values)
    assert track.observe(1.0, 6.0, -2.0)
    assert track.velocity == pytest.approx((1.0, 0.0), abs=0.01)


@pytest.mark.parametrize(
    ("name", "value"), [("noise", 0.0), ("acceleration", 0.0), ("growth", -0.1), ("max_speed", 0)]
)
def test_parameters_out_of_range_are_refused(name, value):
    with pytest.raises(ParameterError, match=f"obstacles.{name}"):
        build(TrackingParameters, {f"obstacles.{name}": value}, "obstacles.")
