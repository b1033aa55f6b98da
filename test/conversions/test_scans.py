"""Scans and clouds: what drivers fill in, and messages that contradict themselves."""

import math
from array import array

import numpy as np
import pytest

from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import Transform

pytest.importorskip("rclpy")
from sensor_msgs.msg import LaserScan, PointCloud2, PointField

from omniman_ros.conversions.scans import cloud_points, scan_from_message

BEAMS = 360
STEP = math.tau / BEAMS


def scan(**changes):
    """A whole turn whose driver counts as many gaps as beams, and knows no times."""
    given = {
        "angle_max": math.tau,
        "angle_increment": STEP,
        "range_min": 0.1,
        "range_max": 10.0,
        "ranges": array("f", [1.0] * BEAMS),
    }
    message = LaserScan(**(given | changes))
    return scan_from_message(message, Transform(), lambda stamp: 0.0)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"angle_max": math.tau - STEP},
        {"angle_min": math.pi, "angle_max": -math.pi, "angle_increment": -STEP},
        {"intensities": array("f", [7.0] * BEAMS)},
        {"scan_time": 0.1, "time_increment": 0.1 / (BEAMS - 1)},
        {"scan_time": 0.001},
        {"time_increment": 0.1 / BEAMS},
    ],
)
def test_scans_as_drivers_fill_them_in_are_used(changes):
    assert len(scan(**changes).hits) == BEAMS


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        (
            {"angle_min": -1.57, "angle_max": 1.57, "angle_increment": -3.14 / (BEAMS - 1)},
            r"end at -4\.7100 rad, but angle_max is 1\.5700 rad",
        ),
        ({"angle_max": math.pi}, "360 beams from 0.0000 rad on"),
        ({"angle_max": math.tau + STEP}, "angle_max is 6.3"),
        ({"angle_max": math.nan}, "angle_max is nan"),
        ({"ranges": array("f", [1.0] * (BEAMS - 2))}, "358 beams"),
        ({"intensities": array("f", [7.0])}, "1 intensities for 360 ranges"),
        ({"range_min": 12.0}, "range_min 12 m is not up to range_max 10 m"),
        ({"range_min": math.nan}, "range_min nan m"),
        ({"scan_time": 0.1, "time_increment": 0.001}, "take 0.359 s, but scan_time is 0.1 s"),
    ],
)
def test_a_scan_that_contradicts_itself_is_refused_and_says_where(changes, why):
    with pytest.raises(InputError, match=why):
        scan(**changes)


def cloud(offsets=(0, 4, 8), names="xyz", **changes):
    message = PointCloud2(height=1, width=2, point_step=12, row_step=24)
    message.fields = [
        PointField(name=name, offset=offset, datatype=PointField.FLOAT32, count=1)
        for name, offset in zip(names, offsets, strict=True)
    ]
    message.data = array("B", np.arange(6, dtype="<f4").tobytes())
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def test_a_cloud_is_read_by_its_fields():
    np.testing.assert_array_equal(cloud_points(cloud()), [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]])


@pytest.mark.parametrize(
    ("message", "why"),
    [
        (cloud(data=array("B", bytes(36))), "36 B, expected 24"),
        (cloud(data=array("B", bytes(12))), "12 B, expected 24"),
        (cloud(row_step=12), "2 points in rows of 12 B"),
        (cloud(offsets=(0, 0, 8)), "overlap"),
        (cloud(offsets=(0, 6, 8)), "overlap"),
        (cloud(offsets=(0, 4, 8, 8), names="xyzz"), "a field is repeated"),
        (cloud(offsets=(0, 4, 9)), "offset 9 in 12 B"),
    ],
)
def test_a_cloud_that_contradicts_itself_is_refused_and_says_where(message, why):
    with pytest.raises(InputError, match=why):
        cloud_points(message)
