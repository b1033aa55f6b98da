"""The platform controller without ROS: odometry, arbitration, and the cascade of CCTA 2017 Fig. 6.

Inputs may come at any time (`update_wheels`, `set_*`); the output is computed once a tick
(`tick`). Time is always an argument, on one steady clock of the caller's.
"""

import numpy as np

from omniman_ros.control.follower import FollowingError, PreviewFollower
from omniman_ros.control.held_robot import HeldRobotDetector
from omniman_ros.control.imu import ImuFeedback
from omniman_ros.control.limits import TwistLimiter, ramp_down, ratio, slowed
from omniman_ros.control.odometry import REST_SPEED, Odometry
from omniman_ros.control.platform_parameters import PlatformParameters
from omniman_ros.control.stability import StabilityLimiter, SupportModel
from omniman_ros.control.wheel_cascade import DriveMode, WheelCascade, WheelCommand
from omniman_ros.control.wheel_feedback import WheelFeedback
from omniman_ros.control.wheel_health import (
    WheelHealthMonitor,
    dead_wheel_indices,
    name_list,
)
from omniman_ros.core import plausible
from omniman_ros.core.arbiter import NEVER, PREVIEW_SOURCES, Arbiter, Source
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError, ParameterError
from omniman_ros.core.late_delivery import LateDelivery
from omniman_ros.core.motion_limit import MotionLimit
from omniman_ros.core.platform import Arm
from omniman_ros.core.preview import Preview
from omniman_ros.core.stop import StopLatch

#: Longest time between two ticks that counts; after a longer one the caller has stalled [s]
MAX_TICK = 0.1
#: Ratio of a wheel's or the platform's speed to its limit above which voltages are not passed on
OVERSPEED = 1.1
#: Time after a stall in which messages sent before its end may still arrive [s].
#:
#: What a stall kept from being received, a reliable connection delivers again. The reader learns
#: of it by a heartbeat, of which Fast DDS sends one every 3 s.
LATE_DELIVERY = 4.0
MAX_LEAD = 1.0  #: Longest time from now to the beginning of a preview that is accepted [s]
#: Wheel speed above which the robot does not count as at rest, so that a reset is refused [rad/s]
RESET_REST_SPEED = 0.1
#: Reason why an input without a stamp is not used after a stall
WAITED = "it may have waited while the controller had stalled"
#: Reason why a twist without a stamp is not used that is old by the sender's clock
LATE = "it was delivered late, or its sender's clock is behind"
#: Twist up to which cmd_vel asks for rest [m/s, rad/s].
#:
#: Sources that stop leave round-off; none means a tenth of a millimetre a second.
NEGLIGIBLE_TWIST = 1e-4


class PlatformController:
    """Follows cmd_vel, previews or voltages within limits, and stops on every fault.

    Attributes:
        parameters: Current parameters.
        odometry: Pose, twist and covariance.
        cascade: Kinematics, dynamics, coupling controller and wheel controllers.
        feedback: Last feedback of the wheels.
        imu: Measurements of an inertial sensor; unused as long as there are none.
        wheel_health: Faults of wheels, wheels that do not drive, and the limits that remain.
        held_robot: External force on the robot, by which a robot that is held is noticed.
        stability: What the arm's posture leaves of the limits.
        limits: Limits of the twist: those of wheel_health, lowered for stability.
        latch: Latch that stops the platform.
        arbiter: Decides which source drives.
        motion_limit: Limit of the speed that a collision monitor sets, for every source.
        setpoint: Twist (3,) of the last tick in base_link [m/s, m/s, rad/s].
        rate: Derivative (3,) of its components in the last tick, zero under voltages
            [m/s^2, m/s^2, rad/s^2].
        demand: Twist (3,) in base_link that the active source asked for in the last tick, before
            the limits of acceleration and of a collision monitor [m/s, m/s, rad/s]; zero under
            voltages.
        cancelled: Reason why a source lost control in the last tick, or empty.
    """

    def __init__(self, parameters: PlatformParameters) -> None:
        robot = parameters.robot
        self.parameters = parameters
        self.latch = StopLatch()
        self.arbiter = Arbiter(_silences(parameters))
        self.motion_limit = MotionLimit(parameters.collision_monitor)
        self.cascade = WheelCascade(parameters, dead_wheel_indices(parameters))
        self.wheel_health = WheelHealthMonitor(parameters, self.cascade)
        self.held_robot = HeldRobotDetector(
            parameters.held, self.cascade.kinematics, self.cascade.dynamics
        )
        self.odometry = Odometry(self.cascade.kinematics, parameters.odometry)
        self.feedback = WheelFeedback(
            robot.wheel_count, parameters.odometry.encoder_span, robot.motor.max_speed
        )
        self.imu = ImuFeedback(parameters.imu)
        self.stability = StabilityLimiter()
        self.limits = self.wheel_health.limits
        self.setpoint: Array = np.zeros(3)
        self.rate: Array = np.zeros(3)
        self.demand: Array = np.zeros(3)
        self.cancelled = ""
        self._limiter = TwistLimiter(self.limits)
        self._adopt_limits()
        self._follower = PreviewFollower(parameters.position)
        self._target: Array = np.zeros(3)
        self._volts: Array | None = None
        self._previews: dict[Source, Preview] = {}
        self._last_tick: float | None = None
        self._stall_end = NEVER
        self._is_recovering = True  # the wheels may turn: another controller may have been killed
        self._delivery = LateDelivery()

    def configure(self, parameters: PlatformParameters) -> None:
        """Set new limits and gains while running; a motion continues without a jump.

        Raises:
            GeometryError: The wheels would not make a platform; nothing is changed.
            ParameterError: Wheels are calibrated or excluded in motion, or too few remain.
        """
        before = self.parameters
        for name, new, old in (
            ("odometry.wheel_scale", parameters.odometry.wheel_scale, before.odometry.wheel_scale),
            ("drive.dead", parameters.drive.dead, before.drive.dead),
        ):
            if new != old and not self.at_rest:
                raise ParameterError(name, new, "the platform moves: stop it first")
        self.cascade.configure(parameters, self.wheel_health.idle_wheels(parameters))
        self.parameters = parameters
        self.arbiter.silence = _silences(parameters)
        self.motion_limit.parameters = parameters.collision_monitor
        self.feedback.max_speed = parameters.robot.motor.max_speed
        self._follower.gains = parameters.position
        self.imu.configure(parameters.imu)
        self._adopt_models()

    def _adopt_models(self) -> None:
        """Pass on the models of the cascade after they have changed."""
        self.wheel_health.configure(self.parameters, self.cascade)
        self.held_robot.configure(
            self.parameters.held, self.cascade.kinematics, self.cascade.dynamics
        )
        self.odometry.configure(self.cascade.kinematics, self.parameters.odometry)
        self._adopt_limits()

    def _adopt_limits(self) -> None:
        """Set the limits of the twist to what wheels and stability leave."""
        cascade = self.cascade
        support = None
        if cascade.robot.arm.mass > 0.0:
            support = SupportModel(cascade.robot, cascade.whole, cascade.dynamics.mass_matrix)
        self.limits = self._limiter.limits = self.stability.configure(
            self.parameters.stability, support, self.wheel_health.limits
        )

    def set_arm(self, arm: Arm) -> None:
        """Use the arm as a body at rest in its present posture, in motion, too.

        Args:
            arm: Mass, centre of mass and inertia of the arm.
        """
        self.cascade.set_arm(arm)
        self.held_robot.observer.set_dynamics(self.cascade.kinematics, self.cascade.dynamics)
        self._adopt_limits()

    # ---- inputs: each returns the reason why it is not used, a warning, or an empty string --

    def update_wheels(
        self,
        time: float,
        now: float,
        position: Array | None,
        velocity: Array | None,
        effort: Array | None = None,
    ) -> str:
        """Process the state of the wheels; position or velocity must be present.

        Args:
            time: Time of the measurement [s]; odometry runs on it. At most `now` counts: the
                stamps of another machine may be ahead.
            now: Time of arrival [s]; the timeout runs on the older of the two.
            position: Positions (n,) [rad], or None.
            velocity: Speeds (n,) [rad/s], or None.
            effort: Torques (n,) [N m], or None. Without them, or if one is not finite, neither a
                dead wheel nor a held robot is found.

        Returns:
            Warning to log, or an empty string.

        Raises:
            InputError: A size is wrong, a number is not finite, there is no content, or the state
                is not newer than the last one.
        """
        time = min(time, now)
        self.wheel_health.update_torques(time, effort)
        step = self.feedback.update(time, now, position, velocity)
        self.held_robot.update_wheels(time, self.feedback.speeds, effort)
        if step is None:
            return ""
        inertial = self.imu.take(self.feedback.time, now, step.speeds)
        coupling, odometry = self.cascade.coupling, self.odometry
        error = odometry.update(step.moved, step.speeds, step.dt, inertial)
        expected = coupling.expected_rate(step.speeds, float(odometry.twist[2])) * step.dt
        coupling.add(error - expected)
        self.held_robot.update_motion(step.dt, odometry, inertial)
        return step.warning

    def set_twist(
        self, twist: Array, now: float, age: float | None = None, sent: float | None = None
    ) -> str:
        """Set the target of `cmd_vel`.

        A twist without a stamp counts from its arrival. Unless it is zero, it is not used before
        the wheels have reported, if it may have waited while the caller had stalled, or if the
        middleware has delivered it late.

        Args:
            twist: Body twist (3,) [m/s, m/s, rad/s].
            now: Time of arrival [s].
            age: Age at that time [s], or None without a stamp.
            sent: Time at which it was sent, as far as the middleware knows [s], or None.

        Returns:
            Why it is not used, or an empty string.

        Raises:
            InputError: The size is wrong, a number is not finite, or the twist is stale.
        """
        if twist.shape != (3,):
            raise InputError(f"cmd_vel: has {twist.size} numbers, expected 3")
        plausible.demand(twist, plausible.SPEED, "cmd_vel: twist")
        if float(np.abs(twist).max()) <= NEGLIGIBLE_TWIST:
            twist = np.zeros(3)
        timeout = self.parameters.timeouts.cmd_vel
        until = _fresh_until("cmd_vel", now, age or 0.0, timeout)
        neutral, doubt = not twist.any(), ""
        if age is None:
            is_late = sent is not None and self._delivery.is_late(sent, now, timeout)
            doubt = WAITED if self._may_have_waited(now, sent) else LATE if is_late else ""
        refusal = self._offer(Source.CMD_VEL, now, until, "" if neutral else doubt, neutral)
        if not refusal:
            self._target = np.array(twist)
        return refusal

    def set_preview(
        self, source: Source, preview: Preview, now: float, stamped: bool = True
    ) -> str:
        """Set the preview of a source; it is valid until it ends or `timeouts.preview` is over.

        A preview without a stamp begins at its arrival; it is not used if it may have waited
        while the caller had stalled.

        Args:
            preview: Motion of the platform in odom.
            now: Time of arrival [s].

        Returns:
            Why it is not used, or an empty string.

        Raises:
            InputError: The preview has ended already, or begins too late to be followed now.
        """
        if preview.start > now + MAX_LEAD:
            raise InputError(f"{source.value}/reference: begins in {preview.start - now:.3g} s")
        if preview.end < now:
            age = now - preview.end
            raise InputError(f"{source.value}/reference: stale, it ended {age:.3f} s ago")
        # If it ends at rest, the platform has arrived; otherwise the preview has run out.
        ends_at_rest = preview.end_speed == 0.0
        timeouts = self.parameters.timeouts
        hold_time = timeouts.reference if ends_at_rest else 0.0
        fresh_until = min(preview.end + hold_time, now + timeouts.preview)
        doubt = WAITED if not stamped and self._may_have_waited(now) else ""
        refusal = self._offer(source, now, fresh_until, doubt)
        if not refusal:
            self._previews[source] = preview
            self._volts = None if source is Source.MPC else self._volts
        return refusal

    def set_voltages(self, volts: Array, now: float, age: float | None = None) -> str:
        """Set the motor voltages of the MPC.

        Voltages without a stamp count from their arrival; they are not used if they may have
        waited while the caller had stalled.

        Args:
            volts: Voltages (n,) [V].
            now: Time of arrival [s].
            age: Age at that time [s], or None without a stamp.

        Returns:
            Why they are not used, or an empty string.

        Raises:
            InputError: The size is wrong, a number is not finite, the voltages are stale, the
                drives have no voltage mode, or a wheel is dead.
        """
        n = self.parameters.robot.wheel_count
        if volts.shape != (n,):
            raise InputError(f"mpc/voltages: {volts.size} voltages for {n} wheels")
        plausible.demand(volts, plausible.EFFORT, "mpc/voltages: volts")
        if DriveMode.VOLTAGE.value not in self.parameters.drive.offered:
            raise InputError("mpc/voltages: the drives have no voltage mode")
        if self.wheel_health.idle:
            raise InputError(f"mpc/voltages: {self._voltages_refusal}")
        until = _fresh_until("mpc/voltages", now, age or 0.0, self.parameters.timeouts.voltages)
        doubt = WAITED if age is None and self._may_have_waited(now) else ""
        refusal = self._offer(Source.MPC, now, until, doubt)
        if not refusal:
            limit = self.parameters.robot.motor.max_voltage
            self._volts = np.clip(volts, -limit, limit)
        return refusal

    @property
    def _voltages_refusal(self) -> str:
        """Return why voltages are not used while wheels are idle."""
        idle = name_list(self.parameters.robot.wheels.names, self.wheel_health.idle)
        return f"computed for all wheels, but {idle} dead"

    def _offer(
        self, source: Source, now: float, fresh_until: float, doubt: str, neutral: bool = False
    ) -> str:
        """Offer a setpoint to the arbiter, unless there is a doubt whether it is still meant.

        Returns:
            Why it is not used, or an empty string.
        """
        if not self.latch.released:
            status = self.latch.status
            return self.arbiter.refuse(source, now, f"{status.state.value}: {status.reason}")
        if not self.feedback.received:
            return "" if neutral else "no wheel_states yet"
        if doubt:
            return self.arbiter.ignore(source, now, doubt)
        return self.arbiter.offer(source, now, fresh_until, neutral)

    def _may_have_waited(self, now: float, sent: float | None = None) -> bool:
        """Return whether an input that arrives at `now` may have waited during a stall.

        What waited may be delivered before the late tick or after it. Motion is resumed by a
        report of the wheels that was sent after the stall; what was received earlier has been
        delivered by then. What has to be delivered again comes later.

        Args:
            now: Time of arrival [s].
            sent: Time at which it was sent, as far as the middleware knows [s], or None.
        """
        if self._last_tick is not None and now - self._last_tick > MAX_TICK:
            return True
        may_come_late = now < self._stall_end + LATE_DELIVERY
        came_late = may_come_late and sent is not None and sent < self._stall_end
        return self._is_recovering or came_late

    @property
    def coupling_error(self) -> Array:
        """Coupling error epsilon (m,) since the last stop [rad]."""
        return self.cascade.coupling.error

    @property
    def tracking_error(self) -> Array:
        """Error (3,) of the last tick that followed a preview [m, m, rad]."""
        return self._follower.error

    @property
    def acceleration(self) -> Array:
        """Acceleration (3,) in space that the last tick demands, in base_link.

        It is that of base_link's origin [m/s^2, m/s^2] and of the yaw [rad/s^2].
        """
        vx, vy, w = self.setpoint.tolist()
        result: Array = self.rate + np.array([-w * vy, w * vx, 0.0])
        return result

    # ---- stops ------------------------------------------------------------------------------

    @property
    def held(self) -> bool:
        """Whether the robot is held, by its forces or as all its wheels stand despite torques.

        If that has stopped it, it stays so until :meth:`reset`.
        """
        return self.held_robot.held or self.wheel_health.all_blocked

    def is_ready(self, now: float) -> bool:
        """Return whether a source may drive at a time [s].

        The wheels have reported, nothing is stopped, and a limit that is expected is there.
        """
        is_known = self.feedback.received and not self._is_recovering
        return is_known and self.latch.released and not self.motion_limit.is_silent(now)

    @property
    def at_rest(self) -> bool:
        """Whether the setpoint of the wheels is zero."""
        return not self.setpoint.any()

    def fault(self, now: float) -> str:
        """Return the present fault, which keeps a stop latched; empty if there is none.

        Reports that came during a stall may not be handled yet: silence counts from its end.
        """
        age = self.feedback.age(now)
        if self._is_recovering:
            age = min(age, now - self._stall_end)
        if self.feedback.received and age > self.parameters.timeouts.wheel_states:
            return f"wheel_states silent for {age:.2f} s"
        return ""

    def reset(self, now: float) -> None:
        """Clear a latched stop; nothing moves until a source sends a new setpoint.

        Raises:
            ResetRefusedError: See StopLatch.reset.
        """
        rotating = float(np.abs(self.feedback.speeds).max()) > RESET_REST_SPEED
        self.latch.reset(at_rest=self.at_rest and not rotating, fault=self.fault(now))
        self.arbiter.cancel_all("reset")
        self.wheel_health.reset()
        self.held_robot.reset()
        self._adopt_idle_wheels()

    def set_pose(self, pose: tuple[float, float, float], covariance: Array | None = None) -> None:
        """Set the pose of the odometry, and cancel the sources that send previews.

        Args:
            pose: Pose x, y, theta in odom [m, m, rad].
            covariance: Covariance (3, 3) of the pose; None means zero.

        Raises:
            InputError: See Odometry.reset.
        """
        self.odometry.reset(pose, covariance)
        for source in PREVIEW_SOURCES:
            self.arbiter.cancel(source, "the pose was set")

    def reset_odometry(self) -> None:
        """Set the pose of the odometry to the origin, and its coupling error to zero.

        The error that the coupling controller corrects is not changed.
        """
        self.set_pose((0.0, 0.0, 0.0))
        self.odometry.reset_coupling_error()

    def _check(self, now: float, dt: float) -> None:
        """Latch a stop for each fault; a stop cancels every source."""
        fault = self.fault(now)
        if fault and (self._is_asked_to_move or not self.at_rest):
            self.latch.stop(fault)
        elif fault and self.latch.released:
            self.feedback.forget()
        driven = self.arbiter.active is not None
        wheel_fault = self.wheel_health.check(self.cascade, self.feedback, driven, now, dt)
        if wheel_fault and self.latch.released:
            self.latch.stop(wheel_fault)
        held = self._check_held(dt)
        if held and self.latch.released:
            self.latch.stop(held)
        self._adopt_idle_wheels()
        if not self.latch.released:
            self.arbiter.cancel_all(self.latch.status.reason)

    @property
    def _is_asked_to_move(self) -> bool:
        """Whether a source drives; a twist of zero asks for what the robot does already."""
        active = self.arbiter.active
        return bool(self._target.any()) if active is Source.CMD_VEL else active is not None

    def _check_held(self, dt: float) -> str:
        """Return why a robot that is to move counts as held, if that stops it; else empty."""
        by_voltage = self.arbiter.active is Source.MPC and self._volts is not None
        driven = self.arbiter.active is not None
        if not (driven and (by_voltage or self._is_demanding_motion)):
            self.held_robot.clear()
            return ""
        held = self.held_robot.check(dt)
        if not held or not self.parameters.held.stop:
            return ""
        notice = self.wheel_health.rest_notice(self.cascade.reference, self.feedback.speeds)
        return f"{held}; {notice}"

    @property
    def _is_demanding_motion(self) -> bool:
        return bool(max(map(abs, self.cascade.reference.tolist())) > REST_SPEED)

    def _adopt_idle_wheels(self) -> None:
        """Update the models if wheels have become idle, or are driven again."""
        if self.wheel_health.idle == self.cascade.kinematics.idle:
            return
        self.cascade.configure(self.parameters, self.wheel_health.idle)
        self._adopt_models()
        if self._volts is not None and self.wheel_health.idle:
            self._volts = None
            self._cancel(Source.MPC, f"mpc/voltages: {self._voltages_refusal}")

    # ---- output -----------------------------------------------------------------------------

    def tick(self, now: float) -> WheelCommand | None:
        """Return the command for the tick at `now` [s], or None if there is none.

        If simulated time goes back, every source is cancelled and feedback starts anew. At first,
        and after the caller has stalled, there is no command until the wheels have reported: the
        drives ramp down by themselves, and the motion continues from their speeds.
        """
        elapsed = 0.0 if self._last_tick is None else now - self._last_tick
        dt = min(max(elapsed, 0.0), MAX_TICK)
        self._last_tick = now
        self.cancelled = ""
        if elapsed < -MAX_TICK:
            self.arbiter.restart(now, "time went back")
            self.feedback.forget()
            self.imu.forget()
        elif elapsed > MAX_TICK:
            self.arbiter.resume(now)
            self._stall_end, self._is_recovering = now, True
            return None  # messages that came meanwhile are handled before the next tick
        self._check(now, dt)
        if self._is_recovering and not self._recovered(dt):
            return None
        source = self.arbiter.select(now)
        measured, before = self.feedback.speeds, self.setpoint
        if source is Source.MPC and self._volts is not None:
            self.setpoint = self.cascade.kinematics.J_pinv @ measured
            self._limiter.restart()
            self.rate = np.zeros(3)
            self.demand = np.zeros(3)
            if not self._too_fast(measured, now):
                volts = self._borne(self._volts, measured)
                return self.cascade.voltage_command(volts, measured, self.wheel_health.probe(now))
            self._cancel(
                source, "mpc/voltages drove a wheel or the platform above its speed limit"
            )
            source, before = None, self.setpoint
        wanted, rate = self._motion(source, now, dt)
        velocity, fraction = self.parameters.limits.velocity, self.motion_limit.fraction(now)
        twist = slowed(wanted, before, velocity, self.limits.deceleration, fraction, dt)
        reachable = self._reachable(twist, before, dt)
        if self.cascade.saturated or rate is None or twist is not wanted:
            rate = (reachable - before) / dt if dt > 0.0 else np.zeros(3)
        if twist is not wanted:
            self._limiter.restart(rate)
        self.setpoint, self.rate = reachable, rate
        driven = self.arbiter.active is not None
        if not driven and not reachable.any():
            return self.cascade.rest_command(measured)
        by_velocity = not driven or self.wheel_health.weak
        mode = DriveMode.VELOCITY if by_velocity else DriveMode(self.parameters.drive.mode)
        probe = self.wheel_health.probe(now) if driven else None
        return self.cascade.command(reachable, rate, measured, mode, dt, probe)

    def _recovered(self, dt: float) -> bool:
        """Continue from the measured motion once the wheels have reported.

        Args:
            dt: Time since the last tick [s].

        Returns:
            Whether commands can be sent again.
        """
        if not self.feedback.received or self.feedback.time < self._stall_end:
            self.setpoint = ramp_down(self.setpoint, self.limits.deceleration, dt)
            return False
        self.setpoint = self.cascade.kinematics.J_pinv @ self.feedback.speeds
        if not self.feedback.speeds.any():
            self.setpoint = np.zeros(3)
        self._limiter.restart()
        self._is_recovering = False
        return True

    def _borne(self, volts: Array, measured: Array) -> Array:
        """Return voltages (n,) [V] that the arm's posture bears, if it lowers the limits.

        Accelerations and decelerations are limited by the larger of the two limits, as they are
        counted for the fraction of the limits.
        """
        if self.stability.fraction == 1.0:
            return volts
        linear, angular = map(max, self.limits.acceleration, self.limits.deceleration)
        limited = self.cascade.dynamics.limited_voltage
        return limited(volts, self.setpoint, measured, (linear, angular))

    def _too_fast(self, measured: Array, now: float) -> bool:
        """Return whether wheels or platform exceed their limits, which voltages do not respect."""
        limits, motor = self.limits, self.parameters.robot.motor
        wheels = float(np.abs(measured).max()) > OVERSPEED * motor.max_speed
        return wheels or (
            ratio(self.setpoint, limits.velocity) > OVERSPEED * self.motion_limit.fraction(now)
        )

    def _reachable(self, twist: Array, before: Array, dt: float) -> Array:
        """Return the twist within the wheels' speed; a limit lowered in motion is ramped to."""
        reachable = self.cascade.reachable(twist)
        if self.cascade.saturated:
            deceleration = self.limits.deceleration
            slowest = ramp_down(before, deceleration, dt)
            if ratio(slowest, deceleration) > ratio(reachable, deceleration):
                return slowest
        return reachable

    def _motion(self, source: Source | None, now: float, dt: float) -> tuple[Array, Array | None]:
        """Return the twist (3,) in base_link for this tick; its rate if the source knows it."""
        self.demand = np.zeros(3)
        if source is Source.CMD_VEL:
            self.demand = self._target
            return self._limiter.step(self.setpoint, self._target, dt), None
        self._limiter.restart()
        followed = None if source is None else self._follow(source, now, dt)
        if followed is None:
            return ramp_down(self.setpoint, self.limits.deceleration, dt), None
        self.demand = self._follower.target
        return followed

    def _follow(self, source: Source, now: float, dt: float) -> tuple[Array, Array] | None:
        """Return twist and rate in base_link that follow a preview; None if it was cancelled."""
        try:
            return self._follower.step(
                self._previews[source],
                self.odometry,
                self.feedback.time,
                self.setpoint,
                self.limits,
                now,
                dt,
            )
        except FollowingError as error:
            self._cancel(source, str(error))
            return None

    def _cancel(self, source: Source, reason: str) -> None:
        """Cancel a source, and record the reason in `cancelled`."""
        self.arbiter.cancel(source, reason)
        self.cancelled = f"{source.value} cancelled: {reason}"


def _silences(parameters: PlatformParameters) -> dict[Source, float]:
    """Return how long each source must be silent after it was cancelled [s]."""
    return dict.fromkeys(Source, parameters.timeouts.cancelled)


def _fresh_until(label: str, now: float, age: float, timeout: float) -> float:
    """Return the time until which an input is fresh [s].

    Raises:
        InputError: The input is stale already.
    """
    if age > timeout:
        raise InputError(f"{label}: stale, {age:.3f} s old")
    return now + timeout - max(age, 0.0)
