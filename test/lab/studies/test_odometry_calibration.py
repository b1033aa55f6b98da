import importlib.util

import pytest

from omniman_ros.lab.studies.odometry_calibration import RUNS, calibrate
from omniman_ros.lab.studies.worlds import WorldChoice
from test import robots

IN_WORLD = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="needs mujoco")


def test_a_radius_that_is_wrong_shows_in_all_scales(monkeypatch):
    module = calibrate.__globals__
    monkeypatch.setitem(module, "RUNS", [(*run[:3], 0.1) for run in RUNS])
    values = robots.values("omniman", {"mismatch.radius": (0.99,)})
    scales = calibrate(values, None)
    assert scales == pytest.approx({run[0]: 0.99 for run in RUNS}, abs=1e-3)


@IN_WORLD
@pytest.mark.exhaustive
def test_rollers_lose_some_of_the_way_sideways_and_of_the_rotation():
    values = robots.values("omniman")
    scales = calibrate(values, WorldChoice.of(values, "rollers"))
    assert scales["odometry.scale_x"] == pytest.approx(0.9988, abs=5e-4)
    assert scales["odometry.scale_y"] == pytest.approx(0.986, abs=1e-3)
    assert scales["odometry.scale_yaw"] == pytest.approx(0.992, abs=1e-3)
