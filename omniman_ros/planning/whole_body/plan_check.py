"""Check of a motion of the whole body to its end, before it is followed."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.body_spheres import PlacedSpheres
from omniman_ros.collision.convex_search import Indices
from omniman_ros.core.arrays import Array
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.whole_body.body_balance import BodyBalance
from omniman_ros.planning.whole_body.body_gaps import NEAR, BodyGaps
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.obstruction import Cause, Obstruction
from omniman_ros.planning.whole_body.parameters import AvoidanceOptions
from omniman_ros.planning.whole_body.redundancy import (
    PATH_PARAMETER,
    BodyRedundancy,
    SingularityMargins,
)

SAMPLE_STEP = 0.04  #: Time between two samples of a motion [s]
#: Part of the least gaps that a robot may consume which is about as close as allowed [m]. It does
#: not add up over cycles: a robot that is closer may move, but not closer.
CONSUMED = 0.005
GAP_TOLERANCE = 1e-6  #: Difference below which gaps count as equal [m]
#: Fraction of a limit of the arm and the wheels that a motion may use between the program's nodes;
#: the program leaves the reserve of the limits free.
EXCESS = 1.1
REST_FRACTION = 0.5  #: Fraction of its tip-over margin at rest that a robot may always have left
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
    #: Time from which it must not be followed [s]; infinite if it may
    obstructed_at: float
    #: Time at which a part of the robot touches something, if all move on as they do [s]; minus
    #: infinity if the motion breaks reach or limits, or has parts of the robot meet
    contact: float
    gap: float  #: Least gap to obstacles on the way [m], up to `moving_clearance`
    #: Obstacle that leaves the least room on the way; None without any
    nearest: Obstruction | None = None

    @property
    def is_clear(self) -> bool:
        """Whether the motion may be followed."""
        return self.obstruction is None


class PlanCheck:
    """Checks motions in the redundancy on a fine grid in time.

    Args:
        margins: The arm's margins to singularities; None: it may pass through them.
    """

    def __init__(
        self,
        redundancy: BodyRedundancy,
        gaps: BodyGaps,
        balance: BodyBalance,
        margins: SingularityMargins | None,
        limits: WholeBodyLimits,
        options: AvoidanceOptions,
    ) -> None:
        self._redundancy, self._gaps, self._margins = redundancy, gaps, margins
        self._balance = balance
        self._limits, self._options = limits, options
        self._reach = max(NEAR, options.clearance, options.moving_clearance)
        self.radius = gaps.radius  #: Distance of the platform's farthest point from its centre [m]

    def judge(
        self,
        motions: Sequence[HermiteTrajectory],
        now: float,
        until: float,
        around: ObstacleSnapshot,
    ) -> list[PlanVerdict]:
        """Check motions to their ends, or longer; what moves is looked at up to `until` [s].

        All samples of several motions are computed together: half the time of one is overhead.
        """
        samples, seen, begin = [], [], 0
        for motion in motions:
            end = max(motion.end, until)
            count = max(2, math.ceil((end - now) / SAMPLE_STEP) + 1)
            times = np.linspace(now, end, count)
            # At its end, the robot comes to rest: two samples there show all that follows.
            moving = min(int(np.searchsorted(times, motion.end)) + 2, count)
            kept = count if len(around.moving) else moving
            seen.append(begin + np.minimum(np.arange(kept), moving - 1))
            samples.append((times[:kept], *motion.at(times[:moving])))
            begin += moving
        z, index = np.concatenate([each[1] for each in samples]), np.concatenate(seen)
        q = self._redundancy.axes(z)
        placed = self._gaps.spheres.place(q[:, 3:])
        own, masses = self._gaps.own(placed), self._balance.arm_centres(placed.frames)
        ages = np.concatenate([each[0] for each in samples]) - around.time
        gaps, parts = self._gaps.to_obstacles(
            z[index, :3], placed.centre[index], around, ages, self._reach
        )
        verdicts, begin, first = [], 0, 0
        for times, at, rates in samples:
            mine = slice(begin, begin + len(at))
            begin, last = mine.stop, first + len(times)
            found = (
                self._impossible(times, at, rates, q[mine])
                or self._too_near_itself(at, placed, own[mine], mine.start)
                or self._tips_over(times, at, masses[mine])
            )
            if found is not None:
                fault, k = found
                verdict = PlanVerdict(fault, float(times[k]), -math.inf, -math.inf)
            else:
                places = z[index[first:last], PATH_PARAMETER]
                there = slice(first, last)
                verdict = self._beside(times, places, gaps[there], parts[there], around)
            verdicts.append(verdict)
            first = last
        return verdicts

    def _too_near_itself(
        self, z: Array, placed: PlacedSpheres, own: Array, begin: int
    ) -> tuple[Obstruction, int] | None:
        """Return which parts of the robot are too near to each other, and the sample; or None.

        The own gaps (k,) are those of all placed spheres from `begin` on.
        """
        is_near = _too_near(own[:, None], self._options.own_clearance)[:, 0]
        if not is_near.any():
            return None
        k = int(is_near.argmax())
        parts = self._gaps.nearest_own(placed, begin + k)
        return Obstruction(Cause.SELF, float(z[k, PATH_PARAMETER]), *parts), k

    def _tips_over(self, times: Array, z: Array, arm: Array) -> tuple[Obstruction, int] | None:
        """Return that the robot would be too close to tipping over, and the sample; or None.

        The arm's centres of mass are (k, 3) [m].
        """
        at_rest = self._balance.rest_margin(arm[0])
        least = min(self._options.tip_over_margin, REST_FRACTION * at_rest)
        is_low = self._balance.margins(times[: len(z)], z[:, :3], arm) < least
        if not is_low.any():
            return None
        k = 1 + int(is_low.argmax())
        return Obstruction(Cause.TIPPING, float(z[k, PATH_PARAMETER])), k

    def _beside(
        self,
        times: Array,
        places: Array,
        gaps: Array,
        parts: Indices,
        around: ObstacleSnapshot,
    ) -> PlanVerdict:
        """Return the verdict on gaps (k, M) of nearest parts at times and places (k,)."""
        o, standing = self._options, len(around.standing)
        if not gaps.shape[1]:
            return PlanVerdict(None, math.inf, math.inf, math.inf)

        def obstacle(k: int, index: int) -> Obstruction:
            cause = Cause.STANDING if index < standing else Cause.MOVING
            part = self._gaps.part_name(int(parts[k, index]))
            return Obstruction(cause, float(places[k]), part, around.labels()[index])

        # What is touched already counts for the gap alone: who leaves it must not touch others.
        touches = np.flatnonzero((gaps[:, gaps[0] > 0.0] <= 0.0).any(axis=1))
        contact = float(times[touches[0]]) if len(touches) else math.inf
        least = min(float(gaps.min()), o.moving_clearance)
        grown = gaps.copy()
        grown[:, standing:] -= around.growth * (times - times[0])[:, None]
        clearance = np.full(gaps.shape[1], o.clearance)
        clearance[standing:] = o.moving_clearance
        nearest = obstacle(*divmod(int((grown - clearance).argmin()), gaps.shape[1]))
        is_near = _too_near(grown, o.least_clearance)
        if not is_near.any():
            return PlanVerdict(None, math.inf, contact, least, nearest)
        k = int(is_near.any(axis=1).argmax())
        found = obstacle(k, int(np.where(is_near[k], grown[k], np.inf).argmin()))
        return PlanVerdict(found, float(times[k]), contact, least, nearest)

    def _impossible(
        self, times: Array, z: Array, rates: Array, q: Array
    ) -> tuple[Obstruction, int] | None:
        """Return why a motion cannot be executed, and the number of the sample; or None."""
        is_reached = np.isfinite(q).all(axis=1) & np.isfinite(rates).all(axis=1)
        if not is_reached.all():
            k = int(is_reached.argmin())
            return Obstruction(Cause.REACH, float(z[k, PATH_PARAMETER])), k
        limits, arm, span = self._limits, q[:, 3:], times[1] - times[0]
        speeds = np.diff(arm, axis=0) / span
        accelerations = np.abs(np.diff(speeds, axis=0)) / span
        c, s = np.cos(z[:, 2]), np.sin(z[:, 2])
        x, y, w = rates[:, :3].T
        wheels = np.column_stack([c * x + s * y, c * y - s * x, w]) @ limits.wheels.T
        faults = {
            Cause.JOINT_LIMIT: (arm < limits.lower[3:]) | (arm > limits.upper[3:]),
            Cause.REVOLUTION: span * np.abs(speeds) > math.pi,
            Cause.JOINT_SPEED: np.abs(speeds) > EXCESS * limits.velocity[3:],
            Cause.JOINT_ACCELERATION: accelerations > EXCESS * limits.acceleration[3:],
            Cause.WHEEL_SPEED: np.abs(wheels) > EXCESS * limits.wheel_speed,
        }
        if self._margins is not None:
            faults[Cause.SINGULARITY] = self._margins.at(arm)[0] < self._margins.least
        for cause, broken in faults.items():
            if broken.any():
                k, axis = divmod(int(broken.argmax()), broken.shape[1])
                place = float(z[k, PATH_PARAMETER])
                return Obstruction(cause, place, AXIS_NAMES[cause].format(axis + 1)), k
        return None


def _too_near(gaps: Array, least: float) -> NDArray[np.bool_]:
    """Return which gaps (k, m) along a motion are below the least one without need."""
    start = gaps[0]
    allowed = least + np.clip(start - least - CONSUMED, -CONSUMED, 0.0)
    leaves = (start <= least) & (gaps >= start - GAP_TOLERANCE)
    result: NDArray[np.bool_] = (gaps < allowed) & ~leaves
    return result


class CycleCheck:
    """The check of the motions of one cycle, each of which is judged once; see `MotionCheck`.

    What moves is looked at up to `until` [s].

    Attributes:
        first: Verdict on the first motion that was judged, if any.
    """

    def __init__(self, check: PlanCheck, until: float, around: ObstacleSnapshot) -> None:
        self._check, self._until, self._around = check, until, around
        self._judged: dict[int, tuple[HermiteTrajectory, PlanVerdict]] = {}
        self.first: PlanVerdict | None = None

    def judge(self, motions: Sequence[HermiteTrajectory], now: float) -> None:
        """Judge motions together from a time [s] on, as their verdicts will be asked for."""
        new = {id(motion): motion for motion in motions if id(motion) not in self._judged}
        if new:
            verdicts = self._check.judge([*new.values()], now, self._until, self._around)
            self.first = self.first or verdicts[0]
            for (key, motion), verdict in zip(new.items(), verdicts, strict=True):
                self._judged[key] = motion, verdict

    def verdict(self, motion: HermiteTrajectory, now: float) -> PlanVerdict:
        """Return the verdict on a motion from a time [s] on."""
        self.judge([motion], now)
        return self._judged[id(motion)][1]

    def contact(self, motion: HermiteTrajectory, now: float) -> float:
        """Return the time from which a motion must not be followed [s]; infinity if it may."""
        return self.verdict(motion, now).obstructed_at

    def threat(self, motion: HermiteTrajectory, now: float) -> tuple[float, float]:
        """Return the time of contact [s] and the least gap [m]; see `PlanVerdict.contact`."""
        verdict = self.verdict(motion, now)
        return verdict.contact, verdict.gap
