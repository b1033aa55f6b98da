"""Kinematics of arms like the UR5: forward, Jacobian, and all inverse solutions in closed form.

The frames are those of UR's controller: z of the base points up along the axis of the first joint,
and `tool0` is at the flange.
Sources: DH table of Universal Robots (UR5); K. P. Hawkins, "Analytic Inverse Kinematics for the
Universal Robots UR-5/UR-10 Arms" (2013), for the order in which the joints are solved.
"""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array

JOINTS = 6  #: Number of joints
#: Number of branches, the solutions of the inverse kinematics up to whole revolutions
BRANCHES = 8
BRANCH_SIGNS = tuple(
    (shoulder, wrist, elbow)
    for shoulder in (1.0, -1.0)
    for wrist in (1.0, -1.0)
    for elbow in (1.0, -1.0)
)  #: Signs (shoulder, wrist, elbow) with which each branch of the inverse kinematics is solved
#: Twist alpha of each joint in the DH table [rad]
DH_TWISTS = (math.pi / 2, 0.0, 0.0, math.pi / 2, -math.pi / 2, 0.0)
#: Sine, or ratio of a distance to the arm's length, below which the arm counts as singular
SINGULARITY_THRESHOLD = 1e-3
#: Tolerance for round-off of a cosine beyond +-1 at the limit of the reach, and of a zero sine
ROUNDING = 1e-9


@dataclass(frozen=True)
class DhTable:
    """Lengths in the DH table of a six-joint arm like the UR5, whose values are the defaults."""

    d1: float = 0.089159  #: Offset along the axis of joint 1 [m]
    a2: float = -0.425  #: Length of the upper arm, negative as in the table [m]
    a3: float = -0.39225  #: Length of the forearm, negative as in the table [m]
    d4: float = 0.10915  #: Offset along the axis of joint 4 [m]
    d5: float = 0.09465  #: Offset along the axis of joint 5 [m]
    d6: float = 0.0823  #: Offset along the axis of joint 6 [m]


UR5 = DhTable()  #: DH table of the UR5


class ArmModel:
    """Kinematics of a six-joint arm with three parallel axes, those of joints 2, 3 and 4.

    Joint angles q are (..., 6) [rad]; poses (..., 4, 4) are in the base frame [m].
    """

    def __init__(self, table: DhTable = UR5) -> None:
        self.table = t = table
        self._d: Array = np.array([t.d1, 0.0, 0.0, t.d4, t.d5, t.d6])
        self._a: Array = np.array([0.0, t.a2, t.a3, 0.0, 0.0, 0.0])
        self._cos, self._sin = np.round(np.cos(DH_TWISTS), 15), np.sin(DH_TWISTS)

    def frames(self, q: Array) -> Array:
        """Return the poses (..., 7, 4, 4) of base and DH frames in the base frame [m].

        Args:
            q: Joint angles (..., 6) [rad].
        """
        shape = q.shape[:-1]
        frames = np.empty((*shape, JOINTS + 1, 4, 4))
        frames[..., 0, :, :] = np.eye(4)
        links = self._links(q)
        for i in range(JOINTS):
            frames[..., i + 1, :, :] = frames[..., i, :, :] @ links[..., i, :, :]
        return frames

    def forward(self, q: Array) -> Array:
        """Return the pose (..., 4, 4) of `tool0` in the base frame [m].

        Args:
            q: Joint angles (..., 6) [rad].
        """
        result: Array = self.frames(q)[..., -1, :, :]
        return result

    def jacobian(self, q: Array) -> Array:
        """Return the geometric Jacobian (..., 6, 6): joint rates to linear and angular velocity.

        Both are velocities of `tool0`, expressed in the base frame [m/s, rad/s].

        Args:
            q: Joint angles (..., 6) [rad].
        """
        return self.jacobian_of(self.frames(q))

    @staticmethod
    def jacobian_of(frames: Array) -> Array:
        """Return the Jacobian (..., 6, 6) of `jacobian` for frames (..., 7, 4, 4) of the links."""
        axes, origins = frames[..., :-1, :3, 2], frames[..., :-1, :3, 3]
        lever_arm = frames[..., -1:, :3, 3] - origins
        result = np.empty((*frames.shape[:-3], 2 * 3, JOINTS))
        for row, first, second in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # axes x levers
            result[..., row, :] = (
                axes[..., first] * lever_arm[..., second]
                - axes[..., second] * lever_arm[..., first]
            )
            result[..., 3 + row, :] = axes[..., row]
        return result

    def inverse(self, poses: Array) -> Array:
        """Return the joint angles (..., 8, 6) [rad] that reach poses on each branch.

        The angles are in (-pi, pi]. The branches combine shoulder left or right, wrist either way,
        and elbow up or down. A branch without a solution is NaN. With the wrist stretched
        (sin q5 = 0), only a combination of q2 + q3 + q4 and q6 is determined: q6 is set to 0.

        Args:
            poses: Poses (..., 4, 4) of `tool0` in the base frame [m].
        """
        shape = poses.shape[:-2]
        pose = poses.reshape(-1, 4, 4)
        branches = [self.inverse_on_branch(pose, branch) for branch in range(BRANCHES)]
        solutions = np.stack(branches, axis=1)
        solutions = math.pi - np.remainder(math.pi - solutions, math.tau)
        return solutions.reshape(*shape, BRANCHES, JOINTS)

    def branch_of(self, q: Array) -> int:
        """Return the index of the branch of `inverse` that contains joint angles (6,) [rad]."""
        solutions = self.inverse(self.forward(q))
        difference = np.abs(np.remainder(solutions - q + math.pi, math.tau) - math.pi).max(axis=1)
        return int(np.nanargmin(difference))

    def nearest(self, pose: Array, q: Array, lower: Array, upper: Array) -> Array | None:
        """Return the joint angles (6,) [rad] that reach a pose and are nearest to `q`.

        The distance is the largest difference of a joint's angle. On each branch, the angles are
        those nearest to `q` up to whole revolutions; an angle beyond its limit is moved back by
        one revolution. The result is None if no solution is within the limits.

        Args:
            pose: Pose (4, 4) of `tool0` in the base frame [m].
        """
        solutions = self.inverse(pose)
        solutions = solutions[np.isfinite(solutions).all(axis=1)]
        solutions = q + np.remainder(solutions - q + math.pi, math.tau) - math.pi
        solutions = np.where(solutions > upper, solutions - math.tau, solutions)
        solutions = np.where(solutions < lower, solutions + math.tau, solutions)
        solutions = solutions[((solutions >= lower) & (solutions <= upper)).all(axis=1)]
        if not len(solutions):
            return None
        best: Array = solutions[int(np.abs(solutions - q).max(axis=1).argmin())]
        return best

    def singularity(self, q: Array) -> str:
        """Return the name of the singularity at joint angles (6,) [rad].

        It is "shoulder", "elbow" or "wrist", or an empty string if the arm is not singular.
        """
        if abs(math.sin(q[4])) < SINGULARITY_THRESHOLD:
            return "wrist"
        if abs(math.sin(q[2])) < SINGULARITY_THRESHOLD:
            return "elbow"
        t = self.table
        forearm = q[1] + q[2]
        reach = t.a2 * math.cos(q[1]) + t.a3 * math.cos(forearm) + t.d5 * math.sin(forearm + q[3])
        return "shoulder" if abs(reach) < SINGULARITY_THRESHOLD * (abs(t.a2) + abs(t.a3)) else ""

    def _links(self, q: Array) -> Array:
        """Return the transforms (..., 6, 4, 4) of DH frames i + 1 in frames i."""
        c, s, ca, sa = np.cos(q), np.sin(q), self._cos, self._sin
        link = np.zeros((*q.shape, 4, 4))
        link[..., 0, 0], link[..., 0, 1], link[..., 0, 2] = c, -s * ca, s * sa
        link[..., 1, 0], link[..., 1, 1], link[..., 1, 2] = s, c * ca, -c * sa
        link[..., 2, 1], link[..., 2, 2] = sa, ca
        link[..., 0, 3], link[..., 1, 3], link[..., 2, 3] = (
            self._a * c,
            self._a * s,
            self._d,
        )
        link[..., 3, 3] = 1.0
        return link

    def inverse_on_branch(self, pose: Array, branch: int) -> Array:
        """Return the joint angles (k, 6) [rad] that reach poses on one branch.

        They are determined up to whole revolutions. For a pose without a solution they are NaN.

        Args:
            pose: Poses (k, 4, 4) of `tool0` in the base frame [m].
            branch: Index of the branch, 0 to 7.
        """
        t, (shoulder, wrist, elbow) = self.table, BRANCH_SIGNS[branch]
        centre = pose[:, :3, 3] - t.d6 * pose[:, :3, 2]
        radius = np.hypot(centre[:, 0], centre[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            offset = _arccos(t.d4 / radius)
        q1 = np.arctan2(centre[:, 1], centre[:, 0]) + shoulder * offset + math.pi / 2
        c1, s1 = np.cos(q1), np.sin(q1)
        # Offset of tool0 along the axes of joints 2 to 4, and the parts of its x and y axes there.
        lateral = pose[:, 0, 3] * s1 - pose[:, 1, 3] * c1
        q5 = wrist * _arccos((lateral - t.d4) / t.d6)
        s5 = np.sin(q5)
        lateral_axes = pose[:, 0, :2] * s1[:, None] - pose[:, 1, :2] * c1[:, None]
        is_stretched = np.abs(s5) < ROUNDING
        q6 = np.where(
            is_stretched,
            0.0,
            np.arctan2(-lateral_axes[:, 1] * np.sign(s5), lateral_axes[:, 0] * np.sign(s5)),
        )
        # The pose of DH frame 4 in DH frame 1 depends on q2, q3 and q4 only: a planar arm.
        c5, c6, s6 = np.cos(q5)[:, None], np.cos(q6)[:, None], np.sin(q6)[:, None]
        n, o, a = (pose[:, :3, k] for k in range(3))
        level = c5 * (c6 * n - s6 * o) - s5[:, None] * a  # x axis of DH frame 4
        origin = centre + t.d5 * (s6 * n + c6 * o)
        x, y = c1 * origin[:, 0] + s1 * origin[:, 1], origin[:, 2] - t.d1
        squared_distance = x * x + y * y
        q3 = elbow * _arccos((squared_distance - t.a2**2 - t.a3**2) / (2.0 * t.a2 * t.a3))
        q2 = np.arctan2(y, x) - np.arctan2(t.a3 * np.sin(q3), t.a2 + t.a3 * np.cos(q3))
        q234 = np.arctan2(level[:, 2], c1 * level[:, 0] + s1 * level[:, 1])  # q2 + q3 + q4
        return np.stack([q1, q2, q3, q234 - q2 - q3, q5, q6], axis=1)


def _arccos(cosine: Array) -> Array:
    """Return the arccosine (k,) [rad]; NaN where a cosine is beyond +-1 by more than round-off."""
    clipped = np.clip(cosine, -1.0, 1.0)
    angle: Array = np.where(np.abs(cosine - clipped) <= ROUNDING, np.arccos(clipped), np.nan)
    return angle
