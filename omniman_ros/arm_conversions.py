"""Messages of the arm to core and back: pure functions without a node."""

from array import array
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Pose
from nav_msgs.msg import Path
from numpy.typing import NDArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from omniman_ros.arm.joint_preview import MAX_POINTS
from omniman_ros.conversions import UNIT_TOLERANCE, check_frame, some_names, time_seconds
from omniman_ros.core import plausible
from omniman_ros.core.errors import InputError
from omniman_ros.core.path.interpolator import Window
from omniman_ros.core.path.joint_points import JointPoints

Array = NDArray[np.float64]


def joint_preview(
    message: JointTrajectory, start: float, names: Sequence[str]
) -> tuple[Array, Array, Array, Array | None]:
    """Arguments of a `JointPreview`, which checks what they say; the joints in our order.

    Args:
        message: Positions and velocities (needed), accelerations (all or none) of all joints.
        start: Time of the header's stamp on the receiver's clock [s].
        names: Of the joints.

    Raises:
        InputError: Other joints, wrong sizes, or too many points.
    """
    given, points = list(message.joint_names), message.points
    if sorted(given) != sorted(names):
        raise InputError(f"joints {some_names(given)}, expected {some_names(names)}")
    if not 1 <= len(points) <= MAX_POINTS:
        raise InputError(f"{len(points)} points, 1 to {MAX_POINTS} are taken")
    positions, velocities, accelerations = (
        _rows(points, label, len(names)) for label in ("positions", "velocities", "accelerations")
    )
    if positions is None or velocities is None:
        raise InputError(f"points without {'positions' if positions is None else 'velocities'}")
    order = [given.index(name) for name in names]
    times = np.array([start + time_seconds(point.time_from_start) for point in points])
    if accelerations is not None:
        accelerations = accelerations[:, order]
    return times, positions[:, order], velocities[:, order], accelerations


def joint_points(message: JointTrajectory, names: Sequence[str], most: int) -> JointPoints:
    """Points of a trajectory; times that are all zero are none. Efforts are not looked at.

    Args:
        message: At least one point; some of the joints, in any order.
        names: All joints.
        most: So many points are taken.

    Raises:
        InputError: Unknown or repeated names, wrong sizes, velocities or accelerations that only
            some points have, or content that :class:`JointPoints` refuses.
    """
    given, points = list(message.joint_names), message.points
    if len(points) > most:
        raise InputError(f"{len(points)} points, at most {most} are taken")
    unknown = [name for name in given if name not in names]
    if unknown:
        raise InputError(f"no joint {some_names(unknown)}; the joints are {some_names(names)}")
    if not given or len(set(given)) != len(given):
        raise InputError(f"no joint, or one twice, among the names {some_names(given)}")
    arrays = [_rows(points, label, len(given)) for label in ("velocities", "accelerations")]
    times = np.array([time_seconds(point.time_from_start) for point in points])
    columns = tuple(names.index(name) for name in given)
    positions = _rows(points, "positions", len(given))
    if positions is None:
        raise InputError("points without positions")
    return JointPoints(columns, times if times.any() else None, positions, *arrays)


def tool_poses(message: Path, frames: Sequence[str], here: Array) -> Array:
    """Poses (k, 4, 4) of a path of the tool.

    Args:
        message: The path; poses without a frame of their own are in the path's.
        frames: Frames that are taken for odom.
        here: (3, 3) orientation of poses whose quaternion is all zeros.

    Raises:
        InputError: Wrong frame, no pose, or one that is not finite or no rotation; it is named.
    """
    check_frame(message.header.frame_id, *frames)
    for frame in {pose.header.frame_id for pose in message.poses} - {"", message.header.frame_id}:
        check_frame(frame, *frames)
    if not message.poses:
        raise InputError("an empty path; ~/cancel ends the one that is driven")
    poses = [stamped.pose for stamped in message.poses]
    places = np.array([(pose.position.x, pose.position.y, pose.position.z) for pose in poses])
    plausible.demand(places, plausible.LENGTH, "positions")
    turns = np.array(
        [(p.orientation.x, p.orientation.y, p.orientation.z, p.orientation.w) for p in poses]
    )
    lengths = np.sqrt((turns * turns).sum(axis=1))
    given = lengths != 0.0
    strange = given & ~(np.abs(lengths - 1.0) <= UNIT_TOLERANCE)
    if strange.any():
        i = int(strange.argmax())
        raise InputError(f"pose {i}: quaternion of length {lengths[i]:.4g}, expected 1 or 0")
    result = np.zeros((len(poses), 4, 4))
    result[:, :3, :3] = here
    result[given, :3, :3] = rotations(turns[given] / lengths[given, None])
    result[:, :3, 3], result[:, 3, 3] = places, 1.0
    return result


def rotations(turns: Array) -> Array:
    """Rotation matrices (k, 3, 3) of quaternions (k, 4) x, y, z, w of unit length."""
    x, y, z, w = turns.T
    rows = [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)],
        [2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)],
        [2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def fill_pose(message: Pose, pose: Array) -> None:
    """Write a pose (4, 4) into a message."""
    place, turn = message.position, message.orientation
    place.x, place.y, place.z = (float(value) for value in pose[:3, 3])
    turn.x, turn.y, turn.z, turn.w = (float(value) for value in unit_quaternion(pose[:3, :3]))


def unit_quaternion(rotation: Array) -> Array:
    """Quaternion (4,) x, y, z, w of a rotation matrix (3, 3); the largest entry is positive."""
    r = rotation
    # Four times the products of all entries with each: the row with the largest square counts.
    products = np.array(
        [
            [1.0 + r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0],
             r[2, 1] - r[1, 2]],
            [r[0, 1] + r[1, 0], 1.0 - r[0, 0] + r[1, 1] - r[2, 2], r[1, 2] + r[2, 1],
             r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], 1.0 - r[0, 0] - r[1, 1] + r[2, 2],
             r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1],
             1.0 + r[0, 0] + r[1, 1] + r[2, 2]],
        ]
    )  # fmt: skip
    row = products[int(np.diag(products).argmax())]
    result: Array = row / np.sqrt((row * row).sum())
    return result


def _rows(points: Sequence[JointTrajectoryPoint], label: str, width: int) -> Array | None:
    """One row (width,) a point, or None where no point has them."""
    rows = [getattr(point, label) for point in points]
    if not any(len(row) for row in rows):
        return None
    for i, row in enumerate(rows):
        if len(row) != width:
            raise InputError(f"point {i}: {len(row)} {label} for {width} joints")
    return np.array(rows, dtype=float)


def joint_reference_message(names: Sequence[str], points: int, tick: float) -> JointTrajectory:
    """An empty preview of joints with points a tick [s] apart, to be filled again and again.

    :func:`fill_joint_reference` writes into it.
    """
    message = JointTrajectory(joint_names=list(names))
    for i in range(points):
        nanoseconds = round(i * tick * 1e9)
        after = Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        message.points.append(JointTrajectoryPoint(time_from_start=after))
    return message


def fill_joint_reference(message: JointTrajectory, stamp: Time, window: Window) -> None:
    """Write a part of the stream, whose first tick is at `stamp`, as far as there are points."""
    message.header.stamp = stamp
    rows = zip(
        message.points, window.positions, window.velocities, window.accelerations, strict=False
    )
    for point, position, velocity, acceleration in rows:
        point.positions = array("d", position.tobytes())
        point.velocities = array("d", velocity.tobytes())
        point.accelerations = array("d", acceleration.tobytes())
