"""A tool path by platform and arm in step, in simulated time: how far the tool is off, and why.

The platform's controller and its drives run as they do on the robot; its poses come to the
interpolator late, previews of the arm come to the streamer later still. What follows the arm's
previews is given: the study knows no arm.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core.arbiter import Source
from omniman_ros.core.body.correction import PlatformCorrection, arm_motion
from omniman_ros.core.body.model import BodyModel
from omniman_ros.core.body.parameters import ToolPathOptions
from omniman_ros.core.errors import InputError, OmnimanError
from omniman_ros.core.parameters import build
from omniman_ros.core.path.parameters import TICK
from omniman_ros.core.path.timed_curve import TimedCurve
from omniman_ros.core.platform_parameters import PlatformParameters
from omniman_ros.core.preview import Preview
from omniman_ros.drive.parameters import Mismatch, SimulationParameters
from omniman_ros.studies.closed_loop import LATENCY, PERIOD, ClosedLoop

Array = NDArray[np.float64]

STEP = 0.001
"""Of the study's clock [s]."""
ODOM_EVERY = 0.01
"""Period of the measured poses [s]."""
ODOM_LATE = (0.005, 0.02)
"""From a measurement to the interpolator, least and most [s]."""
PREVIEW_LATE = (0.002, 0.006)
"""From the interpolator to the streamer [s]."""
PLATFORM_EVERY, PLATFORM_HORIZON = 0.04, 0.4
"""Period and length of the platform's previews [s]."""
START = 0.5
"""When the motion begins [s]."""
ANNOUNCED = 0.024
"""The first previews are sent so much earlier [s]."""
AFTER = 0.5
"""How long the end is watched [s]."""


class StudyError(OmnimanError):
    """Something gave up on the way."""


class Motion(Protocol):
    """The planned motion of all axes, and the tool's; see `core.body`."""

    @property
    def curve(self) -> TimedCurve:
        """All nine axes."""
        ...

    @property
    def branch(self) -> int:
        """Of the arm."""
        ...

    def tool(self, times: Array) -> Array:
        """Poses (k, 4, 4) of `tool0` in odom at times (k,) [s]."""
        ...


class FollowingArm(Protocol):
    """An arm that follows previews of its joints."""

    period: float
    """Of its cycle [s]."""

    def preview(
        self, times: Array, positions: Array, velocities: Array, accelerations: Array, now: float
    ) -> None:
        """Take a preview: times (k,) [s], the others (k, 6); raises InputError if it does not."""
        ...

    def cycle(self, now: float) -> Array:
        """Go on for a period; measured joint angles (6,) [rad] at the time [s]."""
        ...


@dataclass(frozen=True)
class Case:
    """One drive of the study.

    Attributes:
        about: For people.
        changes: Full parameter names to values, of controller and simulation.
        mismatch: How the wheels differ.
        period: Of the arm's previews [s]: that of odom, or more.
        horizon: How far they reach [s].
        options: Of the tool's path; whether there is a correction.
        seed: Of the latencies.
    """

    about: str
    changes: Mapping[str, Any] = field(default_factory=dict)
    mismatch: Mapping[str, Any] = field(default_factory=dict)
    period: float = 0.02
    horizon: float = 0.2
    options: ToolPathOptions = field(default_factory=ToolPathOptions)
    seed: int = 0


@dataclass(frozen=True)
class Wheels:
    """Drives and wheels of a robot, and how they differ from what is known of them."""

    about: str
    changes: Mapping[str, Any]
    mismatch: Mapping[str, Any]

    def case(self, options: ToolPathOptions, seed: int) -> Case:
        """A drive with them."""
        return Case(self.about, self.changes, self.mismatch, options=options, seed=seed)


UNLIKE = {
    "friction": [1.3, 0.8, 1.1, 0.9], "torque_constant": [0.97, 1.03, 1.0, 0.98],
    "amplifier_gain": [1.02, 0.98, 1.01, 0.97],
}  # fmt: skip
"""Those of the demo."""
UNLIKER = {
    "friction": [1.8, 0.5, 1.4, 0.7], "torque_constant": [0.9, 1.1, 1.0, 0.93],
    "amplifier_gain": [1.05, 0.93, 1.02, 0.92],
}  # fmt: skip
P_LOOPS = {"firmware.integral_time": 100.0, "drive.following_error": 100.0}
"""No integral part, and no stop because wheels lag by more than a healthy robot's."""
SOFT = {
    **P_LOOPS, "drive.feed_forward": False, "position.k_xy": 2.0, "position.k_theta": 2.0,
}  # fmt: skip
HARSHEST = "soft"
WHEELS: Mapping[str, Wheels] = {
    "PI": Wheels("wheels of the demo", {}, UNLIKE),
    "P": Wheels("less alike, P loops", P_LOOPS, UNLIKER),
    HARSHEST: Wheels("the same, loosely led", SOFT, UNLIKER),
}


@dataclass(frozen=True)
class Run:
    """What became of a drive, at k times while the tool was to move.

    Attributes:
        case: What was driven.
        course: Along which path.
        times: (k,) of the motion [s].
        wanted: (k, 3) where the tool was to be, in odom [m].
        odom: (k, 3) where it was by the arm's true angles and the measured pose [m].
        truth: (k, 3) where it was in the world [m].
        base: (k, 3) measured pose of base_link [m, m, rad].
        platform: (k, 3) that less its reference [m, m, rad].
        turned: (k,) angle between the tool's orientation in odom and the one wanted [rad].
    """

    case: Case
    course: str
    times: Array
    wanted: Array
    odom: Array
    truth: Array
    base: Array
    platform: Array
    turned: Array

    @property
    def error(self) -> Array:
        """(k,) distance from the timed point of the path, in odom [m]."""
        distance: Array = np.linalg.norm(self.odom - self.wanted, axis=1)
        return distance

    @property
    def true_error(self) -> Array:
        """(k,) the same in the world, where odometry drifts [m]."""
        distance: Array = np.linalg.norm(self.truth - self.wanted, axis=1)
        return distance


class ToolPathLoop:
    """Platform, arm and interpolator along one planned motion.

    Args:
        robot: Full parameter names to values.
        case: What is different.
        course: Name of the path.
        motion: The plan.
        model: Of platform and arm.
        arm: At rest where the motion begins.
    """

    def __init__(
        self, robot: Mapping[str, Any], case: Case, course: str, motion: Motion,
        model: BodyModel, arm: FollowingArm,
    ) -> None:  # fmt: skip
        values = {**robot, **case.changes}
        simulation = build(SimulationParameters, values)
        simulation = replace(simulation, mismatch=build(Mismatch, case.mismatch))
        # Without torques: what watches over dead wheels takes no part.
        self._platform = ClosedLoop(build(PlatformParameters, values), simulation, torques=False)
        self._case, self._course = case, course
        self._motion, self._model, self._arm = motion, model, arm
        self._correction = PlatformCorrection(case.options)
        self._random = np.random.default_rng(case.seed)
        self._poses: deque[tuple[float, float, Array]] = deque()
        self._previews: deque[tuple[float, tuple[Array, Array, Array, Array]]] = deque()
        self._sent = self._announced = -np.inf
        self._arm_rows: list[Array] = []
        self._platform_rows: list[Array] = []

    def run(self) -> Run:
        """Drive it.

        Raises:
            StudyError: Platform or arm gave up.
        """
        end = START + self._motion.curve.duration + AFTER
        arm_due = self._arm.period
        for k in range(round(end / STEP)):
            now = k * STEP
            if now >= self._platform.now:
                self._drive(now)
            self._interpolate(now)
            while self._previews and self._previews[0][0] <= now:
                self._follow(self._previews.popleft()[1], now)
            if now >= arm_due:
                self._arm_rows.append(np.array([arm_due, *self._arm.cycle(arm_due)]))
                arm_due += self._arm.period
        return self._judged()

    def _drive(self, now: float) -> None:
        """One tick of the platform."""
        loop, last = self._platform, START + self._motion.curve.duration
        if START - ANNOUNCED <= now < last + AFTER and now >= self._announced + PLATFORM_EVERY:
            self._announced = now
            times = _grid(now, PLATFORM_HORIZON)
            x, v, a = (part[:, :3] for part in self._motion.curve.sample(times - START))
            refusal = loop.controller.hear_preview(Source.PATH, Preview(times, x, v, a), now)
            if refusal:
                raise StudyError(f"path/reference was refused: {refusal}")
        measured = loop.now
        loop.step()
        core = loop.controller
        stopped = core.cancelled or core.latch.status.reason or loop.drives.stop_reason
        if stopped:
            raise StudyError(f"{self._case.about}: {stopped}")
        pose = np.array(core.odometry.pose)
        self._platform_rows.append(np.array([measured, *pose, *loop.truth]))
        if round(measured / PERIOD) % round(ODOM_EVERY / PERIOD) == 0:
            arrival = measured + LATENCY + self._random.uniform(*ODOM_LATE)
            if self._poses:
                arrival = max(arrival, self._poses[-1][0])  # in the order of their sending
            self._poses.append((arrival, measured, pose))

    def _interpolate(self, now: float) -> None:
        """Hear what has come of odom, and send the arm's preview."""
        heard = False
        while self._poses and self._poses[0][0] <= now:
            _, time, pose = self._poses.popleft()
            reference = self._motion.curve.sample(np.array([time - START]))[0][0, :3]
            self._correction.hear(time, pose, reference)
            heard = True
        last = START + self._motion.curve.duration + AFTER
        if not heard or not START - ANNOUNCED <= now < last:
            return
        if now < self._sent + self._case.period - 0.5 * STEP:
            return
        self._sent = now
        times = _grid(now, self._case.horizon)
        longer = np.concatenate([[times[0] - TICK], times, [times[-1] + TICK]])
        planned = self._motion.curve.sample(longer - START)[0]
        platform = self._correction.platform_at(planned[:, :3], longer)
        parts = arm_motion(
            self._model, platform, self._motion.tool(longer - START), self._motion.branch,
            planned[:, 3:], TICK,
        )  # fmt: skip
        arrival = now + self._random.uniform(*PREVIEW_LATE)
        self._previews.append((arrival, (times, *parts)))

    def _follow(self, preview: tuple[Array, Array, Array, Array], now: float) -> None:
        try:
            self._arm.preview(*preview, now)
        except InputError as error:
            raise StudyError(f"{self._case.about}: arm/joint_reference: {error}") from error

    def _judged(self) -> Run:
        arm, platform = np.array(self._arm_rows), np.array(self._platform_rows)
        times = arm[:, 0]
        moving = (times >= START) & (times <= START + self._motion.curve.duration)
        times, joints = times[moving], arm[moving, 1:]
        poses = np.column_stack(
            [np.interp(times, platform[:, 0], column) for column in platform[:, 1:].T]
        )
        wanted = self._motion.tool(times - START)
        seen = self._model.forward(np.hstack([poses[:, :3], joints]))
        true = self._model.forward(np.hstack([poses[:, 3:], joints]))
        off = poses[:, :3] - self._motion.curve.sample(times - START)[0][:, :3]
        off[:, 2] = np.remainder(off[:, 2] + np.pi, 2.0 * np.pi) - np.pi
        trace = np.einsum("kij,kij->k", seen[:, :3, :3], wanted[:, :3, :3])
        return Run(
            self._case, self._course, times - START, wanted[:, :3, 3], seen[:, :3, 3],
            true[:, :3, 3], poses[:, :3], off,
            np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0)),
        )  # fmt: skip


def _grid(now: float, horizon: float) -> Array:
    """Ticks (k,) from the last one on [s]."""
    first = np.floor(now / TICK + 1e-6)
    times: Array = TICK * (first + np.arange(int(horizon / TICK) + 1))
    return times


def rms(values: Array) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))
