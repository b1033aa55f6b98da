"""The platform controller without ROS: odometry, who drives, and the cascade of CCTA 2017 Fig. 6.

Inputs are heard as they come (`hear_*`), the output is made once a tick (`tick`). Time is an
argument everywhere, on one steady clock of the caller's.
"""

import math

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible, se2
from omniman_ros.core.arbiter import Arbiter, Source
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.feedback import WheelFeedback
from omniman_ros.core.limits import TwistLimiter, clamp, ramp_down, ratio, slew
from omniman_ros.core.odometry import Odometry
from omniman_ros.core.platform_parameters import PlatformParameters
from omniman_ros.core.position_controller import PositionController, pose_error
from omniman_ros.core.preview import Preview
from omniman_ros.core.stop import StopLatch
from omniman_ros.core.wheel_cascade import DriveMode, FollowingWatch, WheelCascade, WheelCommand

Array = NDArray[np.float64]

LONGEST_TICK = 0.1
"""A tick that comes later counts as this long [s]."""
OVERSPEED = 1.1
"""Speed of a wheel or the platform over its limit at which voltages are no longer passed on."""
FARTHEST_START = 1.0
"""A preview that begins later than this is not for now [s]."""
STANDING = 0.1
"""Speed of a wheel above which a reset is refused [rad/s]."""
MOVING_END = 1e-6
"""Speed [m/s, rad/s] above which a preview ends in motion: it ran out, it did not arrive."""


class PlatformController:
    """Follows cmd_vel, previews or voltages within limits, and stops in every way there is.

    Attributes:
        parameters: What it is set by.
        odometry: Pose, twist, covariance.
        cascade: Kinematics, dynamics, coupling controller, wheel controllers.
        feedback: What the wheels said last.
        latch: What holds the platform.
        arbiter: Who drives.
        setpoint: (3,) twist asked for in the last tick, in base_link [m/s, m/s, rad/s].
        tracking_error: (3,) of the last tick that followed a preview [m, m, rad].
        cancelled: Why a source lost control in the last tick, or empty.
    """

    def __init__(self, parameters: PlatformParameters) -> None:
        robot = parameters.robot
        self.parameters = parameters
        self.latch = StopLatch()
        self.arbiter = Arbiter(_silences(parameters))
        self.cascade = WheelCascade(parameters)
        self.odometry = Odometry(self.cascade.kinematics, parameters.odometry)
        self.feedback = WheelFeedback(
            robot.wheel_count, parameters.odometry.encoder_span, robot.motor.max_speed
        )
        self.setpoint: Array = np.zeros(3)
        self.tracking_error: Array = np.zeros(3)
        self.cancelled = ""
        self._limiter = TwistLimiter(parameters.limits)
        self._position = PositionController(parameters.position)
        self._watch = FollowingWatch(robot.wheel_count)
        self._target: Array = np.zeros(3)
        self._volts: Array | None = None
        self._previews: dict[Source, Preview] = {}
        self._last_tick: float | None = None
        self._stalled: float | None = None

    def configure(self, parameters: PlatformParameters) -> None:
        """Take over new limits and gains while running; motion goes on from where it is.

        Raises:
            GeometryError: The wheels would not make a platform; nothing is changed.
            ParameterError: Wheels are calibrated in motion.
        """
        scale = parameters.odometry.wheel_scale
        if scale != self.parameters.odometry.wheel_scale and not self.at_rest:
            raise ParameterError(
                "odometry.wheel_scale", scale, "the platform moves: stop it first"
            )
        self.cascade.configure(parameters)
        self.parameters = parameters
        self.arbiter.silence = _silences(parameters)
        self.odometry.configure(self.cascade.kinematics, parameters.odometry)
        self.feedback.max_speed = parameters.robot.motor.max_speed
        self._limiter.limits = parameters.limits
        self._position.gains = parameters.position

    # ---- inputs: each returns why it is not used or what to warn of, or an empty string -----

    def hear_wheels(
        self, time: float, now: float, position: Array | None, velocity: Array | None
    ) -> str:
        """Take in the wheels' positions [rad] and speeds [rad/s], (n,) each or None.

        Args:
            time: When they were measured [s]; odometry runs on it.
            now: When they arrived [s]; the time-out runs on the older of the two.
            position, velocity: At least one of them.

        Raises:
            InputError: Wrong size, not finite, no content, or not newer than the last.
        """
        step = self.feedback.update(time, now, position, velocity)
        if step is None:
            return ""
        self.cascade.coupling.add(self.odometry.update(step.moved, step.speeds, step.dt))
        return step.warning

    def hear_twist(self, twist: Array, now: float, age: float = 0.0) -> str:
        """Take a body twist setpoint (3,) [m/s, m/s, rad/s], `age` seconds old at `now`.

        Raises:
            InputError: Wrong size, not finite, or stale.
        """
        if twist.shape != (3,):
            raise InputError(f"cmd_vel: {twist.size} numbers, expected 3")
        plausible.demand(twist, plausible.SPEED, "cmd_vel: twist")
        until = _fresh_until("cmd_vel", now, age, self.parameters.timeouts.cmd_vel)
        refusal = self._offer(Source.CMD_VEL, now, until, neutral=not twist.any())
        if not refusal:
            self._target = np.array(twist)
        return refusal

    def hear_preview(self, source: Source, preview: Preview, now: float) -> str:
        """Take a preview of the platform's motion in odom; it is trusted until it ends.

        Raises:
            InputError: It is over already, or begins too late to be followed now.
        """
        if preview.start > now + FARTHEST_START:
            raise InputError(f"{source.value}/reference: begins in {preview.start - now:.3g} s")
        if preview.end < now:
            age = now - preview.end
            raise InputError(f"{source.value}/reference: stale, it ended {age:.3f} s ago")
        hold = 0.0 if preview.end_speed > MOVING_END else self.parameters.timeouts.reference
        refusal = self._offer(source, now, preview.end + hold)
        if not refusal:
            self._previews[source] = preview
            self._volts = None if source is Source.MPC else self._volts
        return refusal

    def hear_voltages(self, volts: Array, now: float, age: float = 0.0) -> str:
        """Take motor voltages (n,) [V] of the MPC, `age` seconds old at `now`.

        Raises:
            InputError: Wrong size, not finite, stale, or the drives have no voltage mode.
        """
        n = self.parameters.robot.wheel_count
        if volts.shape != (n,):
            raise InputError(f"mpc/voltages: {volts.size} voltages for {n} wheels")
        plausible.demand(volts, plausible.EFFORT, "mpc/voltages: volts")
        if DriveMode.VOLTAGE.value not in self.parameters.drive.offered:
            raise InputError("mpc/voltages: the drives have no voltage mode")
        until = _fresh_until("mpc/voltages", now, age, self.parameters.timeouts.voltages)
        refusal = self._offer(Source.MPC, now, until)
        if not refusal:
            limit = self.parameters.robot.motor.max_voltage
            self._volts = np.clip(volts, -limit, limit)
        return refusal

    def _offer(self, source: Source, now: float, fresh_until: float, neutral: bool = False) -> str:
        if not self.latch.released:
            status = self.latch.status
            return self.arbiter.refuse(source, now, f"{status.state.value}: {status.reason}")
        if not self.feedback.heard:
            return "no wheel_states yet"
        return self.arbiter.offer(source, now, fresh_until, neutral)

    # ---- stops ------------------------------------------------------------------------------

    @property
    def at_rest(self) -> bool:
        """Whether nothing is asked of the wheels."""
        return not self.setpoint.any()

    def fault(self, now: float) -> str:
        """A fault that is there now, which keeps a stop latched; or an empty string."""
        age = self.feedback.age(now)
        if self.feedback.heard and age > self.parameters.timeouts.wheel_states:
            return f"wheel_states silent for {age:.2f} s"
        return ""

    def reset(self, now: float) -> None:
        """Clear a latched stop; nothing moves until a source is heard anew.

        Raises:
            ResetRefusedError: See StopLatch.reset.
        """
        turning = float(np.abs(self.feedback.speeds).max()) > STANDING
        self.latch.reset(at_rest=self.at_rest and not turning, fault=self.fault(now))
        self.arbiter.cancel_all("reset")

    def set_pose(self, pose: tuple[float, float, float], covariance: Array | None = None) -> None:
        """Put odometry's pose (x, y, theta) [m, m, rad] somewhere; previews are cancelled.

        Raises:
            InputError: See Odometry.reset.
        """
        self.odometry.reset(pose, covariance)
        for source in (Source.MPC, Source.PATH):
            self.arbiter.cancel(source, "the pose was set")

    def _lost_wheel(self, dt: float) -> str:
        """What is wrong with a wheel, or an empty string."""
        drive, names = self.parameters.drive, self.parameters.robot.wheels.names
        if self.feedback.suspect is not None:
            wheel = names[self.feedback.suspect]
            return f"wheel '{wheel}': position and velocity disagree, its encoder is lost"
        error = self.cascade.reference - self.feedback.speeds
        late = self._watch.update(error, drive.following_error, drive.following_time, dt)
        return "" if late is None else f"wheel '{names[late]}' does not follow its setpoint"

    def _check(self, now: float, dt: float) -> None:
        """Latch what is wrong; a stop cancels every source."""
        fault = self.fault(now)
        if fault and (self.arbiter.active is not None or not self.at_rest):
            self.latch.stop(fault)
        elif fault and self.latch.released:
            self.feedback.forget()
        lost = self._lost_wheel(dt)
        if lost and self.latch.released:
            self.latch.stop(lost)
        if not self.latch.released:
            self.arbiter.cancel_all(self.latch.status.reason)

    # ---- output -----------------------------------------------------------------------------

    def tick(self, now: float) -> WheelCommand | None:
        """Make the command for the tick at `now` [s].

        Where simulated time goes back, every source is cancelled and feedback starts anew. After
        a stall of the caller there is no command until the wheels have reported again: the drives
        have begun to ramp down by themselves, and motion goes on from what they do.
        """
        elapsed = 0.0 if self._last_tick is None else now - self._last_tick
        dt = min(max(elapsed, 0.0), LONGEST_TICK)
        self._last_tick = now
        self.cancelled = ""
        if elapsed < -LONGEST_TICK:
            self.arbiter.restart(now, "time went back")
            self.feedback.forget()
        elif elapsed > LONGEST_TICK:
            self.arbiter.resume(now)
            self._stalled = now
            return None  # what came meanwhile is heard before the next tick
        self._check(now, dt)
        if self._stalled is not None and not self._caught_up(dt):
            return None
        source = self.arbiter.select(now)
        measured, before = self.feedback.speeds, self.setpoint
        if source is Source.MPC and self._volts is not None:
            self.setpoint = self.cascade.kinematics.J_pinv @ measured
            self._limiter.restart()
            if not self._too_fast(measured):
                return self.cascade.volts(self._volts, measured)
            self._cancel(
                source, "mpc/voltages drove a wheel or the platform above its speed limit"
            )
            source, before = None, self.setpoint
        twist, rate = self._motion(source, now, dt)
        reachable = self._reachable(twist, before, dt)
        if self.cascade.saturated or rate is None:
            rate = (reachable - before) / dt if dt > 0.0 else np.zeros(3)
        self.setpoint = reachable
        driven = self.arbiter.active is not None
        if not driven and not reachable.any():
            return self.cascade.rest(measured)
        mode = DriveMode(self.parameters.drive.mode) if driven else DriveMode.VELOCITY
        return self.cascade.command(reachable, rate, measured, mode, dt)

    def _caught_up(self, dt: float) -> bool:
        """Take over from the wheels' own motion once they have reported after a stall."""
        assert self._stalled is not None
        if not self.feedback.heard and self.at_rest:
            self._stalled = None
            return True
        if self.feedback.time < self._stalled:
            self.setpoint = ramp_down(self.setpoint, self.parameters.limits.deceleration, dt)
            return False
        self.setpoint = self.cascade.kinematics.J_pinv @ self.feedback.speeds
        if not self.feedback.speeds.any():
            self.setpoint = np.zeros(3)
        self._limiter.restart()
        self._stalled = None
        return True

    def _too_fast(self, measured: Array) -> bool:
        """Whether wheels or platform are above their limits, which voltages know nothing of."""
        limits, motor = self.parameters.limits, self.parameters.robot.motor
        wheels = float(np.abs(measured).max()) > OVERSPEED * motor.max_speed
        return wheels or ratio(self.setpoint, limits.velocity) > OVERSPEED

    def _reachable(self, twist: Array, before: Array, dt: float) -> Array:
        """The twist within the wheels' speed; a speed that is lowered in motion is ramped to."""
        reachable = self.cascade.reachable(twist)
        if self.cascade.saturated:
            deceleration = self.parameters.limits.deceleration
            slowest = ramp_down(before, deceleration, dt)
            if ratio(slowest, deceleration) > ratio(reachable, deceleration):
                return slowest
        return reachable

    def _motion(self, source: Source | None, now: float, dt: float) -> tuple[Array, Array | None]:
        """Twist (3,) in base_link for this tick, and its rate where the source knows it."""
        if source is Source.CMD_VEL:
            return self._limiter.step(self.setpoint, self._target, dt), None
        self._limiter.restart()
        followed = None if source is None else self._follow(source, now, dt)
        if followed is None:
            return ramp_down(self.setpoint, self.parameters.limits.deceleration, dt), None
        return followed

    def _follow(self, source: Source, now: float, dt: float) -> tuple[Array, Array] | None:
        """Twist and its rate in base_link that follow a preview; None if it was cancelled."""
        preview, theta = self._previews[source], self.odometry.pose[2]
        error = self._pose_error(preview, now)
        if self._position.lost(error):
            distance = math.hypot(error[0], error[1])
            self._cancel(source, f"following error {distance:.3f} m, {error[2]:.3f} rad")
            return None
        self.tracking_error = error
        limits = self.parameters.limits
        reference = preview.sample(now)
        wanted = clamp(self._position.velocity(reference, error), limits.velocity)
        before = se2.to_world(theta, self.setpoint)
        twist = se2.to_robot(theta, slew(before, wanted, limits, dt))
        vx, vy, w = twist.tolist()
        turned = np.array([w * vy, -w * vx, 0.0])  # CCTA (20): the frame turns below the velocity
        top = tuple(map(max, limits.acceleration, limits.deceleration))
        planned = clamp(reference.acceleration, (top[0], top[1]))
        return twist, se2.to_robot(theta, planned) + turned

    def _pose_error(self, preview: Preview, now: float) -> Array:
        """Error (3,) in odom [m, m, rad].

        The pose is as old as its measurement: it is compared with the reference of that time, or,
        where the preview begins later, carried on to its begin.
        """
        measured = self.feedback.time
        lead = max(min(preview.start, now) - measured, 0.0)
        error = pose_error(preview.sample(measured + lead).pose, self.odometry.pose)
        if lead > 0.0:
            error -= lead * se2.to_world(self.odometry.pose[2], self.odometry.twist)
        return error

    def _cancel(self, source: Source, reason: str) -> None:
        self.arbiter.cancel(source, reason)
        self.cancelled = f"{source.value} cancelled: {reason}"


def _silences(parameters: PlatformParameters) -> dict[Source, float]:
    return dict.fromkeys(Source, parameters.timeouts.cancelled)


def _fresh_until(label: str, now: float, age: float, timeout: float) -> float:
    if age > timeout:
        raise InputError(f"{label}: stale, {age:.3f} s old")
    return now + timeout - max(age, 0.0)
