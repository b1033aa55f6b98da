"""Convert planar rotations and twists."""

import math

import numpy as np
from geometry_msgs.msg import Quaternion, Twist, TwistStamped
from geometry_msgs.msg import Transform as TransformMsg

from omniman_ros.conversions.headers import check_frame
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.rigid import Transform, heading


def yaw_from_quaternion(quaternion: Quaternion) -> float:
    """Return the heading of a rotation in the plane [rad], in (-pi, pi].

    Raises:
        InputError: The quaternion is not finite, not of unit length, or not about the vertical.
    """
    return heading((quaternion.x, quaternion.y, quaternion.z, quaternion.w))


def quaternion_from_yaw(theta: float) -> Quaternion:
    """Return the rotation about the vertical by `theta` [rad]."""
    return Quaternion(x=0.0, y=0.0, z=math.sin(0.5 * theta), w=math.cos(0.5 * theta))


def transform_from_message(message: TransformMsg) -> Transform:
    """Return the transform of a message [m], as it is: nothing is checked."""
    t, r = message.translation, message.rotation
    return Transform((t.x, t.y, t.z), (r.x, r.y, r.z, r.w))


def twist_array(message: Twist, bound: float = plausible.SPEED) -> Array:
    """Return x, y and rotation about z (3,) of a twist or an acceleration, in its unit.

    Args:
        message: Twist [m/s, rad/s] or acceleration [m/s^2, rad/s^2].
        bound: Largest plausible magnitude of each of its six numbers, in its unit.

    Raises:
        InputError: One of the six numbers is not finite or beyond +-`bound`.
    """
    linear, angular = message.linear, message.angular
    numbers = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
    plausible.demand(np.array(numbers), bound, "linear and angular")
    return np.array([linear.x, linear.y, angular.z])


def stamped_twist_array(message: TwistStamped, base_frame: str) -> Array:
    """Return the body twist (3,) of a message [m/s, m/s, rad/s]; an empty frame is base.

    Raises:
        InputError: The frame is another one, or a number is not finite.
    """
    check_frame(message.header.frame_id, base_frame, "")
    return twist_array(message.twist)
