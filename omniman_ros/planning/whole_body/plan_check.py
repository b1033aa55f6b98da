"""Check of a motion of the whole body to its end, before it is followed."""

import math
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.motion.whole_body.posture import PostureResolver
from omniman_ros.planning.motion import Motion
from omniman_ros.planning.whole_body.body_gaps import BodyGaps
from omniman_ros.planning.whole_body.parameters import DodgeOptions
from omniman_ros.planning.whole_body.redundancy import ToolRedundancy
from omniman_ros.planning.whole_body.surroundings import Hindrances

SAMPLE_STEP = 0.04
"""Time between two samples of a motion [s]."""
APPROACH = 0.002
"""How much nearer a body may come that is within the least clearance at the beginning [m]."""
EXCESS = 1.1
"""Share of a limit of the arm and the wheels that a motion may use between the program's nodes;
the program leaves the reserve of the limits free."""


@dataclass(frozen=True)
class Verdict:
    """Result of a check.

    Attributes:
        reason: Why the motion must not be followed; empty if it may.
        is_possible: Whether it keeps reach, limits and the gaps of the robot to itself.
        contact: Time until a part of the robot touches something, if all move on as they do [s].
        gap: Least gap on the way [m].
    """

    reason: str
    is_possible: bool
    contact: float
    gap: float

    @property
    def is_clear(self) -> bool:
        """Whether the motion may be followed."""
        return not self.reason

    def is_safer(self, other: "Verdict") -> bool:
        """Whether contact comes later than with another motion, or the gap stays wider."""
        mine, theirs = (self.is_possible, self.contact), (other.is_possible, other.contact)
        return mine > theirs or (mine == theirs and self.gap > other.gap)


class PlanCheck:
    """Checks motions in the redundancy on a fine grid in time.

    Args:
        redundancy: Kinematics on the path of the tool.
        gaps: Shape of the robot.
        resolver: Margins to singularities.
        limits: Limits of the nine axes and of the wheels.
        least_margin: Least margin to singularities.
        options: Options.
    """

    def __init__(
        self,
        redundancy: ToolRedundancy,
        gaps: BodyGaps,
        resolver: PostureResolver,
        limits: WholeBodyLimits,
        least_margin: float,
        options: DodgeOptions,
    ) -> None:
        self._redundancy, self._gaps, self._resolver = redundancy, gaps, resolver
        self._limits, self._options = limits, options
        self._least_margin = least_margin
        self._signs = resolver.signs(redundancy.centre)

    def judge(self, motion: Motion, now: float, until: float, around: Hindrances) -> Verdict:
        """Check a motion from a time on to its end, or longer.

        Args:
            motion: Motion of the redundancy coordinates.
            now: First time [s].
            until: Time up to which what moves is looked at [s].
            around: What is around the robot.
        """
        count = max(2, math.ceil((max(motion.end, until) - now) / SAMPLE_STEP) + 1)
        times = np.linspace(now, max(motion.end, until), count)
        z, rates = motion.at(times)
        q = self._redundancy.axes(z)
        reason = self._impossible(times, z, rates, q)
        if reason:
            return Verdict(reason, False, 0.0, -math.inf)
        placed = self._gaps.spheres.place(q[:, 3:])
        own = self._gaps.own(placed)
        ages = times - around.time
        gaps = self._gaps.to_hindrances(z[:, :3], placed, around, ages)
        standing = gaps.shape[1] - len(around.moving)
        least = np.minimum(own, gaps.min(axis=1, initial=np.inf))
        touches = np.flatnonzero(least <= 0.0)
        contact = float(times[touches[0]] - now) if len(touches) else math.inf
        grown = gaps.copy()
        grown[:, standing:] -= around.growth * (times - now)[:, None]
        least_clearance = self._options.least_clearance
        allowed = np.minimum(least_clearance, grown[0] - APPROACH)
        near = grown < allowed
        if near.any():
            k = int(near.any(axis=1).argmax())
            label = around.labels()[int((grown - allowed)[k].argmin())]
            reason = f"the plan comes too near to {label} in {times[k] - now:.2f} s"
        elif (own < min(self._options.own_clearance, float(own[0]) - APPROACH)).any():
            reason = "parts of the robot come too near to each other"
        return Verdict(reason, True, contact, float(least.min()))

    def _impossible(self, times: Array, z: Array, rates: Array, q: Array) -> str:
        """Return why a motion cannot be executed, or an empty string."""
        if not (np.isfinite(q).all() and np.isfinite(rates).all()):
            return "the tool is out of the arm's reach"
        limits, arm, span = self._limits, q[:, 3:], times[1] - times[0]
        margins, _ = self._resolver.margins(arm, self._signs)
        speeds = np.diff(arm, axis=0) / span
        accelerations = np.abs(np.diff(speeds, axis=0)) / span
        c, s = np.cos(z[:, 2]), np.sin(z[:, 2])
        x, y, w = rates[:, :3].T
        wheels = np.column_stack([c * x + s * y, c * y - s * x, w]) @ limits.wheels.T
        reasons = {
            "a joint is beyond its limit": (arm < limits.lower[3:]) | (arm > limits.upper[3:]),
            "a joint is half a revolution away from its start": span * np.abs(speeds) > math.pi,
            "the arm is too close to a singularity": margins < self._least_margin,
            "a joint is too fast": np.abs(speeds) > EXCESS * limits.velocity[3:],
            "a joint accelerates too much": accelerations > EXCESS * limits.acceleration[3:],
            "a wheel is too fast": np.abs(wheels) > EXCESS * limits.wheel_speed,
        }
        return next((reason for reason, broken in reasons.items() if broken.any()), "")
