"""The rolling map against the geometry of a room."""

import math

import numpy as np
import pytest

from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.perception.local_map import LocalMap
from omniman_ros.perception.parameters import MapParameters
from omniman_ros.perception.scan import Scan, View, placed

BEAMS = 720
ANGLES = -math.pi + math.tau / BEAMS * np.arange(BEAMS)
SMALL = MapParameters(size=6.0, resolution=0.05)


def room_ranges(half=2.0):
    """Ranges from the middle of a square room."""
    return half / np.maximum(np.abs(np.cos(ANGLES)), np.abs(np.sin(ANGLES)))


def view_of(ranges, pose=(0.0, 0.0, 0.0), **changes):
    scan = Scan(
        0.0, np.asarray(ranges), -math.pi, math.tau / BEAMS, 20.0, (0.0, 0.0, 0.0), **changes
    )
    beams = scan.hits
    positions = placed(scan.local_points(beams), np.tile(pose, (len(beams), 1)))
    return View.of(scan, pose, beams, positions, np.ones(len(beams), dtype=bool)), positions


def enter(grid, ranges, times=1, pose=(0.0, 0.0, 0.0)):
    for _ in range(times):
        view, positions = view_of(ranges, pose)
        grid.update(view, positions, 10.0)


def occupancy(grid, x, y):
    cells = grid.occupancy(np.zeros((0, 2)), np.zeros(0))
    column, row = np.floor((np.array([x, y]) - grid.origin) / grid.resolution).astype(int)
    return int(cells[row, column])


def test_walls_are_occupied_the_room_is_free_and_the_rest_unknown():
    grid = LocalMap(SMALL)
    enter(grid, room_ranges(2.02), 5)
    for y in np.arange(-1.9, 1.9, 0.1):
        assert occupancy(grid, 2.02, y) > 90
        assert occupancy(grid, -2.02, y) > 90
        assert occupancy(grid, 2.2, y) == -1
        assert occupancy(grid, 1.9, y) < 20
    assert grid.stands(np.array([[2.02, 0.3], [0.0, 1.0], [50.0, 0.0]])).tolist() == [
        True,
        False,
        False,
    ]
    assert grid.was_free(np.array([[2.02, 0.3], [0.0, 1.0], [50.0, 0.0]])).tolist() == [
        False,
        True,
        False,
    ]


def test_what_has_gone_is_free_after_a_second_and_what_has_come_is_occupied_at_once():
    grid = LocalMap(SMALL)
    with_post = np.where(np.abs(ANGLES) < 0.1, 1.03, room_ranges())
    enter(grid, room_ranges(), 10)
    assert occupancy(grid, 1.03, 0.0) < 20
    enter(grid, with_post, 4)
    assert occupancy(grid, 1.03, 0.0) > 50
    enter(grid, room_ranges(), 10)
    assert occupancy(grid, 1.03, 0.0) < 50


def test_a_single_lost_beam_clears_nothing():
    grid = LocalMap(SMALL)
    enter(grid, room_ranges(1.02), 5)
    lost = room_ranges(1.02)
    lost[BEAMS // 2 + BEAMS // 8] = math.inf  # along the diagonals of cells
    enter(grid, lost, 10)
    middles = grid.origin[:, None] + grid.resolution * (np.arange(len(grid.log_odds)) + 0.5)
    outside = np.maximum(np.abs(middles[0])[None, :], np.abs(middles[1])[:, None]) > 1.1
    assert not grid.log_odds[outside].any()
    assert occupancy(grid, 1.02, 0.0) > 90


@pytest.mark.parametrize("move", [(1.0, 0.0), (-0.7, 2.3), (30.0, 0.0)])
def test_what_the_map_knows_stays_where_it_is_when_the_map_moves(move):
    grid = LocalMap(SMALL)
    enter(grid, room_ranges(1.52), 5)
    assert grid.follow(np.array(move))
    positions = np.array([[1.52, 0.0], [0.0, 0.5], [-1.52, 0.4]])
    inside = (np.abs(positions - move) < 2.9).all(axis=1)
    assert grid.stands(positions).tolist() == (inside & [True, False, True]).tolist()
    assert grid.was_free(positions).tolist() == (inside & [False, True, False]).tolist()
    assert np.abs(grid.origin + 3.0 - move).max() < 0.06


def test_the_map_stays_while_the_robot_is_near_its_middle():
    grid = LocalMap(SMALL)
    assert not grid.follow(np.array([0.2, -0.2]))


def test_what_moves_is_left_out():
    grid = LocalMap(SMALL)
    enter(grid, np.where(np.abs(ANGLES) < 0.2, 1.0, room_ranges()), 2)
    assert occupancy(grid, 1.01, 0.0) > 50
    cells = grid.occupancy(np.array([[1.2, 0.0]]), np.array([0.25]))
    column, row = np.floor((np.array([1.01, 0.0]) - grid.origin) / grid.resolution).astype(int)
    assert cells[row, column] == 0


def test_one_looks_through_what_has_gone_and_not_through_what_hides_it():
    view, _ = view_of(np.where(np.abs(ANGLES) < 0.3, 1.0, room_ranges()))
    assert view.sees_through(np.array([0.0, 1.2]), 0.25) is True
    assert view.sees_through(np.array([1.5, 0.0]), 0.25) is False
    assert view.sees_through(np.array([0.1, 0.0]), 0.25) is None


def test_where_the_robot_stands_it_is_free_and_a_wall_beside_it_stays():
    grid, parts = LocalMap(SMALL), Rectangles.centred(np.array([0.4, 0.25]))
    wall = np.column_stack([np.full(20, 0.425), np.linspace(-0.3, 0.3, 20)])
    view, _ = view_of(np.full(BEAMS, math.nan))
    for _ in range(3):
        grid.update(view, wall, 10.0)
    for _ in range(30):
        grid.occupy((0.0, 0.0, 0.0), parts, 0.05)
    for x, y in ((0.0, 0.0), (0.38, 0.2), (-0.38, -0.2), (0.0, 0.28), (-0.43, 0.0)):
        assert 0 <= occupancy(grid, x, y) < 50
    assert occupancy(grid, 0.425, 0.0) > 50, "what was seen beside it"
    assert occupancy(grid, -0.48, 0.0) == occupancy(grid, 0.0, 0.33) == -1
    # It covers another area at another pose, and where it was it is free still.
    grid.occupy((1.0, 0.0, 0.5 * math.pi), parts, 0.05)
    assert 0 <= occupancy(grid, 1.0, 0.38) < 50 and occupancy(grid, 1.38, 0.0) == -1
    assert 0 <= occupancy(grid, -0.38, 0.0) < 50
