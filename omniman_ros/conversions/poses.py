"""Convert planar poses, paths of poses, and goals."""

from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path

from omniman_ros.conversions.geometry import (
    quaternion_from_yaw,
    twist_array,
    yaw_from_quaternion,
)
from omniman_ros.conversions.headers import check_frame
from omniman_ros.core import plausible, se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError

#: Indices of x, y and rotation about z in the rows and columns of a 6 x 6 covariance
PLANAR_INDICES = (0, 1, 5)


def planar_pose(
    message: PoseWithCovarianceStamped, frames: Sequence[str]
) -> tuple[tuple[float, float, float], Array]:
    """Return the pose (x, y, theta) [m, m, rad] of a message and its covariance (3, 3).

    Raises:
        InputError: The frame is another one, or the pose is not planar or not finite.
    """
    check_frame(message.header.frame_id, *frames)
    position = message.pose.pose.position
    plausible.demand(np.array([position.x, position.y]), plausible.LENGTH, "position")
    covariance = np.array(message.pose.covariance, dtype=float).reshape(6, 6)
    pose = (position.x, position.y, yaw_from_quaternion(message.pose.pose.orientation))
    return pose, covariance[np.ix_(PLANAR_INDICES, PLANAR_INDICES)]


def path_poses(message: Path, frames: Sequence[str], headings: bool) -> Array:
    """Return the poses (k, 3) x, y, theta of a path [m, m, rad]; headings are not unwrapped.

    Args:
        message: Path; a pose without a frame of its own is in the path's frame.
        headings: Whether to read the orientations; if not, they may be anything and theta is 0.

    Raises:
        InputError: A frame is another one, or a pose is not finite or not planar. The message
            names the pose.
    """
    check_frame(message.header.frame_id, *frames)
    pose_frames = {pose.header.frame_id for pose in message.poses}
    for frame in pose_frames - {"", message.header.frame_id}:
        check_frame(frame, *frames)
    poses = [stamped.pose for stamped in message.poses]
    positions = np.array([(pose.position.x, pose.position.y) for pose in poses]).reshape(-1, 2)
    plausible.demand(positions, plausible.LENGTH, "positions")
    result = np.column_stack([positions, np.zeros(len(positions))])
    if headings:
        for i, pose in enumerate(poses):
            try:
                result[i, 2] = yaw_from_quaternion(pose.orientation)
            except InputError as error:
                raise InputError(f"pose {i}: {error}") from error
    return result


def path_message(poses: Array, frame: str) -> Path:
    """Return the path through poses (k, 3) x, y, theta [m, m, rad] in `frame`."""
    message = Path()
    message.header.frame_id = frame
    message.poses = [PoseStamped(pose=pose_message(pose)) for pose in poses]
    return message


def pose_message(pose: Array) -> Pose:
    """Return the message of a pose (3,) x, y, theta [m, m, rad]."""
    x, y, theta = pose.tolist()
    return Pose(position=Point(x=x, y=y), orientation=quaternion_from_yaw(theta))


def goal_pose_from_message(message: PoseStamped, frames: Sequence[str]) -> Array:
    """Return the pose (3,) x, y, theta of a goal in odom [m, m, rad].

    Raises:
        InputError: The frame is another one, or the pose is not planar or not finite.
    """
    check_frame(message.header.frame_id, *frames)
    position = message.pose.position
    pose = np.array([position.x, position.y, yaw_from_quaternion(message.pose.orientation)])
    plausible.demand(pose[:2], plausible.LENGTH, "goal: position")
    return pose


def goal_state_from_message(message: Odometry, frames: Sequence[str]) -> tuple[Array, Array]:
    """Return the pose (3,) [m, m, rad] and the velocity (3,) [m/s, m/s, rad/s] of a goal in odom.

    Args:
        message: Goal. As in odometry, its twist is in `child_frame_id`: in the goal's own frame,
            unless that is one of `frames`.

    Raises:
        InputError: The frame is another one, or the goal is not planar or not finite.
    """
    stamped = PoseStamped(header=message.header, pose=message.pose.pose)
    pose = goal_pose_from_message(stamped, frames)
    twist = twist_array(message.twist.twist)
    if message.child_frame_id not in frames:
        twist = se2.to_world(float(pose[2]), twist)
    return pose, twist
