"""Kinematics of arms like the UR5: forward, Jacobian, and all inverse solutions in closed form.

Frames are those of the controller: base z up along the first joint's axis, `tool0` at the flange.
Source: DH table of Universal Robots (UR5); K. P. Hawkins, "Analytic Inverse Kinematics for the
Universal Robots UR-5/UR-10 Arms" (2013), for the order of the inverse.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

JOINTS, BRANCHES = 6, 8
SIGNS = tuple(
    (shoulder, wrist, elbow)
    for shoulder in (1.0, -1.0)
    for wrist in (1.0, -1.0)
    for elbow in (1.0, -1.0)
)
"""Of each branch: shoulder, wrist, elbow."""
TWISTS = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)
"""alpha of each joint [rad]."""
SINGULAR = 1e-3
"""Sines, and distances over the arm's length, below it are a singularity."""
ROUNDING = 1e-9
"""By which a cosine may be beyond +-1: a pose at the edge of the reach."""


@dataclass(frozen=True)
class DhTable:
    """Lengths of an arm of this kind [m].

    Attributes:
        d1, d4, d5, d6: Offsets along the joints' axes.
        a2, a3: Lengths of upper arm and forearm; negative, as the table has them.
    """

    d1: float = 0.089159
    a2: float = -0.425
    a3: float = -0.39225
    d4: float = 0.10915
    d5: float = 0.09465
    d6: float = 0.0823


UR5 = DhTable()


class ArmModel:
    """Kinematics of a six-joint arm with three parallel axes.

    Args:
        table: Its lengths.
    """

    def __init__(self, table: DhTable = UR5) -> None:
        self.table = t = table
        self._d: Array = np.array([t.d1, 0.0, 0.0, t.d4, t.d5, t.d6])
        self._a: Array = np.array([0.0, t.a2, t.a3, 0.0, 0.0, 0.0])
        self._cos, self._sin = np.round(np.cos(TWISTS), 15), np.sin(TWISTS)

    def frames(self, q: Array) -> Array:
        """Poses (..., 7, 4, 4) of the base and of the frame behind each joint, in the base.

        Args:
            q: Joint angles (..., 6) [rad].
        """
        shape = q.shape[:-1]
        frames = np.empty((*shape, JOINTS + 1, 4, 4))
        frames[..., 0, :, :] = np.eye(4)
        for i in range(JOINTS):
            frames[..., i + 1, :, :] = frames[..., i, :, :] @ self._link(q[..., i], i)
        return frames

    def forward(self, q: Array) -> Array:
        """Pose (..., 4, 4) of `tool0` in the base.

        Args:
            q: Joint angles (..., 6) [rad].
        """
        result: Array = self.frames(q)[..., -1, :, :]
        return result

    def jacobian(self, q: Array) -> Array:
        """Geometric Jacobian (..., 6, 6): joint rates to velocity [m/s] and turn rate [rad/s].

        Both are those of `tool0`, seen in the base.

        Args:
            q: Joint angles (..., 6) [rad].
        """
        frames = self.frames(q)
        axes, places = frames[..., :-1, :3, 2], frames[..., :-1, :3, 3]
        arms = frames[..., -1:, :3, 3] - places
        rows = np.concatenate([np.cross(axes, arms), axes], axis=-1)
        return np.swapaxes(rows, -1, -2)

    def inverse(self, poses: Array) -> Array:
        """All joint angles (..., 8, 6) that reach poses [rad], each in (-pi, pi]; NaN for none.

        The branches are shoulder left and right, wrist either way, elbow up and down. With the
        wrist stretched (sin q5 = 0) only q2 + q3 + q4 and q6 together are determined: q6 is 0.

        Args:
            poses: (..., 4, 4) of `tool0` in the base.
        """
        shape = poses.shape[:-2]
        pose = poses.reshape(-1, 4, 4)
        branches = [self.inverse_on(pose, branch) for branch in range(BRANCHES)]
        solutions = np.stack(branches, axis=1)
        solutions = math.pi - np.remainder(math.pi - solutions, math.tau)
        return solutions.reshape(*shape, BRANCHES, JOINTS)

    def branch_of(self, q: Array) -> int:
        """Index of the branch of :meth:`inverse` that joint angles (6,) [rad] are on."""
        found = self.inverse(self.forward(q))
        away = np.abs(np.remainder(found - q + math.pi, math.tau) - math.pi).max(axis=1)
        return int(np.nanargmin(away))

    def nearest(self, pose: Array, q: Array, lower: Array, upper: Array) -> Array | None:
        """Joint angles (6,) that reach a pose, nearest to others; None if none are in range.

        Whole turns are added where that is nearer.

        Args:
            pose: (4, 4) of `tool0` in the base.
            q: Where the arm is (6,) [rad].
            lower, upper: Limits (6,) [rad].
        """
        found = self.inverse(pose)
        found = found[np.isfinite(found).all(axis=1)]
        found = q + np.remainder(found - q + math.pi, math.tau) - math.pi
        found = np.where(found > upper, found - math.tau, found)
        found = np.where(found < lower, found + math.tau, found)
        found = found[((found >= lower) & (found <= upper)).all(axis=1)]
        if not len(found):
            return None
        best: Array = found[int(np.abs(found - q).max(axis=1).argmin())]
        return best

    def singularity(self, q: Array) -> str:
        """Name the singularity at joint angles (6,) [rad]: shoulder, elbow, wrist or nothing."""
        if abs(math.sin(q[4])) < SINGULAR:
            return "wrist"
        if abs(math.sin(q[2])) < SINGULAR:
            return "elbow"
        t = self.table
        fore = q[1] + q[2]
        reach = t.a2 * math.cos(q[1]) + t.a3 * math.cos(fore) + t.d5 * math.sin(fore + q[3])
        return "shoulder" if abs(reach) < SINGULAR * (abs(t.a2) + abs(t.a3)) else ""

    def _link(self, angle: Array, i: int) -> Array:
        """Transform (..., 4, 4) of joint i at an angle (...)."""
        c, s, ca, sa = np.cos(angle), np.sin(angle), self._cos[i], self._sin[i]
        link = np.zeros((*np.shape(angle), 4, 4))
        link[..., 0, 0], link[..., 0, 1], link[..., 0, 2] = c, -s * ca, s * sa
        link[..., 1, 0], link[..., 1, 1], link[..., 1, 2] = s, c * ca, -c * sa
        link[..., 2, 1], link[..., 2, 2] = sa, ca
        link[..., 0, 3], link[..., 1, 3], link[..., 2, 3] = (
            self._a[i] * c,
            self._a[i] * s,
            self._d[i],
        )
        link[..., 3, 3] = 1.0
        return link

    def inverse_on(self, pose: Array, branch: int) -> Array:
        """Joint angles (k, 6) [rad] on one branch that reach poses (k, 4, 4); NaN for none.

        They are known up to whole turns.
        """
        t, (shoulder, wrist, elbow) = self.table, SIGNS[branch]
        centre = pose[:, :3, 3] - t.d6 * pose[:, :3, 2]
        away = np.hypot(centre[:, 0], centre[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            turn = _arccos(t.d4 / away)
        q1 = np.arctan2(centre[:, 1], centre[:, 0]) + shoulder * turn + math.pi / 2
        c1, s1 = np.cos(q1), np.sin(q1)
        aside = pose[:, 0, 3] * s1 - pose[:, 1, 3] * c1
        q5 = wrist * _arccos((aside - t.d4) / t.d6)
        s5 = np.sin(q5)
        across = pose[:, 0, :2] * s1[:, None] - pose[:, 1, :2] * c1[:, None]
        free = np.abs(s5) < ROUNDING
        q6 = np.where(
            free, 0.0, np.arctan2(-across[:, 1] * np.sign(s5), across[:, 0] * np.sign(s5))
        )
        inner = _inverted(self._link(q1, 0)) @ pose
        inner = inner @ _inverted(self._link(q6, 5)) @ _inverted(self._link(q5, 4))
        x, y = inner[:, 0, 3], inner[:, 1, 3]
        square = x * x + y * y
        q3 = elbow * _arccos((square - t.a2**2 - t.a3**2) / (2.0 * t.a2 * t.a3))
        q2 = np.arctan2(y, x) - np.arctan2(t.a3 * np.sin(q3), t.a2 + t.a3 * np.cos(q3))
        whole = np.arctan2(inner[:, 1, 0], inner[:, 0, 0])
        return np.stack([q1, q2, q3, whole - q2 - q3, q5, q6], axis=1)


def _arccos(cosine: Array) -> Array:
    """Angle (k,); NaN where there is none."""
    held = np.clip(cosine, -1.0, 1.0)
    angle: Array = np.where(np.abs(cosine - held) <= ROUNDING, np.arccos(held), np.nan)
    return angle


def _inverted(pose: Array) -> Array:
    """Inverse (k, 4, 4) of rigid transforms."""
    result = np.zeros_like(pose)
    turned = np.swapaxes(pose[:, :3, :3], 1, 2)
    result[:, :3, :3] = turned
    result[:, :3, 3] = -(turned @ pose[:, :3, 3:])[:, :, 0]
    result[:, 3, 3] = 1.0
    return result
