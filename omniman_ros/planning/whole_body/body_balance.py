"""Tip-over margin of the whole body along a plan; see `control.stability` for one posture.

Platform and arm count as one mass each, at (x, y, z) in base_link. With the acceleration a of the
masses in space, and g, the zero moment point is

    p = sum m ((g + a_z) (x, y) - z (a_x, a_y)) / sum m (g + a_z),

and the margin is its distance from the border of the wheels' contacts. The rows of a plan leave
out how the arm accelerates relative to the platform, which its check knows.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from omniman_ros.control.dynamics import GRAVITY
from omniman_ros.control.stability import support_edges
from omniman_ros.core.arm_model import JOINTS
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.description.arm_mass import ArmMass
from omniman_ros.description.parameters import DescriptionParameters
from omniman_ros.motion.whole_body.model import HALF_TURN, WholeBodyModel
from omniman_ros.planning.whole_body.redundancy import Configurations

TURNED = np.array([[0.0, -1.0], [1.0, 0.0]])  #: Rotation by a right angle
YAW = 2  #: Index of the heading among the coordinates


@dataclass(frozen=True)
class MarginRows(Validated):
    """Tip-over margins to each of E edges at k configurations, with their derivatives.

    Units of the derivatives are those by x, y and s, and by theta and a free orientation.
    """

    margin: Annotated[Array, Shape("k", "E")]  #: Margins (k, E) [m]
    #: By the redundancy coordinates (k, E, d) [m/m, m/rad]
    by_z: Annotated[Array, Shape("k", "E", "d")]
    by_rate: Annotated[Array, Shape("k", "E", "d")]  #: By their rates [s, m s/rad]
    by_acceleration: Annotated[Array, Shape("k", "E", "d")]  #: And accelerations [s^2, m s^2/rad]


class BodyBalance:
    """Centre of mass of the arm, and the tip-over margins of the robot that carries it."""

    def __init__(self, description: DescriptionParameters) -> None:
        robot = description.robot
        mass, model = ArmMass(robot.arm, description.mount), WholeBodyModel(description.mount)
        self._base: Array = description.mount.pose @ HALF_TURN
        zero = np.zeros(JOINTS)
        at_zero = self._base @ model.arm.frames(zero[None])[0]
        bodies = mass.weighted_centres(zero)
        bodies[-2] += bodies[-1]  # the tool is fixed to the last link
        self._of_frame: Array = np.linalg.solve(at_zero, bodies[:-1, :, None])[..., 0]
        body = robot.body
        self._masses = np.array([body.mass, mass.mass])
        self._weight = GRAVITY * float(self._masses.sum())
        self._body = np.array([body.com_x, body.com_y, body.com_z])
        self._edges, self._offsets = support_edges(
            np.column_stack([robot.wheels.x, robot.wheels.y])
        )

    @property
    def edge_count(self) -> int:
        """Number of edges of the wheels' contacts."""
        return len(self._offsets)

    def arm_centres(self, frames: Array) -> Array:
        """Return the arm's centres of mass (k, 3) [m] by its frames (k, 7, 4, 4) in base_link."""
        result: Array = self._parts(frames).sum(axis=1) / float(self._masses[1])
        return result

    def margins(self, times: Array, poses: Array, arm: Array) -> Array:
        """Return the least margins (k - 2,) at all but the first and the last of times (k,) [m].

        The platform has poses (k, 3), and the arm's centres of mass are (k, 3), at even times [s]:
        accelerations are second differences.
        """
        centre = np.stack([np.broadcast_to(self._body, arm.shape), arm])  # (2, k, 3)
        c, s = np.cos(poses[:, YAW]), np.sin(poses[:, YAW])
        x, y, z = np.moveaxis(centre, -1, 0)
        in_odom = np.stack([poses[:, 0] + c * x - s * y, poses[:, 1] + s * x + c * y, z], axis=-1)
        a = np.diff(in_odom, n=2, axis=1) / (times[1] - times[0]) ** 2
        c, s = c[1:-1], s[1:-1]
        along = np.stack([c * a[..., 0] + s * a[..., 1], c * a[..., 1] - s * a[..., 0]], axis=-1)
        weight = self._masses[:, None, None] * (GRAVITY + a[..., 2:])
        moment = weight * centre[:, 1:-1, :2]
        moment -= self._masses[:, None, None] * centre[:, 1:-1, 2:] * along
        point = moment.sum(axis=0) / weight.sum(axis=0)
        result: Array = self._to_edges(point).min(axis=1)
        return result

    def rest_margin(self, arm: Array) -> float:
        """Return the margin at rest [m] with the arm's centre of mass (3,)."""
        centre = np.stack([self._body, arm])[:, :2]
        point = GRAVITY * self._masses @ centre / self._weight
        return float(self._to_edges(point[None]).min())

    def rows(self, at: Configurations, rates: Array, accelerations: Array) -> MarginRows:
        """Return the margins at configurations with rates and accelerations (k, d) in odom."""
        frames = self._base @ at.frames
        arm, by_joints = self.arm_centres(frames), self._arm_derivatives(frames)
        c, s = np.cos(at.z[:, YAW]), np.sin(at.z[:, YAW])
        to_robot = np.stack([np.stack([c, s], axis=-1), np.stack([-s, c], axis=-1)], axis=1)
        pushed = (to_robot @ accelerations[:, :2, None])[..., 0]
        yaw, spin = accelerations[:, YAW, None], rates[:, YAW, None]
        masses, height = (
            self._masses[:, None],
            np.stack([np.full(len(arm), self._body[2]), arm[:, 2]]),
        )
        level = np.stack([np.broadcast_to(self._body[:2], (len(arm), 2)), arm[:, :2]])
        moment = masses * height  # (2, k) [kg m]
        lever = (moment[..., None] * level).sum(axis=0)  # (k, 2) [kg m^2]
        total = moment.sum(axis=0)[:, None]
        turned = lever @ TURNED.T
        point = GRAVITY * (masses[..., None] * level).sum(axis=0)
        point -= total * pushed + yaw * turned - spin**2 * lever
        # By the joints: the arm's centre moves along, and so does what accelerates it.
        m, up, flat = self._masses[1], by_joints[:, 2:], by_joints[:, :2]  # (k, 1, 6), (k, 2, 6)
        carried = pushed + yaw * level[1] @ TURNED.T - spin**2 * level[1]
        by_q = GRAVITY * m * flat - m * up * carried[..., None]
        swung = yaw[..., None] * TURNED @ flat - spin[..., None] ** 2 * flat
        by_q -= (m * height[1])[:, None, None] * swung
        by_z = by_q @ at.rates
        by_z[..., YAW] += total * (pushed @ TURNED.T)  # the robot's axes turn
        by_rate, by_acceleration = np.zeros_like(by_z), np.zeros_like(by_z)
        by_rate[..., YAW] = 2.0 * spin * lever
        by_acceleration[..., :2] = -total[..., None] * to_robot
        by_acceleration[..., YAW] = -turned
        return MarginRows.unchecked(
            margin=self._to_edges(point / self._weight),
            by_z=self._edges @ by_z / self._weight,
            by_rate=self._edges @ by_rate / self._weight,
            by_acceleration=self._edges @ by_acceleration / self._weight,
        )

    def _to_edges(self, points: Array) -> Array:
        """Return the distances (k, E) of points (k, 2) from the edges; negative outside [m]."""
        result: Array = points @ self._edges.T + self._offsets
        return result

    def _parts(self, frames: Array) -> Array:
        """Return the centres (k, 7, 3) of what the frames carry, times their masses [kg m]."""
        result: Array = np.einsum("kfij,fj->kfi", frames[..., :3, :], self._of_frame)
        return result

    def _arm_derivatives(self, frames: Array) -> Array:
        """Return the derivatives (k, 3, 6) of the arm's centre of mass by the joints [m/rad]."""
        # What a joint moves is all that comes after it.
        moved = np.cumsum(self._parts(frames)[:, :0:-1], axis=1)[:, ::-1]
        masses = np.cumsum(self._of_frame[:0:-1, 3])[::-1]
        axis, origin = frames[:, :-1, :3, 2], frames[:, :-1, :3, 3]
        lever = moved - masses[:, None] * origin
        result = np.empty((len(frames), 3, axis.shape[1]))
        for row, first, second in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):  # axes x levers
            result[:, row] = axis[..., first] * lever[..., second]
            result[:, row] -= axis[..., second] * lever[..., first]
        return result / float(self._masses[1])
