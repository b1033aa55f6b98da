"""Convert tracked obstacles and the rolling map to messages."""

from array import array
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Vector3
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.headers import duration_message
from omniman_ros.core.arrays import Array
from omniman_ros.perception.track import TrackedObstacle

NAMESPACE = "tracked"
"""Namespace of the markers."""
SEEN = ColorRGBA(r=0.9, g=0.3, b=0.2, a=0.8)
"""Color of an obstacle that is seen."""
HIDDEN = ColorRGBA(r=0.6, g=0.6, b=0.6, a=0.5)
"""Color of an obstacle that is hidden, where it is expected."""
FIELDS = (
    *("x", "y", "z", "vx", "vy", "radius"),
    *("position_variance", "position_velocity_covariance", "velocity_variance"),
    *("age", "silence", "id"),
)
"""Fields of a point in the cloud of tracks, FLOAT32 each."""


def track_markers(
    obstacles: Iterable[TrackedObstacle],
    gone: Iterable[int],
    frame: str,
    stamp: Time,
    *,
    lifetime: float,
    height: float,
) -> MarkerArray:
    """Return the message of obstacles that everything here reads: upright cylinders.

    Args:
        obstacles: The obstacles.
        gone: Identities of those that are there no longer.
        frame: Name of odom.
        stamp: Time of their places.
        lifetime: Time after which each is forgotten without another message [s].
        height: Height of the cylinders above the floor [m].
    """
    header = Header(stamp=stamp, frame_id=frame)
    markers = [
        Marker(header=header, ns=NAMESPACE, id=number, action=Marker.DELETE) for number in gone
    ]
    duration = duration_message(lifetime)
    for obstacle in obstacles:
        x, y = obstacle.center
        diameter = 2.0 * obstacle.radius
        markers.append(
            Marker(
                header=header,
                ns=NAMESPACE,
                id=obstacle.number,
                type=Marker.CYLINDER,
                action=Marker.ADD,
                lifetime=duration,
                color=HIDDEN if obstacle.silence > 0.0 else SEEN,
                scale=Vector3(x=diameter, y=diameter, z=height),
                pose=Pose(position=Point(x=x, y=y, z=0.5 * height)),
            )
        )
    return MarkerArray(markers=markers)


def track_cloud(obstacles: Sequence[TrackedObstacle], frame: str, stamp: Time) -> PointCloud2:
    """Return all that is known of obstacles, one point for each, with the fields `FIELDS`.

    Args:
        obstacles: The obstacles.
        frame: Name of odom.
        stamp: Time of their places.
    """
    rows = np.array(
        [
            (*o.center, 0.0, *o.velocity, o.radius, *o.covariance, o.age, o.silence, o.number)
            for o in obstacles
        ],
        dtype="<f4",
    ).reshape(-1, len(FIELDS))
    step = 4 * len(FIELDS)
    return PointCloud2(
        header=Header(stamp=stamp, frame_id=frame),
        height=1,
        width=len(rows),
        fields=[
            PointField(name=name, offset=4 * k, datatype=PointField.FLOAT32, count=1)
            for k, name in enumerate(FIELDS)
        ],
        point_step=step,
        row_step=step * len(rows),
        data=array("B", rows.tobytes()),
        is_dense=True,
    )


def grid_message(
    occupancy: NDArray[np.int8], resolution: float, origin: Array, frame: str, stamp: Time
) -> OccupancyGrid:
    """Return the message for a map.

    Args:
        occupancy: (rows along y, columns along x) occupancy [%], -1 where nothing is known.
        resolution: Edge of a cell [m].
        origin: (2,) corner of the first cell [m].
        frame: Name of the frame.
        stamp: Time of the map.
    """
    message = OccupancyGrid(header=Header(stamp=stamp, frame_id=frame))
    info = message.info
    info.map_load_time = stamp
    info.resolution = float(resolution)
    info.height, info.width = occupancy.shape
    info.origin.position.x, info.origin.position.y = origin.tolist()
    info.origin.orientation.w = 1.0
    message.data = array("b", occupancy.tobytes())
    return message


def changed_cells(before: NDArray[np.int8], after: NDArray[np.int8]) -> tuple[slice, slice] | None:
    """Return the rows and columns of the smallest rectangle with all changes; None without any.

    Args:
        before: (rows, columns) occupancy [%].
        after: The same cells later.
    """
    differs = before != after
    rows, columns = np.flatnonzero(differs.any(axis=1)), np.flatnonzero(differs.any(axis=0))
    if not len(rows):
        return None
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def update_message(
    kind: Any, occupancy: NDArray[np.int8], part: tuple[slice, slice], frame: str, stamp: Time
) -> Any:
    """Return the message for a rectangle of a map.

    Args:
        kind: The type, `map_msgs/OccupancyGridUpdate`, which is not installed everywhere.
        occupancy: (rows along y, columns along x) occupancy of the whole map [%].
        part: Rows and columns of the rectangle.
        frame: Name of the map's frame.
        stamp: Time of the map.
    """
    rows, columns = part
    message = kind(header=Header(stamp=stamp, frame_id=frame))
    message.x, message.y = columns.start, rows.start
    message.width, message.height = columns.stop - columns.start, rows.stop - rows.start
    message.data = array("b", occupancy[part].tobytes())
    return message
