"""Tests of the convex outline."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from omniman_ros.nav2.outline import convex_outline

SQUARE = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])


def test_points_within_and_on_the_edges_are_left_out():
    more = [(0.0, 0.0), (1.0, 0.5), (-1.0, 0.0), (0.3, 1.0)]
    outline = convex_outline(np.vstack([SQUARE, more]))
    assert sorted(map(tuple, outline)) == sorted(map(tuple, SQUARE))


@given(st.integers(0, 10_000))
def test_every_point_is_to_the_left_of_every_edge(seed):
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (12, 2))
    outline = convex_outline(points)
    edges = np.roll(outline, -1, axis=0) - outline
    offsets = points[:, None] - outline
    left = edges[:, 0] * offsets[..., 1] - edges[:, 1] * offsets[..., 0]
    assert left.min() >= -1e-8
    assert {tuple(corner) for corner in outline} <= {tuple(point) for point in points}
