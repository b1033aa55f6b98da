"""`omniman reproduce odometry`."""

from omniman_ros.lab.reproduce.odometry import report

DRIVE = {
    "about": "PI velocity loops",
    "roller_lag_s": 0.0,
    "sample": 0,
    "largest_mm": 40.0,
    "wheels": {"end_mm": 25.0, "heading_mrad": -30.0},
    "imu": {"end_mm": 5.0, "heading_mrad": 1.0},
}


def test_an_aim_that_is_missed_is_reported_as_missed():
    aims = {"wheels": False, "imu": True}
    calibration = {"odometry.scale_y": 0.986}
    result = {"drives": [DRIVE], "aims": aims, "calibration": calibration, "aim_mm": 20.0}
    *_, wheels, imu = report(result)
    assert "wheels alone: 25 to 25 mm" in wheels and "MISSED" in wheels
    assert "imu: 5 to 5 mm" in imu and "MISSED" not in imu
