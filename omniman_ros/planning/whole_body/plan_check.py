"""Check of a motion of the whole body to its end, before it is followed."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.redundancy_resolver import RedundancyResolver
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.whole_body.body_gaps import BodyGaps
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.obstruction import Cause, Obstruction
from omniman_ros.planning.whole_body.parameters import AvoidanceOptions
from omniman_ros.planning.whole_body.redundancy import PATH_PARAMETER, ToolRedundancy

SAMPLE_STEP = 0.04  #: Time between two samples of a motion [s]
#: How much nearer a body may come that is within the least clearance at the beginning [m]
APPROACH = 0.002
#: Fraction of a limit of the arm and the wheels that a motion may use between the program's nodes;
#: the program leaves the reserve of the limits free.
EXCESS = 1.1
AXIS_NAMES = {
    Cause.JOINT_LIMIT: "joint {}",
    Cause.REVOLUTION: "joint {}",
    Cause.SINGULARITY: "",
    Cause.JOINT_SPEED: "joint {}",
    Cause.JOINT_ACCELERATION: "joint {}",
    Cause.WHEEL_SPEED: "wheel {}",
}  #: What breaks a limit, by its number from 1 on


@dataclass(frozen=True)
class PlanVerdict:
    """Result of a check."""

    obstruction: Obstruction | None  #: Why the motion must not be followed; None if it may
    is_possible: bool  #: Whether it keeps reach, limits and the gaps of the robot to itself
    #: Time until a part of the robot touches something, if all move on as they do [s]
    contact: float
    gap: float  #: Least gap on the way [m]
    #: Obstacle that leaves the least room on the way; None without any
    nearest: Obstruction | None = None

    @property
    def is_clear(self) -> bool:
        """Whether the motion may be followed."""
        return self.obstruction is None

    def is_safer(self, other: "PlanVerdict") -> bool:
        """Whether contact comes later than with another motion, or the gap stays wider."""
        mine, theirs = (self.is_possible, self.contact), (other.is_possible, other.contact)
        return mine > theirs or (mine == theirs and self.gap > other.gap)


class PlanCheck:
    """Checks motions in the redundancy on a fine grid in time."""

    def __init__(
        self,
        redundancy: ToolRedundancy,
        gaps: BodyGaps,
        resolver: RedundancyResolver,
        limits: WholeBodyLimits,
        least_margin: float,
        options: AvoidanceOptions,
    ) -> None:
        self._redundancy, self._gaps, self._resolver = redundancy, gaps, resolver
        self._limits, self._options = limits, options
        self._least_margin = least_margin
        self._signs = resolver.signs(redundancy.centre)

    def judge(
        self, motion: HermiteTrajectory, now: float, until: float, around: ObstacleSnapshot
    ) -> PlanVerdict:
        """Check a motion to its end, or longer; what moves is looked at up to `until` [s]."""
        count = max(2, math.ceil((max(motion.end, until) - now) / SAMPLE_STEP) + 1)
        times = np.linspace(now, max(motion.end, until), count)
        z, rates = motion.at(times)
        q = self._redundancy.axes(z)
        if fault := self._impossible(times, z, rates, q):
            return PlanVerdict(fault, False, 0.0, -math.inf)
        placed = self._gaps.spheres.place(q[:, 3:])
        own = self._gaps.own(placed)
        obstacles = around.placed(times - around.time)
        of_parts = self._gaps.to_obstacles(z[:, :3], placed, obstacles)
        gaps = of_parts.min(axis=1)
        standing = len(around.standing)
        least = np.minimum(own, gaps.min(axis=1, initial=np.inf))
        touches = np.flatnonzero(least <= 0.0)
        contact = float(times[touches[0]] - now) if len(touches) else math.inf
        grown = gaps.copy()
        grown[:, standing:] -= around.growth * (times - now)[:, None]
        allowed = np.minimum(self._options.least_clearance, grown[0] - APPROACH)
        is_near = (grown < allowed).any(axis=1)
        own_allowed = min(self._options.own_clearance, float(own[0]) - APPROACH)
        found = nearest = None

        def obstacle(k: int, index: int) -> Obstruction:
            cause = Cause.STANDING if index < standing else Cause.MOVING
            part = self._gaps.part_name(int(of_parts[k, :, index].argmin()))
            return Obstruction(cause, float(z[k, PATH_PARAMETER]), part, around.labels()[index])

        if gaps.shape[1]:
            clearance = np.full(gaps.shape[1], self._options.clearance)
            clearance[standing:] = self._options.moving_clearance
            room = grown - clearance
            nearest = obstacle(*divmod(int(room.argmin()), room.shape[1]))
        if is_near.any():
            k = int(is_near.argmax())
            found = obstacle(k, int((grown - allowed)[k].argmin()))
        elif (own < own_allowed).any():
            k = int((own < own_allowed).argmax())
            pair = self._gaps.nearest_own(placed, k)
            found = Obstruction(Cause.SELF, float(z[k, PATH_PARAMETER]), *pair)
        return PlanVerdict(found, True, contact, float(least.min()), nearest)

    def _impossible(self, times: Array, z: Array, rates: Array, q: Array) -> Obstruction | None:
        """Return why a motion cannot be executed, or None."""
        is_reached = np.isfinite(q).all(axis=1) & np.isfinite(rates).all(axis=1)
        if not is_reached.all():
            return Obstruction(Cause.REACH, float(z[int(is_reached.argmin()), PATH_PARAMETER]))
        limits, arm, span = self._limits, q[:, 3:], times[1] - times[0]
        margins, _ = self._resolver.margins(arm, self._signs)
        speeds = np.diff(arm, axis=0) / span
        accelerations = np.abs(np.diff(speeds, axis=0)) / span
        c, s = np.cos(z[:, 2]), np.sin(z[:, 2])
        x, y, w = rates[:, :3].T
        wheels = np.column_stack([c * x + s * y, c * y - s * x, w]) @ limits.wheels.T
        faults = {
            Cause.JOINT_LIMIT: (arm < limits.lower[3:]) | (arm > limits.upper[3:]),
            Cause.REVOLUTION: span * np.abs(speeds) > math.pi,
            Cause.SINGULARITY: margins < self._least_margin,
            Cause.JOINT_SPEED: np.abs(speeds) > EXCESS * limits.velocity[3:],
            Cause.JOINT_ACCELERATION: accelerations > EXCESS * limits.acceleration[3:],
            Cause.WHEEL_SPEED: np.abs(wheels) > EXCESS * limits.wheel_speed,
        }
        for cause, broken in faults.items():
            if broken.any():
                k, axis = np.unravel_index(int(broken.argmax()), broken.shape)
                place = float(z[k, PATH_PARAMETER])
                return Obstruction(cause, place, AXIS_NAMES[cause].format(int(axis) + 1))
        return None
