"""Distances of upright solids, against places that no formula chose."""

import math

import numpy as np
import pytest

from omniman_ros.collision.upright_obstacles import UprightObstacles

POST = UprightObstacles.cylinder(1.0, 0.0, 0.2, (0.0, 1.0))  #: A cylinder
#: A box that is 1 m long in y
BOX = UprightObstacles.box((0.0, 2.0, 0.5 * math.pi), 1.0, 0.4, (0.5, 0.6))


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        ((0, 0, 0.5), (0.5, 0, 0.5), (0.3, math.hypot(1.5, 0.0))),
        ((1, -1, 0.5), (1, 1, 0.5), (0.0, math.hypot(0.5, 0.8))),
        ((1, 0, 1.3), (1.5, 0, 1.3), (0.3, math.hypot(0.7, math.hypot(0.8, 1.5)))),
        ((0.5, -1, 0.8), (0.5, 1, 0.8), (0.3, math.hypot(0.2, math.hypot(0.3, 0.5)))),
    ],
    ids=["ahead", "through", "above", "beside"],
)
def test_known_distances(start, end, expected):
    """A segment has the distances from post and box that are drawn for it."""
    obstacles = UprightObstacles.join([POST, BOX])
    start, end = (np.array(point, dtype=float)[:, None] for point in (start, end))
    assert obstacles.distances(start, end, math.inf)[0] == pytest.approx(expected[0], abs=1e-8)
    assert obstacles.distances(end, start, math.inf)[0] == pytest.approx(expected[0], abs=1e-8)


def test_no_place_on_a_segment_is_nearer():
    """The distance is the least of those of many places, but for their spacing."""
    rng = np.random.default_rng(6)
    count = 400
    obstacles = UprightObstacles(
        rng.uniform(-1.0, 1.0, (2, 5)),
        rng.uniform(-3.0, 3.0, 5),
        np.array([[0.0, 0.3, 0.5, 0.2, 0.0], [0.0, 0.1, 0.4, 0.0, 0.3]]),
        np.array([0.2, 0.0, 0.1, 0.3, 0.0]),
        np.array([0.0, 0.2, 0.0, 0.5, 0.4]),
        np.array([1.0, 0.4, 0.9, 0.6, 0.5]),
    )
    start = rng.uniform(-1.5, 1.5, (3, count, 1))
    end = start + rng.uniform(-0.7, 0.7, (3, count, 1))
    fraction = np.linspace(0.0, 1.0, 400)[:, None, None]
    points = start[:, None] + fraction * (end - start)[:, None]
    grid = obstacles.point_distances(points).min(axis=0)
    found = obstacles.distances(start, end, math.inf)
    assert (found <= grid + 1e-8).all()
    assert (grid - found).max() < 0.002


@pytest.mark.parametrize(
    ("obstacle", "point", "nearest"),
    [
        (POST, (0.0, 0.0, 0.5), (0.8, 0.0, 0.5)),
        (BOX, (1.0, 3.0, 1.0), (0.2, 2.5, 0.6)),
        (BOX, (0.1, 2.2, 0.55), (0.1, 2.2, 0.55)),
    ],
    ids=["post", "turned box", "within"],
)
def test_the_nearest_point_lies_on_the_obstacle(obstacle, point, nearest):
    found = obstacle.nearest_points(np.array(point)[:, None])
    assert found[:, 0] == pytest.approx(nearest)


def test_boxes_have_the_distance_of_their_outlines():
    """Two upright boxes have the least distance of points on their edges, and the vertical gap."""
    rng = np.random.default_rng(7)
    half = np.array([0.4, 0.3])
    side = np.linspace(-1.0, 1.0, 200)
    outline = np.concatenate(
        [np.stack((sign * half[0] * np.ones(200), side * half[1])).T for sign in (-1.0, 1.0)]
        + [np.stack((side * half[0], sign * half[1] * np.ones(200))).T for sign in (-1.0, 1.0)]
    )
    obstacles = UprightObstacles.join([POST, BOX])
    for pose in rng.uniform((-1.0, -1.0, -3.0), (2.0, 3.0, 3.0), (60, 3)):
        c, s = math.cos(pose[2]), math.sin(pose[2])
        points = outline @ np.array([[c, s], [-s, c]]) + pose[:2]
        flat = np.vstack((points.T, np.full(len(points), 0.55)))[..., None]
        grid = obstacles.point_distances(flat).min(axis=0)
        found = obstacles.box_distances(pose, half, (0.0, 0.55))
        assert (found <= grid + 1e-9).all()
        is_apart = found > 0.0
        assert (grid - found)[is_apart].max(initial=0.0) < 0.005
        below = obstacles.box_distances(pose, half, (-1.0, -0.4))
        assert below == pytest.approx(np.hypot(found, [0.4, 0.9]))


def test_a_box_within_another_overlaps():
    """One box inside another touches no side of it, and has no distance."""
    inner = UprightObstacles.box((0.1, 0.0, 0.3), 0.2, 0.2, (0.0, 1.0))
    assert inner.box_distances(np.zeros(3), np.array([1.0, 1.0]), (0.0, 1.0))[0] == 0.0
    outer = UprightObstacles.box((0.0, 0.0, 0.0), 4.0, 4.0, (0.0, 1.0))
    assert outer.box_distances(np.zeros(3), np.array([0.1, 0.1]), (0.0, 1.0))[0] == 0.0
