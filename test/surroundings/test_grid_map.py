import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.surroundings.grid_map import MAX_CELLS, GridMap
from omniman_ros.surroundings.occupancy import OccupancyMap

ORIGIN = np.array([1.0, -2.0, 0.5])


def grid(*rows, resolution=0.1, origin=(0.0, 0, 0)):
    """Return a map drawn with # for occupied cells, the last row at the top."""
    cells = np.array([[cell == "#" for cell in row] for row in reversed(rows)])
    return GridMap(cells, resolution, np.array(origin, float))


def read(*rows, **more):
    return GridMap.of_occupancy(OccupancyMap(np.array(rows, np.int8), 0.1, ORIGIN), **more)


def test_rows_run_along_y_and_columns_along_x():
    centers, radius = grid("..#", "...").obstacles()
    np.testing.assert_allclose(centers, [[0.25, 0.15]])
    assert radius == pytest.approx(0.1 / math.sqrt(2))


def test_discs_are_placed_by_the_origin_and_its_yaw():
    centers, _ = grid("..#", "...", origin=ORIGIN).obstacles()
    c, s = math.cos(0.5), math.sin(0.5)
    np.testing.assert_allclose(
        centers, [[1 + 0.25 * c - 0.15 * s, -2 + 0.25 * s + 0.15 * c]], atol=1e-12
    )


def test_only_cells_with_a_free_neighbour_become_discs_and_outside_is_free():
    whole = grid(*["#####"] * 5)
    assert len(whole.obstacles()[0]) == 16
    inner = grid(".......", *[".#####."] * 5, ".......")
    assert len(inner.obstacles()[0]) == 16
    # The middle cell has no free neighbour at an edge, but one at a corner.
    corner = grid("##.", "###", "###")
    assert [0.15, 0.15] in corner.obstacles()[0].round(9).tolist()


def test_discs_tightly_cover_the_boundary_cells():
    rng = np.random.default_rng(1)
    cells = rng.random((12, 15)) < 0.4
    some = GridMap(cells, 0.05, ORIGIN)
    centers, radius = some.obstacles()
    points = ORIGIN[:2] + rng.uniform(-0.3, 1.0, (4000, 2))
    gaps = np.hypot(*(points[:, None] - centers).T).min(axis=0) - radius
    taken = some.occupied_at(points)
    free_around = ~some._within()
    alone = GridMap(cells & free_around, 0.05, ORIGIN).occupied_at(points)
    assert alone.sum() > 300
    assert (gaps[alone] <= 1e-12).all()
    assert (gaps[~taken] >= -0.5 * (math.sqrt(2) - 1) * 0.05 - 1e-12).all()


def test_occupied_at_reads_the_cell_under_a_point():
    cells = np.random.default_rng(2).random((7, 9)) < 0.5
    some = GridMap(cells, 0.2, ORIGIN)
    rows, columns = np.mgrid[-1:8, -1:10]
    own = 0.2 * (np.stack([columns.ravel(), rows.ravel()], axis=1) + 0.5)
    c, s = math.cos(0.5), math.sin(0.5)
    points = ORIGIN[:2] + own @ np.array([[c, s], [-s, c]])
    expected = np.pad(cells, 1)  # free outside the map
    np.testing.assert_array_equal(some.occupied_at(points), expected.ravel())


def test_ellipses_are_the_discs_at_rest():
    some = grid("#.#", "...")
    known = some.ellipses(3.0)
    assert known.time == 3.0
    assert len(known) == 2
    np.testing.assert_array_equal(known.centers, some.obstacles()[0])
    np.testing.assert_array_equal(known.semi_axes, some.radius)
    assert not known.velocities.any() and not known.growth.any()


def test_map_without_obstacles_has_no_discs():
    assert grid("...", "...").obstacles()[0].shape == (0, 2)


def test_map_is_immutable():
    cells, origin = np.zeros((2, 3), dtype=bool), np.zeros(3)
    some = GridMap(cells, 0.1, origin)
    cells[0, 0], origin[0] = True, 5.0
    assert not some.occupied.any() and not some.origin.any()
    with pytest.raises(ValueError):
        some.occupied[0, 0] = True


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"occupied": np.zeros(4, dtype=bool)}, r"\(4,\)"),
        ({"occupied": np.zeros((0, 4), dtype=bool)}, r"\(0, 4\)"),
        ({"occupied": np.zeros((5001, 5000), dtype=bool)}, r"\(5001, 5000\)"),
        ({"resolution": 0.004}, "0.004"),
        ({"resolution": 1.1}, "1.1"),
        ({"resolution": math.nan}, "nan"),
        ({"origin": np.zeros(2)}, r"\(2,\)"),
        ({"origin": np.array([0, math.inf, 0])}, "inf"),
        ({"origin": np.array([0, 0, math.nan])}, "nan"),
    ],
)
def test_invalid_map_is_refused_with_its_value(changes, named):
    fine = {"occupied": np.zeros((2, 2), dtype=bool), "resolution": 0.1, "origin": np.zeros(3)}
    with pytest.raises(InputError, match=named):
        GridMap(**{**fine, **changes})


def test_largest_map_is_accepted():
    assert GridMap(np.zeros((5000, 5000), dtype=bool), 0.05, np.zeros(3)).occupied.size == (
        MAX_CELLS
    )


def test_cells_are_occupied_from_the_threshold():
    some = read([0, 49, 50], [100, 51, 10])
    np.testing.assert_array_equal(some.occupied, [[False, False, True], [True, True, False]])
    np.testing.assert_array_equal(some.origin, ORIGIN)


def test_threshold_and_meaning_of_unknown_cells_are_configurable():
    some = read([0, 49, 50], [100, -1, 10], threshold=10)
    np.testing.assert_array_equal(some.occupied, [[False, True, True], [True, False, True]])
    some = read([0, 49, 50], [100, -1, 10], threshold=10, unknown_is_free=False)
    np.testing.assert_array_equal(some.occupied, [[False, True, True], [True, True, True]])


@pytest.mark.parametrize(
    ("value", "more", "named"),
    [
        (101, {}, "101"),
        (-2, {}, "-2"),
        (1, {"threshold": 0}, "threshold is 0"),
        (1, {"threshold": 101}, "threshold is 101"),
    ],
)
def test_an_invalid_cell_or_threshold_is_refused_with_its_value(value, more, named):
    with pytest.raises(InputError, match=named):
        read([0, value], **more)


def test_a_displaced_map_is_the_map_seen_from_another_frame():
    cells = np.random.default_rng(5).random((20, 30)) < 0.3
    some = GridMap(cells, 0.1, np.array([1.0, -2.0, 0.4]))
    frame = (0.5, 3.0, 2.0)
    moved = some.displaced(frame)
    c, s = math.cos(2.0), math.sin(2.0)
    turn = np.array([[c, -s], [s, c]])
    assert moved.obstacles()[0] == pytest.approx(some.obstacles()[0] @ turn.T + frame[:2])
    points = np.random.default_rng(6).uniform(-4, 4, (500, 2))
    found = moved.occupied_at(points @ turn.T + frame[:2])
    assert (found == some.occupied_at(points)).mean() > 0.995  # all but some on the edges


def test_a_map_does_not_change_with_the_callers_array():
    cells = np.zeros((3, 3), dtype=bool)
    some = GridMap(cells, 0.1, np.zeros(3))
    cells[1, 1] = True
    assert not some.occupied.any()
