"""Receding-horizon control of platform and arm in the redundancy, with the tool on its path."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.whole_body.limits import WholeBodyLimits
from omniman_ros.planning.motion import HermiteTrajectory
from omniman_ros.planning.motion_choice import MotionChoice, MotionChooser, rest_of
from omniman_ros.planning.mpc.quadratic_program import SolverError
from omniman_ros.planning.whole_body.body_gaps import BodyGaps
from omniman_ros.planning.whole_body.linearisation import Linearisation
from omniman_ros.planning.whole_body.obstacle_snapshot import ObstacleSnapshot
from omniman_ros.planning.whole_body.obstruction import Cause, Obstruction
from omniman_ros.planning.whole_body.parameters import AvoidanceOptions
from omniman_ros.planning.whole_body.plan_check import CycleCheck, PlanCheck, PlanVerdict
from omniman_ros.planning.whole_body.platform_path import PlatformPath
from omniman_ros.planning.whole_body.redundancy import PATH_PARAMETER, BodyRedundancy

PERIOD = 0.05  #: Time from cycle to cycle [s]; a plan begins one period after its cycle
#: Number of brakings of a motion that are checked in search of its longest clear part: a check of
#: the whole body takes milliseconds
BRAKINGS = 2
#: Distance of an obstacle from the platform's place within a horizon beyond which it is left out
#: [m], besides the platform's own radius.
OBSTACLE_CUTOFF = 1.6
BRAKING_NODE = 0.05  #: Time between two nodes while the robot brakes [s]
LEAST_BRAKING = 0.2  #: Least time in which the robot brakes [s]
BRAKING_LIMIT_FRACTION = (
    0.7  #: Fraction of the limits on acceleration that braking along a plan uses
)
END_DISTANCE = 0.0005  #: Distance from the end of the path at which it is completed [m]
AT_REST = 0.002  #: Speed below which the tool is at rest at the end [m/s]


@dataclass(frozen=True)
class CycleOutcome:
    """Result of a cycle."""

    choice: MotionChoice  #: The motion that is followed from now on
    verdict: PlanVerdict  #: What the check says of it
    #: What is in the way of the whole new plan; None if nothing is
    obstruction: Obstruction | None = None


class WholeBodyController:
    """Moves platform and arm along the path of the tool, past what stands and moves.

    Each cycle improves the last plan by one Gauss-Newton step. A plan ends at rest. Its longest
    clear part is followed, which brakes along the plan; see `MotionChooser`.
    """

    def __init__(
        self,
        redundancy: BodyRedundancy,
        gaps: BodyGaps,
        limits: WholeBodyLimits,
        linearisation: Linearisation,
        check: PlanCheck,
        options: AvoidanceOptions,
    ) -> None:
        self._redundancy, self._gaps, self._limits = redundancy, gaps, limits
        self._linearisation, self._check, self._options = linearisation, check, options
        self._step, self._horizon = options.step, options.steps * options.step
        self.motion = _rest(0.0, np.zeros(len(redundancy.bound)))
        self._choice: MotionChoice | None = None
        #: Times at which motions that brake begin to, by the times at which they end [s]
        self._brakes_from: dict[float, float] = {}

    def begin(self, time: float, start: Array) -> None:
        """Begin at rest at a time [s] at redundancy coordinates (d,).

        Raises:
            InputError: The tool is out of reach there.
        """
        if not np.isfinite(self._redundancy.axes(start[None])).all():
            raise InputError("the arm does not reach the tool's path at the start")
        self.motion, self._choice = _rest(time, start), None

    def is_completed(self, time: float) -> bool:
        """Return whether the tool is at rest at the end of the path at a time [s].

        The platform may still move, to where it is to be there: that is not waited for.
        """
        z, rates = self.motion.sample(time)
        is_there = self._redundancy.path.end - z[PATH_PARAMETER] <= END_DISTANCE
        return bool(is_there and rates[PATH_PARAMETER] <= AT_REST)

    def cycle(
        self,
        now: float,
        way: PlatformPath,
        around: ObstacleSnapshot,
        ready: float | None = None,
    ) -> CycleOutcome:
        """Choose the motion from a time [s] on; the way of the platform leads the plans.

        Args:
            ready: Time at which the result is expected [s], before which nothing can brake; None:
                at once.
        """
        ready = now if ready is None else ready
        around = self._near(now, around)
        due = max(now + PERIOD, ready)
        check = CycleCheck(self._check, due + self._horizon, around)
        last = self.motion = rest_of(self.motion, now)
        known = self._brakes_from.get(last.end)
        self._brakes_from = {} if known is None else {last.end: known}
        guesses, faults = self._guesses(last, due), list[str]()
        plans = self._plans(guesses, due, way, around, faults)

        def brakings(motion: HermiteTrajectory, times: Sequence[float]) -> list[HermiteTrajectory]:
            shorter = self._braked_each(motion, times)
            check.judge([*shorter, last], now)  # the last motion is what comes next
            return shorter

        # People may not see the robot: where contact comes on every motion, it is to rest by then.
        chooser = MotionChooser(
            check, self.braked, now, ready, BRAKINGS, brakings, evades_contact=False
        )
        self._choice = choice = chooser.choose(plans, due + 0.5 * self._step, last, self._choice)
        self.motion = choice.motion
        found = check.first.obstruction if check.first is not None else None
        if len(faults) == len(guesses):  # there was no plan to check
            place = float(last.sample(due)[0][PATH_PARAMETER])
            found = Obstruction(Cause.PROGRAM, place, "", faults[0])
        return CycleOutcome(choice, check.verdict(choice.motion, now), found)

    def _guesses(self, last: HermiteTrajectory, due: float) -> list[HermiteTrajectory]:
        """Return the motions that plans from a time [s] on improve.

        Where the last cycle had no clear plan, the second one is braking, which leads to an
        evasion: from there, the robot is free to go elsewhere. A robot that evades or brakes
        already improves on what it does.
        """
        before = self._choice
        follows_plan = before is None or (before.is_clear and before.plan is not None)
        if follows_plan or (before is not None and before.is_evasion):
            return [last]
        braked = self.braked(last, due)
        return [last] if braked is last else [last, braked]

    def _plans(
        self,
        guesses: Sequence[HermiteTrajectory],
        due: float,
        way: PlatformPath,
        around: ObstacleSnapshot,
        faults: list[str],
    ) -> Iterator[HermiteTrajectory]:
        """Yield new plans from a time [s] on, and append to `faults` why one is missing.

        Each is made if it is asked for.
        """
        last = self.motion
        before = last.between(last.start, due)
        for guess in guesses:
            times: Array = due + self._step * np.arange(self._options.steps + 1.0)
            z, rates = guess.at(times)
            controls = np.diff(rates, axis=0) / self._step
            for k, control in enumerate(controls):
                z[k + 1] = z[k] + self._step * rates[k] + 0.5 * self._step**2 * control
            try:
                z, rates = self._linearisation.improved(z, rates, controls, times, way, around)
            except SolverError as error:
                faults.append(str(error))
                continue
            plan = HermiteTrajectory.unchecked(
                times=times,
                poses=z,
                velocities=rates,
                currents=np.zeros((self._options.steps, 0)),
            )
            yield before.then(plan)

    def braked(self, motion: HermiteTrajectory, time: float) -> HermiteTrajectory:
        """Return a motion that from a time [s] on is slowed down to rest on its own way.

        One that brakes already is returned as it is: to brake it again would be harder.
        """
        return self._braked_each(motion, [time])[0]

    def _braked_each(
        self, motion: HermiteTrajectory, times: Sequence[float]
    ) -> list[HermiteTrajectory]:
        """Return what `braked` does for each of several times [s]."""
        brakes = min(self._brakes_from.get(motion.end, math.inf), motion.end)
        if all(time >= brakes for time in times):
            return [motion] * len(times)  # it brakes already, and all motions end at rest
        z, rates = motion.at(np.array(times))
        at = self._redundancy.configurations(z)
        speeds = np.abs(np.hstack([rates[:, :3], np.einsum("kij,kj->ki", at.rates, rates)]))
        fractions = speeds / (BRAKING_LIMIT_FRACTION * self._limits.acceleration)
        durations = np.maximum(LEAST_BRAKING, np.nan_to_num(fractions, nan=1.0).max(axis=1))
        is_moving = np.abs(rates).max(axis=1) > 0.0
        each = zip(times, durations.tolist(), is_moving.tolist(), strict=True)
        return [
            motion if time >= brakes else self._slowed(motion, time, duration, moves=moves)
            for time, duration, moves in each
        ]

    def _slowed(
        self, motion: HermiteTrajectory, time: float, duration: float, *, moves: bool
    ) -> HermiteTrajectory:
        """Return a motion that from a time [s] on comes to rest within a duration [s]."""
        if not moves:
            return motion.between(motion.start, max(time, motion.start + PERIOD))
        count = max(2, math.ceil(duration / BRAKING_NODE))
        elapsed = np.linspace(0.0, duration, count + 1)
        # Time on the motion goes by at a rate that falls linearly from 1 to 0.
        inner, inner_rates = motion.at(time + elapsed - 0.5 * elapsed**2 / duration)
        pace = (1.0 - elapsed / duration)[:, None]
        tail = HermiteTrajectory.unchecked(
            times=time + elapsed,
            poses=inner,
            velocities=pace * inner_rates,
            currents=np.zeros((count, 0)),
        )
        self._brakes_from[tail.end] = time
        if time <= motion.start + 1e-6:
            return tail
        return motion.between(motion.start, time).then(tail)

    def _near(self, now: float, around: ObstacleSnapshot) -> ObstacleSnapshot:
        """Return what is around the robot, without standing obstacles that are far away."""
        places, _ = self.motion.sample(now)
        reach = OBSTACLE_CUTOFF + self._gaps.radius
        index = around.standing_near(places[:2], reach)
        moving = around.moving.obstacles.centre + (now - around.time) * around.moving.velocity
        closing = np.hypot(*around.moving.velocity) * self._horizon
        is_near = np.hypot(*(moving - places[:2, None])) - closing < reach + 1.0
        return around.selected(index, np.flatnonzero(is_near))


def _rest(time: float, z: Array) -> HermiteTrajectory:
    """Return a motion at rest at redundancy coordinates (d,) from a time [s] on."""
    return HermiteTrajectory.coasting(time, z, np.zeros_like(z), 0)
