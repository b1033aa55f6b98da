import numpy as np
import pytest

from omniman_ros.recording.film import rasterizer
from omniman_ros.recording.film.rasterizer import Rasterizer

BLACK = np.zeros((40, 60, 3), np.uint8)
RED, GREEN = np.array([[255, 0, 0]], np.uint8), np.array([[0, 255, 0]], np.uint8)


def inside(corners, shape):
    """Return which pixels' centres lie in a triangle, by the signs of the cross products."""
    rows, columns = np.mgrid[: shape[0], : shape[1]] + 0.5
    signs = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        signs.append((b[0] - a[0]) * (rows - a[1]) - (b[1] - a[1]) * (columns - a[0]))
    return (np.array(signs) >= 0.0).all(axis=0) | (np.array(signs) <= 0.0).all(axis=0)


def test_the_pixels_are_drawn_whose_centres_are_inside():
    random = np.random.default_rng(1)
    drawn = 0
    for corners in random.uniform((-20.0, -15.0), (80.0, 55.0), (100, 3, 2)):
        raster = Rasterizer(BLACK)
        raster.draw(corners[None], np.ones((1, 3)), RED)
        expected = inside(corners, BLACK.shape)
        assert np.array_equal(raster.image[..., 0] == 255, expected)
        drawn += expected.sum()
    assert drawn > 10_000


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
@pytest.mark.parametrize("pixels", [rasterizer.PIXELS, 7])
def test_of_two_triangles_that_cross_the_nearer_one_is_seen(order, pixels, monkeypatch):
    monkeypatch.setattr(rasterizer, "PIXELS", pixels)
    shape = [(-1.0, -1.0), (120.0, -1.0), (-1.0, 80.0)]
    corners = np.array([shape, shape])
    # One of them is equally near everywhere; the other one is nearer from column 30 on.
    at = [1.0 + 0.01 * (x - 30.0) for x, _ in shape]
    nearness = np.array([[1.0, 1.0, 1.0], at])
    colours = np.concatenate((RED, GREEN))
    raster = Rasterizer(BLACK)
    chosen = list(order)
    raster.draw(corners[chosen], nearness[chosen], colours[chosen])
    assert (raster.image[:, :30] == RED[0]).all()
    assert (raster.image[:, 30:] == GREEN[0]).all()


def test_what_was_drawn_before_stays_in_front_if_it_is_nearer():
    corners = np.array([[(-1.0, -1.0), (120.0, -1.0), (-1.0, 80.0)]])
    raster = Rasterizer(BLACK)
    raster.draw(corners, np.full((1, 3), 0.5), RED)
    raster.draw(corners, np.full((1, 3), 0.4), GREEN)
    assert (raster.image == RED[0]).all()
    raster.draw(corners, np.full((1, 3), 0.6), GREEN)
    assert (raster.image == GREEN[0]).all()


def test_triangles_without_area_or_outside_of_the_image_leave_it_as_it_is():
    corners = np.array(
        [
            [(1.0, 1.0), (20.0, 20.0), (30.0, 30.0)],
            [(-9.0, 1.0), (-1.0, 1.0), (-5.0, 30.0)],
            [(1.0, 50.0), (50.0, 50.0), (20.0, 70.0)],
            [(5.1, 5.1), (5.4, 5.1), (5.1, 5.4)],
        ]
    )
    raster = Rasterizer(BLACK)
    raster.draw(corners, np.ones((4, 3)), np.repeat(RED, 4, axis=0))
    raster.draw(corners[:0], np.ones((0, 3)), RED[:0])
    assert not raster.image.any()
