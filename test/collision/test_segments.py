"""Distances of segments, against places on them that no formula chose."""

import numpy as np
import pytest

from omniman_ros.collision.segments import segment_distances


def distance(*points):
    """Return the distance of one pair of segments, given as four points."""
    return float(segment_distances(*(np.array(point, dtype=float) for point in points)))


@pytest.mark.parametrize(
    ("points", "expected"),
    [
        (((0, 0, 0), (2, 0, 0), (1, -1, 0.5), (1, 1, 0.5)), 0.5),
        (((0, 0, 0), (2, 0, 0), (3, 0, 0), (5, 0, 0)), 1.0),
        (((0, 0, 0), (2, 0, 0), (0.5, 0.3, 0), (1.5, 0.3, 0)), 0.3),
        (((0, 0, 0), (2, 0, 0), (1.5, 0.3, 0), (0.5, 0.3, 0)), 0.3),
        (((0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1, 0)), 0.0),
        (((0, 0, 0), (0, 0, 0), (1, -1, 0), (1, 1, 0)), 1.0),
        (((0, 0, 0), (0, 0, 0), (0, 3, 4), (0, 3, 4)), 5.0),
    ],
    ids=["crossing", "in line", "parallel", "antiparallel", "meeting", "a point", "two points"],
)
def test_known_distances(points, expected):
    """Two segments have the distance that is drawn for them, also as points or parallel."""
    assert distance(*points) == pytest.approx(expected, abs=1e-12)
    assert distance(*points[2:], *points[:2]) == pytest.approx(expected, abs=1e-12)


def test_no_pair_of_points_is_nearer():
    """The least distance over a fine grid of places is the result, or above it by its spacing."""
    rng = np.random.default_rng(1)
    first, first_end, second, second_end = rng.uniform(-1.0, 1.0, (4, 3, 300))
    second_end[:, :50] = second[:, :50] + 0.7 * (first_end - first)[:, :50]
    fraction = np.linspace(0.0, 1.0, 101)
    a = first[..., None] + (first_end - first)[..., None] * fraction
    b = second[..., None] + (second_end - second)[..., None] * fraction
    grid = np.linalg.norm(a[..., :, None] - b[..., None, :], axis=0).min(axis=(1, 2))
    found = segment_distances(first, first_end, second, second_end)
    assert (found <= grid + 1e-12).all()
    assert (grid - found).max() < 0.04
