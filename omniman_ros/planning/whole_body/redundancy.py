"""The redundancy of the whole body: all axes from the platform's pose and the place on the path.

A redundancy coordinate z = (x, y, theta, s) is the pose of base_link in odom [m, m, rad] and the
parameter of a path [m], of which the arm follows in closed form, q = f(z). The rates of the joints
are q' = G z'.

* A path of the tool: the tool is on it whatever z is. G = J_arm^-1 (-J_platform, t), where t is
  the tool's twist per s; the accelerations are q'' = G z'' + J_arm^-1 (t' s'^2 - J' q').
* Where the orientation of the tool is free, z goes on with the free coordinates f [rad], see
  :mod:`free_orientation`, and the tool's twist is t s' + T f'.
* A path of the joints c(s): the platform is free. G = (0, c'), and q'' = G z'' + c'' s'^2.
"""

from dataclasses import dataclass
from typing import Annotated, Protocol

import numpy as np

from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.validated import Validated
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.model import WholeBodyModel
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.redundancy_resolver import RedundancyResolver
from omniman_ros.motion.whole_body.tool_curve import ROTATION_LENGTH
from omniman_ros.planning.whole_body.free_orientation import FreeOrientation

COORDINATES = 4  #: Number of redundancy coordinates without those of a free orientation
PATH_PARAMETER = 3  #: Index of the place on the path among them
DIFFERENCE_STEP = 1e-5  #: Step of the numerical derivative of the Jacobian [s]
_LINEAR, _ANGULAR = slice(0, 3), slice(3, 6)  #: Parts of a twist
SINGULAR = 1e-9  #: Determinant of the arm's Jacobian below which it counts as singular


class BodyPath(Protocol):
    """A path that the body follows."""

    @property
    def end(self) -> float:
        """Parameter u at the end [m]."""
        ...

    def length(self) -> float:
        """Return the length of the path by which progress is told [m]."""
        ...


class LedPath(BodyPath, Protocol):
    """A path of the tool, as a `ToolCurve` or a `HeldTool` is; its length is that of `tool0`."""

    def pose(self, u: Array) -> Array:
        """Return poses (m, 4, 4) of the tool at u (m,)."""
        ...

    def motion(self, u: Array) -> tuple[Array, Array, Array]:
        """Return poses (m, 4, 4), twists (m, 6) per u and their derivatives by u, at u (m,)."""
        ...


@dataclass(frozen=True)
class Configurations(Validated):
    """Configurations of the whole body along a plan."""

    z: Annotated[Array, Shape("k", "d")]  #: Redundancy coordinates (k, d)
    #: All axes (k, 9); NaN where the arm does not reach the tool
    q: Annotated[Array, Shape("k", 9, finite=False)]
    #: G (k, 6, d), the joints' derivatives by z
    rates: Annotated[Array, Shape("k", 6, "d", finite=False)]
    #: Poses (k, 7, 4, 4) of the arm's links in the base of the DH table
    frames: Annotated[Array, Shape("k", 7, 4, 4, finite=False)]
    jacobian: Annotated[Array, Shape("k", 6, 9, finite=False)]  #: Jacobians (k, 6, 9) of the tool
    #: Derivatives (k, 6) by s of the tool's twist per s, or of the joints' derivatives by s
    bend: Annotated[Array, Shape("k", 6, finite=False)]

    @property
    def platform(self) -> Array:
        """Poses (k, 3) of the platform."""
        return self.q[:, :3]

    @property
    def arm(self) -> Array:
        """Joint angles (k, 6) [rad]."""
        return self.q[:, 3:]


class SingularityMargins:
    """Margins of the arm to its singularities, on the sides of them on which it starts.

    Attributes:
        least: Least margin that a motion must keep.

    Raises:
        InputError: The arm starts (6,) nearer to a singularity than that.
    """

    def __init__(
        self,
        model: WholeBodyModel,
        limits: WholeBodyLimits,
        options: ToolPathOptions,
        start: Array,
    ) -> None:
        self._resolver = RedundancyResolver(model, limits, options)
        self.least = options.singularity
        self._signs = self._resolver.signs(start)

    def at(self, arm: Array) -> tuple[Array, Array]:
        """Return margins (k, 3) at joint angles (k, 6), and their derivatives (k, 3, 6)."""
        return self._resolver.margins(arm, self._signs)


class BodyRedundancy(Protocol):
    """All axes as functions of the redundancy coordinates.

    Attributes:
        centre: Joint angles (6,) of the start [rad].
        pull: Weight of the platform's distance from its searched way, relative to that of a tool
            that is led, whose arm holds the platform besides.
        bound: Largest coordinates (d,); infinity without a bound.
    """

    model: WholeBodyModel
    centre: Array
    pull: float
    bound: Array

    @property
    def path(self) -> BodyPath:
        """What the arm follows."""
        ...

    def axes(self, z: Array) -> Array:
        """Return all axes (k, 9) at coordinates (k, d); NaN where there are none."""
        ...

    def configurations(self, z: Array) -> Configurations:
        """Return configurations with derivatives at coordinates (k, d)."""
        ...

    def drift(self, at: Configurations, velocity: Array) -> Array:
        """Return the joints' accelerations (k, 6) while z' (k, d) does not change [rad/s^2]."""
        ...

    def bends(self, places: Array) -> Array:
        """Return the accelerations (k,) along the path per squared rate of s [1/m].

        A rotation counts as the length that it has in s.
        """
        ...

    def tool(self, z: Array) -> Array:
        """Return poses (k, 4, 4) of `tool0` in odom at coordinates (k, d)."""
        ...


class ToolRedundancy:
    """Arm and platform while the tool is on a path in odom.

    Args:
        free: What is free of the tool's orientation, if anything.
        centre: Joint angles (6,) of the start [rad]; the arm stays on their branch of the inverse
            kinematics, and each joint within half a revolution of them.
    """

    pull = 1.0

    def __init__(
        self,
        model: WholeBodyModel,
        path: LedPath,
        centre: Array,
        free: FreeOrientation | None = None,
    ) -> None:
        self.model, self.path, self.centre, self.free = model, path, centre, free
        self.bound: Array = np.full(COORDINATES, np.inf)
        if free is not None:
            self.bound = np.append(self.bound, free.bound)
        self._branch = model.arm.branch_of(centre)

    def axes(self, z: Array) -> Array:
        """Return all axes (k, 9) at coordinates (k, d); NaN where the tool is out of reach."""
        platform = z[:, :3]
        return np.hstack([platform, self.arm(platform, self.tool(z))])

    def arm(self, platform: Array, tool: Array) -> Array:
        """Return joint angles (k, 6) for poses of platform (k, 3) and tool (k, 4, 4)."""
        return self.model.arm_angles(platform, tool, self._branch, self.centre)

    def configurations(self, z: Array) -> Configurations:
        """Return configurations with derivatives at coordinates (k, d).

        The derivatives are NaN where the arm is singular or does not reach the tool.
        """
        pose, twist, bend = self.path.motion(z[:, PATH_PARAMETER])
        if self.free is None:
            twists = twist[:, :, None]
        else:
            pose, twists = self.free.motion(pose, twist, z[:, COORDINATES:])
        q = np.hstack([z[:, :3], self.arm(z[:, :3], pose)])
        frames = self.model.arm.frames(q[:, 3:])
        jacobian = self.model.jacobian_of(q, frames)
        right = np.concatenate([-jacobian[:, :, :3], twists], axis=2)
        rates = _solved(jacobian[:, :, 3:], right)
        return Configurations.unchecked(
            z=z, q=q, rates=rates, frames=frames, jacobian=jacobian, bend=bend
        )

    def drift(self, at: Configurations, velocity: Array) -> Array:
        """Return the joints' accelerations (k, 6) while z' (k, d) does not change [rad/s^2]."""
        rates = np.hstack([velocity[:, :3], _times(at.rates, velocity)])
        step = DIFFERENCE_STEP * rates
        ahead, behind = self.model.jacobian(np.stack([at.q + step, at.q - step]))
        turning = _times(ahead - behind, rates) / (2.0 * DIFFERENCE_STEP)
        speed = velocity[:, PATH_PARAMETER]
        if self.free is None:
            change = at.bend * speed[:, None] ** 2
        else:
            pose, twist, bend = self.path.motion(at.z[:, PATH_PARAMETER])
            f, f_rate = at.z[:, COORDINATES:], velocity[:, COORDINATES:]
            change = self.free.change(pose, twist, bend, f, speed, f_rate)
        right = change - turning
        return _solved(at.jacobian[:, :, 3:], right[:, :, None])[:, :, 0]

    def bends(self, places: Array) -> Array:
        """Return the accelerations (k,) of the tool per squared rate of s; see the protocol."""
        _, _, bend = self.path.motion(places)
        linear, angular = (np.linalg.norm(bend[:, part], axis=1) for part in (_LINEAR, _ANGULAR))
        bends: Array = np.maximum(linear, ROTATION_LENGTH * angular)
        return bends

    def tool(self, z: Array) -> Array:
        """Return poses (k, 4, 4) of `tool0` in odom at coordinates (k, d)."""
        pose = self.path.pose(z[:, PATH_PARAMETER])
        return pose if self.free is None else self.free.turned(pose, z[:, COORDINATES:])


def _times(matrix: Array, vectors: Array) -> Array:
    """Return the products (k, i) of matrices (k, i, j) and vectors (k, j)."""
    result: Array = (matrix @ vectors[:, :, None])[:, :, 0]
    return result


def _solved(matrix: Array, right: Array) -> Array:
    """Return the solutions (k, 6, j) of systems with matrices (k, 6, 6); NaN where singular."""
    regular = np.abs(np.linalg.det(matrix)) > SINGULAR
    result = np.full(right.shape, np.nan)
    result[regular] = np.linalg.solve(matrix[regular], right[regular])
    return result
