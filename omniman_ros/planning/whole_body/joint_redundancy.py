"""Platform and joints of the arm side by side: the joints on a path of their own, c(s)."""

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.tool_timing import PlatformSpline
from omniman_ros.planning.whole_body.redundancy import (
    COORDINATES,
    PATH_PARAMETER,
    Configurations,
)


class JointPath:
    """Joint angles at equally spaced places of a path, joined smoothly.

    Args:
        nodes: Joint angles (n + 1, 6) [rad], n >= 1.
        end: Parameter s at the last of them; that of the first is 0 [m].
        scale: Lengths (6,) that a rotation of each joint by 1 rad has in s [m/rad].
    """

    def __init__(self, nodes: Array, end: float, scale: Array) -> None:
        self.end, self.scale = end, scale
        self._spline = PlatformSpline(nodes, end)

    def motion(self, places: Array) -> tuple[Array, Array, Array]:
        """Return joint angles (k, 6) at places (k,), held at the ends, and two derivatives."""
        angles, slope, bend = self._spline.motion(np.clip(places, 0.0, self.end))
        held = (places < 0.0) | (places > self.end)
        slope[held] = bend[held] = 0.0
        return angles, slope, bend

    def length(self) -> float:
        """Return the length in s, in which rotations count [m]."""
        return self.end


class JointRedundancy:
    """All axes while the joints are on a path of their own and the platform is free."""

    bound: Array = np.full(COORDINATES, np.inf)
    pull = 10.0  # nothing else keeps the platform beside the posture with which it has room

    def __init__(self, model: WholeBodyModel, path: JointPath) -> None:
        self.model, self.path = model, path
        self.centre = path.motion(np.zeros(1))[0][0]

    def axes(self, z: Array) -> Array:
        """Return all axes (k, 9) at coordinates (k, 4)."""
        return np.hstack([z[:, :3], self.path.motion(z[:, PATH_PARAMETER])[0]])

    def configurations(self, z: Array) -> Configurations:
        """Return configurations with derivatives at coordinates (k, 4)."""
        arm, slope, bend = self.path.motion(z[:, PATH_PARAMETER])
        q = np.hstack([z[:, :3], arm])
        rates = np.zeros((*arm.shape, COORDINATES))
        rates[:, :, PATH_PARAMETER] = slope
        frames = self.model.arm.frames(arm)
        jacobian = self.model.jacobian_of(q, frames)
        return Configurations.unchecked(
            z=z, q=q, rates=rates, frames=frames, jacobian=jacobian, bend=bend
        )

    def drift(self, at: Configurations, velocity: Array) -> Array:
        """Return the joints' accelerations (k, 6) while z' (k, 4) does not change [rad/s^2]."""
        result: Array = at.bend * velocity[:, PATH_PARAMETER, None] ** 2
        return result

    def bends(self, places: Array) -> Array:
        """Return the largest acceleration (k,) of a joint per squared rate of s, as a length."""
        bends: Array = np.abs(self.path.motion(places)[2] * self.path.scale).max(axis=1)
        return bends

    def tool(self, z: Array) -> Array:
        """Return poses (k, 4, 4) of `tool0` in odom at coordinates (k, 4)."""
        return self.model.forward(self.axes(z))
