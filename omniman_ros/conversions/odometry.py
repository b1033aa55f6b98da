"""Convert odometry of the platform to messages."""

from collections.abc import Sequence

from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from nav_msgs.msg import Odometry

from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.conversions.poses import PLANAR_INDICES
from omniman_ros.core.arrays import Array

UNMEASURED_VARIANCE = 1e6
"""Variance of z, roll and pitch, which a planar platform does not measure."""


def initialize_odometry(message: Odometry, twist_variance: float) -> None:
    """Write the constant parts: the variance of the twist, and those of z, roll and pitch.

    Args:
        message: Message to write to.
        twist_variance: Variance of the planar twist [m^2/s^2, rad^2/s^2].
    """
    for i in range(6):
        measured = i in PLANAR_INDICES
        message.twist.covariance[7 * i] = twist_variance if measured else UNMEASURED_VARIANCE
        message.pose.covariance[7 * i] = 0.0 if measured else UNMEASURED_VARIANCE


def fill_odometry(
    message: Odometry, pose: Sequence[float], twist: Array, covariance: Array, stamp: Time
) -> None:
    """Write the parts that change.

    Args:
        message: Message to write to.
        pose: Pose x, y, theta in the header's frame [m, m, rad].
        twist: Twist (3,) in the child frame [m/s, m/s, rad/s].
        covariance: Covariance (3, 3) of the pose.
        stamp: ROS time of the measurement.
    """
    message.header.stamp = stamp
    message.pose.pose.position.x = float(pose[0])
    message.pose.pose.position.y = float(pose[1])
    message.pose.pose.orientation = quaternion_from_yaw(float(pose[2]))
    for row, values in zip(PLANAR_INDICES, covariance.tolist(), strict=True):
        for column, value in zip(PLANAR_INDICES, values, strict=True):
            message.pose.covariance[6 * row + column] = value
    vx, vy, yaw_rate = twist.tolist()
    message.twist.twist.linear.x = vx
    message.twist.twist.linear.y = vy
    message.twist.twist.angular.z = yaw_rate


def odometry_transform(message: Odometry) -> TransformStamped:
    """Return the transform odom -> base_link of an odometry message."""
    result = TransformStamped(header=message.header, child_frame_id=message.child_frame_id)
    result.transform.translation.x = message.pose.pose.position.x
    result.transform.translation.y = message.pose.pose.position.y
    result.transform.rotation = message.pose.pose.orientation
    return result
