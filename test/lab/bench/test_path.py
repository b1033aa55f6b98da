import numpy as np
import pytest

from omniman_ros.core.parameters import build
from omniman_ros.lab.bench import path as bench_path
from omniman_ros.motion.path.parameters import PathParameters
from omniman_ros.robots import load_robot


def test_plain_resampling_is_at_constant_speed():
    steps = np.diff(bench_path.resampled(bench_path.spiral(1000), 0.5), axis=0)
    # Chords at the corners are slightly shorter than the path.
    assert np.hypot(*steps.T[:2]) == pytest.approx(0.004, rel=0.01)


def test_planning_is_compared_with_plain_resampling(monkeypatch):
    monkeypatch.setattr(bench_path, "COUNTS", (2, 20))
    figures = bench_path.planning(build(PathParameters, load_robot("omniman")), 1)
    assert set(figures) == {"2", "20"}
    for row in figures.values():
        assert row["planning_ms"] > row["plain_resampling_ms"] > 0.0
        assert 1.0 < row["duration_ratio"] == row["duration_s"] / row["bound_s"] < 1.2
