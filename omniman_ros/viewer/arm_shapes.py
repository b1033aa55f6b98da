"""The UR5 as cylinders: where each one is at given joint angles.

Sizes and frames are those of the robot's description. All parts of a kind are instances of one
mesh, so that a pose of the arm costs two arrays a kind, however many parts there are.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arm_model import JOINTS, UR5, DhTable
from omniman_ros.core.body.model import Mount
from omniman_ros.description.inertia import Vector
from omniman_ros.description.ur5 import BASE, Link, Tube, links

Array = NDArray[np.float64]

START, END = -1, 1
CAPS = (
    (1, 0, END), (2, 1, END), (2, 2, START), (2, 2, END), (3, 1, START), (4, 0, END), (5, 0, END),
)  # fmt: skip
"""Ends of tubes that a cap closes: link (0 is the base), tube, which end."""
WIDER = 1.03
"""Radius of a cap over that of its tube."""


@dataclass(frozen=True)
class Parts:
    """Instances of one mesh on the links.

    Attributes:
        link: (N,) whose, 0 is the base.
        positions: (N, 3) in the link's frame [m].
        rotations: (N, 4) quaternions (w, x, y, z) likewise.
        scales: (N, 3) along the mesh's own axes.
    """

    link: NDArray[np.int64]
    positions: Array
    rotations: Array
    scales: Array


class ArmShape:
    """The arm on its platform.

    Args:
        mount: Where it stands.
        table: Lengths of the arm.

    Attributes:
        tubes: Of a cylinder about z of radius 1 and length 1.
        caps: Of a dome upon z of radius 1.
    """

    def __init__(self, mount: Mount, table: DhTable = UR5) -> None:
        chain = (BASE, *links(table))
        self.tubes = _parts(
            (k, _centre(tube), quaternion(tube.rpy), (tube.radius, tube.radius, tube.length))
            for k, link in enumerate(chain)
            for tube in link.tubes
        )
        self.caps = _parts(_cap(chain[k], k, tube, end) for k, tube, end in CAPS)
        self._root = np.array([mount.x, mount.y, mount.z]), quaternion((0.0, 0.0, mount.yaw))
        self._steps = np.array([link.place for link in chain])
        self._turns = np.array([quaternion(link.rpy) for link in chain])

    def frames(self, angles: Array) -> tuple[Array, Array]:
        """Frames of base and links in base_link: positions (7, 3) [m], quaternions (7, 4).

        Args:
            angles: Of the joints (6,) [rad].
        """
        halves = 0.5 * np.concatenate([[0.0], angles])
        joints = np.zeros((JOINTS + 1, 4))
        joints[:, 0], joints[:, 3] = np.cos(halves), np.sin(halves)
        by = _by(product(self._turns, joints))
        rotations = np.empty((JOINTS + 2, 4))
        rotations[0] = self._root[1]
        for k in range(JOINTS + 1):
            rotations[k + 1] = rotations[k] @ by[k]
        positions = self._root[0] + np.cumsum(turned(rotations[:-1], self._steps), axis=0)
        return positions, rotations[1:]

    @staticmethod
    def placed(parts: Parts, frames: tuple[Array, Array]) -> tuple[Array, Array]:
        """Positions (N, 3) [m] and quaternions (N, 4) of parts on links with these frames."""
        positions, rotations = frames[0][parts.link], frames[1][parts.link]
        return (
            positions + turned(rotations, parts.positions),
            product(rotations, parts.rotations),
        )


def quaternion(rpy: Vector) -> Array:
    """Quaternion (w, x, y, z) of a turn about x, then y, then z, all of them fixed [rad]."""
    roll, pitch, yaw = (0.5 * angle for angle in rpy)
    about_x = np.array([math.cos(roll), math.sin(roll), 0.0, 0.0])
    about_y = np.array([math.cos(pitch), 0.0, math.sin(pitch), 0.0])
    about_z = np.array([math.cos(yaw), 0.0, 0.0, math.sin(yaw)])
    return product(product(about_z, about_y), about_x)


def product(first: Array, second: Array) -> Array:
    """Products (..., 4) of quaternions (..., 4): the second turn in the frame of the first."""
    result: Array = (first[..., None, :] @ _by(second))[..., 0, :]
    return result


def turned(rotations: Array, vectors: Array) -> Array:
    """Vectors (..., 3) after turns by quaternions (..., 4)."""
    pure = np.concatenate([np.zeros((*vectors.shape[:-1], 1)), vectors], axis=-1)
    result: Array = product(product(rotations, pure), rotations * _BACK)[..., 1:]
    return result


_BACK = np.array([1.0, -1.0, -1.0, -1.0])
_HAMILTON: Array = np.zeros((4, 16))
"""Products of 1, i, j, k: row the second, column four times the first and their product."""
for _first, _second, _both, _sign in (
    (0, 0, 0, 1), (0, 1, 1, 1), (0, 2, 2, 1), (0, 3, 3, 1),
    (1, 0, 1, 1), (1, 1, 0, -1), (1, 2, 3, 1), (1, 3, 2, -1),
    (2, 0, 2, 1), (2, 1, 3, -1), (2, 2, 0, -1), (2, 3, 1, 1),
    (3, 0, 3, 1), (3, 1, 2, 1), (3, 2, 1, -1), (3, 3, 0, -1),
):  # fmt: skip
    _HAMILTON[_second, 4 * _first + _both] = _sign


def _by(rotations: Array) -> Array:
    """Matrices (..., 4, 4): a quaternion from the left times one of them is their product."""
    result: Array = (rotations @ _HAMILTON).reshape(*rotations.shape[:-1], 4, 4)
    return result


Part = tuple[int, Array, Array, Vector]


def _centre(tube: Tube) -> Array:
    return np.array(tube.centre)


def _cap(link: Link, k: int, index: int, end: int) -> Part:
    tube = link.tubes[index]
    turn = quaternion(tube.rpy)
    if end == START:
        turn = product(turn, quaternion((math.pi, 0.0, 0.0)))
    radius = WIDER * tube.radius
    place = np.array(tube.end if end == END else tube.start)
    return k, place, turn, (radius, radius, radius)


def _parts(parts: Iterable[Part]) -> Parts:
    link, positions, rotations, scales = zip(*parts, strict=True)
    return Parts(np.array(link), np.array(positions), np.array(rotations), np.array(scales))
