"""Kinematics of the whole robot: nine axes, of which the platform's three come first.

Arrays hold the axes in the order of `omniman_ros.motion.axes`. `arm_base_link` is the frame in
which the arm is mounted. As in the public description of the UR arms, it is rotated by pi about z
relative to the base of the DH table, so that the arm points forward if all its joints are at zero.
"""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arm_model import ArmModel
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated
from omniman_ros.motion.axes import AXES

HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])  #: Pose of the base of the DH table in `arm_base_link`


@dataclass(frozen=True)
class Mount(Validated):
    """Pose of `arm_base_link` in base_link, with a vertical axis."""

    x: float = parameter(
        0.2, "Position of the arm's base, forward.", unit="m", low=-5, high=5, read_only=True
    )
    y: float = parameter(
        0.0, "Position of the arm's base, left.", unit="m", low=-5, high=5, read_only=True
    )
    z: float = parameter(
        0.5, "Height of the arm's base above the floor.", unit="m", low=-1, high=5, read_only=True
    )
    yaw: float = parameter(
        0.0,
        "Rotation of the arm's base about the vertical.",
        unit="rad",
        low=-6.3,
        high=6.3,
        read_only=True,
    )

    @property
    def pose(self) -> Array:
        """Pose (4, 4) of `arm_base_link` in base_link."""
        result = np.eye(4)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        result[:2, :2] = [[c, -s], [s, c]]
        result[:3, 3] = self.x, self.y, self.z
        return result


class WholeBodyModel:
    """Kinematics of platform and arm together.

    Positions of all axes q are (..., 9), poses of base_link (..., 3) in odom [m, m, rad].
    """

    def __init__(self, mount: Mount, arm: ArmModel | None = None) -> None:
        self.arm = arm or ArmModel()
        self._base: Array = mount.pose @ HALF_TURN
        self._base_inverse: Array = np.array(np.linalg.inv(self._base), dtype=np.float64)

    def base(self, platform: Array) -> Array:
        """Return the pose (..., 4, 4) of the base of the DH table in odom.

        Args:
            platform: Poses (..., 3) of base_link in odom [m, m, rad].
        """
        result: Array = planar_transform(platform) @ self._base
        return result

    def forward(self, q: Array) -> Array:
        """Return the pose (..., 4, 4) of `tool0` in odom."""
        result: Array = self.base(q[..., :3]) @ self.arm.forward(q[..., 3:])
        return result

    def jacobian(self, q: Array) -> Array:
        """Return the geometric Jacobian (..., 6, 9).

        It maps the rates of all axes to the linear and angular velocity of `tool0` in odom
        [m/s, rad/s].
        """
        return self.jacobian_of(q, self.arm.frames(q[..., 3:]))

    def jacobian_of(self, q: Array, frames: Array) -> Array:
        """Return the Jacobian (..., 6, 9) of `jacobian` at positions whose arm's frames are known.

        Args:
            frames: Frames (..., 7, 4, 4) of the arm's links, :meth:`ArmModel.frames`.
        """
        base = self.base(q[..., :3])
        rotation = base[..., :3, :3]
        arm = self.arm.jacobian_of(frames)
        position = (rotation @ frames[..., -1, :3, 3:])[..., 0] + base[..., :3, 3]
        result = np.zeros((*q.shape[:-1], 6, AXES))
        result[..., 0, 0] = result[..., 1, 1] = result[..., 5, 2] = 1.0
        result[..., 0, 2] = q[..., 1] - position[..., 1]
        result[..., 1, 2] = position[..., 0] - q[..., 0]
        result[..., :3, 3:] = rotation @ arm[..., :3, :]
        result[..., 3:, 3:] = rotation @ arm[..., 3:, :]
        return result

    def tool_in_arm_base(self, platform: Array, tool: Array) -> Array:
        """Return poses (k, 4, 4) of `tool0` in the base of the DH table.

        Args:
            platform: Poses (k, 3) of base_link in odom [m, m, rad].
            tool: Poses (k, 4, 4) of `tool0` in odom.
        """
        shifted = tool.copy()
        c, s = np.cos(platform[:, 2]), np.sin(platform[:, 2])
        to_platform = np.zeros((len(platform), 4, 4))
        to_platform[:, 0, 0] = to_platform[:, 1, 1] = c
        to_platform[:, 0, 1], to_platform[:, 1, 0] = s, -s
        to_platform[:, 2, 2] = to_platform[:, 3, 3] = 1.0
        shifted[:, :2, 3] -= platform[:, :2]
        result: Array = self._base_inverse @ (to_platform @ shifted)
        return result

    def arm_angles(self, platform: Array, tool: Array, branch: int, near: Array) -> Array:
        """Return joint angles (k, 6) [rad] for poses of the tool; NaN where it cannot be reached.

        Args:
            platform: Poses (k, 3) of base_link in odom [m, m, rad].
            tool: Poses (k, 4, 4) of `tool0` in odom.
            branch: Branch of the arm's inverse kinematics, :meth:`ArmModel.inverse`.
            near: Angles (6,) or (k, 6) [rad]; each result is within half a revolution of them.
        """
        angles = self.arm.inverse_on_branch(self.tool_in_arm_base(platform, tool), branch)
        nearest: Array = near + np.remainder(angles - near + math.pi, math.tau) - math.pi
        return nearest


def planar_transform(platform: Array) -> Array:
    """Return the transforms (..., 4, 4) of planar poses (..., 3) [m, m, rad]."""
    result = np.zeros((*platform.shape[:-1], 4, 4))
    c, s = np.cos(platform[..., 2]), np.sin(platform[..., 2])
    result[..., 0, 0], result[..., 0, 1], result[..., 0, 3] = c, -s, platform[..., 0]
    result[..., 1, 0], result[..., 1, 1], result[..., 1, 3] = s, c, platform[..., 1]
    result[..., 2, 2] = result[..., 3, 3] = 1.0
    return result
