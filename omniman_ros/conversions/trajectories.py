"""Conversion of platform previews, sampled future motions that controllers follow, to messages."""

import math
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Transform, Twist, Vector3
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

from omniman_ros.conversions.geometry import (
    quaternion_from_yaw,
    twist_array,
    yaw_from_quaternion,
)
from omniman_ros.conversions.headers import check_frame, duration_message, time_seconds
from omniman_ros.conversions.joints import abbreviate_names
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.preview import MAX_POINTS, Preview
from omniman_ros.motion.path.pace import Window

PLATFORM_JOINT = "platform"  #: Name of the platform's joint in previews


def preview_from_message(
    message: MultiDOFJointTrajectory, start: float, frames: Sequence[str]
) -> Preview:
    """Return the preview of the platform's motion that a message carries.

    Args:
        message: Poses and velocities in the odom frame; either all points have an acceleration
            or none has.
        start: Time of the header's stamp on the receiver's clock [s].

    Raises:
        InputError: The frame, the joint name or the number of values is wrong, a pose is not
            planar, the times do not increase, or a number is not finite.
    """
    check_frame(message.header.frame_id, *frames)
    if list(message.joint_names) != [PLATFORM_JOINT]:
        raise InputError(
            f"it has joints {abbreviate_names(message.joint_names)}, expected "
            f"'{PLATFORM_JOINT}' alone"
        )
    points = message.points
    if len(points) > MAX_POINTS:
        raise InputError(f"there are {len(points)} points, at most {MAX_POINTS} are accepted")
    times, poses, velocities, accelerations = [], [], [], []
    for i, point in enumerate(points):
        if len(point.transforms) != 1 or len(point.velocities) != 1:
            raise InputError(f"point {i}: expected one transform and one velocity")
        if len(point.accelerations) not in (0, 1):
            count = len(point.accelerations)
            raise InputError(f"point {i}: {count} accelerations for one joint")
        times.append(start + time_seconds(point.time_from_start))
        poses.append(_pose(point.transforms[0]))
        velocities.append(twist_array(point.velocities[0]))
        accelerations += [
            twist_array(acceleration, plausible.ACCELERATION)
            for acceleration in point.accelerations
        ]
    if len(accelerations) not in (0, len(points)):
        raise InputError("some points have an acceleration and some have none")
    return Preview(
        np.array(times),
        np.array(poses).reshape(-1, 3),
        np.array(velocities).reshape(-1, 3),
        np.array(accelerations) if accelerations else None,
    )


def _pose(transform: Transform) -> Array:
    """Return the planar pose (3,) of a transform [m, m, rad]."""
    x, y = transform.translation.x, transform.translation.y
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(f"position ({x}, {y}) is not finite")
    return np.array([x, y, yaw_from_quaternion(transform.rotation)])


def preview_message(
    frame: str, stamp: Time, times: Array, poses: Array, velocities: Array
) -> MultiDOFJointTrajectory:
    """Return the message for a preview of the platform.

    Args:
        poses: Poses (k, 3), x, y, theta, in `frame` [m, m, rad].
        velocities: Velocities (k, 3), x', y', theta', in `frame` [m/s, m/s, rad/s].
    """
    message = MultiDOFJointTrajectory(joint_names=[PLATFORM_JOINT])
    message.header.frame_id, message.header.stamp = frame, stamp
    rows = zip((times - times[0]).tolist(), poses.tolist(), velocities.tolist(), strict=True)
    for elapsed, (x, y, theta), (vx, vy, yaw_rate) in rows:
        twist = Twist(linear=Vector3(x=vx, y=vy), angular=Vector3(z=yaw_rate))
        transform = Transform(translation=Vector3(x=x, y=y), rotation=quaternion_from_yaw(theta))
        message.points.append(
            MultiDOFJointTrajectoryPoint(
                transforms=[transform],
                velocities=[twist],
                time_from_start=duration_message(elapsed),
            )
        )
    return message


def reference_message(frame: str, points: int, tick: float) -> MultiDOFJointTrajectory:
    """Return a preview message for `fill_reference` with points `tick` [s] apart."""
    message = MultiDOFJointTrajectory(joint_names=[PLATFORM_JOINT])
    message.header.frame_id = frame
    for i in range(points):
        message.points.append(
            MultiDOFJointTrajectoryPoint(
                transforms=[Transform()],
                velocities=[Twist()],
                accelerations=[Twist()],
                time_from_start=duration_message(i * tick),
            )
        )
    return message


def fill_reference(message: MultiDOFJointTrajectory, stamp: Time, window: Window) -> None:
    """Write a part of the platform's motion into the points of a message.

    If the part is longer than the message, its end is dropped; if it is shorter, the remaining
    points are not changed.

    Args:
        window: Positions, velocities and accelerations (k, 3) of the platform in the message's
            frame, sampled at the message's `tick`.
    """
    message.header.stamp = stamp
    # Lists are used because numpy scalars are slow to assign to message fields.
    rows = zip(
        message.points,
        window.positions.tolist(),
        window.velocities.tolist(),
        window.accelerations.tolist(),
        strict=False,
    )
    for point, (x, y, theta), (vx, vy, yaw_rate), (ax, ay, yaw_acceleration) in rows:
        transform, velocity = point.transforms[0], point.velocities[0]
        transform.translation.x, transform.translation.y = x, y
        transform.rotation.z, transform.rotation.w = math.sin(0.5 * theta), math.cos(0.5 * theta)
        velocity.linear.x, velocity.linear.y, velocity.angular.z = vx, vy, yaw_rate
        acceleration = point.accelerations[0]
        acceleration.linear.x, acceleration.linear.y = ax, ay
        acceleration.angular.z = yaw_acceleration
