"""Forward kinematics of a UR arm by its Denavit-Hartenberg table, and gravity torques."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array


@dataclass(frozen=True)
class DhParameters:
    """Denavit-Hartenberg parameters, joint by joint: T = Rz(q) Tz(d) Tx(a) Rx(alpha)."""

    a: tuple[float, ...]  #: Link lengths [m]
    d: tuple[float, ...]  #: Link offsets [m]
    alpha: tuple[float, ...]  #: Link twists [rad]


UR5 = DhParameters(
    a=(0.0, -0.425, -0.39225, 0.0, 0.0, 0.0),
    d=(0.089159, 0.0, 0.0, 0.10915, 0.09465, 0.0823),
    alpha=(math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0),
)  #: Universal Robots, "DH parameters for calculations of kinematics and dynamics", UR5

GRAVITY = 9.82  #: Gravity [m/s^2]
ELBOW = 2  #: Number of the frame at the elbow joint


def frames(q: Array, table: DhParameters = UR5) -> list[Array]:
    """Return the frames of base, links and tool flange in the base: seven 4 x 4 matrices."""
    transforms = [np.eye(4)]
    for angle, a, d, alpha in zip(q.tolist(), table.a, table.d, table.alpha, strict=True):
        c, s, ca, sa = math.cos(angle), math.sin(angle), math.cos(alpha), math.sin(alpha)
        step = np.array(
            [
                [c, -s * ca, s * sa, a * c],
                [s, c * ca, -c * sa, a * s],
                [0.0, sa, ca, d],
                [0.0, 0.0, 0.0, 1.0],
            ]
        )
        transforms.append(transforms[-1] @ step)
    return transforms


def pose(q: Array, table: DhParameters = UR5) -> Array:
    """Return the tool flange in the base: x, y, z [m] and rotation vector [rad], shape (6,)."""
    end = frames(q, table)[-1]
    return np.concatenate((end[:3, 3], rotation_vector(end[:3, :3])))


def rotation_vector(rotation: Array) -> Array:
    """Return axis times angle, 0 to pi [rad], of a rotation matrix (3, 3)."""
    skew = np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    sine, cosine = 0.5 * float(np.linalg.norm(skew)), 0.5 * (float(np.trace(rotation)) - 1.0)
    angle = math.atan2(sine, cosine)
    if sine > 1e-6:
        return np.asarray(skew * (0.5 * angle / sine))
    if cosine > 0.0:
        return np.asarray(0.5 * skew)
    # The angle is pi: the symmetric part has the axis in the column of its largest diagonal.
    symmetric = 0.5 * (rotation + np.eye(3))
    axis = symmetric[:, int(np.argmax(np.diag(symmetric)))]
    signed_angle = math.copysign(angle, float(axis @ skew))
    return np.asarray(axis * (signed_angle / float(np.linalg.norm(axis))))


def twist(q: Array, qd: Array, link: int = 6) -> Array:
    """Return the twist (6,) of frame `link` in the base [m/s, rad/s]; 6 is the tool flange.

    Args:
        q: Joint angles [rad].
        qd: Joint speeds [rad/s].
    """
    chain = frames(q)
    point, result = chain[link][:3, 3], np.zeros(6)
    for frame, speed in zip(chain[:link], qd.tolist(), strict=False):
        axis = frame[:3, 2]
        result[:3] += speed * np.cross(axis, point - frame[:3, 3])
        result[3:] += speed * axis
    return result
