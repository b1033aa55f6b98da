"""A tool path with platform and arm in step, in simulated time: the tool's error and its causes.

The platform controller and the drives run as they do on the robot. The measured poses reach the
interpolator with a latency, and so do the arm's previews on their way to the streamer. The arm
that follows these previews is an argument.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from omniman_ros.core.arbiter import Source
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.core.parameters import build
from omniman_ros.core.preview import Preview
from omniman_ros.lab.measurement import columns_at
from omniman_ros.lab.studies.closed_loop import LATENCY, PERIOD, ClosedLoop, StudyError
from omniman_ros.lab.studies.worlds import WorldChoice
from omniman_ros.motion.path.parameters import TICK
from omniman_ros.motion.whole_body.correction import PlatformCorrection, corrected_arm_motion
from omniman_ros.motion.whole_body.model import WholeBodyModel, planar_transform
from omniman_ros.motion.whole_body.parameters import ToolPathOptions
from omniman_ros.motion.whole_body.tool_planner import ToolPlan
from omniman_ros.simulation.plant.parameters import MismatchParameters
from omniman_ros.simulation.ur.arm_body import ArmBody
from omniman_ros.simulation.ur.motion import ServoJ, Target
from omniman_ros.ur.joint_preview import JointPreview
from omniman_ros.ur.parameters import PERIOD as ARM_PERIOD
from omniman_ros.ur.parameters import UrParameters
from omniman_ros.ur.setpoint_generator import GeneratorSettings, JointSetpointGenerator
from omniman_ros.ur.streaming_supervisor import joint_limits

STEP = 0.001  #: period of the study's clock [s]
ODOM_PERIOD = 0.01  #: period of the measured poses [s]
#: Range of the latency from the tick that computes a measured pose to the interpolator [s]
ODOM_LATENCY = (0.005, 0.02)
#: Range of the latency of the arm's previews from the interpolator to the streamer [s]
PREVIEW_LATENCY = (0.002, 0.006)
ARM_PREVIEW_PERIOD = 0.02  #: period of the arm's previews [s]
ARM_PREVIEW_HORIZON = 0.2  #: duration that a preview of the arm covers [s]
PLATFORM_PREVIEW_PERIOD = 0.04  #: period of the platform's previews [s]
PLATFORM_PREVIEW_HORIZON = 0.4  #: duration that a preview of the platform covers [s]
MOTION_START = 0.5  #: time at which the motion begins [s]
PREVIEW_LEAD = 0.024  #: time by which the first previews are sent before the motion begins [s]
RECORDING_TAIL = 0.5  #: time for which a drive continues after the motion [s]


class StreamedArm:
    """Setpoint generator of the streamer, connected directly to the servo of a simulated arm."""

    period = ARM_PERIOD

    def __init__(self, body: ArmBody, arm: ArmParameters, ur: UrParameters) -> None:
        self._ur = ur
        settings = GeneratorSettings(ur.start_distance, ur.servo_lag)
        self._generator = JointSetpointGenerator(joint_limits(arm, ur), settings, ARM_PERIOD)
        self._generator.begin(body.q, 0.0)
        self._body = body
        self._target = Target(body.q.copy())

    def preview(
        self, times: Array, positions: Array, velocities: Array, accelerations: Array, now: float
    ) -> None:
        """Follow a preview of the joints from now on: times (k,) [s], and (k, 6) each [rad, s]."""
        self._generator.follow(JointPreview(times, positions, velocities, accelerations), now)

    def cycle(self, now: float) -> Array:
        """Send the setpoint of a time [s]; return the angles (6,) after one servo period [rad]."""
        self._body.measure(now)
        setpoint = self._generator.tick(now, self._body.q)
        servo = ServoJ(setpoint, ARM_PERIOD, self._ur.lookahead_time, self._ur.gain)
        servo.advance(self._target, ARM_PERIOD)
        self._body.follow(self._target.q, ARM_PERIOD)
        return self._body.q


@dataclass(frozen=True)
class WheelSettings:
    """Settings of a robot's drives, and errors of its wheels."""

    about: str  #: description in the tables
    changes: Mapping[str, Any]  #: parameters of controller and simulation, full names to values
    mismatch: Mapping[str, Any]  #: errors of the wheels, names to factors by wheel


@dataclass(frozen=True)
class ToolPathCase:
    """One drive of the study."""

    course: str  #: name of the path, a key of `tool_courses.COURSES`
    wheels: WheelSettings
    options: ToolPathOptions = field(default_factory=ToolPathOptions)  #: such as the correction
    seed: int = 0  #: seed of the latencies

    def platform(self, robot: Mapping[str, Any], world: WorldChoice | None = None) -> ClosedLoop:
        """Return the controller and the drives."""
        mismatch = build(MismatchParameters, self.wheels.mismatch)
        return ClosedLoop.of_robot({**robot, **self.wheels.changes}, world, mismatch)


DEMO_MISMATCH = {
    "friction": [1.3, 0.8, 1.1, 0.9],
    "torque_constant": [0.97, 1.03, 1.0, 0.98],
    "amplifier_gain": [1.02, 0.98, 1.01, 0.97],
}  #: Errors of the wheels in the demo, ratios of true to nominal values by wheel, and larger ones
LARGE_MISMATCH = {
    "friction": [1.8, 0.5, 1.4, 0.7],
    "torque_constant": [0.9, 1.1, 1.0, 0.93],
    "amplifier_gain": [1.05, 0.93, 1.02, 0.92],
}
#: Parameters that turn the velocity loops into P loops, and prevent a stop by the following error,
#: which then is larger than on a healthy robot.
P_LOOPS = {"firmware.integral_time": 100.0, "drive.following_error": 100.0}
LOW_GAINS = {
    **P_LOOPS,
    "drive.feed_forward": False,
    "position.k_xy": 2.0,
    "position.k_theta": 2.0,
}  #: Parameters of P velocity loops under a position control with low gains and no feed-forward
MOST_DEMANDING = "soft"  #: name of the wheels with which the platform deviates most from its path
WHEELS: Mapping[str, WheelSettings] = {
    "PI": WheelSettings("wheels of the demo", {}, DEMO_MISMATCH),
    "P": WheelSettings("larger mismatch, P loops", P_LOOPS, LARGE_MISMATCH),
    MOST_DEMANDING: WheelSettings("the same, low position gains", LOW_GAINS, LARGE_MISMATCH),
}  #: Wheels of the study, by name


@dataclass(frozen=True)
class ToolPathRun:
    """A completed drive, at k times of the tool's motion."""

    case: ToolPathCase  #: the case
    times: Array  #: (k,) times since the beginning of the motion [s]
    reference: Array  #: (k, 3) reference positions of the tool in odom [m]
    odom: Array  #: (k, 3) positions by the arm's true angles and the platform's measured pose [m]
    truth: Array  #: (k, 3) true positions of the tool in the world, with the platform's tilt [m]
    base: Array  #: (k, 3) measured poses of base_link in odom [m, m, rad]
    platform: Array  #: (k, 3) errors of these poses relative to the reference [m, m, rad]
    turned: Array  #: (k,) errors of the tool's orientation in odom: angles to its reference [rad]

    @property
    def error(self) -> Array:
        """(k,) distances of the tool from its reference at the same time, in odom [m]."""
        return _lengths(self.odom - self.reference)

    @property
    def true_error(self) -> Array:
        """(k,) distances of the tool from its reference at the same time, in the world [m]."""
        return _lengths(self.truth - self.reference)


class ToolPathLoop:
    """Runs platform, arm and interpolator along one planned motion."""

    def __init__(
        self,
        platform: ClosedLoop,
        case: ToolPathCase,
        motion: ToolPlan,
        model: WholeBodyModel,
        arm: StreamedArm,
    ) -> None:
        self._platform, self._case = platform, case
        self._motion, self._model, self._arm = motion, model, arm
        self._correction = PlatformCorrection(case.options)
        self._random = np.random.default_rng(case.seed)
        self._poses: deque[tuple[float, float, Array]] = deque()
        self._previews: deque[tuple[float, tuple[Array, Array, Array, Array]]] = deque()
        self._sent = self._announced = -np.inf
        self._arm_rows: list[Array] = []
        self._platform_rows: list[Array] = []

    def run(self) -> ToolPathRun:
        """Drive the motion once, and return the completed drive."""
        end = MOTION_START + self._motion.curve.duration + RECORDING_TAIL
        arm_due = self._arm.period
        for k in range(round(end / STEP)):
            now = k * STEP
            if now >= self._platform.now:
                self._drive(now)
            self._interpolate(now)
            while self._previews and self._previews[0][0] <= now:
                self._follow(self._previews.popleft()[1], now)
            if now >= arm_due:
                self._platform.drives.advance(arm_due)  # the joints may be in its world
                self._arm_rows.append(np.array([arm_due, *self._arm.cycle(arm_due)]))
                arm_due += self._arm.period
        return self._completed_run()

    def _drive(self, now: float) -> None:
        """Run one tick of the platform, sending its preview and the measured pose when due."""
        loop, motion_end = self._platform, MOTION_START + self._motion.curve.duration
        if (
            MOTION_START - PREVIEW_LEAD <= now < motion_end + RECORDING_TAIL
            and now >= self._announced + PLATFORM_PREVIEW_PERIOD
        ):
            self._announced = now
            times = _grid(now, PLATFORM_PREVIEW_HORIZON)
            x, v, a = (part[:, :3] for part in self._motion.curve.sample(times - MOTION_START))
            loop.send(Source.PATH, Preview(times, x, v, a))
        measured = loop.now
        loop.drives.advance(measured)
        base = self._base_frame()
        loop.step()
        loop.check(self._case.wheels.about)
        pose = np.array(loop.controller.odometry.pose)
        self._platform_rows.append(np.array([measured, *pose, *base[:3].ravel()]))
        if round(measured / PERIOD) % round(ODOM_PERIOD / PERIOD) == 0:
            arrival = measured + LATENCY + self._random.uniform(*ODOM_LATENCY)
            if self._poses:
                arrival = max(arrival, self._poses[-1][0])  # poses arrive in the order of sending
            self._poses.append((arrival, measured, pose))

    def _base_frame(self) -> Array:
        """Return the true pose (4, 4) of base_link in the world."""
        drives, world = self._platform.drives, self._platform.world
        if world is None:
            return planar_transform(drives.ground_truth()[0])
        frame = np.eye(4)
        frame[:3, 3], frame[:3, :3] = world.base_frame
        return frame

    def _interpolate(self, now: float) -> None:
        """Process the measured poses that have arrived, and send the arm's preview when due."""
        has_arrived = False
        while self._poses and self._poses[0][0] <= now:
            _, time, pose = self._poses.popleft()
            reference = self._motion.curve.sample(np.array([time - MOTION_START]))[0][0, :3]
            self._correction.update(time, pose, reference)
            has_arrived = True
        end = MOTION_START + self._motion.curve.duration + RECORDING_TAIL
        if not has_arrived or not MOTION_START - PREVIEW_LEAD <= now < end:
            return
        if now < self._sent + ARM_PREVIEW_PERIOD - 0.5 * STEP:
            return
        self._sent = now
        times = _grid(now, ARM_PREVIEW_HORIZON)
        extended = np.concatenate([[times[0] - TICK], times, [times[-1] + TICK]])
        planned = self._motion.curve.sample(extended - MOTION_START)[0]
        platform = self._correction.platform_at(planned[:, :3], extended)
        parts = corrected_arm_motion(
            self._model,
            platform,
            self._motion.tool(extended - MOTION_START),
            self._motion.branch,
            planned[:, 3:],
            TICK,
        )
        arrival = now + self._random.uniform(*PREVIEW_LATENCY)
        self._previews.append((arrival, (times, *parts)))

    def _follow(self, preview: tuple[Array, Array, Array, Array], now: float) -> None:
        """Pass a preview that has arrived to the arm."""
        try:
            self._arm.preview(*preview, now)
        except InputError as error:
            raise StudyError(f"{self._case.wheels.about}: arm/joint_reference: {error}") from error

    def _completed_run(self) -> ToolPathRun:
        """Return the drive, evaluated at the cycles of the arm during the motion."""
        arm, platform = np.array(self._arm_rows), np.array(self._platform_rows)
        times = arm[:, 0]
        moving = (times >= MOTION_START) & (times <= MOTION_START + self._motion.curve.duration)
        times, joints = times[moving], arm[moving, 1:]
        poses = columns_at(platform, times)
        reference = self._motion.tool(times - MOTION_START)
        measured = self._model.forward(np.hstack([poses[:, :3], joints]))
        base = poses[:, 3:].reshape(-1, 3, 4)
        in_base = self._model.forward(np.hstack([np.zeros((len(times), 3)), joints]))
        true = base @ in_base
        errors = poses[:, :3] - self._motion.curve.sample(times - MOTION_START)[0][:, :3]
        errors[:, 2] = np.remainder(errors[:, 2] + np.pi, 2.0 * np.pi) - np.pi
        trace = np.einsum("kij,kij->k", measured[:, :3, :3], reference[:, :3, :3])
        return ToolPathRun(
            self._case,
            times - MOTION_START,
            reference[:, :3, 3],
            measured[:, :3, 3],
            true[:, :3, 3],
            poses[:, :3],
            errors,
            np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0)),
        )


def _grid(now: float, horizon: float) -> Array:
    """Return the times (k,) of the ticks from the latest one to the end of a horizon [s]."""
    first = np.floor(now / TICK + 1e-6)
    times: Array = TICK * (first + np.arange(int(horizon / TICK) + 1))
    return times


def _lengths(vectors: Array) -> Array:
    result: Array = np.linalg.norm(vectors, axis=1)
    return result


def rms(values: Array) -> float:
    """Return the root mean square of values, in their unit."""
    return float(np.sqrt(np.mean(np.square(values))))
