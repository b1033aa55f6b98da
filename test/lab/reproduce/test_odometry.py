"""`omniman reproduce odometry`."""

import importlib.util
import json

import numpy as np
import pytest

from omniman_ros.cli.main import main
from omniman_ros.lab.reproduce.odometry import report, row
from omniman_ros.lab.studies.odometry_drive import OdometryCase, OdometryErrors

IN_WORLD = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="needs mujoco")
CASE = OdometryCase("PI", 0, 0.0, 0)


def result():
    errors = OdometryErrors(np.array([0.015, 0.02, -0.03]), np.array([0.003, 0.004, 0.001]), 0.04)
    aims = {"wheels": False, "imu": True}
    calibration = {"odometry.scale_y": 0.986}
    return {
        "drives": [row(CASE, errors)],
        "aims": aims,
        "calibration": calibration,
        "aim_mm": 20.0,
    }


def test_the_ends_are_distances_with_the_heading_beside_them():
    (drive,) = result()["drives"]
    assert drive["wheels"] == {"end_mm": pytest.approx(25.0), "heading_mrad": pytest.approx(-30.0)}
    assert drive["imu"] == {"end_mm": pytest.approx(5.0), "heading_mrad": pytest.approx(1.0)}


def test_an_aim_that_is_missed_is_reported_as_missed():
    *_, wheels, imu = report(result())
    assert "wheels alone: 25 to 25 mm" in wheels and "MISSED" in wheels
    assert "imu: 5 to 5 mm" in imu and "MISSED" not in imu


@IN_WORLD
@pytest.mark.exhaustive
def test_on_rollers_the_sensor_leaves_no_more_than_its_noise_in_the_heading(tmp_path):
    """At rest for 1.5 s, a noise of 3e-4 rad/s/sqrt(Hz) leaves 0.25 mrad/s of bias, for 30 s."""
    arguments = ["reproduce", "odometry", "--quick", "--world", "--results", str(tmp_path)]
    assert main(arguments) == 0
    found = json.loads((tmp_path / "reproduce_odometry_rollers.json").read_text())
    assert found["calibration"]["odometry.scale_y"] == pytest.approx(0.986, abs=2e-3)
    assert max(abs(drive["imu"]["heading_mrad"]) for drive in found["drives"]) < 25.0
    assert max(drive["imu"]["end_mm"] for drive in found["drives"]) < 40.0
