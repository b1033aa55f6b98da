"""Rotations of the tool that its path leaves free: about an axis, and of the axis in a cone.

In a frame C at the point that is held, with z along the free axis, the tool is turned by

    E(f) = exp(t) Rz(phi),  t = (sin r / r) w,  r = |w| / h,

where f = (phi, w) are the free coordinates, phi about the axis and w (2,) of its tilt t, a
horizontal rotation vector, and h is the half angle of the cone, less a reserve. So |t| <= h for
any w, and no plan leaves the cone. Without a cone, f = (phi,).
"""

import itertools
import math

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.motion.whole_body.tool_curve import SMALL, swing_rate, tilted, upright
from omniman_ros.planning.whole_body.parameters import OrientationFreedom

#: Rotations with z along each axis of `tool0`
AXES = {
    "x": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "y": np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    "z": np.eye(3),
}
USED = 0.98  #: Fraction of the cone that plans use; the rest is for errors of what is executed
#: Bound of each component of w over h: the tilt is greatest at pi / 2, and near it beyond
BOUND = 1.3


class FreeOrientation:
    """The free coordinates f (d,) of the tool's orientation: 1 of an axis, 3 with a cone.

    Attributes:
        cone: Half angle h of the cone; 0: none [rad].
        bound: Largest coordinates (d,) [rad].
    """

    def __init__(self, freedom: OrientationFreedom) -> None:
        self.cone = USED * freedom.cone
        axis = AXES[freedom.free_axis]
        self._frame: Array = np.eye(4)
        self._frame[:3, :3], self._frame[:3, 3] = axis, freedom.pivot * axis[:, 2]
        self._back: Array = np.array(np.linalg.inv(self._frame), dtype=np.float64)
        tilt = [BOUND * self.cone] * 2 if self.cone > 0.0 else []
        self.bound = np.array([math.inf, *tilt])

    def turned(self, poses: Array, f: Array) -> Array:
        """Return poses (k, 4, 4) of the tool that is turned by f (k, d) from poses (k, 4, 4)."""
        turn = np.zeros((len(f), 4, 4))
        turn[:, :3, :3], turn[:, 3, 3] = self._rotation(f), 1.0
        result: Array = poses @ (self._frame @ turn @ self._back)
        return result

    def motion(self, pose: Array, twist: Array, f: Array) -> tuple[Array, Array]:
        """Return turned poses (k, 4, 4), and their twists (k, 6, 1 + d) by s and by f.

        Args:
            pose: Poses (k, 4, 4) of the path.
            twist: Its twists (k, 6) per s.
        """
        tool = self.turned(pose, f)
        held, lever = self._levers(pose, tool)
        spins = np.concatenate(
            [twist[:, 3:, None], pose[:, :3, :3] @ self._frame[:3, :3] @ self._spins(f)], axis=2
        )
        linear = np.cross(spins, lever[:, :, None], axis=1)
        linear[:, :, 0] += twist[:, :3] + np.cross(twist[:, 3:], held)
        return tool, np.concatenate([linear, spins], axis=1)

    def change(
        self, pose: Array, twist: Array, bend: Array, f: Array, speed: Array, rates: Array
    ) -> Array:
        """Return the accelerations (k, 6) of the tool while s' (k,) and f' (k, d) do not change.

        Args:
            bend: Derivatives (k, 6) by s of the twists of the path.
        """
        held, lever = self._levers(pose, self.turned(pose, f))
        axes = pose[:, :3, :3] @ self._frame[:3, :3]
        along, along_change = speed[:, None] * twist, speed[:, None] ** 2 * bend
        step = SMALL * rates
        ahead, behind = (self._spin(f + change, rates) for change in (step, -step))
        own = _times(axes, self._spin(f, rates))
        spin = along[:, 3:] + own
        spin_change = along_change[:, 3:] + np.cross(along[:, 3:], own)
        spin_change += _times(axes, (ahead - behind) / (2.0 * SMALL))
        linear = along_change[:, :3] + _swung(along_change[:, 3:], along[:, 3:], held)
        linear += _swung(spin_change, spin, lever)
        return np.hstack([linear, spin_change])

    def path_of(
        self, start: Array, poses: Array, goal: Array | None = None
    ) -> tuple[Array, Array]:
        """Return the path (k + 1, 4, 4) to which the freedom refers, and f (d,) at its start.

        Rotations about the free axis are taken out of poses (k, 4, 4). The axis begins where the
        first of them has it, or as near as the cone around where it is at the start (4, 4) allows.

        Args:
            goal: Pose (4, 4) to whose axis all poses are tilted likewise, as far as the cone
                allows: they are those of a tool that is in it already; None: they stay.
        """
        frames = np.concatenate([start[None], poses]) @ self._frame
        axis = frames[1, :3, 2] if goal is None else (goal @ self._frame)[:3, 2]
        away = self._tilts_within(frames[:, :3, :3], axis)
        if goal is None:
            away[1:] = 0.0
        frames[:, :3, :3] = frames[:, :3, :3] @ tilted(away)
        for before, frame in itertools.pairwise(frames[:, :3, :3]):
            frame[:] = before @ tilted(_tilt_to(before, frame[:, 2])[None])[0]
        f = np.zeros(len(self.bound))
        if len(f) > 1:
            size = float(np.linalg.norm(away[0]))
            r = math.asin(min(size / self.cone, 1.0))
            f[1:] = -self.cone * r / max(size, SMALL) * away[0]
        return frames @ self._back, f

    def tilt(self, f: Array) -> Array:
        """Return the tilts (k, 2) of the axis at f (k, 3) [rad]."""
        w = f[:, 1:]
        r = np.linalg.norm(w, axis=1, keepdims=True) / self.cone
        result: Array = np.sinc(r / math.pi) * w
        return result

    def _tilts_within(self, rotations: Array, axis: Array) -> Array:
        """Return tilts (k, 2) of rotations (k, 3, 3) to an axis (3,), in the cone at most."""
        tilts = np.stack([_tilt_to(rotation, axis) for rotation in rotations])
        size = np.linalg.norm(tilts, axis=1, keepdims=True)
        result: Array = tilts * np.where(size > self.cone, self.cone / np.maximum(size, SMALL), 1)
        return result

    def _rotation(self, f: Array) -> Array:
        about = upright(f[:, 0])
        return about if f.shape[1] == 1 else tilted(self.tilt(f)) @ about

    def _spins(self, f: Array) -> Array:
        """Return the angular velocities (k, 3, d) by f, in the frame C."""
        k, d = f.shape
        result = np.zeros((k, 3, d))
        if d == 1:
            result[:, 2, 0] = 1.0
            return result
        tilt, w = self.tilt(f), f[:, 1:]
        result[:, :, 0] = tilted(tilt)[:, :, 2]
        size = np.linalg.norm(w, axis=1)
        r = size / self.cone
        direction = w / np.maximum(size, SMALL)[:, None]
        sine = np.sinc(r / math.pi)
        for j in (0, 1):
            change = (np.cos(r) - sine)[:, None] * direction * direction[:, j : j + 1]
            change[:, j] += sine
            result[:, :, 1 + j] = swing_rate(tilt, change)
        return result

    def _spin(self, f: Array, rates: Array) -> Array:
        """Return the angular velocity (k, 3) at rates f' (k, d), in the frame C."""
        return _times(self._spins(f), rates)

    def _levers(self, pose: Array, tool: Array) -> tuple[Array, Array]:
        """Return the vectors (k, 3) from the path to the point that is held, and from it on."""
        held = _times(pose[:, :3, :3], np.broadcast_to(self._frame[:3, 3], (len(pose), 3)))
        return held, tool[:, :3, 3] - pose[:, :3, 3] - held


def _tilt_to(rotation: Array, axis: Array) -> Array:
    """Return the tilt (2,) by which the z axis of a rotation (3, 3) becomes an axis (3,)."""
    x, y, z = (rotation.T @ axis).tolist()
    size = math.hypot(x, y)
    if size < SMALL * SMALL:
        return np.array([0.0 if z > 0.0 else math.pi, 0.0])
    return math.atan2(size, z) / size * np.array([-y, x])


def _swung(change: Array, spin: Array, lever: Array) -> Array:
    """Return the accelerations (k, 3) at the ends of levers (k, 3) that turn."""
    result: Array = np.cross(change, lever) + np.cross(spin, np.cross(spin, lever))
    return result


def _times(matrix: Array, vectors: Array) -> Array:
    """Return the products (k, i) of matrices (k, i, j) and vectors (k, j)."""
    result: Array = (matrix @ vectors[:, :, None])[:, :, 0]
    return result
