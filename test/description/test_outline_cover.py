import numpy as np
import pytest

from omniman_ros.core.polygon import signed_area
from omniman_ros.description.outline_cover import outline_cover
from omniman_ros.description.platform_shape import platform_boxes
from test.core.test_polygon import star
from test.outlines import FORKS, OCTAGON, outlined


def within(rows, points):
    """Return whether each point (k, 2) is in one of the rectangles (P, 5)."""
    x, y = (points[:, None, i] - rows[:, i] for i in (0, 1))
    c, s = np.cos(rows[:, 2]), np.sin(rows[:, 2])
    along, across = np.abs(c * x + s * y), np.abs(c * y - s * x)
    return ((along <= rows[:, 3] + 1e-9) & (across <= rows[:, 4] + 1e-9)).any(axis=1)


def inner_points(corners, rng, count=400):
    """Return random points of a polygon around the origin, and points of its sides."""
    sides = np.roll(corners, -1, axis=0) - corners
    k = rng.integers(len(corners), size=count)
    rim = corners[k] + rng.uniform(0.0, 1.0, (count, 1)) * sides[k]
    return np.concatenate((rim, corners))


def area(rows):
    return 4.0 * float((rows[:, 3] * rows[:, 4]).sum())


@pytest.mark.parametrize("most", [1, 2, 4, 12])
def test_every_point_of_an_outline_is_covered(most):
    rng = np.random.default_rng(3)
    for corners in (np.array(OCTAGON), np.array(FORKS), star(rng, 9), star(rng, 14)):
        rows = outline_cover(tuple(map(tuple, corners.tolist())), most)
        assert 1 <= len(rows) <= most
        points = inner_points(corners, rng)
        assert within(rows, points).all()
        # A star around the origin holds what is nearer to it than its sides.
        if corners.shape[0] in (9, 14):
            assert within(rows, points * rng.uniform(0.0, 1.0, (len(points), 1))).all()


def test_more_rectangles_cover_less_that_is_outside():
    sizes = [area(outline_cover(tuple(FORKS), most)) for most in (1, 2, 4, 12)]
    assert sizes == sorted(sizes, reverse=True)
    own = signed_area(np.array(FORKS))
    assert sizes[0] == pytest.approx(0.7)
    assert own <= sizes[2] < 1.06 * own


def test_a_rotated_rectangle_is_one_rectangle():
    c, s = np.cos(0.3), np.sin(0.3)
    corners = np.array([(0.3, 0.1), (-0.3, 0.1), (-0.3, -0.1), (0.3, -0.1)]) @ [[c, s], [-s, c]]
    (row,) = outline_cover(tuple(map(tuple, corners.tolist())), 4)
    np.testing.assert_allclose(row, [0.0, 0.0, 0.3, 0.3, 0.1], atol=1e-9)


def test_a_thin_outline_keeps_a_rectangle_with_a_width():
    row = outline_cover(((0.0, 0.0), (0.5, 0.0), (0.5, 0.01)), 4)[0]
    assert row[3:].min() == pytest.approx(0.02)


def test_boxes_of_the_description_cover_the_outline_at_the_decks_heights():
    parameters = outlined(FORKS)
    boxes = platform_boxes(parameters.robot, parameters.mount.z)
    assert len({(box.centre[2], box.size[2]) for box in boxes}) == 1
    rows = np.array([(*b.centre[:2], b.yaw, 0.5 * b.size[0], 0.5 * b.size[1]) for b in boxes])
    assert within(rows, inner_points(np.array(FORKS), np.random.default_rng(4))).all()
    assert f'rpy="0.0 0.0 {boxes[-1].yaw!r}"' in parameters.urdf
    assert parameters.urdf.count("<collision>") > len(boxes)
