"""The way out of what the robot touches according to the map."""

import math

import numpy as np
import pytest

from omniman_ros.collision.footprint import Footprint
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.planning.obstacles.environment import Environment
from omniman_ros.planning.obstacles.escape_path import EXIT_GAP, EscapePath
from omniman_ros.planning.obstacles.walls import Walls
from omniman_ros.surroundings.grid_map import GridMap
from test.planning.support import ellipses

HALF = np.array([0.4, 0.25])
WIDE = (-9.0, -9.0, 9.0, 9.0)
CELL = 0.05
ORIGIN = np.array([-3.0, -3.0, 0.0])
AT_ORIGIN = np.zeros(3)


def around(*boxes, known=None):
    """Return a map of 6 x 6 m, occupied in boxes (x0, y0, x1, y1) in odom, and obstacles."""
    cells = np.zeros((120, 120), dtype=bool)
    for box in boxes:
        x0, y0, x1, y1 = np.round((np.array(box) + 3.0) / CELL).astype(int).tolist()
        cells[y0:y1, x0:x1] = True
    grid = GridMap(cells, CELL, ORIGIN)
    known = ellipses() if known is None else known
    walls = Walls(*grid.obstacles())
    return Environment(Footprint(Rectangles.centred(HALF)), known, WIDE, grid, walls)


def way_of(environment, pose=AT_ORIGIN):
    """Return direction [rad] and length [m] of the way out."""
    assert environment.touches(pose)
    way = EscapePath.find(pose, environment)
    assert way is not None and not environment.touches(way.end)
    assert environment.gaps(way.end[None], 0.3)[0] > EXIT_GAP
    x, y = (way.end - way.start)[:2]
    return math.atan2(y, x), math.hypot(x, y)


@pytest.mark.parametrize("heading", [0.0, 0.4])
def test_the_way_out_of_an_area_leads_to_its_free_side_and_not_over_its_boundary(heading):
    half_plane = around((-3.0, -3.0, 0.3, 3.0))
    angle, length = way_of(half_plane, np.array([0.0, 0.0, heading]))
    assert abs(angle) < 0.1
    extent = HALF @ [math.cos(heading), math.sin(heading)]
    assert 0.3 + extent <= length < 0.3 + extent + 0.05


@pytest.mark.parametrize("depth", [0.02, 0.1])
def test_the_way_out_of_a_thin_wall_leads_back(depth):
    angle, length = way_of(around((0.4 - depth, -3.0, 0.45 - depth, 3.0)))
    assert math.cos(angle) < -0.9 and depth <= length < depth + 0.1


@pytest.mark.parametrize("place", [(0.0, 0.0), (0.2, -0.1), (0.35, 0.2)])
@pytest.mark.parametrize("heading", [0.0, 0.7])
def test_a_noisy_cell_under_the_robot_is_left_by_the_shortest_way(place, heading):
    x, y = place
    noisy = around((x, y, x + CELL, y + CELL))
    _, length = way_of(noisy, np.array([0.0, 0.0, heading]))
    assert length < HALF.min() + 2.0 * CELL


def test_a_noisy_cell_under_the_robot_opens_no_way_through_a_wall_that_reaches_under_it():
    wall = (-0.1, -3.0, -0.05, 3.0)
    assert EscapePath.find(AT_ORIGIN, around(wall)) is None
    assert EscapePath.find(AT_ORIGIN, around(wall, (0.1, 0.0, 0.15, 0.05))) is None


@pytest.mark.parametrize("angle", [0.0, 0.5 * math.pi])
def test_a_disc_that_the_robot_overlaps_by_millimetres_is_left_at_once(angle):
    ahead = np.array([math.cos(angle), math.sin(angle)])
    x, y = ahead * (abs(HALF @ ahead) + 0.25 - 0.009)
    out, length = way_of(around(known=ellipses((float(x), float(y), 0.25))))
    assert math.cos(out - angle) < -0.99 and length < 0.05


def test_a_robot_that_is_wholly_inside_has_no_way_out():
    inside = around((-1.5, -1.5, 1.5, 1.5))
    assert inside.touches(AT_ORIGIN)
    assert EscapePath.find(AT_ORIGIN, inside) is None
    assert inside.nearest(AT_ORIGIN) == "the map at (0.00, 0.00) m"


def test_no_way_out_leads_through_what_is_not_touched_yet():
    half_plane = (-3.0, -3.0, 0.3, 3.0)
    assert EscapePath.find(AT_ORIGIN, around(half_plane, (0.6, -3.0, 0.7, 3.0))) is None
    disc = around(half_plane, known=ellipses((0.8, 0.0, 0.25)))
    assert EscapePath.find(AT_ORIGIN, disc) is None


def test_the_way_out_of_an_obstacle_leads_away_from_it():
    angle, length = way_of(around(known=ellipses((0.0, 0.5, 0.3))))
    assert math.sin(angle) < -0.9 and length < 0.15


def test_a_motion_is_on_the_way_out_unless_it_goes_back_aside_or_turns():
    way = EscapePath(AT_ORIGIN, np.array([0.7, 0.0, 0.0]))
    times = np.arange(5.0)
    ahead = 0.1 * times
    for poses, left in (
        (np.column_stack([ahead, 0 * times, 0 * times]), math.inf),
        (np.column_stack([-ahead, 0 * times, 0 * times]), 1.0),
        (np.column_stack([ahead * [1, 1, 1, 0, 0], 0 * times, 0 * times]), 3.0),
        (np.column_stack([ahead, 0.015 * times, 0 * times]), 2.0),
        (np.column_stack([ahead, 0 * times, 0.03 * times]), 2.0),
    ):
        assert way.left_at(times, poses) == left


def test_the_walls_beside_the_way_are_left_out_and_the_others_stay():
    half_plane = around((-3.0, -3.0, 0.3, 3.0), (1.5, -0.5, 1.6, 0.5))
    way = EscapePath.find(AT_ORIGIN, half_plane)
    kept = way.without(half_plane.walls, half_plane.footprint, 0.05)
    at_robot = np.abs(half_plane.walls.centers - [0.275, 0.0]) < [0.01, 0.25]
    assert at_robot.all(axis=1).any()
    assert not (np.abs(kept.centers - [0.275, 0.0]) < [0.01, 0.25]).all(axis=1).any()
    assert (kept.centers[:, 0] > 1.4).sum() == (half_plane.walls.centers[:, 0] > 1.4).sum()


def test_what_is_nearest_is_named_with_its_place():
    things = around((1.0, -0.5, 1.1, 0.5), known=ellipses((0.0, 1.5, 0.3)))
    assert things.nearest(np.array([0.5, 0.0, 0.0])).startswith("the map at (1.0")
    assert things.nearest(np.array([0.0, 1.0, 0.0])) == "the obstacle at (0.00, 1.50) m"
    assert things.nearest(np.array([-8.8, 0.0, 0.0])) == "the workspace's edge"
