"""Convert laser scans and point clouds to scans in one plane."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import LaserScan, PointCloud2, PointField

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.rigid import Transform
from omniman_ros.perception.scan import Scan

SECTORS = 720
"""Number of sectors into which the points of a cloud are sorted."""
MOST_POINTS = 2_000_000
"""Largest number of points accepted in a cloud."""


@dataclass(frozen=True)
class Slice:
    """Part of a point cloud that is converted; points outside of it are ignored.

    Attributes:
        low, high: Lowest and highest height above the floor [m].
        range_max: Longest distance from the sensor [m].
    """

    low: float
    high: float
    range_max: float


def scan_from_message(
    message: LaserScan, mount: Transform, clock: Callable[[Time], float]
) -> Scan:
    """Return the scan of a message, whose stamp is the time of the first beam.

    Args:
        message: The message.
        mount: Pose of the scanner in base_link.
        clock: Converts a stamp to the caller's clock [s].

    Raises:
        InputError: The mount is tilted; see also `Scan`.
    """
    ranges = np.array(message.ranges, dtype=np.float64)
    ranges[ranges < message.range_min] = -math.inf
    height = mount.translation[2]
    return Scan(
        clock(message.header.stamp),
        ranges,
        message.angle_min,
        message.angle_increment,
        message.range_max,
        mount.planar(),
        message.time_increment,
        (height, height),
    )


def scan_from_cloud(
    message: PointCloud2, mount: Transform, clock: Callable[[Time], float], part: Slice
) -> Scan:
    """Return the nearest points of a cloud between two heights, in all directions.

    A direction without a point is unknown: a cloud does not contain the beams that hit nothing.

    Args:
        message: The message.
        mount: Pose of the sensor in base_link; it may be tilted.
        clock: Converts a stamp to the caller's clock [s].
        part: Heights and distances of the points that are converted.

    Raises:
        InputError: The cloud has no coordinates x, y, z of type FLOAT32, or too little data.
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

    Args:
        message: The cloud.
        names: Names of the fields.

    Raises:
        InputError: The cloud lacks one of the fields as FLOAT32, or has too little data.
    """
    offsets = {field.name: field for field in message.fields}
    for name in names:
        field = offsets.get(name)
        if field is None or field.datatype != PointField.FLOAT32:
            raise InputError(f"it has no field '{name}' of type FLOAT32")
        if not 0 <= field.offset <= message.point_step - 4:
            raise InputError(f"field '{name}' has offset {field.offset} in {message.point_step} B")
    count = message.width * message.height
    rows, step = message.height, message.point_step
    if count > MOST_POINTS or message.row_step < message.width * step:
        raise InputError(f"it has {count} points in rows of {message.row_step} B")
    if len(message.data) < rows * message.row_step:
        raise InputError(f"it has {len(message.data)} B, expected {rows * message.row_step}")
    data = np.frombuffer(message.data, dtype=np.uint8)[: rows * message.row_step]
    cells = data.reshape(rows, message.row_step)[:, : message.width * step].reshape(count, step)
    order = ">f4" if message.is_bigendian else "<f4"
    columns = [
        cells[:, offsets[name].offset : offsets[name].offset + 4].copy().view(order)[:, 0]
        for name in names
    ]
    return np.column_stack(columns).astype(np.float64)
