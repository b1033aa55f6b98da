import math

import numpy as np
import pytest

from omniman_ros.planning.following import Along
from omniman_ros.planning.route import Route

SPEEDS = (0.8, 1.6)
STEP = 1e-3


def a_route(*places):
    """Through places on the x axis."""
    return Route(np.array([[x, 0.0, 0.0] for x in places]), SPEEDS)


def some_way(random):
    """Anywhere on a route, at any pace that can still come to rest."""
    route = a_route(0.0, random.uniform(0.1, 1.0), random.uniform(1.0, 6.0))
    rate, most = random.uniform(0.3, 3.0), random.uniform(0.2, 1.0)
    place = random.uniform(0.0, route.duration)
    left = route.duration - place
    pace = min(random.uniform(0.0, 1.0) * most, math.sqrt(2.0 * rate * left))
    return Along(route, 10.0, place, pace, rate, most)


def profile(along, seconds=None):
    """Times, places and paces of the targets."""
    slowest = 0.5 * math.sqrt(along.rate * (along.route.duration - along.place) + 1e-12)
    lasts = along.route.duration / min(along.most, max(slowest, 1e-3)) + 2.0 / along.rate
    times = np.arange(0.0, seconds or 2.0 * lasts, STEP)
    passed = along.passed(times)
    return times, along.place + passed, np.diff(passed) / STEP


@pytest.mark.parametrize("seed", range(10))
def test_targets_keep_to_pace_and_rate_and_come_to_rest_at_the_end(seed):
    along = some_way(np.random.default_rng(seed))
    _, places, paces = profile(along)
    assert places[0] == along.place
    assert places[-1] == pytest.approx(along.route.duration, abs=1e-6)
    assert paces.min() > -1e-9 and paces.max() < along.most + 1e-9
    assert paces[0] == pytest.approx(along.pace, abs=2.0 * along.rate * STEP)
    assert paces[-1] < 1e-9
    assert np.abs(np.diff(paces)).max() < along.rate * STEP + 1e-9
    # As fast as that allows: no time is lost on the way.
    changes = np.abs(np.diff(paces)) / STEP
    going = paces[1:] > 1e-6
    idle = going & (changes < 0.9 * along.rate) & (paces[1:] < along.most - 1e-6)
    assert idle.sum() <= 4


@pytest.mark.parametrize("seed", range(10))
def test_the_same_profile_comes_out_from_anywhere_on_it(seed):
    random = np.random.default_rng(100 + seed)
    along = some_way(random)
    times, places, _ = profile(along)
    for later in random.uniform(0.0, times[-1], 8).tolist():
        tick = 1e-6
        before, here = along.passed(np.array([later - tick, later + tick]))
        place = along.place + float(along.passed(np.array([later]))[0])
        again = Along(
            along.route, 10.0 + later, place, (here - before) / (2 * tick), along.rate, along.most
        )
        expected = along.place + along.passed(later + times)
        # A place that is off by its rounding comes to rest off by the root of that.
        np.testing.assert_allclose(place + again.passed(times), expected, atol=2e-5)


def test_a_pace_above_the_most_comes_down_to_it_at_the_rate():
    along = Along(a_route(0.0, 6.0), 0.0, 0.5, 1.0, 0.9, most=0.25)
    _, places, paces = profile(along)
    assert paces[0] == pytest.approx(1.0, abs=2e-3)
    assert np.abs(np.diff(paces)).max() < 0.9 * STEP + 1e-9
    slowed = int((1.0 - 0.25) / 0.9 / STEP) + 2
    assert paces[slowed:].max() < 0.25 + 1e-9
    assert places[-1] == pytest.approx(along.route.duration)


@pytest.mark.parametrize(("pace", "as_if"), [(1.7, 1.0), (-0.8, 0.0), (math.inf, 1.0)])
def test_a_pace_out_of_its_range_is_its_nearest(pace, as_if):
    route, times = a_route(0.0, 4.0), np.linspace(0.0, 9.0, 91)
    found = Along(route, 0.0, 1.0, pace, 1.2).passed(times)
    np.testing.assert_allclose(found, Along(route, 0.0, 1.0, as_if, 1.2).passed(times))
    assert (np.diff(found) >= 0.0).all()


def test_a_pace_that_cannot_come_to_rest_any_more_ends_at_the_end():
    along = Along(a_route(0.0, 4.0), 0.0, 4.9, 1.0, 0.5)
    _, places, paces = profile(along, seconds=5.0)
    assert (paces >= -1e-9).all()
    assert places.max() == pytest.approx(along.route.duration)
    assert paces[0] == pytest.approx(1.0, abs=1e-2)


def test_targets_are_poses_of_the_route_and_want_no_velocity():
    route = Route(np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 2.0, 1.5]]), SPEEDS)
    along = Along(route, 50.0, 1.0, 0.5, 1.0)
    times = 50.0 + np.array([0.0, 0.5, 2.0, 60.0])
    poses, velocities = along.targets(times)
    np.testing.assert_allclose(poses, route.at(1.0 + along.passed(times - 50.0)))
    np.testing.assert_allclose(poses[0], [0.8, 0.0, 0.0])
    np.testing.assert_allclose(poses[-1], route.poses[-1])
    assert velocities.shape == (4, 3) and not velocities.any()
    assert not along.moves and along.until == -math.inf and along.near(9.0) is along
    # What was before is not gone back to.
    np.testing.assert_allclose(along.targets(np.array([40.0]))[0], poses[:1])


@pytest.mark.parametrize("poses", [[[1.0, 2.0, 3.0]], [[1.0, 2.0, 3.0], [1.0, 2.0, 3.0]]])
@pytest.mark.parametrize("pace", [0.0, 1.0])
def test_a_route_without_length_is_stood_on(poses, pace):
    along = Along(Route(np.array(poses), SPEEDS), 0.0, 0.0, pace, 1.3)
    found, _ = along.targets(np.linspace(0.0, 3.0, 7))
    np.testing.assert_array_equal(found, np.tile([1.0, 2.0, 3.0], (7, 1)))
