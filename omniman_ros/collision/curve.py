"""Poses on the curve of a constant twist."""

import numpy as np

from omniman_ros.core.arrays import Array


def curve_poses(pose: Array, twist: Array, times: Array) -> Array:
    """Return the poses (K, 3) that a constant twist in base_link leads to at times (K,) [s].

    Args:
        pose: Pose (3,) at time zero [m, m, rad].
        twist: Twist (3,) in base_link [m/s, m/s, rad/s].
    """
    x, y, angle = (times * each for each in twist.tolist())
    # The chord of an arc of this angle is sinc(angle / 2) times its length, at half the angle.
    chord = np.sinc(0.5 * angle / np.pi)
    heading = pose[2] + 0.5 * angle
    c, s = chord * np.cos(heading), chord * np.sin(heading)
    return np.column_stack((pose[0] + c * x - s * y, pose[1] + s * x + c * y, pose[2] + angle))
