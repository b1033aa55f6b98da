"""Limit of the speed at which the robot can still come to rest before it touches anything."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from omniman_ros.collision.body_geometry import BodyGeometry
from omniman_ros.collision.curve import curve_poses
from omniman_ros.collision.moving_obstacles import MovingObstacles
from omniman_ros.collision.rectangles import Rectangles
from omniman_ros.collision.speed_limits import SpeedLimits
from omniman_ros.collision.unseen import (
    Arrivals,
    OcclusionLimit,
    UnseenLimitParameters,
    unseen_limit,
)
from omniman_ros.collision.upright_obstacles import UprightObstacles
from omniman_ros.core.arrays import Array, Shape
from omniman_ros.core.parameters import parameter
from omniman_ros.core.validated import Validated

#: Number of intervals into which the predicted motion is divided; they grow with the distance
STEPS = 12
RESTING = 1e-3  #: Fraction of the speed limits up to which a motion counts as rest
#: Fraction of the speed limits at which the robot at least passes the predicted motion, as far as
#: the motion of obstacles is concerned: at rest it would never come to where it goes.
SLOWEST_PASS = 0.1
#: Number of moving obstacles, each counted once for each time, with which distances are computed
#: together: a few calls cost less than many, and superfluous pairs of poses and obstacles more.
COPIES = 40
TOLERANCE = 1e-6  #: Decrease of a distance that is rounding [m]


@dataclass(frozen=True, kw_only=True)
class MonitorParameters(Validated):
    """Distances and times of the limit of the speed."""

    margin: float = parameter(
        0.03,
        "Distance from everything that the robot keeps: the gap that must remain, and what the "
        "robot does not know about where it and the obstacles are.",
        unit="m",
        low=0.0,
        high=1.0,
    )
    reaction_time: float = parameter(
        0.1,
        "Time from an observation until the robot begins to brake, for which it goes on at full "
        "speed.",
        unit="s",
        low=0.0,
        high=1.0,
    )
    slow_down_time: float = parameter(
        1.0,
        "Time at full speed to the margin from which on the robot slows down: its share of the "
        "speed limits is at most the time that is left over this one.",
        unit="s",
        low=0.05,
        high=10.0,
    )
    contact_speed: float = parameter(
        0.05,
        "Share of the speed limits that is left where something seems to touch the robot already, "
        "so that no motion can be told to lead away; 0: stop.",
        low=0.0,
        high=1.0,
    )


@dataclass(frozen=True)
class RobotMotion(Validated):
    """Where the robot is and how it moves."""

    #: Pose (3,) of base_link in the frame of the surroundings [m, m, rad]
    pose: Annotated[Array, Shape(3)]
    joints: Annotated[Array, Shape(6)]  #: Joint angles (6,) [rad]; zeros without an arm
    #: Twist in base_link and joint rates (9,) [m/s, m/s, rad/s, rad/s ...]
    motion: Annotated[Array, Shape(9)]


@dataclass(frozen=True)
class Encounter:
    """What limits the speed."""

    part: str  #: Name of the robot's part
    obstacle: int  #: Index of the obstacle among the surroundings
    distance: float  #: Present distance between the two [m]


@dataclass(frozen=True)
class SpeedLimit:
    """Largest fraction of the speed limits, 0 to 1, for platform and arm, and why."""

    platform: float = 1.0  #: Share for the platform
    arm: float = 1.0  #: Share for the arm
    encounter: Encounter | None = None  #: What limits the speed; None if nothing does
    in_contact: bool = False  #: Whether something seems to touch the robot already


@dataclass(frozen=True)
class _Course:
    """A motion at full speed, and whose speed its limit applies to."""

    motion: Array
    is_platform: bool
    is_arm: bool


class CollisionMonitor:
    """Limits the speed so that the robot comes to rest before contact, whichever source drives.

    A stop keeps the robot on its curve: platform and joints slow down together, at a constant
    ratio of their rates. Where the robot can be until it is at rest therefore depends on the
    direction of its motion only, and how far it gets on the curve on its speed. Each direction in
    which the robot moves, or is asked to move, is followed at full speed, in `STEPS` intervals.
    The time after which the robot would be nearer to something than the margin, the free time,
    gives the fraction of full speed that is allowed: the free time over `slow_down_time`, and at
    most the share s from which the robot can stop within it. In the reaction time T and the time B
    of a stop from full speed it gets as far as in s T + s^2 B / 2 at full speed.

    Between two samples, the square of the distance d of two convex bodies that move relative to
    one another by h is at most h^2 / 4 below that at the nearer sample: its second derivative is
    at most 2 (h / dt)^2, as half the squared distance from a convex set has a gradient that is
    1-Lipschitz. Where the body turns by the angle b meanwhile, its points are accelerated by
    h b / dt^2, and d h b / 4 comes in addition.

    A pair that is nearer than the margin already may not come nearer, but may part: a robot that
    has parked at a wall can leave it.
    Parameters, limits and geometry may be changed at any time.
    """

    def __init__(
        self, geometry: BodyGeometry, limits: SpeedLimits, parameters: MonitorParameters
    ) -> None:
        self.geometry, self.limits, self.parameters = geometry, limits, parameters

    def limit(
        self, robot: RobotMotion, demands: Sequence[Array], surroundings: MovingObstacles
    ) -> SpeedLimit:
        """Return the limit of the speed; of the demands (9,), only the directions count.

        Raises:
            InputError: A pose or an angle is not finite.
        """
        courses = list(self._courses([robot.motion, *demands]))
        if not courses or not len(surroundings):
            return SpeedLimit()
        full = np.array([course.motion for course in courses])
        stop_times = np.array([self.limits.stop_time(motion) for motion in full])
        p = self.parameters
        horizon = max(p.slow_down_time, p.reaction_time + 0.5 * float(stop_times.max()))
        speed = max(self.limits.fraction(robot.motion), SLOWEST_PASS)
        time_left = p.reaction_time + self.limits.stop_time(robot.motion)
        far = float(self.geometry.part_radii.max()) + 2.0 * p.margin
        far += horizon * self.limits.velocity[0]
        near = surroundings.within(robot.pose, far, time_left)
        if not near.any():
            return SpeedLimit()
        prediction = _Prediction(
            self.geometry,
            robot,
            full,
            horizon * (np.arange(STEPS + 1.0) / STEPS) ** 2,
            surroundings.select(near),
            speed,
            time_left,
            p.margin,
        )
        return self._judge(courses, stop_times, prediction, np.flatnonzero(near))

    def unseen_limit(
        self,
        robot: RobotMotion,
        demands: Sequence[Array],
        arrivals: Arrivals,
        outline: Rectangles,
        parameters: UnseenLimitParameters,
    ) -> OcclusionLimit:
        """Return the platform's speed limit by what is not seen, at least creeping speed."""
        courses = [
            (course.motion[:3], self.limits.stop_time(course.motion))
            for course in self._courses([robot.motion, *demands])
            if not course.is_arm
        ]
        found = unseen_limit(
            arrivals,
            outline,
            robot.pose,
            courses,
            parameters.person.radius,
            self.parameters.reaction_time,
        )
        return replace(found, fraction=max(found.fraction, parameters.creep_speed))

    def _courses(self, motions: Sequence[Array]) -> Iterator[_Course]:
        """Yield the motions at full speed: of the platform, of the arm, and of both together."""
        for motion in motions:
            platform, arm = motion.copy(), motion.copy()
            platform[3:] = arm[:3] = 0.0
            parts = [(platform, True, False), (arm, False, True)]
            moving = [part for part in parts if self.limits.fraction(part[0]) > RESTING]
            if len(moving) == 2:
                moving.append((motion, True, True))
            for part, is_platform, is_arm in moving:
                yield _Course(part / self.limits.fraction(part), is_platform, is_arm)

    def _judge(
        self,
        courses: Sequence[_Course],
        stop_times: Array,
        prediction: "_Prediction",
        indices: NDArray[np.intp],
    ) -> SpeedLimit:
        """Return the limit from the predicted distances of the obstacles with these indices."""
        platform = arm = least = 1.0
        culprit: tuple[int, int] | None = None
        for course, stop_time, free in zip(
            courses, stop_times.tolist(), prediction.free_times(), strict=True
        ):
            fraction = self._fraction(free.time, stop_time)
            platform = min(platform, fraction) if course.is_platform else platform
            arm = min(arm, fraction) if course.is_arm else arm
            if fraction < least:
                least, culprit = fraction, free.pair
        now = prediction.present
        in_contact = bool((now <= 0.0).any())
        if in_contact:
            bound = self.parameters.contact_speed
            platform, arm = min(platform, bound), min(arm, bound)
            if bound <= least:
                part, obstacle = np.argwhere(now <= 0.0)[0]
                culprit = int(part), int(obstacle)
        if culprit is None:
            return SpeedLimit(platform, arm, None, in_contact)
        part, obstacle = culprit
        encounter = Encounter(
            self.geometry.parts[part], int(indices[obstacle]), float(now[part, obstacle])
        )
        return SpeedLimit(platform, arm, encounter, in_contact)

    def _fraction(self, free_time: float, stop_time: float) -> float:
        if free_time == math.inf:
            return 1.0
        p = self.parameters
        half = 0.5 * p.reaction_time
        # s T + s^2 B / 2 = free time, in a form without a difference of nearly equal numbers.
        stopping = free_time / (half + math.sqrt(half * half + 0.5 * stop_time * free_time))
        fraction = min(1.0, free_time / p.slow_down_time, stopping)
        return fraction if fraction > RESTING else 0.0


@dataclass(frozen=True)
class _FreeTime:
    """Time at full speed until something is too near, and the part and the obstacle that are."""

    time: float
    pair: tuple[int, int] | None


class _Prediction:
    """Distances of the robot's parts from M obstacles, along C courses (C, 9) at full speed.

    Times (K,) are at full speed, the first is zero; `time_left` is that after which the robot
    could be at rest, so that nothing moves on [s]. Obstacles that move are met at a fraction of
    full speed. The present distances are (N, M) [m].
    """

    def __init__(
        self,
        geometry: BodyGeometry,
        robot: RobotMotion,
        courses: Array,
        times: Array,
        surroundings: MovingObstacles,
        speed: float,
        time_left: float,
        margin: float,
    ) -> None:
        passing = np.minimum(times / speed, time_left)
        displacement = (
            np.hypot(courses[:, 0], courses[:, 1])[:, None]
            + np.abs(courses[:, 2, None]) * geometry.part_radii
            + np.abs(courses[:, 3:]) @ geometry.part_levers.T
        )
        drift = np.diff(passing)[:, None, None] * np.hypot(*surroundings.velocity)
        steps = np.diff(times)[:, None, None] * displacement[:, None, :, None] + drift
        angles = np.abs(courses[:, 2]) + np.abs(courses[:, 3:]).sum(axis=1)
        turns = (angles[:, None] * np.diff(times))[..., None, None]
        self._bound = np.sqrt(margin * margin + 0.25 * steps * (steps + margin * turns))
        self._times = times
        self._poses: Array = np.stack([curve_poses(robot.pose, c[:3], times) for c in courses])
        self._joints = robot.joints + times[:, None] * courses[:, None, 3:]
        self._measure(geometry, surroundings, passing)
        self.present: Array = self._distances[0, 0]

    def _measure(
        self, geometry: BodyGeometry, surroundings: MovingObstacles, passing: Array
    ) -> None:
        """Find the distances (C, K, N, M) while obstacles that move do so at times (K,) [s]."""
        poses, joints, reach = self._poses, self._joints, float(self._bound.max())
        is_moving = surroundings.is_moving
        parts = len(geometry.parts)
        self._distances: Array = np.empty((*poses.shape[:2], parts, len(surroundings)))
        still = surroundings.select(~is_moving).obstacles
        if len(still):
            self._distances[..., ~is_moving] = geometry.distances(poses, joints, still, reach)
        moving = surroundings.select(is_moving)
        size = max(1, COPIES // max(len(moving), 1))
        for begin in range(0, len(passing) if len(moving) else 0, size):
            # The obstacles at several times with the poses at these times: those of one time
            # count.
            some = slice(begin, begin + size)
            obstacles = [moving.after(time) for time in passing[some].tolist()]
            found = geometry.distances(
                poses[:, some], joints[:, some], UprightObstacles.join(obstacles), reach
            )
            found = found.reshape(*found.shape[:3], len(obstacles), len(moving))
            k = np.arange(len(obstacles))
            self._distances[:, some, :, is_moving] = np.moveaxis(found[:, k, :, k], 0, 1)

    def free_times(self) -> Iterator[_FreeTime]:
        """Yield the free time of each course; infinite if nothing comes too near."""
        bound = np.minimum(self._bound, self.present) - TOLERANCE
        before = self._distances[:, :-1] - bound
        after = self._distances[:, 1:] - bound
        is_near = np.minimum(before, after) < 0.0
        for course, first in enumerate(is_near.any(axis=(2, 3)).argmax(axis=1).tolist()):
            chosen = is_near[course, first]
            if not chosen.any():
                yield _FreeTime(math.inf, None)
                continue
            left, right = before[course, first], after[course, first]
            # The part of the interval before the bound is reached.
            falling = np.maximum(left - right, np.finfo(np.float64).tiny)
            part = np.where(chosen, np.clip(left / falling, 0.0, 1.0), np.inf)
            worst = np.unravel_index(int(part.argmin()), part.shape)
            begin, end = self._times[first : first + 2].tolist()
            time = begin + float(part[worst]) * (end - begin)
            yield _FreeTime(time, (int(worst[0]), int(worst[1])))
