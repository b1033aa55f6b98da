"""Convert messages of the arm: motions of its joints, paths and poses of its tool."""

from array import array
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose
from nav_msgs.msg import Path
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from omniman_ros.conversions.headers import check_frame, duration_message, time_seconds
from omniman_ros.conversions.joints import abbreviate_names
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.repairs import note_repair
from omniman_ros.core.rigid import ROUNDING, UNIT_TOLERANCE
from omniman_ros.motion.path.joint_points import JointPoints
from omniman_ros.motion.path.pace import Window
from omniman_ros.ur.joint_preview import MAX_POINTS


def joint_preview(
    message: JointTrajectory, start: float, names: Sequence[str]
) -> tuple[Array, Array, Array, Array | None]:
    """Return the arguments of a `JointPreview`, which checks their content.

    Args:
        start: Time of the header's stamp on the receiver's clock [s].

    Returns:
        Times (k,) [s], positions (k, n) [rad], velocities (k, n) [rad/s], and accelerations
        (k, n) [rad/s^2] or None.

    Raises:
        InputError: The joints differ from `names`, a size is wrong, or there are too many points.
    """
    given, points = list(message.joint_names), message.points
    if sorted(given) != sorted(names):
        raise InputError(
            f"it has joints {abbreviate_names(given)}, expected {abbreviate_names(names)}"
        )
    if not 1 <= len(points) <= MAX_POINTS:
        raise InputError(f"there are {len(points)} points, 1 to {MAX_POINTS} are accepted")
    positions, velocities, accelerations = (
        _rows(points, label, len(names)) for label in ("positions", "velocities", "accelerations")
    )
    _rows(points, "effort", len(names))  # not used, but a wrong number of them shows a mix-up
    if positions is None or velocities is None:
        missing = "positions" if positions is None else "velocities"
        raise InputError(f"points without {missing} are not accepted")
    order = [given.index(name) for name in names]
    times = np.array([start + time_seconds(point.time_from_start) for point in points])
    if accelerations is not None:
        accelerations = accelerations[:, order]
    return times, positions[:, order], velocities[:, order], accelerations


def joint_points(message: JointTrajectory, names: Sequence[str], most: int) -> JointPoints:
    """Return the points of a trajectory; times that are all zero count as absent.

    Efforts are not used.

    Args:
        message: Trajectory with at least one point, for some of the joints in any order.

    Raises:
        InputError: A name is unknown or repeated, a size is wrong, only some points have
            velocities or accelerations, or :class:`JointPoints` refuses the content.
    """
    given, points = list(message.joint_names), message.points
    if len(points) > most:
        raise InputError(f"there are {len(points)} points, at most {most} are accepted")
    unknown = [name for name in given if name not in names]
    if unknown:
        raise InputError(
            f"there is no joint {abbreviate_names(unknown)}; the joints are "
            f"{abbreviate_names(names)}"
        )
    if not given or len(set(given)) != len(given):
        raise InputError(
            f"the names must be those of one or more joints, without repeats, got "
            f"{abbreviate_names(given)}"
        )
    labels = ("velocities", "accelerations", "effort")
    arrays = [_rows(points, label, len(given)) for label in labels][:2]
    times = np.array([time_seconds(point.time_from_start) for point in points])
    columns = tuple(names.index(name) for name in given)
    positions = _rows(points, "positions", len(given))
    if positions is None:
        raise InputError("points without positions are not accepted")
    return JointPoints(columns, times if times.any() else None, positions, *arrays)


def tool_poses(message: Path, frames: Sequence[str], here: Array) -> Array:
    """Return the poses (k, 4, 4) of a path of the tool.

    Args:
        message: Path; a pose without a frame of its own is in the path's frame.
        here: Rotation matrix (3, 3) of poses whose quaternion is all zeros.

    Raises:
        InputError: A frame is another one, there are no poses, or a pose is not finite or not a
            rotation. The message names the pose.
    """
    check_frame(message.header.frame_id, *frames)
    for frame in {pose.header.frame_id for pose in message.poses} - {"", message.header.frame_id}:
        check_frame(frame, *frames)
    if not message.poses:
        raise InputError("the path is empty; ~/cancel ends the path under way")
    poses = [stamped.pose for stamped in message.poses]
    positions = np.array([(pose.position.x, pose.position.y, pose.position.z) for pose in poses])
    plausible.demand(positions, plausible.LENGTH, "positions")
    quaternions = np.array(
        [(p.orientation.x, p.orientation.y, p.orientation.z, p.orientation.w) for p in poses]
    )
    lengths = np.sqrt((quaternions * quaternions).sum(axis=1))
    given = lengths != 0.0
    invalid = given & ~(np.abs(lengths - 1.0) <= UNIT_TOLERANCE)
    if invalid.any():
        i = int(invalid.argmax())
        raise InputError(f"pose {i}: quaternion of length {lengths[i]:.4g}, expected 1 or 0")
    rough = given & (np.abs(lengths - 1.0) > ROUNDING)
    if rough.any():
        note_repair(f"a quaternion of length {lengths[rough][0]:.4g} was normalised")
    result = np.zeros((len(poses), 4, 4))
    result[:, :3, :3] = here
    result[given, :3, :3] = rotations(quaternions[given] / lengths[given, None])
    result[:, :3, 3], result[:, 3, 3] = positions, 1.0
    return result


def rotations(quaternions: Array) -> Array:
    """Return the rotation matrices (k, 3, 3) of unit quaternions (k, 4) x, y, z, w."""
    x, y, z, w = quaternions.T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def fill_pose(message: Pose, pose: Array) -> None:
    """Write a pose (4, 4) [m] into a message."""
    position, q = message.position, message.orientation
    position.x, position.y, position.z = (float(value) for value in pose[:3, 3])
    q.x, q.y, q.z, q.w = (float(value) for value in unit_quaternion(pose[:3, :3]))


def unit_quaternion(rotation: Array) -> Array:
    """Return the unit quaternion (4,) x, y, z, w of a rotation matrix (3, 3).

    Its largest entry is positive.
    """
    r, trace = rotation, np.trace(rotation)
    # Four times the products of the entries: the row with the largest square is used.
    products = np.empty((4, 4))
    products[:3, :3] = r + r.T + (1.0 - trace) * np.eye(3)
    products[3, :3] = products[:3, 3] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    products[3, 3] = 1.0 + trace
    row = products[int(np.diag(products).argmax())]
    result: Array = row / np.sqrt((row * row).sum())
    return result


def _rows(points: Sequence[JointTrajectoryPoint], label: str, width: int) -> Array | None:
    """Return one row (width,) of an array field per point, or None if no point has any."""
    rows = [getattr(point, label) for point in points]
    if not any(len(row) for row in rows):
        return None
    for i, row in enumerate(rows):
        if len(row) != width:
            raise InputError(f"point {i}: {len(row)} {label} for {width} joints")
    return np.array(rows, dtype=float)


def joint_reference_message(names: Sequence[str], points: int, tick: float) -> JointTrajectory:
    """Allocate a preview, points `tick` [s] apart, for :func:`fill_joint_reference`."""
    message = JointTrajectory(joint_names=list(names))
    for i in range(points):
        message.points.append(JointTrajectoryPoint(time_from_start=duration_message(i * tick)))
    return message


def fill_joint_reference(message: JointTrajectory, stamp: Time, window: Window) -> None:
    """Write a window of a stream into a message, as far as the message has points."""
    message.header.stamp = stamp
    rows = zip(
        message.points, window.positions, window.velocities, window.accelerations, strict=False
    )
    for point, position, velocity, acceleration in rows:
        point.positions = array("d", position.tobytes())
        point.velocities = array("d", velocity.tobytes())
        point.accelerations = array("d", acceleration.tobytes())
