"""Convert odometry of the platform to messages."""

import math
from collections.abc import Sequence

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry

from omniman_ros.conversions.poses import PLANAR_INDICES
from omniman_ros.core.arrays import Array

#: Variance of z, roll and pitch, which a planar platform does not measure
UNMEASURED_VARIANCE = 1e6
ODOMETRY_NUMBERS = 16  #: Count of the numbers of an odometry message that change


def initialize_odometry(message: Odometry, twist_variance: float) -> None:
    """Write the constant parts; `twist_variance` is in m^2/s^2 and rad^2/s^2.

    Args:
        twist_variance: Variance of the planar twist [m^2/s^2, rad^2/s^2].
    """
    for i in range(6):
        measured = i in PLANAR_INDICES
        message.twist.covariance[7 * i] = twist_variance if measured else UNMEASURED_VARIANCE
        message.pose.covariance[7 * i] = 0.0 if measured else UNMEASURED_VARIANCE


def odometry_numbers(pose: Sequence[float], twist: Array, covariance: Array) -> tuple[float, ...]:
    """Return the numbers that change, in the order of :func:`set_odometry_numbers`.

    Args:
        pose: Pose x, y, theta in the header's frame [m, m, rad].
        twist: Twist (3,) in the child frame [m/s, m/s, rad/s].
        covariance: Covariance (3, 3) of the pose.
    """
    x, y, theta = pose
    half = 0.5 * theta
    return (x, y, math.sin(half), math.cos(half), *twist.tolist(), *covariance.ravel().tolist())


def set_odometry_numbers(message: Odometry, numbers: Sequence[float]) -> None:
    """Write :func:`odometry_numbers` into a message."""
    pose, twist = message.pose.pose, message.twist.twist
    pose.position.x, pose.position.y = numbers[:2]
    pose.orientation.z, pose.orientation.w = numbers[2:4]
    twist.linear.x, twist.linear.y, twist.angular.z = numbers[4:7]
    rest = iter(numbers[7:])
    for row in PLANAR_INDICES:
        for column in PLANAR_INDICES:
            message.pose.covariance[6 * row + column] = next(rest)


def fill_odometry(
    message: Odometry, pose: Sequence[float], twist: Array, covariance: Array, stamp: Time
) -> None:
    """Write the parts that change; see :func:`odometry_numbers`.

    Args:
        pose: Pose x, y, theta in the header's frame [m, m, rad].
        twist: Twist (3,) in the child frame [m/s, m/s, rad/s].
    """
    message.header.stamp = stamp
    set_odometry_numbers(message, odometry_numbers(pose, twist, covariance))


def odometry_transform(message: Odometry) -> TransformStamped:
    """Return the transform odom -> base_link of an odometry message."""
    result = TransformStamped(header=message.header, child_frame_id=message.child_frame_id)
    result.transform.translation.x = message.pose.pose.position.x
    result.transform.translation.y = message.pose.pose.position.y
    result.transform.rotation = message.pose.pose.orientation
    return result
