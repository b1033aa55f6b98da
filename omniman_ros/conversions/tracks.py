"""Convert tracked obstacles to messages."""

from array import array
from collections.abc import Iterable, Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Vector3
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.headers import duration_message
from omniman_ros.perception.track import TrackedObstacle

NAMESPACE = "tracked"  #: Namespace of the markers
SEEN = ColorRGBA(r=0.9, g=0.3, b=0.2, a=0.8)  #: Color of an obstacle that is seen
#: Color of an obstacle that is hidden, where it is expected
HIDDEN = ColorRGBA(r=0.6, g=0.6, b=0.6, a=0.5)
FIELDS = (
    *("x", "y", "z", "vx", "vy", "radius"),
    *("position_variance", "position_velocity_covariance", "velocity_variance"),
    *("age", "silence", "id"),
)  #: Fields of a point in the cloud of tracks, FLOAT32 each


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

    Their `points` are their velocities and variances; see `marker_changes`.

    Args:
        gone: Identities of those that are there no longer.
        lifetime: Time after which each is forgotten without another message [s].
        height: Height of the cylinders above the floor [m].
    """
    header = Header(stamp=stamp, frame_id=frame)
    markers = [
        Marker(header=header, ns=NAMESPACE, id=number, action=Marker.DELETE) for number in gone
    ]
    duration = duration_message(lifetime)
    for obstacle in obstacles:
        (x, y), (vx, vy), (pp, pv, vv) = obstacle.center, obstacle.velocity, obstacle.covariance
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
                points=[Point(x=vx, y=vy), Point(x=pp, y=pv, z=vv)],
            )
        )
    return MarkerArray(markers=markers)


def track_cloud(obstacles: Sequence[TrackedObstacle], frame: str, stamp: Time) -> PointCloud2:
    """Return all that is known of obstacles, one point for each, with the fields `FIELDS`."""
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
