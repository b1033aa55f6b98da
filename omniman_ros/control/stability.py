"""Loads of the wheels and tip-over margin of a robot whose mass is anywhere, and what they allow.

All is quasi-static: the robot is a rigid body that accelerates in the plane, without rocking. Its
zero moment point (M. Vukobratovic, B. Borovac, "Zero-Moment Point: Thirty Five Years of Its
Life", 2004) is where the floor's forces have no moment about any horizontal axis. Of masses m at
(x, y, z) with the acceleration a in space,

    p = sum m (g (x, y) - z a) / (g sum m).

Platform and arm count as one mass each, at their centres of mass.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from omniman_ros.control.dynamics import GRAVITY
from omniman_ros.control.kinematics import PlatformKinematics
from omniman_ros.control.limits import TwistLimits
from omniman_ros.core.arrays import Array
from omniman_ros.core.parameters import parameter
from omniman_ros.core.platform import Platform
from omniman_ros.core.validated import Validated

#: Smallest fraction of the limits of acceleration and deceleration that any posture leaves: the
#: robot must remain able to stop.
MIN_LIMIT_SCALE = 0.1
#: Number of steps in which the fraction of the limits changes: it is not reported at each movement
#: of the arm.
LIMIT_SCALE_STEPS = 20
PARALLEL = 1e-9  #: Area over that of the platform below which three wheels count as in line


@dataclass(frozen=True)
class StabilityParameters(Validated):
    """How much of the robot's stability accelerations may use; for robots with an arm only."""

    limit: bool = parameter(
        True,
        "Whether the limits of acceleration, deceleration and velocity are lowered where the "
        "arm's posture does not bear them.",
    )
    margin: float = parameter(
        0.05,
        "Smallest tip-over margin that the limits of the twist leave: distance of the zero moment "
        "point from the border of the wheels' contacts.",
        unit="m",
        low=0,
        high=1,
    )


class SupportModel:
    """What the wheels bear, and how far the robot is from tipping over.

    The loads are those of smallest norm that balance the weight and its moments, as of equal
    springs under the wheels (a rigid chassis on more than three wheels does not determine them).

    Args:
        kinematics: Kinematics of its n wheels, all of which drive: dead wheels have limits of
            their own.
        mass_matrix: Mass matrix (3, 3) of the robot about base_link's origin.
    """

    def __init__(
        self, robot: Platform, kinematics: PlatformKinematics, mass_matrix: Array
    ) -> None:
        wheels = robot.wheels
        parts = [(b.mass, b.com_x, b.com_y, b.com_z) for b in (robot.body, robot.arm)]
        mass, x, y, z = np.array(parts).T
        weight = GRAVITY * float(mass.sum())
        lever_arm = mass * z / weight  # [s^2]: times an acceleration, the shift of the point.
        self._rest = GRAVITY / weight * np.array([mass @ x, mass @ y])
        # Accelerations (ax, ay, yaw) of base_link's origin shift the point; w^2 pulls outwards.
        self._shift = -np.array(
            [[lever_arm.sum(), 0.0, -(lever_arm @ y)], [0.0, lever_arm.sum(), lever_arm @ x]]
        )
        self._spin = np.array([lever_arm @ x, lever_arm @ y])
        self._edges, self._offsets = support_edges(np.column_stack([wheels.x, wheels.y]))
        balance = np.linalg.pinv(np.array([np.ones(len(wheels.x)), wheels.x, wheels.y]))
        self._loads_at_rest = weight * (balance[:, 0] + balance[:, 1:] @ self._rest)
        self._load_shift = weight * balance[:, 1:]
        lengths = np.array(wheels.radius) * np.cos(wheels.roller_angle)
        # Force of each wheel along its roller's axis for an acceleration, CCTA 2017 (19).
        self._push = kinematics.J_pinv.T @ mass_matrix / lengths[:, None]
        self._friction = robot.friction.mu

    @property
    def rest_margin(self) -> float:
        """Tip-over margin at rest [m]; negative where the robot would tip over."""
        return float((self._edges @ self._rest + self._offsets).min())

    def zero_moment_point(self, acceleration: Array, yaw_rate: float = 0.0) -> Array:
        """Return the zero moment point (2,) in base_link [m].

        Args:
            acceleration: Acceleration (3,) of base_link's origin in space, in base_link, and of
                the yaw [m/s^2, m/s^2, rad/s^2].
            yaw_rate: Yaw rate [rad/s].
        """
        result: Array = self._rest + self._shift @ acceleration + yaw_rate**2 * self._spin
        return result

    def margin(self, acceleration: Array, yaw_rate: float = 0.0) -> float:
        """Return the tip-over margin [m]: how far the zero moment point is inside the contacts.

        It is negative outside. Arguments are those of :meth:`zero_moment_point`.
        """
        point = self.zero_moment_point(acceleration, yaw_rate)
        return float((self._edges @ point + self._offsets).min())

    def loads(self, acceleration: Array, yaw_rate: float = 0.0) -> Array:
        """Return the loads (n,) of the wheels [N]; 0 for a wheel that would lift.

        Arguments are those of :meth:`zero_moment_point`.
        """
        shift = self.zero_moment_point(acceleration, yaw_rate) - self._rest
        return np.maximum(self._loads_at_rest + self._load_shift @ shift, 0.0)

    def fraction(self, limits: TwistLimits, margin: float) -> float:
        """Return the fraction of the limits that keeps a tip-over margin, and all wheels' grip.

        Limits of acceleration and deceleration times s, and of velocity times the root of s, slow
        every motion down uniformly: all accelerations, the centripetal ones included, have s
        times their size, and the way of a stop, v^2 / (2 a), stays the same. So the shift of the
        zero moment point, the forces of the wheels and the changes of their loads are in
        proportion to s, and the largest s follows in closed form from the worst acceleration
        within the limits.

        For the margin it is in any direction, with the centripetal acceleration of the largest
        speeds. For the grip, force of each wheel at most mu times its load, which also keeps all
        wheels on the floor, it is without: a robot that slips in a curve finds grip again. The
        share is above 1 if the limits leave more than that. It is not positive if the robot does
        not have the margin, or a wheel no load, at rest.

        Args:
            margin: Smallest margin [m].
        """
        linear, yaw = map(max, limits.acceleration, limits.deceleration)
        speed, turn = limits.velocity
        used = self._edges @ self._shift
        lost = np.hypot(used[:, 0], used[:, 1]) * (linear + speed * turn)
        lost += np.abs(used[:, 2]) * yaw + np.maximum(-self._edges @ self._spin, 0.0) * turn**2
        spare = self._edges @ self._rest + self._offsets - margin
        fraction = _smallest_ratio(spare, lost)
        for side in (1.0, -1.0):
            asked = side * self._push - self._friction * self._load_shift @ self._shift
            need = np.hypot(asked[:, 0], asked[:, 1]) * linear + np.abs(asked[:, 2]) * yaw
            fraction = min(fraction, _smallest_ratio(self._friction * self._loads_at_rest, need))
        return fraction


class StabilityLimiter:
    """Lowers the limits of the twist to what the arm's posture bears.

    The fraction of the limits changes in steps, and rises only if the posture leaves half a step
    more.

    Attributes:
        fraction: Fraction of the limits of acceleration in use, from MIN_SHARE to 1.
    """

    def __init__(self) -> None:
        self.support: SupportModel | None = None
        self.fraction = 1.0

    def configure(
        self, parameters: StabilityParameters, support: SupportModel | None, limits: TwistLimits
    ) -> TwistLimits:
        """Set what the wheels bear now, and return the limits of the twist that this leaves.

        Args:
            limits: Limits of the twist for a robot that cannot tip over.
        """
        self.support = support
        if support is None or not parameters.limit:
            self.fraction = 1.0
            return limits
        exact = min(max(support.fraction(limits, parameters.margin), MIN_LIMIT_SCALE), 1.0)
        if not self.fraction <= exact < min(self.fraction + 1.5 / LIMIT_SCALE_STEPS, 1.0):
            self.fraction = max(
                math.floor(LIMIT_SCALE_STEPS * exact + 1e-9) / LIMIT_SCALE_STEPS, MIN_LIMIT_SCALE
            )
        return slowed_limits(limits, self.fraction)


def slowed_limits(limits: TwistLimits, fraction: float) -> TwistLimits:
    """Return limits for the same motions with a fraction of their accelerations; jerks stay."""
    if fraction == 1.0:
        return limits
    pace = math.sqrt(fraction)
    return replace(
        limits,
        linear_velocity=pace * limits.linear_velocity,
        angular_velocity=pace * limits.angular_velocity,
        linear_acceleration=fraction * limits.linear_acceleration,
        angular_acceleration=fraction * limits.angular_acceleration,
        linear_deceleration=fraction * limits.linear_deceleration,
        angular_deceleration=fraction * limits.angular_deceleration,
    )


def support_edges(points: Array) -> tuple[Array, Array]:
    """Return the edges of the smallest convex polygon around points.

    Args:
        points: The points (n, 2) [m], of which three are not in line.

    Returns:
        Inward unit normals (e, 2) and offsets (e,) [m]: normal . p + offset is the distance of a
        point p from an edge, and is positive inside.
    """
    middle = points.mean(axis=0)
    size = float(np.ptp(points, axis=0).max())
    normals, offsets = [], []
    for i, start in enumerate(points):
        for end in points[i + 1 :]:
            along = end - start
            length = math.hypot(*along)
            if length < PARALLEL * size:
                continue
            normal = np.array([-along[1], along[0]]) / length
            if normal @ (middle - start) < 0.0:
                normal = -normal
            distances = (points - start) @ normal
            if distances.min() >= -PARALLEL * size and distances.max() > PARALLEL * size:
                normals.append(normal)
                offsets.append(-float(normal @ start))
    return np.array(normals), np.array(offsets)


def _smallest_ratio(spare: Array, used: Array) -> float:
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = np.where(used > 0.0, spare / used, np.where(spare > 0.0, np.inf, 0.0))
    return float(ratios.min())
