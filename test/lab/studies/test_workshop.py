import math

import numpy as np
import pytest

from omniman_ros.lab.studies.recorded_drive import wall_gaps
from omniman_ros.lab.studies.workshop import (
    AREA,
    DOOR_WIDTH,
    RESOLUTION,
    grid,
    walls,
    workshop,
)
from omniman_ros.planning.obstacles.grid_map import GridMap
from omniman_ros.robots import load_robot
from test import robots

IG42 = load_robot("ig42")
BODY = robots.robot("ig42").body
HALF = 0.5 * np.array([BODY.length, BODY.width])


def cell(x, y):
    return int((y - AREA[1]) / RESOLUTION), int((x - AREA[0]) / RESOLUTION)


def test_map_shows_every_wall_and_leaves_the_doors_open():
    occupied = grid().occupied
    for wall in walls():
        along = np.array([math.cos(wall.heading), math.sin(wall.heading)])
        for share in np.linspace(-0.49, 0.49, 23):
            assert occupied[cell(*(np.array([wall.x, wall.y]) + share * wall.length * along))]
    for x, y in ((3.05, 4.4), (6.55, 0.2), (9.4, 2.85)):
        assert not occupied[cell(x, y)]
    assert 0.05 < occupied.mean() < 0.2


def test_robot_fits_through_the_doors_lengthwise_only():
    for x, y, heading in ((3.05, 4.4, 0.0), (6.55, 0.2, 0.0), (9.4, 2.85, math.pi / 2)):
        through, across = np.array([[x, y, heading]]), np.array([[x, y, heading + math.pi / 2]])
        assert wall_gaps(through, HALF, walls())[0] == pytest.approx(0.5 * DOOR_WIDTH - HALF[1])
        assert wall_gaps(across, HALF, walls())[0] < 0.0


def test_start_and_goal_are_free_and_the_start_is_a_dead_end():
    scene = workshop()
    ends = np.array([scene.start, scene.goal])
    assert wall_gaps(ends, HALF, scene.walls).min() > 0.2
    ahead = np.linspace(scene.start, (scene.goal[0], 0.0, 0.0), 200)
    assert wall_gaps(ahead, HALF, scene.walls).min() < 0.0
    assert isinstance(scene.grid, GridMap)
