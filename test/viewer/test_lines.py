import math

import numpy as np
import pytest

from omniman_ros.viewer.lines import (
    OUTLINE_POINTS,
    TRAIL_SPACING,
    Line,
    Trail,
    outlines,
    segments,
    thinned,
)


def test_a_trail_keeps_points_that_are_far_enough_apart():
    trail = Trail(spacing=0.1)
    for x in np.arange(0.0, 1.0, 0.03):
        trail.add(x, 0.0)
    steps = np.diff(trail.points[:, 0])
    assert len(steps) > 5
    assert (steps >= 0.1).all() and (steps < 0.13).all()


def test_a_trail_is_bounded_and_keeps_the_newest():
    trail = Trail(limit=50)
    for i in range(1, 1001):
        trail.add(float(i), -float(i))
        assert trail.points[:, 0].tolist() == list(range(max(i - 49, 1), i + 1))
    assert trail.points[-1].tolist() == [1000.0, -1000.0]


def test_the_version_of_a_trail_changes_with_its_points():
    trail = Trail()
    trail.add(0.0, 0.0)
    version = trail.version
    trail.add(0.5 * TRAIL_SPACING, 0.0)
    assert trail.version == version
    trail.add(2.0 * TRAIL_SPACING, 0.0)
    assert trail.version != version
    version = trail.version
    trail.clear()
    assert len(trail.points) == 0 and trail.version != version


def test_a_line_is_broken_where_it_jumps():
    points = np.array([[0.0, 0.0], [0.1, 0.0], [5.0, 5.0], [5.0, 5.1]])
    assert len(segments(points)) == 3
    pieces = segments(points, jump=0.5)
    assert pieces.tolist() == [[[0.0, 0.0], [0.1, 0.0]], [[5.0, 5.0], [5.0, 5.1]]]


@pytest.mark.parametrize("count", [0, 1])
def test_a_line_of_too_few_points_has_no_segments(count):
    assert segments(np.zeros((count, 2)), 0.5).shape == (0, 2, 2)


@pytest.mark.parametrize("count", [0, 1, 7, 10, 11, 1000, 10**6])
def test_a_long_path_is_thinned_evenly_to_its_ends(count):
    selected = list(thinned(count, 10))
    assert len(selected) == min(count, 10)
    if count:
        assert (selected[0], selected[-1]) == (0, count - 1)
    gaps = np.diff(selected)
    assert gaps.size == 0 or gaps.max() - gaps.min() <= 1


def test_setting_a_line_changes_its_version():
    line = Line()
    line.set(np.zeros((2, 2)))
    assert line.version == 1 and line.points.shape == (2, 2)


def test_outlines_go_around_each_obstacle_with_a_gap_between_two():
    centers, axes = np.array([[1.0, 2.0], [4.0, 0.0]]), np.array([[0.5, 0.2], [1.0, 1.0]])
    points = outlines(centers, axes, np.array([math.pi / 2, 0.0]))
    pieces = segments(points)
    assert len(pieces) == 2 * OUTLINE_POINTS
    first, second = pieces[:OUTLINE_POINTS].reshape(-1, 2), pieces[OUTLINE_POINTS:].reshape(-1, 2)
    around = (first - centers[0]) / [0.2, 0.5]  # the obstacle is turned by 90 degrees
    assert np.hypot(*around.T) == pytest.approx(1.0)
    assert np.hypot(*(second - centers[1]).T) == pytest.approx(1.0)
