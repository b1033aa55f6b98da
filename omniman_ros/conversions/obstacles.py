"""Convert markers of obstacles to observations, and predicted obstacles to markers."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Pose, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.conversions.geometry import quaternion_from_yaw, yaw_from_quaternion
from omniman_ros.conversions.headers import time_seconds
from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.transform_tree import Placement
from omniman_ros.surroundings.ellipses import Ellipses
from omniman_ros.surroundings.obstacles import Observation


@dataclass(frozen=True)
class MarkerDeletion:
    """A request to delete one marker, all markers of a namespace, or all markers."""

    #: Namespace of the markers; if it is empty and `number` is None, every namespace
    namespace: str
    number: int | None = None  #: Number of the marker, or None if all of the namespace are deleted


def marker_changes(
    message: MarkerArray, place: Callable[[Header], Placement], clock: Callable[[Time], float]
) -> tuple[list[Observation | MarkerDeletion], list[str]]:
    """Return the changes that markers make to the obstacles, in order, and the complaints.

    A CYLINDER or a SPHERE is an ellipse whose diameters along its own x and y are its scale. It
    extends by half of its scale's z above and below its position; if that is 0, its height is
    unknown, and it has no ends.
    One `point`, where there is one, is the velocity over the ground along the axes of its frame
    [m/s], from a source that tracks it. A second one has the variances of each component of
    position (x) [m^2] and velocity (z) [m^2/s^2], and their covariance (y) [m^2/s].
    ADD (and MODIFY) places it, DELETE removes it, and DELETEALL removes all of its namespace, or
    all obstacles if it has no namespace. The frame and type of a deletion are ignored.

    Args:
        place: Returns where the coordinates under a header are; an InputError that it raises
            becomes a complaint.
        clock: Converts a stamp to the caller's clock [s]; a zero stamp means now. An InputError
            that it raises becomes a complaint.

    Returns:
        Observations and deletions; and one complaint for each marker that was left out, with its
        namespace and number, the reason, and the value.
    """
    changes: list[Observation | MarkerDeletion] = []
    complaints: list[str] = []
    for marker in message.markers:
        try:
            if marker.action == Marker.ADD:
                changes.append(_observation(marker, place, clock))
            elif marker.action == Marker.DELETE:
                changes.append(MarkerDeletion(marker.ns, marker.id))
            elif marker.action == Marker.DELETEALL:
                changes.append(MarkerDeletion(marker.ns))
            else:
                raise InputError(
                    f"it has action {marker.action}, expected ADD, DELETE or DELETEALL"
                )
        except InputError as error:
            complaints.append(f"marker '{marker.ns[:40]}' {marker.id}: {error}")
    return changes, complaints


def _observation(
    marker: Marker, place: Callable[[Header], Placement], clock: Callable[[Time], float]
) -> Observation:
    time, placement = clock(marker.header.stamp), place(marker.header)
    if marker.type not in (Marker.CYLINDER, Marker.SPHERE):
        raise InputError(f"it has type {marker.type}, expected CYLINDER or SPHERE")
    position, scale = marker.pose.position, marker.scale
    if not math.isfinite(position.x + position.y + position.z):
        raise InputError(f"position ({position.x}, {position.y}, {position.z}) is not finite")
    if not (scale.x > 0.0 and scale.y > 0.0):
        raise InputError(f"scale ({scale.x}, {scale.y}) m must be two diameters above 0")
    if not 0.0 <= scale.z < math.inf:
        raise InputError(f"scale.z {scale.z} m must be a height, or 0 if it is unknown")
    plane, height = placement.transform.planar(), placement.transform.translation[2]
    yaw = yaw_from_quaternion(marker.pose.orientation)
    x, y, angle = se2.compose(plane, (position.x, position.y, yaw))
    points = marker.points
    velocity, deviation = _motion(points, plane[2]) if points else (None, 0.0)
    low, high = position.z + height - 0.5 * scale.z, position.z + height + 0.5 * scale.z
    return Observation(
        (marker.ns, marker.id),
        time,
        x,
        y,
        angle,
        (0.5 * scale.x, 0.5 * scale.y),
        time_seconds(marker.lifetime),
        (low, high) if scale.z > 0.0 else (-math.inf, math.inf),
        placement.frame,
        velocity,
        deviation,
    )


def _motion(points: Sequence[Point], angle: float) -> tuple[tuple[float, float], float]:
    """Return the velocity (x, y) in the points of a marker, and its deviation [m/s].

    Its frame is turned by an angle [rad].
    """
    if len(points) > 2:
        raise InputError(f"it has {len(points)} points, expected a velocity and its variances")
    v, variance = points[0], points[1].z if len(points) == 2 else 0.0
    if not 0.0 <= variance < math.inf:
        raise InputError(f"the variance of its velocity {variance} m^2/s^2 is below 0 or infinite")
    c, s = math.cos(angle), math.sin(angle)
    return (c * v.x - s * v.y, s * v.x + c * v.y), math.sqrt(variance)


def ellipse_markers(
    ellipses: Ellipses,
    times: Array,
    frame: str,
    stamp: Time,
    *,
    margin: float = 0.0,
    height: float = 0.05,
) -> MarkerArray:
    """Return markers of predicted obstacles: flat cylinders, whose opacity falls with time.

    The first marker deletes those of the previous message.

    Args:
        times: Times (K,) at which the obstacles are shown [s].
        margin: Margin around each obstacle in addition to its growth [m].

    Returns:
        1 + K M markers; namespace `predicted_i` for obstacle i, numbers 0 to K - 1 in order of
        time.
    """
    header = Header(stamp=stamp, frame_id=frame)
    result = MarkerArray(markers=[Marker(header=header, action=Marker.DELETEALL)])
    centers = ellipses.centers_at(times).tolist()
    diameters = (2.0 * ellipses.axes_at(times, margin)).tolist()
    orientations = [quaternion_from_yaw(angle) for angle in ellipses.angles.tolist()]
    for k, (positions, sizes) in enumerate(zip(centers, diameters, strict=True)):
        color = ColorRGBA(r=1.0, g=0.4, b=0.1, a=0.5 * (1.0 - k / len(centers)))
        rows = zip(positions, sizes, orientations, strict=True)
        for i, ((x, y), (length, width), orientation) in enumerate(rows):
            result.markers.append(
                Marker(
                    header=header,
                    ns=f"predicted_{i}",
                    id=k,
                    type=Marker.CYLINDER,
                    action=Marker.ADD,
                    color=color,
                    scale=Vector3(x=length, y=width, z=height),
                    pose=Pose(position=Point(x=x, y=y, z=0.5 * height), orientation=orientation),
                )
            )
    return result
