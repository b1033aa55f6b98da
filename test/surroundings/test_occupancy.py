"""Maps of occupancy, their updates, and what both refuse."""

import dataclasses
import math

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.surroundings.occupancy import (
    MAX_CELLS,
    MapUpdate,
    OccupancyMap,
    cells_of,
    changed_cells,
)

ORIGIN = np.array([1.0, -2.0, 0.5])
ROWS, COLUMNS = 4, 6


def a_map(time=10.0, **changes):
    values = np.arange(ROWS * COLUMNS, dtype=np.int8).reshape(ROWS, COLUMNS)
    given = OccupancyMap(values, 0.1, ORIGIN, "odom", time)
    return dataclasses.replace(given, **changes)


def an_update(time=10.0, **changes):
    given = MapUpdate(np.full((2, 3), 100, np.int8), 1, 2, "odom", time)
    return dataclasses.replace(given, **changes)


def test_a_map_does_not_change_with_the_callers_arrays():
    values, origin = np.zeros((2, 3), np.int8), np.zeros(3)
    some = OccupancyMap(values, 0.1, origin)
    values[0, 0], origin[0] = 100, 5.0
    assert not some.values.any() and not some.origin.any()
    with pytest.raises(ValueError, match="read-only"):
        some.values[0, 0] = 1


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"values": np.zeros((0, 3), np.int8)}, r"shape \(0, 3\)"),
        ({"values": np.zeros(6, np.int8)}, r"shape = \(6,\)"),
        ({"values": np.broadcast_to(np.int8(0), (5001, 5000))}, f"1 to {MAX_CELLS}"),
        ({"resolution": 0.0}, "resolution is 0.0 m"),
        ({"resolution": math.nan}, "resolution = nan"),
        ({"resolution": 1e6}, "map: size"),
        ({"origin": np.zeros(2)}, r"origin\.shape = \(2,\)"),
        ({"origin": np.array([0.0, math.inf, 0.0])}, r"origin\[1\] = inf"),
    ],
)
def test_an_invalid_map_is_refused_with_its_value(changes, named):
    with pytest.raises(InputError, match=named):
        a_map(**changes)


def test_an_update_replaces_its_rectangle_and_the_stamp():
    before = a_map()
    after = before.updated(an_update(time=11.0))
    expected = before.values.copy()
    expected[2:4, 1:4] = 100
    np.testing.assert_array_equal(after.values, expected)
    assert after.time == 11.0 and not after.values.flags.writeable
    assert before.values.max() < 100, "the map before stays"


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"frame": "map"}, "its frame is 'map', that of the map 'odom'"),
        ({"time": 9.75}, "stale, 0.250 s before the map"),
        ({"time": None}, "it is unstamped, and the map that it would change is stamped"),
        ({"column": -1}, r"3 x 2 cells from \(-1, 2\) on"),
        ({"row": -1}, "not inside of a map of 6 x 4"),
        ({"column": COLUMNS - 2}, "not inside"),
        ({"row": ROWS - 1}, "not inside"),
    ],
)
def test_an_update_that_does_not_fit_is_refused(changes, named):
    with pytest.raises(InputError, match=named):
        a_map().updated(an_update(**changes))


@pytest.mark.parametrize("time", [None, 3.0])
def test_an_unstamped_map_takes_every_update(time):
    assert a_map(time=None).updated(an_update(time=time)).time == time


def test_the_cells_of_a_message_are_row_by_row():
    data = np.array([1, 2, 3, 4, 5, 6], np.int8)
    assert cells_of(data, 3, 2).tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("count", "width", "height"),
    [(6, 3, 3), (6, -3, -2), (0, 0, 5), (0, 5, 0), (0, np.uint32(65536), np.uint32(65536))],
)
def test_a_number_of_cells_that_does_not_fit_is_refused(count, width, height):
    with pytest.raises(InputError, match=f"there are {count} cells, expected {width} x {height}"):
        cells_of(np.zeros(count, np.int8), width, height)


@pytest.mark.parametrize("seed", range(20))
def test_the_changed_rectangle_is_the_smallest_that_makes_the_old_map_the_new_one(seed):
    rng = np.random.default_rng(seed)
    before = rng.integers(-1, 101, (12, 9), dtype=np.int8)
    after = before.copy()
    cells = np.column_stack([rng.integers(0, size, 3) for size in before.shape])
    after[tuple(cells.T)] = (after[tuple(cells.T)] + 5) % 100
    part = changed_cells(before, after)
    assert [each.start for each in part] == cells.min(axis=0).tolist()
    assert [each.stop for each in part] == (cells.max(axis=0) + 1).tolist()
    before[part] = after[part]
    np.testing.assert_array_equal(before, after)
    assert changed_cells(before, after) is None
