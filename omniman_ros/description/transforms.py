"""Transforms of frames that are given as URDF gives them."""

import math

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.description.inertia import Vector


def transform(position: Vector, rpy: Vector) -> Array:
    """Return the pose (4, 4) of a frame: origin [m], rotations about fixed x, y, z [rad]."""
    (cr, cp, cy), (sr, sp, sy) = ([f(a) for a in rpy] for f in (math.cos, math.sin))
    result = np.eye(4)
    result[:3, :3] = (
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    )
    result[:3, 3] = position
    return result
