import math

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.core.errors import InputError
from omniman_ros.planning.route.route import Route, straight
from test.planning.support import crowd, ellipses, true_gaps

HALF = np.array([0.4, 0.25])
FOOTPRINT = Footprint(Rectangles.centred(HALF))
SPEEDS = (0.8, 1.5)
WIDE = (-1e3, -1e3, 1e3, 1e3)
ROOM = (-3.0, -2.0, 3.0, 2.0)


def route(*poses, speeds=SPEEDS):
    return Route(np.array(poses, float), speeds)


def winding(seed=0, count=12):
    rng = np.random.default_rng(seed)
    return Route(np.cumsum(rng.uniform(-1, 1.2, (count, 3)), axis=0), SPEEDS)


def test_times_follow_the_slower_of_translation_and_rotation():
    known = route([0, 0, 0], [0.8, 0, 0.5], [0.8, 0.4, 3.5], [0.8, 0.4, 2])
    np.testing.assert_allclose(known.times, [0, 1, 3, 4])
    assert known.duration == 4
    assert known.length == pytest.approx(1.2)


def test_at_interpolates_the_poses_and_clamps_to_the_ends():
    known = winding()
    np.testing.assert_allclose(known.at(known.times), known.poses)
    ends = known.at(np.array([-1.0, known.duration + 1]))
    np.testing.assert_allclose(ends, known.poses[[0, -1]])
    middle = 0.5 * (known.times[:-1] + known.times[1:])
    np.testing.assert_allclose(known.at(middle), 0.5 * (known.poses[:-1] + known.poses[1:]))


def test_route_is_driven_no_faster_than_its_speeds():
    known = winding(3)
    times = np.linspace(0, known.duration, 5000)
    rates = np.diff(known.at(times), axis=0) / np.diff(times)[:, None]
    assert np.hypot(rates[:, 0], rates[:, 1]).max() <= SPEEDS[0] + 1e-9
    assert np.abs(rates[:, 2]).max() <= SPEEDS[1] + 1e-9


def test_route_of_one_pose_is_a_point():
    known = route([1, 2, 3])
    assert known.duration == 0 and known.length == 0
    np.testing.assert_array_equal(known.at(np.array([0.0, 1])), [[1, 2, 3]] * 2)
    assert known.project(np.array([5.0, 5, 0])) == 0
    assert known.clear(FOOTPRINT, ellipses((1, 2.6, 0.1)), WIDE) is True


@pytest.mark.parametrize("seed", range(5))
def test_pose_on_the_route_is_projected_onto_itself(seed):
    known = winding(seed)
    for at in np.linspace(0, known.duration, 41):
        pose = known.at(np.array([at]))[0]
        assert known.project(pose, near=at) == pytest.approx(at, abs=1e-9)


def test_projection_does_not_depend_on_the_branch_of_the_heading():
    known = route([0, 0, 0], [0.1, 0, 9])
    for at in np.linspace(0, known.duration, 30):
        pose = known.at(np.array([at]))[0] + [0, 0.05, 4 * math.pi]
        assert known.project(pose) == pytest.approx(at, abs=0.01)


def test_projection_searches_near_the_last_place_only():
    # The route returns 0.3 m beside itself.
    known = route([0, 0, 0], [8, 0, 0], [8, 0.3, 0], [0, 0.3, 0])
    pose = np.array([2.0, 0.29, 0])
    assert known.project(pose, near=2.4) == pytest.approx(2.5)
    assert known.project(pose) == pytest.approx(known.duration - 2.5)
    assert known.project(pose, near=known.duration) == pytest.approx(known.duration - 0.5)


def test_search_window_has_the_given_length():
    known = route([0, 0, 0], [8, 0, 0])
    pose = np.array([4.0, 0, 0])
    assert known.project(pose, near=1.0, window=(0.5, 2)) == pytest.approx(3)
    assert known.project(pose, near=9.0, window=(0.5, 2)) == pytest.approx(8.5)
    assert known.project(pose, near=99.0) == pytest.approx(9.5)
    assert known.project(pose, near=-9.0) == pytest.approx(2)


def test_pose_outside_a_corner_is_projected_onto_the_corner():
    known = route([0, 0, 0], [0.8, 0, 0], [0.8, 0.8, 0])
    assert known.project(np.array([1.5, -1, 0])) == pytest.approx(1)


@pytest.mark.parametrize("first, last", [(0, math.inf), (1.3, 4.2), (3, 3), (-1, 1e9)])
def test_points_of_the_box_move_little_between_two_samples(first, last):
    known = winding(2)
    times, poses = known.samples(FOOTPRINT.radius, first, last)
    assert times[0] == max(first, 0)
    assert times[-1] == min(last, known.duration)
    np.testing.assert_allclose(known.at(times), poses, atol=1e-9)
    corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]]) * HALF
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x = poses[:, :1] + c * corners[:, 0] - s * corners[:, 1]
    y = poses[:, 1:2] + s * corners[:, 0] + c * corners[:, 1]
    moved = np.hypot(np.diff(x, axis=0), np.diff(y, axis=0))
    assert moved.max(initial=0) <= 0.02 + 1e-9


def test_route_is_immutable():
    poses = np.zeros((2, 3))
    known = Route(poses, SPEEDS)
    poses[1, 0] = 5
    assert known.length == 0
    with pytest.raises(ValueError):
        known.poses[0, 0] = 1


@pytest.mark.parametrize(
    ("poses", "speeds", "named"),
    [
        (np.zeros((0, 3)), SPEEDS, r"\(0, 3\)"),
        (np.zeros((2, 2)), SPEEDS, r"\(2, 2\)"),
        (np.array([[0, 0, 0], [math.nan, 0, 0]]), SPEEDS, "nan"),
        (np.array([[0, 0, 0], [0, 0, math.inf]]), SPEEDS, "inf"),
        (np.zeros((2, 3)), (0.0, 1), "0.0"),
        (np.zeros((2, 3)), (1, math.nan), "nan"),
    ],
)
def test_invalid_route_is_refused_with_its_value(poses, speeds, named):
    with pytest.raises(InputError, match=named):
        Route(poses, speeds)


@pytest.mark.parametrize(
    ("start", "goal", "end"), [(3, -3, 2 * math.pi - 3), (-7, 0, -2 * math.pi), (0.2, 1, 1)]
)
def test_straight_route_turns_the_shorter_way(start, goal, end):
    known = straight(np.array([0.0, 0, start]), np.array([1.0, 2, goal]), SPEEDS)
    np.testing.assert_allclose(known.poses, [[0, 0, start], [1, 2, end]])


def test_route_is_clear_until_an_obstacle_comes_within_the_margin():
    known = route([-2, 0, 0], [2, 0, 0])
    beside = ellipses((0.5, 0.25 + 0.05 + 0.1, 0.1))
    assert known.clear(FOOTPRINT, beside, WIDE, 0.0499)
    assert not known.clear(FOOTPRINT, beside, WIDE, 0.0501)


def test_only_the_given_part_of_a_route_is_checked():
    known = route([-2, 0, 0], [2, 0, 0])
    upon = ellipses((0.5, 0, 0.1))
    assert known.clear(FOOTPRINT, upon, WIDE, last=2.4)
    assert not known.clear(FOOTPRINT, upon, WIDE, last=2.6)
    assert known.clear(FOOTPRINT, upon, WIDE, first=3.8)
    assert not known.clear(FOOTPRINT, upon, WIDE, first=3.7)


def test_route_that_leaves_the_workspace_is_not_clear():
    known = route([-2, 0, 0], [2, 0, 0], [2, 0, math.pi / 2], [2, 1.59, math.pi / 2])
    assert known.clear(FOOTPRINT, ellipses(), ROOM)
    assert not known.clear(FOOTPRINT, ellipses(), ROOM, 0.02)
    assert known.clear(FOOTPRINT, ellipses(), ROOM, 0.02, last=known.times[-2])


@pytest.mark.parametrize("seed", range(12))
def test_clear_route_has_no_contact_and_other_routes_come_close(seed):
    rng = np.random.default_rng(seed)
    known, around = winding(seed, 4), crowd(rng, 6, 3.0)
    times = np.linspace(0, known.duration, 1500)
    gaps = true_gaps(times, known.at(times), HALF, around).min()
    # `box_gap` is a lower bound, and a point between two samples may be a little closer.
    assert gaps > 0.04 if known.clear(FOOTPRINT, around, WIDE, 0.05) else gaps < 0.4
