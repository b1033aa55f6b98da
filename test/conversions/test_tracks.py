"""Changes of the rolling map."""

import numpy as np
import pytest

from omniman_ros.conversions.tracks import changed_cells


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
