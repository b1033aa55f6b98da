"""Convert laser scans and point clouds to scans in one plane."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import LaserScan, PointCloud2, PointField

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import TILT_TOLERANCE, UPSIDE_DOWN, PlanarPose, Transform
from omniman_ros.perception.no_return import REP_117, rep117_ranges
from omniman_ros.perception.scan import Scan

SECTORS = 720  #: Number of sectors into which the points of a cloud are sorted
MOST_POINTS = 2_000_000  #: Largest number of points accepted in a cloud
#: Increments by which `angle_max` may be off: many drivers count a gap more than there are
END_SLACK = 1.5
SCAN_TIME_SLACK = 1.5  #: Fraction of `scan_time` that all beams together may take


@dataclass(frozen=True)
class Slice:
    """Part of a point cloud that is converted; points outside of it are ignored.

    Attributes:
        low, high: Lowest and highest height above the floor [m].
    """

    low: float
    high: float
    range_max: float  #: Longest distance from the sensor [m]


def scan_from_message(
    message: LaserScan,
    mount: Transform,
    clock: Callable[[Time], float],
    no_return: str = REP_117,
) -> Scan:
    """Return the scan of a message, whose stamp is the time of the first beam.

    Args:
        mount: Pose of the scanner in base_link, upright or upside down.
        clock: Converts a stamp to the caller's clock [s].
        no_return: What the scanner sends where a beam meets nothing, see `no_return.NO_RETURN`.

    Raises:
        InputError: The mount is tilted, or the message contradicts itself; see also `Scan`.
    """
    _demand_consistent(message)
    ranges = np.array(message.ranges, dtype=np.float64)
    pose, sense = _plane(mount)
    height = mount.translation[2]
    return Scan(
        clock(message.header.stamp),
        rep117_ranges(ranges, message.range_min, message.range_max, no_return),
        sense * message.angle_min,
        sense * message.angle_increment,
        message.range_max,
        pose,
        message.time_increment,
        (height, height),
    )


def _plane(mount: Transform) -> tuple[PlanarPose, float]:
    """Return the pose of a scanner on the floor, and the sense of its angles seen from above.

    The angles of one that hangs upside down, by a half turn about any axis in its plane, grow to
    the right: their sense is -1.
    """
    x, y, up = mount.rotated((0.0, 0.0, 1.0))
    slope = math.hypot(x, y)
    if not slope <= TILT_TOLERANCE:
        tilt, tolerance = math.atan2(slope, up), math.asin(TILT_TOLERANCE)
        raise InputError(
            f"the scanner is tilted by {math.degrees(tilt):.1f} degrees, expected upright or "
            f"upside down within {math.degrees(tolerance):.1f} degrees"
        )
    if up > 0.0:
        return mount.planar(), 1.0
    return (mount @ UPSIDE_DOWN).planar(), -1.0


def _demand_consistent(message: LaserScan) -> None:
    """Check that what a scan states twice agrees; times that are 0 are not known.

    Raises:
        InputError: Angles and number of beams, the numbers of ranges and intensities, the shortest
            and the longest range, or the times contradict each other.
    """
    count, increment = len(message.ranges), message.angle_increment
    gaps = count - 1
    end = message.angle_min + gaps * increment
    if not abs(message.angle_max - end) <= END_SLACK * abs(increment):
        raise InputError(
            f"{count} beams from {message.angle_min:.4f} rad on, {increment:.4g} rad apart, "
            f"end at {end:.4f} rad, but angle_max is {message.angle_max:.4f} rad"
        )
    if len(message.intensities) not in (0, count):
        raise InputError(f"there are {len(message.intensities)} intensities for {count} ranges")
    if not message.range_min <= message.range_max:
        raise InputError(
            f"range_min {message.range_min:.4g} m is not up to range_max {message.range_max:.4g} m"
        )
    duration = gaps * message.time_increment
    if duration > SCAN_TIME_SLACK * message.scan_time > 0.0:
        raise InputError(
            f"{count} beams, {message.time_increment:.4g} s apart, take {duration:.4g} s, but "
            f"scan_time is {message.scan_time:.4g} s"
        )


def scan_from_cloud(
    message: PointCloud2, mount: Transform, clock: Callable[[Time], float], part: Slice
) -> Scan:
    """Return the nearest points of a cloud between two heights, in all directions.

    A direction without a point is unknown: a cloud does not contain the beams that hit nothing.

    Args:
        mount: Pose of the sensor in base_link; it may be tilted.
        clock: Converts a stamp to the caller's clock [s].
        part: Heights and distances of the points that are converted.

    Raises:
        InputError: The cloud has no coordinates x, y, z of type FLOAT32; see also
            `cloud_fields`.
    """
    points = cloud_points(message)
    points = points[np.isfinite(points).all(axis=1)]
    matrix = mount.matrix()
    places = points @ matrix[:3, :3].T + matrix[:3, 3]
    places = places[(places[:, 2] >= part.low) & (places[:, 2] <= part.high)]
    away = places[:, :2] - matrix[:2, 3]
    distances = np.hypot(away[:, 0], away[:, 1])
    is_near = (distances > 0.0) & (distances <= part.range_max)
    away, distances = away[is_near], distances[is_near]
    sector = math.tau / SECTORS
    index = ((np.arctan2(away[:, 1], away[:, 0]) + math.pi) / sector).astype(np.intp) % SECTORS
    ranges = np.full(SECTORS, math.inf)
    np.minimum.at(ranges, index, distances)
    ranges[np.isinf(ranges)] = math.nan
    x, y, _ = mount.translation
    return Scan(
        clock(message.header.stamp),
        ranges,
        -math.pi + 0.5 * sector,
        sector,
        part.range_max,
        (x, y, 0.0),
        heights=(part.low, part.high),
    )


def cloud_points(message: PointCloud2) -> Array:
    """Return the coordinates (N, 3) of the points of a cloud in its frame [m].

    Raises:
        InputError: See `scan_from_cloud`.
    """
    return cloud_fields(message, ("x", "y", "z"))


def cloud_fields(message: PointCloud2, names: Sequence[str]) -> Array:
    """Return fields of the points of a cloud as columns (N, number of names).

    Raises:
        InputError: The cloud lacks one of the fields as FLOAT32, has it twice or in the place of
            another one, or its sizes contradict each other.
    """
    repeated = {field.name for field in message.fields if field.name in names}
    if sum(field.name in names for field in message.fields) > len(repeated):
        raise InputError(f"a field is repeated among {[field.name for field in message.fields]}")
    offsets = {field.name: field for field in message.fields}
    for name in names:
        field = offsets.get(name)
        if field is None or field.datatype != PointField.FLOAT32:
            raise InputError(f"it has no field '{name}' of type FLOAT32")
        if field.count > 1:
            raise InputError(f"field '{name}' has {field.count} numbers, expected 1")
        if not 0 <= field.offset <= message.point_step - 4:
            raise InputError(f"field '{name}' has offset {field.offset} in {message.point_step} B")
    places = sorted(offsets[name].offset for name in names)
    if any(after - before < 4 for before, after in pairwise(places)):
        raise InputError(f"its fields overlap: they have offsets {places}")
    count = message.width * message.height
    rows, step = message.height, message.point_step
    if count > MOST_POINTS or message.row_step < message.width * step:
        raise InputError(f"it has {count} points in rows of {message.row_step} B")
    if len(message.data) != rows * message.row_step:
        raise InputError(f"it has {len(message.data)} B, expected {rows * message.row_step}")
    data = np.frombuffer(message.data, dtype=np.uint8)[: rows * message.row_step]
    cells = data.reshape(rows, message.row_step)[:, : message.width * step].reshape(count, step)
    order = ">f4" if message.is_bigendian else "<f4"
    columns = [
        cells[:, offsets[name].offset : offsets[name].offset + 4].copy().view(order)[:, 0]
        for name in names
    ]
    return np.column_stack(columns).astype(np.float64)
