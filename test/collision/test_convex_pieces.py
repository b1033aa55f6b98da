import numpy as np
import pytest

from omniman_ros.collision.convex_pieces import convex_pieces
from omniman_ros.core.polygon import signed_area
from test.core.test_polygon import star
from test.outlines import FORKS, OCTAGON


def contains(polygon, points):
    """Return which points (k, 2) are within a polygon, by the angle that it turns around them."""
    offset = polygon - points[:, None]
    angles = np.arctan2(offset[..., 1], offset[..., 0])
    turns = np.diff(angles, axis=1, append=angles[:, :1])
    around = ((turns + np.pi) % (2.0 * np.pi) - np.pi).sum(axis=1)
    return np.abs(around) > np.pi


def require_pieces(corners, pieces):
    """Require convex pieces that cover a polygon without overlap."""
    for piece in pieces:
        side = np.roll(piece, -1, axis=0) - piece
        ahead = np.roll(side, -1, axis=0)
        assert (side[:, 0] * ahead[:, 1] - side[:, 1] * ahead[:, 0] >= 0.0).all()
    assert sum(map(signed_area, pieces)) == pytest.approx(signed_area(corners))
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (200, 2))
    within = np.array([contains(piece, points) for piece in pieces])
    np.testing.assert_array_equal(within.sum(axis=0), contains(corners, points))


def test_a_convex_polygon_is_one_piece():
    (piece,) = convex_pieces(np.array(OCTAGON))
    np.testing.assert_array_equal(piece, OCTAGON)


def test_forks_are_few_pieces():
    pieces = convex_pieces(np.array(FORKS))
    assert len(pieces) <= 4
    require_pieces(np.array(FORKS), pieces)


@pytest.mark.parametrize("count", [4, 5, 7, 12, 20])
def test_random_polygons_are_covered_by_convex_pieces(count):
    rng = np.random.default_rng(count)
    for _ in range(10):
        corners = star(rng, count)
        require_pieces(corners, convex_pieces(corners))


def test_corners_on_a_straight_side_are_no_trouble():
    corners = np.array(
        [(0, 0), (0.2, 0), (0.4, 0), (0.4, 0.4), (0.2, 0.2), (0.1, 0.1), (0, 0.4), (0, 0.1)]
    )
    require_pieces(corners, convex_pieces(corners))
