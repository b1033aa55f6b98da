"""The platform controller without ROS: odometry, who drives, and the cascade of CCTA 2017 Fig. 6.

Inputs are heard as they come (`hear_*`), the output is made once a tick (`tick`). Time is an
argument everywhere, on one steady clock of the caller's.
"""

import numpy as np
from numpy.typing import NDArray

from omniman_ros.core import plausible
from omniman_ros.core.arbiter import Arbiter, Source
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.feedback import WheelFeedback
from omniman_ros.core.follower import FollowingError, PreviewFollower
from omniman_ros.core.limits import TwistLimiter, ramp_down, ratio
from omniman_ros.core.odometry import Odometry
from omniman_ros.core.platform_parameters import PlatformParameters
from omniman_ros.core.preview import Preview
from omniman_ros.core.stop import StopLatch
from omniman_ros.core.wheel_cascade import DriveMode, WheelCascade, WheelCommand
from omniman_ros.core.wheel_guard import WheelGuard, told

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
        guard: What is wrong with wheels, which of them do not drive, and what limits that leaves.
        latch: What holds the platform.
        arbiter: Who drives.
        setpoint: (3,) twist asked for in the last tick, in base_link [m/s, m/s, rad/s].
        cancelled: Why a source lost control in the last tick, or empty.
    """

    def __init__(self, parameters: PlatformParameters) -> None:
        robot = parameters.robot
        self.parameters = parameters
        self.latch = StopLatch()
        self.arbiter = Arbiter(_silences(parameters))
        self.cascade = WheelCascade(parameters, told(parameters))
        self.guard = WheelGuard(parameters, self.cascade)
        self.odometry = Odometry(self.cascade.kinematics, parameters.odometry)
        self.feedback = WheelFeedback(
            robot.wheel_count, parameters.odometry.encoder_span, robot.motor.max_speed
        )
        self.setpoint: Array = np.zeros(3)
        self.cancelled = ""
        self._limiter = TwistLimiter(self.guard.limits)
        self._follower = PreviewFollower(parameters.position)
        self._target: Array = np.zeros(3)
        self._volts: Array | None = None
        self._previews: dict[Source, Preview] = {}
        self._last_tick: float | None = None
        self._stalled: float | None = None

    def configure(self, parameters: PlatformParameters) -> None:
        """Take over new limits and gains while running; motion goes on from where it is.

        Raises:
            GeometryError: The wheels would not make a platform; nothing is changed.
            ParameterError: Wheels are calibrated or left out in motion, or too few are left.
        """
        before = self.parameters
        for name, new, old in (
            ("odometry.wheel_scale", parameters.odometry.wheel_scale, before.odometry.wheel_scale),
            ("drive.dead", parameters.drive.dead, before.drive.dead),
        ):
            if new != old and not self.at_rest:
                raise ParameterError(name, new, "the platform moves: stop it first")
        self.cascade.configure(parameters, self.guard.without(parameters))
        self.parameters = parameters
        self.arbiter.silence = _silences(parameters)
        self.feedback.max_speed = parameters.robot.motor.max_speed
        self._follower.gains = parameters.position
        self._refit()

    def _refit(self) -> None:
        """Take over the wheels that drive from the cascade, whose models have changed."""
        self.guard.configure(self.parameters, self.cascade)
        self.odometry.configure(self.cascade.kinematics, self.parameters.odometry)
        self._limiter.limits = self.guard.limits

    # ---- inputs: each returns why it is not used or what to warn of, or an empty string -----

    def hear_wheels(
        self,
        time: float,
        now: float,
        position: Array | None,
        velocity: Array | None,
        effort: Array | None = None,
    ) -> str:
        """Take in the wheels' positions [rad], speeds [rad/s] and torques [N m], (n,) or None.

        Args:
            time: When they were measured [s]; odometry runs on it.
            now: When they arrived [s]; the time-out runs on the older of the two.
            position, velocity: At least one of them.
            effort: Without it, or where it is not finite, a dead wheel is not found.

        Raises:
            InputError: Wrong size, not finite, no content, or not newer than the last.
        """
        self.guard.hear(time, effort)
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
        if self.guard.idle:
            raise InputError("mpc/voltages: made for all wheels, but one is dead")
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

    @property
    def tracking_error(self) -> Array:
        """Error (3,) of the last tick that followed a preview [m, m, rad]."""
        return self._follower.error

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
        self.guard.reset()
        self._leave_out()

    def set_pose(self, pose: tuple[float, float, float], covariance: Array | None = None) -> None:
        """Put odometry's pose (x, y, theta) [m, m, rad] somewhere; previews are cancelled.

        Raises:
            InputError: See Odometry.reset.
        """
        self.odometry.reset(pose, covariance)
        for source in (Source.MPC, Source.PATH):
            self.arbiter.cancel(source, "the pose was set")

    def _check(self, now: float, dt: float) -> None:
        """Latch what is wrong; a stop cancels every source."""
        fault = self.fault(now)
        if fault and (self.arbiter.active is not None or not self.at_rest):
            self.latch.stop(fault)
        elif fault and self.latch.released:
            self.feedback.forget()
        driven = self.arbiter.active is not None
        lost = self.guard.check(self.cascade, self.feedback, driven, now, dt)
        if lost and self.latch.released:
            self.latch.stop(lost)
        self._leave_out()
        if not self.latch.released:
            self.arbiter.cancel_all(self.latch.status.reason)

    def _leave_out(self) -> None:
        """Drive on without the wheels that the guard has given up, or with them again."""
        if self.guard.idle == self.cascade.kinematics.idle:
            return
        self.cascade.configure(self.parameters, self.guard.idle)
        self._refit()
        if self._volts is not None and self.guard.idle:
            self._volts = None
            self._cancel(Source.MPC, "mpc/voltages are made for all wheels, but one is dead")

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
                return self.cascade.volts(self._volts, measured, self.guard.probe(now))
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
        probe = self.guard.probe(now) if driven else None
        return self.cascade.command(reachable, rate, measured, mode, dt, probe)

    def _caught_up(self, dt: float) -> bool:
        """Take over from the wheels' own motion once they have reported after a stall."""
        assert self._stalled is not None
        if not self.feedback.heard and self.at_rest:
            self._stalled = None
            return True
        if self.feedback.time < self._stalled:
            self.setpoint = ramp_down(self.setpoint, self.guard.limits.deceleration, dt)
            return False
        self.setpoint = self.cascade.kinematics.J_pinv @ self.feedback.speeds
        if not self.feedback.speeds.any():
            self.setpoint = np.zeros(3)
        self._limiter.restart()
        self._stalled = None
        return True

    def _too_fast(self, measured: Array) -> bool:
        """Whether wheels or platform are above their limits, which voltages know nothing of."""
        limits, motor = self.guard.limits, self.parameters.robot.motor
        wheels = float(np.abs(measured).max()) > OVERSPEED * motor.max_speed
        return wheels or ratio(self.setpoint, limits.velocity) > OVERSPEED

    def _reachable(self, twist: Array, before: Array, dt: float) -> Array:
        """The twist within the wheels' speed; a speed that is lowered in motion is ramped to."""
        reachable = self.cascade.reachable(twist)
        if self.cascade.saturated:
            deceleration = self.guard.limits.deceleration
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
            return ramp_down(self.setpoint, self.guard.limits.deceleration, dt), None
        return followed

    def _follow(self, source: Source, now: float, dt: float) -> tuple[Array, Array] | None:
        """Twist and its rate in base_link that follow a preview; None if it was cancelled."""
        try:
            return self._follower.step(
                self._previews[source], self.odometry, self.feedback.time, self.setpoint,
                self.guard.limits, now, dt,
            )  # fmt: skip
        except FollowingError as error:
            self._cancel(source, str(error))
            return None

    def _cancel(self, source: Source, reason: str) -> None:
        self.arbiter.cancel(source, reason)
        self.cancelled = f"{source.value} cancelled: {reason}"


def _silences(parameters: PlatformParameters) -> dict[Source, float]:
    return dict.fromkeys(Source, parameters.timeouts.cancelled)


def _fresh_until(label: str, now: float, age: float, timeout: float) -> float:
    if age > timeout:
        raise InputError(f"{label}: stale, {age:.3f} s old")
    return now + timeout - max(age, 0.0)
