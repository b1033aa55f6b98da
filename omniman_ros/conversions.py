"""Messages to core and back: pure functions without a node."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import (
    Point,
    Pose,
    PoseStamped,
    PoseWithCovarianceStamped,
    Quaternion,
    Transform,
    TransformStamped,
    Twist,
    TwistStamped,
    Vector3,
)
from nav_msgs.msg import Odometry as OdometryMsg
from nav_msgs.msg import Path
from numpy.typing import NDArray
from sensor_msgs.msg import JointState
from std_msgs.msg import ColorRGBA, Float64MultiArray, Header, MultiArrayDimension
from trajectory_msgs.msg import (
    MultiDOFJointTrajectory,
    MultiDOFJointTrajectoryPoint,
)
from visualization_msgs.msg import Marker, MarkerArray

from omniman_ros.core import plausible, se2
from omniman_ros.core.errors import InputError
from omniman_ros.core.path.interpolator import Window
from omniman_ros.core.preview import MAX_POINTS, Preview
from omniman_ros.core.wheel_cascade import DriveMode, WheelCommand

Array = NDArray[np.float64]
Observed = TypeVar("Observed")

PLATFORM_JOINT = "platform"
"""Name of the platform in previews."""
LIMITS_KEY = "limits"
"""Of the value in `wheel_health` that is the share of the limits left without a wheel."""
UNIT_TOLERANCE = 0.01
"""How far a quaternion's length may be from 1."""
TILT_TOLERANCE = 0.02
"""How far from vertical a planar pose may turn [rad, about]."""
UNMEASURED = 1e6
"""Variance of what a platform in the plane does not measure."""
_PLANE = (0, 1, 5)
"""x, y and rotation about z among the six of a 6 x 6 covariance."""


def time_seconds(stamp: Time) -> float:
    """Seconds of a stamp or a duration."""
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def yaw(quaternion: Quaternion) -> float:
    """Heading in (-pi, pi] [rad] of a rotation in the plane.

    Raises:
        InputError: Not finite, not of unit length, or not about the vertical.
    """
    x, y, z, w = quaternion.x, quaternion.y, quaternion.z, quaternion.w
    length = math.sqrt(x * x + y * y + z * z + w * w)
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        raise InputError(f"quaternion of length {length:.4g}, expected 1")
    if 2.0 * math.hypot(x, y) > TILT_TOLERANCE:
        raise InputError("a rotation that is not about the vertical")
    return se2.wrap(2.0 * math.atan2(z, w))


def quaternion(theta: float) -> Quaternion:
    """Rotation about the vertical by theta [rad]."""
    return Quaternion(x=0.0, y=0.0, z=math.sin(0.5 * theta), w=math.cos(0.5 * theta))


def check_frame(frame: str, *allowed: str) -> None:
    """Demand one of the allowed frames.

    Raises:
        InputError: It is another one.
    """
    if frame.lstrip("/") not in allowed:
        names = " or ".join(repr(name) for name in allowed)
        raise InputError(f"frame '{frame[:40]}', expected {names}")


def twist_array(message: Twist, bound: float = plausible.SPEED) -> Array:
    """Planar part (3,) of a twist or acceleration [m/s, m/s, rad/s, or the same per second].

    Raises:
        InputError: One of its six numbers is not finite or beyond +-bound.
    """
    v, w = message.linear, message.angular
    plausible.demand(np.array([v.x, v.y, v.z, w.x, w.y, w.z]), bound, "linear and angular")
    return np.array([v.x, v.y, w.z])


def stamped_twist_array(message: TwistStamped, base_frame: str) -> Array:
    """Body twist (3,) of a stamped message in the base frame (an empty frame is taken for it).

    Raises:
        InputError: Another frame, or not finite.
    """
    check_frame(message.header.frame_id, base_frame, "")
    return twist_array(message.twist)


def joint_arrays(
    message: JointState, names: Sequence[str]
) -> tuple[Array | None, Array | None, Array | None]:
    """Positions, velocities and efforts (n,) of a JointState, in the order of `names`.

    What is absent is None; joints that are not asked for are left out.

    Raises:
        InputError: A name is missing or there twice, or an array has another length than names.
    """
    given = message.name
    parts = []
    for label in ("position", "velocity", "effort"):
        values = getattr(message, label)
        if len(values) not in (0, len(given)):
            raise InputError(f"{len(values)} {label} values for {len(given)} names")
        parts.append(np.array(values, dtype=float) if len(values) else None)
    if list(given) == list(names):
        return parts[0], parts[1], parts[2]
    if len(set(given)) != len(given):
        raise InputError(f"a name is there twice among {some_names(given)}")
    missing = [name for name in names if name not in given]
    if missing:
        raise InputError(f"no {', '.join(missing)} among the names {some_names(given)}")
    order = [given.index(name) for name in names]
    position, velocity, effort = (None if part is None else part[order] for part in parts)
    return position, velocity, effort


def some_names(names: Sequence[str]) -> str:
    """The first few names, for a message."""
    shown = ", ".join(name[:40] for name in names[:8])
    return f"{shown}, ..." if len(names) > 8 else shown or "(none)"


def present(array: Array | None, bound: float, label: str) -> Array:
    """The array, which must be there, finite and within +-bound.

    Raises:
        InputError: It is not.
    """
    if array is None:
        raise InputError(f"no {label}")
    plausible.demand(array, bound, label)
    return array


def preview(message: MultiDOFJointTrajectory, start: float, frames: Sequence[str]) -> Preview:
    """Preview of the platform.

    Args:
        message: Poses, velocities (needed) and accelerations (all or none) in the odom frame.
        start: Time of the header's stamp on the receiver's clock [s].
        frames: Frames that are taken for odom.

    Raises:
        InputError: Wrong frame, joint or sizes, a pose that is not planar, times that do not
            increase, or anything that is not finite.
    """
    check_frame(message.header.frame_id, *frames)
    if list(message.joint_names) != [PLATFORM_JOINT]:
        raise InputError(
            f"joints {some_names(message.joint_names)}, expected '{PLATFORM_JOINT}' alone"
        )
    points = message.points
    if len(points) > MAX_POINTS:
        raise InputError(f"{len(points)} points, at most {MAX_POINTS} are taken")
    times, poses, velocities, accelerations = [], [], [], []
    for i, point in enumerate(points):
        if len(point.transforms) != 1 or len(point.velocities) != 1:
            raise InputError(f"point {i}: expected one transform and one velocity")
        if len(point.accelerations) not in (0, 1):
            raise InputError(f"point {i}: {len(point.accelerations)} accelerations for one joint")
        times.append(start + time_seconds(point.time_from_start))
        poses.append(_pose(point.transforms[0]))
        velocities.append(twist_array(point.velocities[0]))
        accelerations += [twist_array(a, plausible.ACCELERATION) for a in point.accelerations]
    if len(accelerations) not in (0, len(points)):
        raise InputError("some points have an acceleration and some have none")
    return Preview(
        np.array(times),
        np.array(poses).reshape(-1, 3),
        np.array(velocities).reshape(-1, 3),
        np.array(accelerations) if accelerations else None,
    )


def _pose(transform: Transform) -> Array:
    x, y = transform.translation.x, transform.translation.y
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(f"position ({x}, {y}) is not finite")
    return np.array([x, y, yaw(transform.rotation)])


def path_poses(message: Path, frames: Sequence[str], headings: bool) -> Array:
    """Poses (k, 3) x, y, theta of a path [m, m, rad]; not unwrapped.

    Args:
        message: The path; poses without a frame of their own are in the path's.
        frames: Frames that are taken for odom.
        headings: Whether the orientations count; else they are not looked at.

    Raises:
        InputError: Wrong frame, or a pose that is not finite or not planar; it is named.
    """
    check_frame(message.header.frame_id, *frames)
    strange = {pose.header.frame_id for pose in message.poses} - {"", message.header.frame_id}
    for frame in strange:
        check_frame(frame, *frames)
    poses = [stamped.pose for stamped in message.poses]
    places = np.array([(pose.position.x, pose.position.y) for pose in poses]).reshape(-1, 2)
    plausible.demand(places, plausible.LENGTH, "positions")
    result = np.column_stack([places, np.zeros(len(places))])
    if headings:
        for i, pose in enumerate(poses):
            try:
                result[i, 2] = yaw(pose.orientation)
            except InputError as error:
                raise InputError(f"pose {i}: {error}") from error
    return result


def limits_share(message: DiagnosticStatus) -> float:
    """Share of the limits that `wheel_health` says is left, 1 where it says nothing of it.

    Raises:
        InputError: No number above 0 and up to 1.
    """
    for item in message.values:
        if item.key == LIMITS_KEY:
            try:
                share = float(item.value)
            except ValueError:
                share = math.nan
            if not 0.0 < share <= 1.0:
                raise InputError(f"{LIMITS_KEY} '{item.value[:40]}', expected above 0 and up to 1")
            return share
    return 1.0


def path_message(poses: Array, frame: str) -> Path:
    """Poses (k, 3) x, y, theta [m, m, rad] as a path."""
    message = Path()
    message.header.frame_id = frame
    for x, y, theta in poses.tolist():
        pose = Pose(position=Point(x=x, y=y), orientation=quaternion(theta))
        message.poses.append(PoseStamped(pose=pose))
    return message


def planar_pose(
    message: PoseWithCovarianceStamped, frames: Sequence[str]
) -> tuple[tuple[float, float, float], Array]:
    """Pose (x, y, theta) [m, m, rad] and its covariance (3, 3).

    Raises:
        InputError: Wrong frame, not planar, or not finite.
    """
    check_frame(message.header.frame_id, *frames)
    position = message.pose.pose.position
    plausible.demand(np.array([position.x, position.y]), plausible.LENGTH, "position")
    covariance = np.array(message.pose.covariance, dtype=float).reshape(6, 6)
    pose = (position.x, position.y, yaw(message.pose.pose.orientation))
    return pose, covariance[np.ix_(_PLANE, _PLANE)]


def fill_odometry(
    message: OdometryMsg, pose: Sequence[float], twist: Array, covariance: Array, stamp: Time
) -> None:
    """Write pose (x, y, theta), twist (3,) of the child frame and covariance (3, 3)."""
    message.header.stamp = stamp
    message.pose.pose.position.x = float(pose[0])
    message.pose.pose.position.y = float(pose[1])
    message.pose.pose.orientation = quaternion(float(pose[2]))
    for i, row in enumerate(_PLANE):
        for j, column in enumerate(_PLANE):
            message.pose.covariance[6 * row + column] = covariance[i, j]
    vx, vy, w = twist.tolist()
    message.twist.twist.linear.x = vx
    message.twist.twist.linear.y = vy
    message.twist.twist.angular.z = w


def reference_message(frame: str, points: int, tick: float) -> MultiDOFJointTrajectory:
    """An empty preview of the platform with points a tick [s] apart, to be filled again and again.

    :func:`fill_reference` writes into it.
    """
    message = MultiDOFJointTrajectory(joint_names=[PLATFORM_JOINT])
    message.header.frame_id = frame
    for i in range(points):
        nanoseconds = round(i * tick * 1e9)
        after = Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        message.points.append(
            MultiDOFJointTrajectoryPoint(
                transforms=[Transform()], velocities=[Twist()], accelerations=[Twist()],
                time_from_start=after,
            )
        )  # fmt: skip
    return message


def fill_reference(message: MultiDOFJointTrajectory, stamp: Time, window: Window) -> None:
    """Write a part of the stream, whose first tick is at `stamp`, as far as there are points."""
    message.header.stamp = stamp
    rows = zip(
        message.points,
        window.positions.tolist(),
        window.velocities.tolist(),
        window.accelerations.tolist(),
        strict=False,
    )  # fmt: skip  (lists: numpy's own numbers are slow to assign)
    for point, (x, y, theta), (vx, vy, w), (ax, ay, turn) in rows:
        transform, velocity = point.transforms[0], point.velocities[0]
        transform.translation.x, transform.translation.y = x, y
        transform.rotation.z, transform.rotation.w = math.sin(0.5 * theta), math.cos(0.5 * theta)
        velocity.linear.x, velocity.linear.y, velocity.angular.z = vx, vy, w
        rate = point.accelerations[0]
        rate.linear.x, rate.linear.y, rate.angular.z = ax, ay, turn


def prepare_odometry(message: OdometryMsg, twist_variance: float) -> None:
    """Write what stays: the twist's variance, and that z, roll and pitch are not measured."""
    for i in range(6):
        measured = i in _PLANE
        message.twist.covariance[7 * i] = twist_variance if measured else UNMEASURED
        message.pose.covariance[7 * i] = 0.0 if measured else UNMEASURED


def transform(message: OdometryMsg) -> TransformStamped:
    """The transform odom -> base_link of an odometry message."""
    result = TransformStamped(header=message.header, child_frame_id=message.child_frame_id)
    result.transform.translation.x = message.pose.pose.position.x
    result.transform.translation.y = message.pose.pose.position.y
    result.transform.rotation = message.pose.pose.orientation
    return result


def fill_command(message: JointState, command: WheelCommand, stamp: Time) -> None:
    """Write a command into a JointState: velocity with effort, or effort (N m or V) alone."""
    message.header.stamp = stamp
    message.effort = command.effort.tolist()
    message.velocity = [] if command.velocity is None else command.velocity.tolist()


def wheel_command(message: JointState, names: Sequence[str], voltage: bool) -> WheelCommand:
    """Command of a message from `wheel_voltages` (voltage true) or `wheel_commands`.

    Raises:
        InputError: Names, sizes or content are wrong, or there is neither velocity nor effort.
    """
    _, velocity, effort = joint_arrays(message, names)
    if voltage:
        return WheelCommand(DriveMode.VOLTAGE, present(effort, plausible.EFFORT, "effort (volts)"))
    if velocity is None:
        torque = present(effort, plausible.EFFORT, "velocity or effort")
        return WheelCommand(DriveMode.TORQUE, torque)
    speeds = present(velocity, plausible.WHEEL_SPEED, "velocity")
    if effort is None:
        return WheelCommand(DriveMode.VELOCITY, np.zeros(len(names)), speeds)
    return WheelCommand(DriveMode.VELOCITY, present(effort, plausible.EFFORT, "effort"), speeds)


def electrical(values: Array) -> Float64MultiArray:
    """Voltage [V], current [A] and energy [J] per wheel, from an array (n, 3)."""
    rows, columns = values.shape
    message = Float64MultiArray(data=values.ravel().tolist())
    message.layout.dim = [
        MultiArrayDimension(label="wheel", size=rows, stride=rows * columns),
        MultiArrayDimension(label="voltage,current,energy", size=columns, stride=columns),
    ]
    return message


# ---- obstacles --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Deletion:
    """Markers that go: the one of this namespace and number, or all of the namespace.

    Attributes:
        namespace: Theirs; empty with `number` None: every marker.
        number: Of the one, or None for all.
    """

    namespace: str
    number: int | None = None


def marker_changes(
    message: MarkerArray,
    frames: Sequence[str],
    clock: Callable[[Time], float],
    observation: Callable[..., Observed],
) -> tuple[list[Observed | Deletion], list[str]]:
    """What the markers of obstacles change, in their order, and what is wrong with the others.

    A CYLINDER or a SPHERE is an ellipse whose diameters along its own x and y are its scale.
    ADD (and MODIFY) puts it there, DELETE takes it away, DELETEALL takes all away (of its
    namespace, if it has one). Frame and type of a deletion do not count.

    Args:
        message: The markers.
        frames: Frames that are taken for odom.
        clock: Time of a stamp on the caller's clock [s]; a zero stamp means now. What it refuses
            with an InputError is one of the complaints.
        observation: Makes an observation from key (namespace, number), time [s], x, y [m],
            angle [rad], semi-axes (a, b) [m] and lifetime [s], and refuses with an InputError
            what is implausible: `planning.obstacles.Observation`.

    Returns:
        Observations and deletions; and a complaint for each marker that is left out, with its
        namespace and number, what is wrong, and the value.
    """
    changes: list[Observed | Deletion] = []
    complaints: list[str] = []
    for marker in message.markers:
        try:
            if marker.action == Marker.ADD:
                changes.append(_observed(marker, frames, clock, observation))
            elif marker.action == Marker.DELETE:
                changes.append(Deletion(marker.ns, marker.id))
            elif marker.action == Marker.DELETEALL:
                changes.append(Deletion(marker.ns))
            else:
                raise InputError(f"action {marker.action}, expected ADD, DELETE or DELETEALL")
        except InputError as error:
            complaints.append(f"marker '{marker.ns[:40]}' {marker.id}: {error}")
    return changes, complaints


def _observed(
    marker: Marker,
    frames: Sequence[str],
    clock: Callable[[Time], float],
    observation: Callable[..., Observed],
) -> Observed:
    check_frame(marker.header.frame_id, *frames)
    if marker.type not in (Marker.CYLINDER, Marker.SPHERE):
        raise InputError(f"type {marker.type}, expected CYLINDER or SPHERE")
    place, scale = marker.pose.position, marker.scale
    if not math.isfinite(place.x + place.y + place.z):
        raise InputError(f"position ({place.x}, {place.y}, {place.z}) is not finite")
    if not (scale.x > 0.0 and scale.y > 0.0):
        raise InputError(f"scale ({scale.x}, {scale.y}) m, expected two diameters above 0")
    return observation(
        (marker.ns, marker.id), clock(marker.header.stamp), place.x, place.y,
        yaw(marker.pose.orientation), (0.5 * scale.x, 0.5 * scale.y),
        time_seconds(marker.lifetime),
    )  # fmt: skip


class MovingEllipses(Protocol):
    """Ellipses at constant velocity, as `planning.ellipses.Ellipses`."""

    @property
    def angles(self) -> Array:
        """(M,) of their own x axes [rad]."""

    def centers_at(self, times: Array) -> Array:
        """Centres (K, M, 2) [m] at times (K,) [s]."""

    def axes_at(self, times: Array, margin: float = 0.0) -> Array:
        """Semi-axes (K, M, 2) [m] at times (K,) with a margin [m] around them."""


def ellipse_markers(
    ellipses: MovingEllipses,
    times: Array,
    frame: str,
    stamp: Time,
    margin: float = 0.0,
    height: float = 0.05,
) -> MarkerArray:
    """Where obstacles are expected: a flat cylinder each at each time, fainter the later it is.

    The first marker deletes those of before.

    Args:
        ellipses: M obstacles.
        times: (K,) at which they are shown [s].
        frame: Frame of the ellipses.
        stamp: Of the message.
        margin: Around each, beside its growth [m].
        height: Of the cylinders [m].

    Returns:
        1 + K M markers; namespace `predicted_i` for obstacle i, numbers 0 to K - 1 in time.
    """
    header = Header(stamp=stamp, frame_id=frame)
    result = MarkerArray(markers=[Marker(header=header, action=Marker.DELETEALL)])
    centers = ellipses.centers_at(times).tolist()
    diameters = (2.0 * ellipses.axes_at(times, margin)).tolist()
    orientations = [quaternion(angle) for angle in ellipses.angles.tolist()]
    for k, (places, sizes) in enumerate(zip(centers, diameters, strict=True)):
        color = ColorRGBA(r=1.0, g=0.4, b=0.1, a=0.5 * (1.0 - k / len(centers)))
        rows = zip(places, sizes, orientations, strict=True)
        for i, ((x, y), (length, width), orientation) in enumerate(rows):
            result.markers.append(
                Marker(
                    header=header, ns=f"predicted_{i}", id=k, type=Marker.CYLINDER,
                    action=Marker.ADD, color=color, scale=Vector3(x=length, y=width, z=height),
                    pose=Pose(position=Point(x=x, y=y, z=0.5 * height), orientation=orientation),
                )
            )  # fmt: skip
    return result


# ---- goals and plans --------------------------------------------------------------------------


def goal_pose(message: PoseStamped, frames: Sequence[str]) -> Array:
    """Pose (3,) x, y, theta of a goal.

    Raises:
        InputError: Wrong frame, not planar, or not finite.
    """
    check_frame(message.header.frame_id, *frames)
    place = message.pose.position
    pose = np.array([place.x, place.y, yaw(message.pose.orientation)])
    plausible.demand(pose[:2], plausible.LENGTH, "goal: position")
    return pose


def goal_state(message: OdometryMsg, frames: Sequence[str]) -> tuple[Array, Array]:
    """Pose (3,) of a goal and its velocity (3,), both in odom.

    The message's twist is in its `child_frame_id`: the robot's own frame, as in odometry, unless
    that is one of `frames`.

    Raises:
        InputError: Wrong frame, not planar, or not finite.
    """
    pose = goal_pose(PoseStamped(header=message.header, pose=message.pose.pose), frames)
    twist = twist_array(message.twist.twist)
    if message.child_frame_id not in frames:
        twist = se2.to_world(float(pose[2]), twist)
    return pose, twist


def preview_message(
    frame: str, stamp: Time, times: Array, poses: Array, velocities: Array
) -> MultiDOFJointTrajectory:
    """A preview of the platform; the first of the times (k,) [s] is at `stamp`."""
    message = MultiDOFJointTrajectory(joint_names=[PLATFORM_JOINT])
    message.header.frame_id, message.header.stamp = frame, stamp
    rows = zip((times - times[0]).tolist(), poses.tolist(), velocities.tolist(), strict=True)
    for after, (x, y, theta), (vx, vy, w) in rows:
        nanoseconds = round(after * 1e9)
        twist = Twist(linear=Vector3(x=vx, y=vy), angular=Vector3(z=w))
        transform = Transform(translation=Vector3(x=x, y=y), rotation=quaternion(theta))
        message.points.append(
            MultiDOFJointTrajectoryPoint(
                transforms=[transform], velocities=[twist],
                time_from_start=Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9),
            )
        )  # fmt: skip
    return message
