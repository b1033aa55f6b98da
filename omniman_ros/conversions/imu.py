"""Convert measurements of an inertial measurement unit to messages and back."""

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped, Vector3
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.imu_mount import ImuMount

#: First entry of the covariance of a quantity that is not measured (sensor_msgs/Imu)
UNKNOWN = -1.0


def imu_message(rate: Array, acceleration: Array, frame: str, stamp: Time) -> Imu:
    """Return the message for a sensor that does not measure its orientation.

    Args:
        rate: Angular velocity (3,) in the sensor's frame [rad/s].
        acceleration: Acceleration (3,) with gravity [m/s^2].
    """
    message = Imu(header=Header(stamp=stamp, frame_id=frame))
    message.orientation_covariance[0] = UNKNOWN
    for vector, values in (
        (message.angular_velocity, rate),
        (message.linear_acceleration, acceleration),
    ):
        vector.x, vector.y, vector.z = values.tolist()
    return message


def imu_arrays(message: Imu, frame: str) -> tuple[Array, Array]:
    """Return angular velocity (3,) [rad/s] and acceleration (3,) [m/s^2] of a message.

    Raises:
        InputError: It has another frame, or says that one of the two is not measured.
    """
    if message.header.frame_id != frame:
        raise InputError(f"the frame is '{message.header.frame_id[:40]}', expected '{frame}'")
    for label, covariance in (
        ("angular velocity", message.angular_velocity_covariance),
        ("linear acceleration", message.linear_acceleration_covariance),
    ):
        if covariance[0] == UNKNOWN:
            raise InputError(f"it says that it has no {label}: its covariance begins with -1")
    rate, force = message.angular_velocity, message.linear_acceleration
    return np.array([rate.x, rate.y, rate.z]), np.array([force.x, force.y, force.z])


def imu_transform(mount: ImuMount, base_frame: str, stamp: Time) -> TransformStamped:
    """Return the pose of the sensor in the base frame."""
    result = TransformStamped(
        header=Header(stamp=stamp, frame_id=base_frame), child_frame_id=mount.frame
    )
    result.transform.translation = Vector3(x=mount.x, y=mount.y, z=mount.z)
    result.transform.rotation = quaternion_from_yaw(mount.yaw)
    return result
