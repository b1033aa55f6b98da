"""Receding-horizon control of platform and arm in the redundancy, with the tool on its path."""

import enum
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.mpc.quadratic_program import SolverError
from omniman_ros.planning.whole_body.body_gaps import BodyGaps
from omniman_ros.planning.whole_body.linearisation import Linearisation
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.obstruction import Cause, Obstruction
from omniman_ros.planning.whole_body.parameters import AvoidanceOptions
from omniman_ros.planning.whole_body.plan_check import PlanCheck, PlanVerdict
from omniman_ros.planning.whole_body.platform_path import PlatformPath
from omniman_ros.planning.whole_body.redundancy import COORDINATES, PATH_PARAMETER, ToolRedundancy

PERIOD = 0.05  #: Time from cycle to cycle [s]; a plan begins one period after its cycle
HISTORY_TIME = 0.2  #: Length of the past part of a motion that is kept [s]
#: Time for which a new plan that is not clear is followed before it brakes [s]
UNCLEAR_PLAN_TIME = 0.4
#: Distance of an obstacle from the platform's place within a horizon beyond which it is left out
#: [m], besides the platform's own radius.
OBSTACLE_CUTOFF = 1.6
BRAKING_NODE = 0.05  #: Time between two nodes while the robot brakes [s]
LEAST_BRAKING = 0.2  #: Least time in which the robot brakes [s]
BRAKING_LIMIT_FRACTION = (
    0.7  #: Fraction of the limits on acceleration that braking along a plan uses
)
END_DISTANCE = 0.0005  #: Distance from the end of the path at which it is completed [m]
AT_REST = 0.002  #: Rate below which the robot is at rest at the end [m/s, rad/s]


class Choice(enum.Enum):
    """What is followed after a cycle."""

    PLAN = "plan"
    BEGINNING = "plan, then braking"
    LAST_PLAN = "last plan"
    BRAKING = "braking"


@dataclass(frozen=True)
class CycleOutcome:
    """Result of a cycle."""

    choice: Choice  #: What is followed from now on
    verdict: PlanVerdict  #: What the check says of it
    #: What is in the way of the whole new plan; None if nothing is
    obstruction: Obstruction | None = None


class WholeBodyController:
    """Moves platform and arm along the path of the tool, past what stands and moves.

    Each cycle improves the last plan by one Gauss-Newton step. A plan ends at rest, and is
    followed only if it is clear to its end, or if nothing else is safer.
    """

    def __init__(
        self,
        redundancy: ToolRedundancy,
        gaps: BodyGaps,
        limits: WholeBodyLimits,
        linearisation: Linearisation,
        check: PlanCheck,
        options: AvoidanceOptions,
    ) -> None:
        self._redundancy, self._gaps, self._limits = redundancy, gaps, limits
        self._linearisation, self._check, self._options = linearisation, check, options
        self.motion = _rest(0.0, np.zeros(COORDINATES))

    def begin(self, time: float, start: Array) -> None:
        """Begin at rest at a time [s] at redundancy coordinates (4,).

        Raises:
            InputError: The tool is out of reach there.
        """
        if not np.isfinite(self._redundancy.axes(start[None])).all():
            raise InputError("the arm does not reach the tool's path at the start")
        self.motion = _rest(time, start)

    def is_completed(self, time: float) -> bool:
        """Return whether the robot is at rest at the end of the path at a time [s]."""
        z, rates = self.motion.sample(time)
        is_there = self._redundancy.path.end - z[PATH_PARAMETER] <= END_DISTANCE
        return bool(is_there and np.abs(rates).max() <= AT_REST)

    def cycle(self, now: float, way: PlatformPath, around: ObstacleSnapshot) -> CycleOutcome:
        """Choose the motion from a time [s] on; the way of the platform leads the plans."""
        around = self._near(now, around)
        due = now + PERIOD
        until = due + self._options.steps * self._options.step
        plan, fault = self._plan(due, way, around)
        best: tuple[HermiteTrajectory, CycleOutcome] | None = None
        found = None
        if plan is None:
            found = Obstruction(
                Cause.PROGRAM, float(self.motion.sample(due)[0][PATH_PARAMETER]), "", fault
            )
        for choice, motion in self._candidates(now, due, plan):
            verdict = self._check.judge(motion, now, until, around)
            found = found or verdict.obstruction
            outcome = CycleOutcome(choice, verdict, found)
            if verdict.is_clear:
                best = motion, outcome
                break
            if best is None or verdict.is_safer(best[1].verdict):
                best = motion, outcome
        assert best is not None  # braking is always a candidate
        self.motion, outcome = best
        return outcome

    def _plan(
        self, due: float, way: PlatformPath, around: ObstacleSnapshot
    ) -> tuple[HermiteTrajectory | None, str]:
        """Return the new plan from a time [s] on, or None and the reason."""
        o = self._options
        times: Array = due + o.step * np.arange(o.steps + 1.0)
        z, rates = self.motion.at(times)
        controls = np.diff(rates, axis=0) / o.step
        for k in range(o.steps):
            z[k + 1] = z[k] + o.step * rates[k] + 0.5 * o.step**2 * controls[k]
        try:
            z, rates = self._linearisation.improved(z, rates, controls, times, way, around)
        except SolverError as error:
            return None, str(error)
        before = self.motion.between(max(self.motion.start, due - HISTORY_TIME - PERIOD), due)
        return before.then(HermiteTrajectory(times, z, rates, np.zeros((o.steps, 0)))), ""

    def _candidates(
        self, now: float, due: float, plan: HermiteTrajectory | None
    ) -> Iterator[tuple[Choice, HermiteTrajectory]]:
        """Yield the motions to choose from, in the order of preference."""
        if plan is not None:
            yield Choice.PLAN, plan
            yield Choice.BEGINNING, self.braked(plan, due + UNCLEAR_PLAN_TIME)
        begins = max(self.motion.start, now - HISTORY_TIME)
        last = self.motion.between(begins, max(self.motion.end, now + PERIOD))
        yield Choice.LAST_PLAN, last
        yield Choice.BRAKING, self.braked(last, now)

    def braked(self, motion: HermiteTrajectory, time: float) -> HermiteTrajectory:
        """Return a motion that from a time [s] on is slowed down to rest on its own way."""
        z, rates = motion.sample(time)
        if not np.abs(rates).max() > 0.0:
            return motion.between(motion.start, max(time, motion.start + PERIOD))
        at = self._redundancy.configurations(z[None])
        speeds = np.abs(np.concatenate([rates[:3], (at.rates[0] @ rates)]))
        fraction = speeds / (BRAKING_LIMIT_FRACTION * self._limits.acceleration)
        duration = max(LEAST_BRAKING, float(np.nan_to_num(fraction, nan=1.0).max()))
        count = max(2, math.ceil(duration / BRAKING_NODE))
        elapsed = np.linspace(0.0, duration, count + 1)
        # Time on the motion goes by at a rate that falls linearly from 1 to 0.
        inner, inner_rates = motion.at(time + elapsed - 0.5 * elapsed**2 / duration)
        pace = (1.0 - elapsed / duration)[:, None]
        tail = HermiteTrajectory(time + elapsed, inner, pace * inner_rates, np.zeros((count, 0)))
        if time <= motion.start + 1e-6:
            return tail
        return motion.between(motion.start, time).then(tail)

    def _near(self, now: float, around: ObstacleSnapshot) -> ObstacleSnapshot:
        """Return what is around the robot, without standing obstacles that are far away."""
        places, _ = self.motion.sample(now)
        offset = around.standing.centre - places[:2, None]
        extent = np.hypot(*around.standing.half) + around.standing.rounding
        reach = OBSTACLE_CUTOFF + self._gaps.radius
        index = np.flatnonzero(np.hypot(*offset) - extent < reach)
        moving = around.moving.obstacles.centre + (now - around.time) * around.moving.velocity
        closing = np.hypot(*around.moving.velocity) * self._options.steps * self._options.step
        is_near = np.hypot(*(moving - places[:2, None])) - closing < reach + 1.0
        return around.selected(index, np.flatnonzero(is_near))


def _rest(time: float, z: Array) -> HermiteTrajectory:
    """Return a motion at rest at redundancy coordinates (4,) from a time [s] on."""
    return HermiteTrajectory.coasting(time, z, np.zeros(COORDINATES), 0)
