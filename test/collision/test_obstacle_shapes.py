"""Obstacles and maps as solids."""

import numpy as np
import pytest

from omniman_ros.collision.obstacle_shapes import ellipse_surroundings, grid_obstacles
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.grid_map import GridMap


def at_height(points):
    return np.stack((points[:, 0], points[:, 1], np.full(len(points), 1.0)))[..., None]


@pytest.mark.parametrize("axes", [(0.5, 0.5), (0.8, 0.2), (0.1, 0.6)])
def test_a_solid_contains_its_ellipse_and_is_not_longer_or_wider(axes):
    ellipses = Ellipses(
        0.0,
        np.array([[1.0, 2.0]]),
        np.array([[0.3, -0.1]]),
        np.array([axes]),
        np.array([0.4]),
        np.zeros(1),
    )
    found = ellipse_surroundings(ellipses)
    phase = np.linspace(0.0, 2.0 * np.pi, 200)
    c, s = np.cos(0.4), np.sin(0.4)
    own = np.column_stack((axes[0] * np.cos(phase), axes[1] * np.sin(phase)))
    rotate = np.array([[c, s], [-s, c]])
    inside = found.obstacles.point_distances(at_height(own @ rotate + (1.0, 2.0)))
    assert inside.max() < 1e-9
    for i in (0, 1):
        tip = np.zeros((1, 2))
        tip[0, i] = axes[i] + 0.1
        outside = found.obstacles.point_distances(at_height(tip @ rotate + (1.0, 2.0)))
        assert outside.max() == pytest.approx(0.1)
    np.testing.assert_allclose(found.velocity[:, 0], (0.3, -0.1))


def test_a_solid_has_the_heights_of_its_obstacle_and_reaches_past_the_robot_without_any():
    ellipses = Ellipses(
        0.0,
        np.zeros((3, 2)),
        np.zeros((3, 2)),
        np.full((3, 2), 0.2),
        np.zeros(3),
        np.zeros(3),
        np.array([-np.inf, 0.6, -0.1]),
        np.array([np.inf, 0.8, 0.1]),
    )
    found = ellipse_surroundings(ellipses)
    np.testing.assert_array_equal(found.obstacles.lower[1:], (0.6, -0.1))
    np.testing.assert_array_equal(found.obstacles.upper[1:], (0.8, 0.1))
    assert found.obstacles.lower[0] < -5.0 < 5.0 < found.obstacles.upper[0] < np.inf
    assert found.within(np.zeros(2), 0.1, 0.0).all()


@pytest.mark.parametrize("seed", range(5))
def test_boxes_cover_exactly_the_occupied_cells(seed):
    rng = np.random.default_rng(seed)
    occupied = rng.random((12, 17)) < 0.4
    grid = GridMap(occupied, 0.1, np.array([0.5, -0.3, 0.6]))
    obstacles = grid_obstacles(grid)
    assert obstacles.half.prod(axis=0).sum() * 4.0 == pytest.approx(0.01 * occupied.sum())
    points = rng.uniform(-2.0, 3.0, (400, 2))
    covered = (obstacles.point_distances(at_height(points)) <= 0.0).any(axis=1)
    np.testing.assert_array_equal(covered, grid.occupied_at(points))


def test_straight_walls_are_one_box_each_and_an_empty_map_is_none():
    room = np.zeros((40, 30), dtype=bool)
    room[0] = room[-1] = True
    room[:, 0] = room[:, -1] = True
    assert len(grid_obstacles(GridMap(room, 0.05, np.zeros(3)))) == 4
    assert len(grid_obstacles(GridMap(np.zeros((3, 3), dtype=bool), 0.05, np.zeros(3)))) == 0
