"""Rigid transforms in space as plain numbers, as they are composed many times a second."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core import se2
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.repairs import note_repair

Vector = tuple[float, float, float]  #: A vector (x, y, z)
Quaternion = tuple[float, float, float, float]  #: A rotation (x, y, z, w) of unit length
PlanarPose = tuple[float, float, float]  #: A pose in the plane: x [m], y [m], heading [rad]

UNIT_TOLERANCE = 0.05  #: Largest deviation of a quaternion's length from 1 that is accepted
ROUNDING = 0.01  #: Deviation of a quaternion's length from 1 above which that is noted
TILT_TOLERANCE = 0.02  #: Largest tilt of a planar rotation that is accepted [rad, approximately]
#: Cosine of the half angle between rotations above which they are interpolated linearly [-]
NEARLY_PARALLEL = 1.0 - 1e-6


@dataclass(frozen=True, slots=True)
class Transform:
    """Pose of a frame in another frame; it takes coordinates from the former to the latter."""

    translation: Vector = (0.0, 0.0, 0.0)  #: Origin of the frame [m]
    rotation: Quaternion = (0.0, 0.0, 0.0, 1.0)  #: Rotation of the frame, of unit length

    @staticmethod
    def of_planar(pose: PlanarPose) -> "Transform":
        """Return the transform of a pose on the floor [m, m, rad]."""
        x, y, theta = pose
        rotation = (0.0, 0.0, math.sin(0.5 * theta), math.cos(0.5 * theta))
        return Transform((x, y, 0.0), rotation)

    def __matmul__(self, other: "Transform") -> "Transform":
        """Return the transform that applies `other` first."""
        x, y, z = self.rotated(other.translation)
        tx, ty, tz = self.translation
        translation = (tx + x, ty + y, tz + z)
        return Transform(translation, _product(self.rotation, other.rotation))

    @property
    def inverse(self) -> "Transform":
        """The transform back."""
        x, y, z, w = self.rotation
        back = Transform((0.0, 0.0, 0.0), (-x, -y, -z, w))
        tx, ty, tz = back.rotated(self.translation)
        return Transform((-tx, -ty, -tz), back.rotation)

    def rotated(self, vector: Vector) -> Vector:
        """Return a vector, whose origin does not matter, in the other frame.

        For a unit quaternion (q, w), v' = v + 2 w (q x v) + 2 q x (q x v).
        """
        x, y, z, w = self.rotation
        a, b, c = vector
        u, v, s = 2.0 * (y * c - z * b), 2.0 * (z * a - x * c), 2.0 * (x * b - y * a)
        return (
            a + w * u + y * s - z * v,
            b + w * v + z * u - x * s,
            c + w * s + x * v - y * u,
        )

    def matrix(self) -> Array:
        """Return the homogeneous matrix (4, 4)."""
        result = np.eye(4)
        for i, axis in enumerate(((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))):
            result[:3, i] = self.rotated(axis)
        result[:3, 3] = self.translation
        return result

    def planar(self) -> PlanarPose:
        """Return the pose of the frame on the floor [m, m, rad]; its height is left out.

        Raises:
            InputError: The frame is tilted.
        """
        return self.translation[0], self.translation[1], heading(self.rotation)

    def interpolated(self, other: "Transform", fraction: float) -> "Transform":
        """Return the transform between this one (share 0) and another one (share 1).

        Positions are interpolated linearly, rotations at a constant rate about a fixed axis on the
        shorter way (slerp), as tf2 does.
        """
        left, right = 1.0 - fraction, fraction
        translation = tuple(
            left * a + right * b for a, b in zip(self.translation, other.translation, strict=True)
        )
        cosine = sum(a * b for a, b in zip(self.rotation, other.rotation, strict=True))
        sign, cosine = math.copysign(1.0, cosine), abs(cosine)
        if cosine < NEARLY_PARALLEL:
            angle = math.acos(cosine)
            left = math.sin(left * angle) / math.sin(angle)
            right = math.sin(right * angle) / math.sin(angle)
        rotation = [
            left * a + sign * right * b for a, b in zip(self.rotation, other.rotation, strict=True)
        ]
        size = math.hypot(*rotation)
        x, y, z, w = (value / size for value in rotation)
        tx, ty, tz = translation
        return Transform((tx, ty, tz), (x, y, z, w))


IDENTITY = Transform()  #: Transform of a frame into itself
UPSIDE_DOWN = Transform(rotation=(1.0, 0.0, 0.0, 0.0))  #: Half turn about the x axis


def demand_unit(rotation: Quaternion) -> float:
    """Return the length of a quaternion, which is nearly 1; note it if it is only roughly so.

    Raises:
        InputError: The quaternion is not finite, or not of unit length.
    """
    length = math.hypot(*rotation)
    if not abs(length - 1.0) <= UNIT_TOLERANCE:
        raise InputError(f"it has a quaternion of length {length:.4g}, expected 1")
    if abs(length - 1.0) > ROUNDING:
        note_repair(f"a quaternion of length {length:.4g} was normalised")
    return length


def heading(rotation: Quaternion) -> float:
    """Return the heading of a rotation in the plane [rad], in (-pi, pi].

    Raises:
        InputError: The quaternion is not finite, not of unit length, or not about the vertical.
    """
    length = demand_unit(rotation)
    x, y, z, w = rotation
    if 2.0 * math.hypot(x, y) > TILT_TOLERANCE * length:
        raise InputError("it has a rotation that is not about the vertical")
    return se2.wrap(2.0 * math.atan2(z, w))


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )
