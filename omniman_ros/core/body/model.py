"""Kinematics of the whole robot: nine axes, of which the platform's three come first.

Axes are odom_x, odom_y [m] and odom_t [rad], the platform's pose in odom, then the arm's joints
[rad]. `arm_base_link` is where the arm is mounted; as in the public description of the UR arms it
is turned by half a turn about z against the base of the DH table, so that an arm stretched at
zero points forward.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arm_model import JOINTS, ArmModel
from omniman_ros.core.parameters import parameter

Array = NDArray[np.float64]

PLATFORM_AXES = ("odom_x", "odom_y", "odom_t")
"""Names of the platform's axes in trajectories."""
AXES = len(PLATFORM_AXES) + JOINTS
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Base of the DH table in `arm_base_link`."""


@dataclass(frozen=True)
class Mount:
    """Where the arm stands on the platform: `arm_base_link` in base_link, its axis upright."""

    x: float = parameter(
        0.2, "Base of the arm, forward.", unit="m", low=-5, high=5, read_only=True
    )
    y: float = parameter(0.0, "Base of the arm, left.", unit="m", low=-5, high=5, read_only=True)
    z: float = parameter(
        0.5, "Base of the arm above the floor.", unit="m", low=-1, high=5, read_only=True
    )
    yaw: float = parameter(
        0.0, "Turn of the arm's base about the vertical.", unit="rad", low=-6.3, high=6.3,
        read_only=True,
    )  # fmt: skip

    @property
    def pose(self) -> Array:
        """`arm_base_link` in base_link (4, 4)."""
        result = np.eye(4)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        result[:2, :2] = [[c, -s], [s, c]]
        result[:3, 3] = self.x, self.y, self.z
        return result


class BodyModel:
    """Forward kinematics, Jacobian and the arm's inverse for a platform that is somewhere.

    Args:
        mount: Where the arm stands.
        arm: Its kinematics.

    Attributes:
        arm: As above.
    """

    def __init__(self, mount: Mount, arm: ArmModel | None = None) -> None:
        self.arm = arm or ArmModel()
        self._base: Array = mount.pose @ HALF_TURN
        self._base_inverse: Array = np.array(np.linalg.inv(self._base), dtype=np.float64)

    def base(self, platform: Array) -> Array:
        """Base of the DH table (..., 4, 4) in odom.

        Args:
            platform: Poses (..., 3) of base_link in odom [m, m, rad].
        """
        result: Array = planar(platform) @ self._base
        return result

    def forward(self, q: Array) -> Array:
        """Pose (..., 4, 4) of `tool0` in odom.

        Args:
            q: All axes (..., 9).
        """
        result: Array = self.base(q[..., :3]) @ self.arm.forward(q[..., 3:])
        return result

    def jacobian(self, q: Array) -> Array:
        """Geometric Jacobian (..., 6, 9): rates of all axes to velocity and turn rate of `tool0`.

        Both are seen in odom [m/s, rad/s].

        Args:
            q: All axes (..., 9).
        """
        base = self.base(q[..., :3])
        turned = base[..., :3, :3]
        arm = self.arm.jacobian(q[..., 3:])
        place = (base @ self.arm.forward(q[..., 3:]))[..., :3, 3]
        result = np.zeros((*q.shape[:-1], 6, AXES))
        result[..., 0, 0] = result[..., 1, 1] = result[..., 5, 2] = 1.0
        result[..., 0, 2] = q[..., 1] - place[..., 1]
        result[..., 1, 2] = place[..., 0] - q[..., 0]
        result[..., :3, 3:] = turned @ arm[..., :3, :]
        result[..., 3:, 3:] = turned @ arm[..., 3:, :]
        return result

    def seen(self, platform: Array, tool: Array) -> Array:
        """Poses of `tool0` (k, 4, 4) in the base of the DH table.

        Args:
            platform: Poses (k, 3) of base_link in odom [m, m, rad].
            tool: Poses (k, 4, 4) of `tool0` in odom.
        """
        shifted = tool.copy()
        c, s = np.cos(platform[:, 2]), np.sin(platform[:, 2])
        back = np.zeros((len(platform), 4, 4))
        back[:, 0, 0] = back[:, 1, 1] = c
        back[:, 0, 1], back[:, 1, 0] = s, -s
        back[:, 2, 2] = back[:, 3, 3] = 1.0
        shifted[:, :2, 3] -= platform[:, :2]
        result: Array = self._base_inverse @ (back @ shifted)
        return result

    def arm_angles(self, platform: Array, tool: Array, branch: int, near: Array) -> Array:
        """Joint angles (k, 6) [rad] with which the tool is where it is to be; NaN for none.

        Args:
            platform: Poses (k, 3) of base_link in odom [m, m, rad].
            tool: Poses (k, 4, 4) of `tool0` in odom.
            branch: Of :meth:`ArmModel.inverse`.
            near: Angles (6,) or (k, 6); each result is within half a turn of them.
        """
        found = self.arm.inverse_on(self.seen(platform, tool), branch)
        turned: Array = near + np.remainder(found - near + math.pi, math.tau) - math.pi
        return turned


def planar(platform: Array) -> Array:
    """Poses (..., 4, 4) of planar ones (..., 3) [m, m, rad]."""
    result = np.zeros((*platform.shape[:-1], 4, 4))
    c, s = np.cos(platform[..., 2]), np.sin(platform[..., 2])
    result[..., 0, 0], result[..., 0, 1], result[..., 0, 3] = c, -s, platform[..., 0]
    result[..., 1, 0], result[..., 1, 1], result[..., 1, 3] = s, c, platform[..., 1]
    result[..., 2, 2] = result[..., 3, 3] = 1.0
    return result
