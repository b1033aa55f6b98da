"""`omniman reproduce odometry`."""

import numpy as np
import pytest

from omniman_ros.lab.reproduce.odometry import report, row
from omniman_ros.lab.studies.odometry_drive import OdometryCase, OdometryErrors

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
