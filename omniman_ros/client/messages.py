"""The messages that move a robot, from numbers that are checked before anything is sent."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Twist, TwistStamped, Vector3
from nav_msgs.msg import Path
from numpy.typing import ArrayLike
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint
from visualization_msgs.msg import Marker

from omniman_ros.console.preview_messages import twist_message
from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.conversions.headers import duration_message
from omniman_ros.conversions.poses import path_message
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.planar import Triple
from omniman_ros.motion.axes import PLATFORM_AXES

FRAME = "odom"  #: Frame in which poses are given unless another is named
BASE_FRAME = "base_link"  #: Frame of twists
#: Shortest duration of a motion of the arm that is demanded [s]: a single point that is due sooner
#: counts as one of a stream, of which nobody reports the end.
SHORTEST_MOVE = 0.6
#: Time after which an obstacle that is not repeated vanishes [s]: its script may have been killed
OBSTACLE_LIFETIME = 1.0


def number(name: str, value: Any, bound: float, above: float | None = None) -> float:
    """Return a finite number of magnitude `bound` at most, and above a limit if there is one.

    Raises:
        ParameterError: It is something else.
    """
    try:
        result = float(value)
    except (TypeError, ValueError) as error:
        raise ParameterError(name, value, "must be a number") from error
    if not abs(result) <= bound:
        raise ParameterError(name, value, f"must be finite and within +-{bound:g}")
    if above is not None and not result > above:
        raise ParameterError(name, value, f"must be above {above:g}")
    return result


def body_twist(vx: Any, vy: Any, wz: Any) -> Triple:
    """Return a twist [m/s, m/s, rad/s]; ParameterError if it is not plausible."""
    values = [number(n, v, plausible.SPEED) for n, v in (("vx", vx), ("vy", vy), ("wz", wz))]
    return values[0], values[1], values[2]


def twist(values: Triple, stamp: Any | None) -> Twist | TwistStamped:
    """Return the message of a twist; with a stamp, a TwistStamped."""
    if stamp is None:
        return twist_message(values)
    message = TwistStamped(twist=twist_message(values))
    message.header.stamp, message.header.frame_id = stamp, BASE_FRAME
    return message


def goal(x: Any, y: Any, heading: Any, frame: str) -> PoseStamped:
    """Return a goal [m, m, rad] in a frame; ParameterError if it is not plausible."""
    position = Point(x=number("x", x, plausible.LENGTH), y=number("y", y, plausible.LENGTH))
    orientation = quaternion_from_yaw(number("heading", heading, plausible.ANGLE))
    message = PoseStamped(pose=Pose(position=position, orientation=orientation))
    message.header.frame_id = frame
    return message


def position(x: Any, y: Any, z: Any) -> Triple:
    """Return a position [m]; ParameterError if it is not plausible."""
    values = [number(n, v, plausible.LENGTH) for n, v in (("x", x), ("y", y), ("z", z))]
    return values[0], values[1], values[2]


def relative_position(start: Triple, heading: float, offset: Triple) -> Triple:
    """Return a position that is given from another [m], in the frame of a heading [rad]."""
    c, s = math.cos(heading), math.sin(heading)
    x, y, z = offset
    return start[0] + c * x - s * y, start[1] + s * x + c * y, start[2] + z


def path(poses: ArrayLike, frame: str) -> Path:
    """Return a path of the platform through poses (k, 3) [m, m, rad]; InputError for others."""
    return path_message(_rows("poses", poses, (3,), "x, y, heading"), frame)


def tool_path(poses: ArrayLike, frame: str) -> Path:
    """Return a path of the tool; InputError if it is not one.

    Args:
        poses: Positions (k, 3) [m], on which the tool keeps its orientation, or poses (k, 7) with
            unit quaternions x, y, z, w behind the positions.
    """
    message = Path()
    message.header.frame_id = frame
    for row in _rows("poses", poses, (3, 7), "x, y, z and perhaps a quaternion").tolist():
        # A quaternion of zeros means that the orientation stays as it is.
        qx, qy, qz, qw = row[3:] or (0.0, 0.0, 0.0, 0.0)
        pose = Pose(
            position=Point(x=row[0], y=row[1], z=row[2]),
            orientation=Quaternion(x=qx, y=qy, z=qz, w=qw),
        )
        message.poses.append(PoseStamped(pose=pose))
    return message


def tool_goal(
    x: Any, y: Any, z: Any, orientation: Sequence[float] | None, frame: str
) -> PoseStamped:
    """Return a goal of the tool [m] with a unit quaternion x, y, z, w; None keeps the present one.

    Raises:
        ParameterError: The position is not plausible.
        InputError: The orientation has not four finite numbers.
    """
    row = [*position(x, y, z), *(() if orientation is None else orientation)]
    message: PoseStamped = tool_path([row], frame).poses[0]
    message.header.frame_id = frame
    return message


def _rows(name: str, values: ArrayLike, widths: Sequence[int], columns: str) -> Array:
    expected = " or ".join(f"(k, {width})" for width in widths)
    try:
        rows = np.array(values, dtype=float)
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} must be an array {expected}: {columns}") from error
    if rows.ndim != 2 or rows.shape[1] not in widths or not len(rows):
        raise InputError(f"{name} has shape {rows.shape}, expected {expected}: {columns}")
    plausible.demand(rows, plausible.LENGTH, name)
    return rows


def joint_motion(
    target: Mapping[str, Any] | Sequence[Any], names: Sequence[str], duration: Any | None
) -> JointTrajectory:
    """Return a motion of the arm to joint angles [rad].

    Args:
        target: Angles by name, or of all joints in the order of `names`.
        names: Names of the arm's joints.
        duration: Duration [s]; None: as short as the limits allow.

    Raises:
        InputError: A joint is unknown, or there is not one angle for each joint.
        ParameterError: An angle or the duration is not plausible.
    """
    known = ", ".join(names)
    if not isinstance(target, Mapping):
        values = list(target)
        if len(values) != len(names):
            raise InputError(f"there are {len(values)} angles for the joints {known}")
        target = dict(zip(names, values, strict=True))
    if not target:
        raise InputError(f"no joint is named; there are {known}")
    for name in target:
        if name not in names:
            raise InputError(f"the arm has no joint '{name}'; there are {known}")
    angles = [number(name, value, plausible.ANGLE) for name, value in target.items()]
    point = JointTrajectoryPoint(positions=angles)
    if duration is not None:
        seconds = number("duration", duration, 3600.0)
        if seconds < SHORTEST_MOVE:
            raise ParameterError("duration", duration, f"must be at least {SHORTEST_MOVE:g} s")
        point.time_from_start = duration_message(seconds)
    return JointTrajectory(joint_names=list(target), points=[point])


def joint_goal(
    x: Any,
    y: Any,
    heading: Any,
    angles: Mapping[str, Any] | Sequence[Any],
    names: Sequence[str],
    frame: str,
) -> JointTrajectory:
    """Return a goal of the platform [m, m, rad] in a frame, and of the arm's joints [rad].

    See :func:`joint_motion` for the angles, the names and the errors.
    """
    message = joint_motion(angles, names, None)
    pose = [number("x", x, plausible.LENGTH), number("y", y, plausible.LENGTH)]
    pose.append(number("heading", heading, plausible.ANGLE))
    message.header.frame_id = frame
    message.joint_names = [*PLATFORM_AXES, *message.joint_names]
    message.points[0].positions = [*pose, *message.points[0].positions]
    return message


class RoundObstacle:
    """A round obstacle that moves at a constant velocity from where it was placed."""

    def __init__(self, name: str, x: Any, y: Any, radius: Any, velocity: Sequence[Any]) -> None:
        """Check the numbers: position [m] in odom, radius [m], velocity [m/s].

        Raises:
            ParameterError: One of them is not plausible, or the name is empty.
        """
        if not isinstance(name, str) or not name:
            raise ParameterError("name", name, "must be a text")
        if len(velocity) != 2:
            raise ParameterError("velocity", velocity, "must have two components")
        self.name = name
        self._x, self._y = number("x", x, plausible.LENGTH), number("y", y, plausible.LENGTH)
        self._radius = number("radius", radius, plausible.LENGTH, above=0.0)
        self._vx, self._vy = (number("velocity", v, plausible.SPEED) for v in velocity)

    def marker(self, elapsed: float, stamp: Any) -> Marker:
        """Return the observation of it a time [s] after it was placed."""
        marker = Marker(ns=self.name, type=Marker.CYLINDER, action=Marker.ADD)
        marker.header.frame_id, marker.header.stamp = FRAME, stamp
        marker.pose.position.x = self._x + elapsed * self._vx
        marker.pose.position.y = self._y + elapsed * self._vy
        marker.scale = Vector3(
            x=2.0 * self._radius, y=2.0 * self._radius
        )  # no height: from the floor upwards
        marker.points = [Point(x=self._vx, y=self._vy)]  # so that nobody has to estimate it
        marker.lifetime = duration_message(OBSTACLE_LIFETIME)
        marker.color.r, marker.color.g, marker.color.b, marker.color.a = 0.85, 0.3, 0.1, 0.9
        return marker


def removal(name: str) -> Marker:
    """Return the marker that removes an obstacle."""
    marker = Marker(ns=name, action=Marker.DELETE)
    marker.header.frame_id = FRAME
    return marker
