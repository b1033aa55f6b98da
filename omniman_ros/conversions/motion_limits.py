"""Convert limits of the speed, and motions that are asked for, to and from joint states."""

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import JointState

from omniman_ros.conversions.joints import joint_arrays, require_array
from omniman_ros.core import plausible
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError

#: Names in `motion_limit`; the velocities are fractions of the speed limits, 0 to 1
LIMITED = ("platform", "arm")
#: Names of the platform's twist in `motion_demand`: along x and y of base_link, and about z
TWIST = ("base_x", "base_y", "base_theta")


def motion_limit_message(platform: float, arm: float, stamp: Time) -> JointState:
    """Return the message of the fractions of the speed limits that platform and arm may use."""
    message = JointState(name=list(LIMITED), velocity=[platform, arm])
    message.header.stamp = stamp
    return message


def motion_limit_fractions(message: JointState) -> tuple[float, float]:
    """Return the fractions of the speed limits in a message, for platform and arm.

    Raises:
        InputError: A name or a value is missing, or a value is not 0 to 1.
    """
    _, velocity, _ = joint_arrays(message, LIMITED)
    fractions = require_array(velocity, 1.0, "velocity (share)")
    if float(fractions.min()) < 0.0:
        raise InputError(f"the shares {fractions.tolist()} must be 0 to 1")
    platform, arm = fractions.tolist()
    return platform, arm


def motion_demand_message(
    joints: Sequence[str], motion: Sequence[float], stamp: Time, frame: str
) -> JointState:
    """Return the message of a motion that is asked for.

    Args:
        motion: Twist in base_link and rates of these joints [m/s, m/s, rad/s, rad/s ...].
    """
    message = JointState(name=[*TWIST, *joints], velocity=list(motion))
    message.header.stamp, message.header.frame_id = stamp, frame
    return message


def demanded_motion(message: JointState, joints: Sequence[str]) -> Array:
    """Return the motion (9,) in a message: twist in base_link, and joint rates, zero if absent.

    Raises:
        InputError: There is neither a twist nor joints, a part of them is missing, or a value is
            implausible.
    """
    parts = [part for part in (TWIST, joints) if not set(part).isdisjoint(message.name)]
    names = [name for part in parts or (TWIST,) for name in part]
    _, velocity, _ = joint_arrays(message, names)
    motion = require_array(velocity, plausible.SPEED, "velocity")
    result: Array = np.zeros(len(TWIST) + len(joints))
    begin = 0 if TWIST in parts else len(TWIST)
    result[begin : begin + len(motion)] = motion
    return result
