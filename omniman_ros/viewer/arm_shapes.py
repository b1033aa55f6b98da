"""The UR5 as cylinders: positions and rotations of all of them at given joint angles.

Sizes and frames are those of the robot's description. All parts of a kind are instances of one
mesh, so that a pose of the arm costs two arrays per kind, however many parts there are.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array
from omniman_ros.description.inertia import Vector
from omniman_ros.description.ur5 import BASE, Link, links
from omniman_ros.motion.whole_body.model import Mount

START = -1  #: Value of the field `end` in `CAPS` for the start of a tube
END = 1  #: Value of the field `end` in `CAPS` for the end of a tube
CAPS = (
    (1, 0, END),
    (2, 1, END),
    (2, 2, START),
    (2, 2, END),
    (3, 1, START),
    (4, 0, END),
    (5, 0, END),
)  #: Ends of tubes that a cap closes: index of the link (0: base), index of its tube, and `end`
CAP_RADIUS_RATIO = 1.03  #: Ratio of a cap's radius to that of its tube


@dataclass(frozen=True)
class Parts:
    """Instances of one mesh on the links."""

    link: NDArray[np.int64]  #: (N,) indices of the instances' links, 0 for the base
    positions: Array  #: (N, 3) positions in the frames of the links [m]
    rotations: Array  #: (N, 4) quaternions (w, x, y, z) in the frames of the links
    scales: Array  #: (N, 3) scale factors along the axes of the mesh


class ArmShape:
    """The arm on its platform: tubes, cylinders of radius and length 1 along z, and caps."""

    def __init__(self, mount: Mount) -> None:
        chain = (BASE, *links())
        self.tubes = _parts(
            (
                k,
                np.array(tube.centre),
                quaternion(tube.rpy),
                (tube.radius, tube.radius, tube.length),
            )
            for k, link in enumerate(chain)
            for tube in link.tubes
        )
        #: Instances of a dome along z of radius 1
        self.caps = _parts(_cap(chain[k], k, tube, end) for k, tube, end in CAPS)
        self._root = np.array([mount.x, mount.y, mount.z]), quaternion((0.0, 0.0, mount.yaw))
        self._link_offsets = np.array([link.place for link in chain])
        self._link_rotations = np.array([quaternion(link.rpy) for link in chain])

    def frames(self, angles: Array) -> tuple[Array, Array]:
        """Return the frames of base and links in `base_link` at joint angles (6,) [rad].

        Returns:
            Positions (7, 3) [m] and quaternions (7, 4), (w, x, y, z).
        """
        halves = 0.5 * np.concatenate([[0.0], angles])
        joints = np.zeros((JOINTS + 1, 4))
        joints[:, 0], joints[:, 3] = np.cos(halves), np.sin(halves)
        factors = _right_factors(product(self._link_rotations, joints))
        rotations = np.empty((JOINTS + 2, 4))
        rotations[0] = self._root[1]
        for k in range(JOINTS + 1):
            rotations[k + 1] = rotations[k] @ factors[k]
        positions = self._root[0] + np.cumsum(rotated(rotations[:-1], self._link_offsets), axis=0)
        return positions, rotations[1:]

    @staticmethod
    def placed(parts: Parts, frames: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return positions (N, 3) [m] and quaternions (N, 4) of parts in `base_link`."""
        positions, rotations = frames[0][parts.link], frames[1][parts.link]
        return (
            positions + rotated(rotations, parts.positions),
            product(rotations, parts.rotations),
        )


def quaternion(rpy: Vector) -> Array:
    """Return the quaternion (w, x, y, z) of rotations about fixed x, then y, then z [rad]."""
    roll, pitch, yaw = (0.5 * angle for angle in rpy)
    about_x = np.array([math.cos(roll), math.sin(roll), 0.0, 0.0])
    about_y = np.array([math.cos(pitch), 0.0, math.sin(pitch), 0.0])
    about_z = np.array([math.cos(yaw), 0.0, 0.0, math.sin(yaw)])
    return product(product(about_z, about_y), about_x)


def product(first: Array, second: Array) -> Array:
    """Return the products (..., 4) of quaternions: `second` rotates in the frame of `first`."""
    result: Array = (first[..., None, :] @ _right_factors(second))[..., 0, :]
    return result


def rotated(rotations: Array, vectors: Array) -> Array:
    """Return vectors (..., 3) rotated by quaternions (..., 4)."""
    pure = np.concatenate([np.zeros((*vectors.shape[:-1], 1)), vectors], axis=-1)
    result: Array = product(product(rotations, pure), rotations * _CONJUGATION)[..., 1:]
    return result


_CONJUGATION = np.array([1.0, -1.0, -1.0, -1.0])  #: Signs of a quaternion's conjugate

#: Multiplication table of 1, i, j, k.
#:
#: The row is the index of the second factor, the column four times that of the first factor plus
#: that of the product; the value is the sign.
_HAMILTON: Array = np.zeros((4, 16))
for _first, _second, _both, _sign in (
    (0, 0, 0, 1),
    (0, 1, 1, 1),
    (0, 2, 2, 1),
    (0, 3, 3, 1),
    (1, 0, 1, 1),
    (1, 1, 0, -1),
    (1, 2, 3, 1),
    (1, 3, 2, -1),
    (2, 0, 2, 1),
    (2, 1, 3, -1),
    (2, 2, 0, -1),
    (2, 3, 1, 1),
    (3, 0, 3, 1),
    (3, 1, 2, 1),
    (3, 2, 1, -1),
    (3, 3, 0, -1),
):
    _HAMILTON[_second, 4 * _first + _both] = _sign


def _right_factors(rotations: Array) -> Array:
    """Return the matrices (..., 4, 4) by which row quaternions are multiplied from the right."""
    result: Array = (rotations @ _HAMILTON).reshape(*rotations.shape[:-1], 4, 4)
    return result


#: Index of the link, position [m], quaternion and scales of an instance, as in `Parts`
Part = tuple[int, Array, Array, Vector]


def _cap(link: Link, k: int, index: int, end: int) -> Part:
    tube = link.tubes[index]
    rotation = quaternion(tube.rpy)
    if end == START:
        rotation = product(rotation, quaternion((math.pi, 0.0, 0.0)))
    radius = CAP_RADIUS_RATIO * tube.radius
    position = np.array(tube.end if end == END else tube.start)
    return k, position, rotation, (radius, radius, radius)


def _parts(parts: Iterable[Part]) -> Parts:
    link, positions, rotations, scales = zip(*parts, strict=True)
    return Parts(np.array(link), np.array(positions), np.array(rotations), np.array(scales))
