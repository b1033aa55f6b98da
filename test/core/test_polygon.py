import math

import numpy as np
import pytest

from omniman_ros.core.polygon import is_simple, signed_area, trapezoids
from test.outlines import FORKS, OCTAGON


def star(rng, count):
    """Return a polygon around the origin, convex or not, counter-clockwise."""
    angles = math.tau / count * (np.arange(count) + rng.uniform(0.0, 0.8, count))
    return rng.uniform(0.1, 0.5, (count, 1)) * np.column_stack((np.cos(angles), np.sin(angles)))


def crossings(corners):
    """Return whether two sides cross, each of them cut into many points."""
    count = len(corners)
    for i in range(count):
        for j in range(i):
            a, b = corners[i], corners[(i + 1) % count] - corners[i]
            c, d = corners[j], corners[(j + 1) % count] - corners[j]
            matrix = np.column_stack((b, -d))
            if (i - j) % count in (1, count - 1) or abs(np.linalg.det(matrix)) < 1e-12:
                continue
            s, t = np.linalg.solve(matrix, c - a)
            if 0.0 <= s <= 1.0 and 0.0 <= t <= 1.0:
                return True
    return False


def test_the_sign_of_the_area_tells_the_order_of_the_corners():
    square = np.array([(0.0, 0.0), (2.0, 0.0), (2.0, 2.0), (0.0, 2.0)])
    assert signed_area(square) == pytest.approx(4.0)
    assert signed_area(square[::-1]) == pytest.approx(-4.0)
    assert signed_area(np.array(OCTAGON)) == pytest.approx(0.7 - 2.0 * 0.15**2)


@pytest.mark.parametrize("outline", [OCTAGON, FORKS])
def test_outlines_are_simple_in_both_orders(outline):
    corners = np.array(outline)
    assert is_simple(corners) and is_simple(corners[::-1])


def test_random_polygons_are_simple_unless_two_sides_cross():
    rng = np.random.default_rng(1)
    found = []
    for _ in range(200):
        corners = rng.uniform(-1.0, 1.0, (rng.integers(3, 7), 2))
        found.append(is_simple(corners))
        assert found[-1] is not crossings(corners)
    assert 20 < sum(found) < 180, "there are both"


@pytest.mark.parametrize(
    "corners",
    [
        [(0, 0), (1, 0), (1, 0), (0, 1)],
        [(0, 0), (2, 0), (1, 0), (1, 1)],
        [(0, 0), (2, 0), (2, 2), (1, 0), (0, 2)],
        [(0, 0), (3, 0), (3, 2), (2, 2), (2, 0), (1, 0), (1, 2), (0, 2)],
        [(0, 0), (1, 1), (1, 0), (0, 1)],
    ],
    ids=["repeated", "folded back", "touching", "on one line", "crossing"],
)
def test_sides_that_touch_are_not_simple(corners):
    assert not is_simple(np.array(corners, dtype=float))


@pytest.mark.parametrize("count", [4, 5, 9, 20])
def test_trapezoids_have_the_area_and_the_points_of_their_polygon(count):
    rng = np.random.default_rng(count)
    for _ in range(10):
        corners = star(rng, count)
        pieces = trapezoids(corners, [0.05])
        assert all(signed_area(piece) >= 0.0 for piece in pieces)
        assert sum(map(signed_area, pieces)) == pytest.approx(signed_area(corners), abs=1e-5)
        assert not any((piece[:, 0].min() < 0.05 < piece[:, 0].max()) for piece in pieces)
        for piece in pieces:  # a point of the star lies before its rim as seen from the origin
            middle = piece.mean(axis=0)
            towards, end = corners, np.roll(corners, -1, axis=0)
            first = towards[:, 0] * middle[1] - towards[:, 1] * middle[0]
            last = end[:, 0] * middle[1] - end[:, 1] * middle[0]
            k = int(np.flatnonzero((first >= 0.0) & (last <= 0.0))[0])
            side, offset = end[k] - towards[k], middle - towards[k]
            assert side[0] * offset[1] - side[1] * offset[0] >= -1e-9
