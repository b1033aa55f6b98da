import math

import numpy as np
import pytest

from omniman_ros.planning.route.route import Route
from omniman_ros.planning.route.route_goal import RouteGoal

SPEEDS = (0.8, 1.6)
STEP = 1e-3


def a_route(*places):
    """Return a route through points on the x axis."""
    return Route(np.array([[x, 0.0, 0.0] for x in places]), SPEEDS)


def any_progress(random):
    """Draw a place on a route and a pace from which it can still come to rest."""
    route = a_route(0.0, random.uniform(0.1, 1.0), random.uniform(1.0, 6.0))
    rate, most = random.uniform(0.3, 3.0), random.uniform(0.2, 1.0)
    place = random.uniform(0.0, route.duration)
    left = route.duration - place
    pace = min(random.uniform(0.0, 1.0) * most, math.sqrt(2.0 * rate * left))
    return RouteGoal(route, 10.0, place, pace, rate, most)


def profile(along, seconds=None):
    """Return times, places and paces of the targets."""
    slowest = 0.5 * math.sqrt(along.rate * (along.route.duration - along.position) + 1e-12)
    lasts = along.route.duration / min(along.max_pace, max(slowest, 1e-3)) + 2.0 / along.rate
    times = np.arange(0.0, seconds or 2.0 * lasts, STEP)
    passed = along.passed(times)
    return times, along.position + passed, np.diff(passed) / STEP


@pytest.mark.parametrize("seed", range(10))
def test_targets_keep_pace_and_rate_limits_and_rest_at_the_end(seed):
    along = any_progress(np.random.default_rng(seed))
    _, places, paces = profile(along)
    assert places[0] == along.position
    assert places[-1] == pytest.approx(along.route.duration, abs=1e-6)
    assert paces.min() > -1e-9 and paces.max() < along.max_pace + 1e-9
    assert paces[0] == pytest.approx(along.pace, abs=2.0 * along.rate * STEP)
    assert paces[-1] < 1e-9
    assert np.abs(np.diff(paces)).max() < along.rate * STEP + 1e-9
    # The profile is as fast as the limits allow.
    changes = np.abs(np.diff(paces)) / STEP
    going = paces[1:] > 1e-6
    idle = going & (changes < 0.9 * along.rate) & (paces[1:] < along.max_pace - 1e-6)
    assert idle.sum() <= 4


@pytest.mark.parametrize("seed", range(10))
def test_profile_recomputed_from_any_of_its_points_is_the_same(seed):
    random = np.random.default_rng(100 + seed)
    along = any_progress(random)
    times, _, _ = profile(along)
    for later in random.uniform(0.0, times[-1], 8).tolist():
        tick = 1e-6
        before, here = along.passed(np.array([later - tick, later + tick]))
        place = along.position + float(along.passed(np.array([later]))[0])
        again = RouteGoal(
            along.route,
            10.0 + later,
            place,
            (here - before) / (2 * tick),
            along.rate,
            along.max_pace,
        )
        expected = along.position + along.passed(later + times)
        # Rounding of a place enters the time of rest by its square root.
        np.testing.assert_allclose(place + again.passed(times), expected, atol=2e-5)


def test_pace_above_the_maximum_decreases_at_the_rate_limit():
    along = RouteGoal(a_route(0.0, 6.0), 0.0, 0.5, 1.0, 0.9, max_pace=0.25)
    _, places, paces = profile(along)
    assert paces[0] == pytest.approx(1.0, abs=2e-3)
    assert np.abs(np.diff(paces)).max() < 0.9 * STEP + 1e-9
    slowed = int((1.0 - 0.25) / 0.9 / STEP) + 2
    assert paces[slowed:].max() < 0.25 + 1e-9
    assert places[-1] == pytest.approx(along.route.duration)


@pytest.mark.parametrize(("pace", "as_if"), [(1.7, 1.0), (-0.8, 0.0), (math.inf, 1.0)])
def test_pace_outside_its_range_is_clamped(pace, as_if):
    route, times = a_route(0.0, 4.0), np.linspace(0.0, 9.0, 91)
    found = RouteGoal(route, 0.0, 1.0, pace, 1.2).passed(times)
    np.testing.assert_allclose(found, RouteGoal(route, 0.0, 1.0, as_if, 1.2).passed(times))
    assert (np.diff(found) >= 0.0).all()


def test_pace_too_high_to_come_to_rest_ends_at_the_end_of_the_route():
    along = RouteGoal(a_route(0.0, 4.0), 0.0, 4.9, 1.0, 0.5)
    _, places, paces = profile(along, seconds=5.0)
    assert (paces >= -1e-9).all()
    assert places.max() == pytest.approx(along.route.duration)
    assert paces[0] == pytest.approx(1.0, abs=1e-2)


def test_targets_are_poses_of_the_route_without_velocity():
    route = Route(np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 2.0, 1.5]]), SPEEDS)
    along = RouteGoal(route, 50.0, 1.0, 0.5, 1.0)
    times = 50.0 + np.array([0.0, 0.5, 2.0, 60.0])
    poses, velocities = along.targets(times)
    np.testing.assert_allclose(poses, route.at(1.0 + along.passed(times - 50.0)))
    np.testing.assert_allclose(poses[0], [0.8, 0.0, 0.0])
    np.testing.assert_allclose(poses[-1], route.poses[-1])
    assert velocities.shape == (4, 3) and not velocities.any()
    assert not along.moves and along.until == -math.inf
    # Targets never return to an earlier place.
    np.testing.assert_allclose(along.targets(np.array([40.0]))[0], poses[:1])


@pytest.mark.parametrize("poses", [[[1.0, 2.0, 3.0]], [[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]]])
@pytest.mark.parametrize("pace", [0.0, 1.0])
def test_route_of_zero_length_has_constant_targets(poses, pace):
    along = RouteGoal(Route(np.array(poses), SPEEDS), 0.0, 0.0, pace, 1.3)
    found, _ = along.targets(np.linspace(0.0, 3.0, 7))
    np.testing.assert_array_equal(found, np.tile([1.0, 2.0, 3.0], (7, 1)))
