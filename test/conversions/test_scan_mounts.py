"""How a scanner may be mounted: upright or upside down, in any direction."""

import math

import numpy as np
import pytest
from sensor_msgs.msg import LaserScan

from omniman_ros.conversions.scans import scan_from_message
from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import Transform

RANGES = [1.0, 2.0, 3.0, 1.5, 2.5]
ANGLE_MIN, INCREMENT = -0.3, 0.4


def turned(axis, angle):
    half = 0.5 * angle
    rotation = [0.0, 0.0, 0.0, math.cos(half)]
    rotation["xyz".index(axis)] = math.sin(half)
    return Transform(rotation=tuple(rotation))


def mounted(yaw, *turns):
    pose = Transform((0.3, -0.2, 0.25)) @ turned("z", yaw)
    for axis, angle in turns:
        pose = pose @ turned(axis, angle)
    return pose


def scan_of(mount):
    message = LaserScan(angle_min=ANGLE_MIN, angle_increment=INCREMENT, ranges=RANGES)
    message.angle_max = ANGLE_MIN + (len(RANGES) - 1) * INCREMENT
    message.range_min, message.range_max = 0.1, 10.0
    return scan_from_message(message, mount, lambda stamp: 0.0)


MOUNTS = {
    "upright": mounted(0.7),
    "turned over its x axis": mounted(0.7, ("x", math.pi)),
    "turned over its y axis": mounted(-2.0, ("y", -math.pi)),
    "as a URDF with 3.14 says": mounted(1.0, ("x", 3.14)),
}


@pytest.mark.parametrize("mount", MOUNTS)
def test_beams_meet_what_they_meet_in_space(mount):
    scan, pose = scan_of(MOUNTS[mount]), MOUNTS[mount].matrix()
    angles = ANGLE_MIN + INCREMENT * np.arange(5)
    beams = np.column_stack((RANGES * np.cos(angles), RANGES * np.sin(angles), np.zeros(5)))
    points = beams @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(scan.local_points(scan.hits), points[:, :2], atol=1e-5)
    assert scan.heights == (0.25, 0.25)


@pytest.mark.parametrize(
    ("turn", "says"),
    [
        (
            ("x", math.radians(3.0)),
            "tilted by 3.0 degrees, expected upright or upside down within",
        ),
        (("y", math.radians(172.0)), "tilted by 172.0 degrees"),
        (("x", math.pi / 2), "tilted by 90.0 degrees"),
    ],
)
def test_a_tilted_scanner_is_refused_with_its_tilt(turn, says):
    with pytest.raises(InputError, match=says):
        scan_of(mounted(0.4, turn))
