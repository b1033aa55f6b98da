import math

import numpy as np
import pytest

from omniman_ros.recording.film.camera import FIELD_OF_VIEW, LEAST_DISTANCE, Camera, fitted_camera

SIZE = (320, 180)
MARGINS = np.array([[16.0, 16.0], [18.0, 12.0]])


def test_what_it_looks_at_is_in_the_middle_and_the_axes_point_right_down_and_away():
    target = np.array([1.0, -2.0, 0.5])
    camera = Camera(target, 0.4, 0.6, 5.0, SIZE)
    right = target + np.array([math.sin(0.4), -math.cos(0.4), 0.0])
    places, depth = camera.project(np.array([target, right, target + [0.0, 0.0, 0.3]]))
    assert places[0] == pytest.approx([160.0, 90.0])
    assert depth[:2] == pytest.approx([5.0, 5.0])
    focal = 160.0 / math.tan(0.5 * FIELD_OF_VIEW)
    assert places[1] == pytest.approx([160.0 + focal / 5.0, 90.0])
    assert places[2, 0] == pytest.approx(160.0)
    assert places[2, 1] < 90.0
    c = math.cos(0.6)
    back = np.array([-c * math.cos(0.4), -c * math.sin(0.4), math.sin(0.6)])
    assert camera.position == pytest.approx(target + 5.0 * back)


@pytest.mark.parametrize("way", [(6.0, 0.5, 0.0), (0.2, 9.0, 1.5), (-3.0, 3.0, 0.3)])
def test_the_camera_shows_all_points_as_near_as_it_can(way):
    points = np.linspace((1.0, 1.0, 0.0), np.array([1.0, 1.0, 0.0]) + way, 20)
    camera = fitted_camera(points, SIZE, MARGINS)
    places, _ = camera.project(points)
    low, high = MARGINS[:, 0], np.array(SIZE) - MARGINS[:, 1]
    assert (places >= low - 0.1).all() and (places <= high + 0.1).all()
    free = np.concatenate((places.min(axis=0) - low, high - places.max(axis=0)))
    assert camera.distance == pytest.approx(LEAST_DISTANCE) or free.min() < 1.0


def test_the_camera_of_a_robot_that_does_not_move_keeps_the_least_distance():
    points = np.array([[2.0, 3.0, 0.0], [2.01, 3.0, 0.1]])
    camera = fitted_camera(points, SIZE, MARGINS)
    assert camera.distance == pytest.approx(LEAST_DISTANCE, rel=1e-6)
    middle = 0.5 * (MARGINS[:, 0] + np.array(SIZE) - MARGINS[:, 1])
    places, _ = camera.project(points)
    assert 0.5 * (places.min(axis=0) + places.max(axis=0)) == pytest.approx(middle, abs=0.1)
