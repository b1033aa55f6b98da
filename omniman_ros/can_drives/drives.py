"""Policy over all drives of a platform, for any protocol: frames in, frames out, time given.

Nothing but `tick` and the first moment of a stop makes frames: a bridge that hangs or is frozen
falls silent, and the drives' own watchdogs stop the wheels.
"""

import math
from enum import Enum

import numpy as np

from omniman_ros.can_drives.axis import AxisState, Demand, DriveSetpoint, Receipt
from omniman_ros.can_drives.foreign_host import ForeignHostDetector
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.can_drives.protocols import drive_protocol
from omniman_ros.can_drives.setpoints import SetpointGenerator
from omniman_ros.can_drives.transmission import axis_settings
from omniman_ros.can_drives.wheel_axes import WheelAxes
from omniman_ros.can_drives.wheel_feedback import FeedbackConverter, WheelStates
from omniman_ros.control.wheel_cascade import WheelCommand
from omniman_ros.core.arrays import Array
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import InputError
from omniman_ros.core.platform import Platform

REST_SPEED = 0.05  #: Speed below which a wheel counts as at rest [rad/s]
#: Time for which all wheels must be at rest before a stop switches the power off [s]
REST_TIME = 0.2
#: Time to listen to the bus before anything is sent: two periods of the slowest host [s]
LISTEN_TIME = 0.2
#: Time after the ramp of a stop at which the power is switched off regardless [s]
STOP_MARGIN = 0.5


class CanDrivesPhase(Enum):
    """State that the drives are in, or are being brought to."""

    UNCONFIGURED = "unconfigured"
    CONFIGURING = "configuring"
    #: Configured; the motors have no power, or their wheels are being stopped to switch it off
    IDLE = "idle"
    ENABLING = "enabling"
    DRIVING = "driving"


class CanDrives:
    """Policy over all drives: who may move, when all stop, and when one is lost.

    * Setpoints and the host's heartbeat are made by `tick` alone, which checks the age of the
      command; a stale command becomes a ramp to rest on the curve the robot is on.
    * One wheel lost, for whatever reason, is a quick stop of all, latched until :meth:`reset`.
    * A policy that was itself delayed for longer than the drives wait assumes that they have
      stopped, and stops all.
    * After a stop, when all wheels are at rest, the power is switched off. Enabling begins at zero
      speed.

    Raises:
        ParameterError: The installation does not fit the robot.
    """

    def __init__(self, robot: Platform, parameters: CanParameters) -> None:
        settings = axis_settings(robot, parameters)
        protocol = drive_protocol(parameters.protocol)
        # The constructor of a protocol takes the settings alone.
        self._group = WheelAxes([protocol(drive) for drive in settings])  # type: ignore[call-arg]
        self.axes = self._group.axes
        self._network = protocol.network(settings)
        self.phase = CanDrivesPhase.UNCONFIGURED
        self.stop_reason = ""
        self._has_moved = False
        ids = set(self._network.command_ids).union(*(axis.command_ids for axis in self.axes))
        self.host_detector = ForeignHostDetector(ids)
        self._parameters = parameters
        self._setpoints = SetpointGenerator(self.axes, robot, parameters)
        samples_at_sync = self._network.samples_at_sync
        self._feedback = FeedbackConverter(self.axes, robot, parameters, samples_at_sync)
        self._phase_began_at = -math.inf
        self._is_listening = False
        self._at_rest_since: float | None = None
        self._last_tick = self._tick_before = -math.inf

    def update_parameters(self, robot: Platform, parameters: CanParameters) -> None:
        """Replace limits and timeouts; parameters that are read once at the start are ignored."""
        self._parameters = parameters
        self._setpoints.update_parameters(robot, parameters)
        self._feedback.update_parameters(robot, parameters)

    # ---- requests -----------------------------------------------------------------------------

    def configure(self, now: float) -> None:
        """Begin to configure all drives; `tick` continues until the phase is IDLE.

        First the bus is listened to: drives that another host commands are left alone. A drive
        that then reports a fault is reset once, as the fault may stem from the silence since the
        last host.
        """
        self.phase, self._phase_began_at = CanDrivesPhase.CONFIGURING, now
        self.stop_reason = ""
        self._forget()
        self._is_listening = True

    def enable(self, now: float) -> None:
        """Enable all drives at zero speed over the next ticks, or raise InputError if not IDLE."""
        if self.phase in (CanDrivesPhase.UNCONFIGURED, CanDrivesPhase.CONFIGURING):
            raise InputError(f"the drives are {self.phase.value}")
        if self.stop_reason:
            raise InputError(f"stopped: {self.stop_reason}")
        self._begin_enabling(now)

    def disable(self, now: float) -> None:
        """Stop the wheels, then switch the power off."""
        if self.phase in (CanDrivesPhase.ENABLING, CanDrivesPhase.DRIVING):
            self.phase = CanDrivesPhase.IDLE
            self._begin_stop(now)

    def stop(self, reason: str, now: float) -> list[CanFrame]:
        """Latch a quick stop of all drives until :meth:`reset`; return frames to send at once."""
        if self.stop_reason:
            return []
        self._latch(reason, now)
        if self.phase in (CanDrivesPhase.UNCONFIGURED, CanDrivesPhase.CONFIGURING):
            return []
        return self._record_sent(self._axis_frames(Demand.STOP, now))

    def _latch(self, reason: str, now: float) -> None:
        self.stop_reason = reason
        self._begin_stop(now)

    def reset(self, now: float) -> None:
        """Clear a stop: `tick` resets faults and configures drives that restarted.

        Nothing moves; drives that were to drive are enabled again at zero speed.
        """
        reason, self.stop_reason = self.stop_reason, ""
        if not reason or self.phase in (CanDrivesPhase.UNCONFIGURED, CanDrivesPhase.CONFIGURING):
            return
        self._group.reset(now)
        self._forget()
        if self.phase in (CanDrivesPhase.ENABLING, CanDrivesPhase.DRIVING):
            self._begin_enabling(now)
        else:
            self._phase_began_at = now

    def _begin_enabling(self, now: float) -> None:
        self.phase, self._phase_began_at = CanDrivesPhase.ENABLING, now
        self._forget()

    def _begin_stop(self, now: float) -> None:
        self._forget()
        self._phase_began_at, self._at_rest_since = now, None
        self._setpoints.begin_ramp(self._feedback.believed_velocity())

    def _forget(self) -> None:
        self._setpoints.drop_command()
        self._feedback.restart_monitors()

    def set_command(self, command: WheelCommand, now: float, age: float = 0.0) -> str:
        """Set the command, `age` [s] old, of wheels in the robot's order; return why not, or "".

        Raises:
            InputError: The command is invalid or stale; the last one remains, and ages on.
        """
        self._setpoints.check(command, now - age, now)
        values = command.effort if command.velocity is None else command.velocity
        if self.stop_reason or self.phase is not CanDrivesPhase.DRIVING:
            reason = f"stopped: {self.stop_reason}" if self.stop_reason else self.phase.value
            return reason if values.any() else ""
        if values.any() or command.effort.any():
            self._has_moved = True
        self._setpoints.set_command(command, now - age)
        return ""

    # ---- the bus ------------------------------------------------------------------------------

    def receive(self, frame: CanFrame, now: float) -> list[CanFrame]:
        """Process a received frame; return frames to send at once if it makes the drives stop."""
        if self._detect_gap(now):
            return self._record_sent(self._axis_frames(Demand.STOP, now))
        if self.host_detector.is_host_frame(frame):
            return self._receive_host_frame(frame, now)
        receipt = self._group.receive(frame, now)
        if receipt is not None:
            return self._evaluate(*receipt, now)
        self.host_detector.counts["unknown"] += 1
        return []

    def _receive_host_frame(self, frame: CanFrame, now: float) -> list[CanFrame]:
        if self.phase is CanDrivesPhase.UNCONFIGURED or self.host_detector.is_echo(frame):
            return []
        reason = f"another host commands the drives: frame {frame}"
        if self.phase is CanDrivesPhase.CONFIGURING:
            self._give_up(reason)
        return self.stop(reason, now)

    def _evaluate(self, k: int, receipt: Receipt, now: float) -> list[CanFrame]:
        """Stop all drives if the frame that wheel `k` has just received gives a reason."""
        if receipt is Receipt.MALFORMED:
            self.host_detector.counts["malformed"] += 1
        axis = self.axes[k]
        implausible = self._feedback.check(k)
        reason = axis.fault_reason or implausible
        if not reason or self.stop_reason or self.phase is CanDrivesPhase.CONFIGURING:
            return []
        return self.stop(f"{axis.settings.name}: {reason}", now)

    def on_bus_failure(self, reason: str, now: float) -> list[CanFrame]:
        """Stop all drives because the bus is off or a frame could not be sent.

        While the drives are configured nothing moves, and configuring is given up instead.
        """
        if self.phase is CanDrivesPhase.CONFIGURING:
            self._give_up(f"bus: {reason}")
        return self.stop(f"bus: {reason}", now)

    def tick(self, now: float) -> list[CanFrame]:
        """Return the frames of one period; to be called at the installation's rate."""
        if self.phase is CanDrivesPhase.UNCONFIGURED or self._listen(now):
            return []
        self._detect_gap(now)
        self._last_tick, self._tick_before = now, self._last_tick
        before = self._network.before(now)
        if self.phase is CanDrivesPhase.CONFIGURING:
            frames = self._axis_frames(Demand.IDLE, now)
            self._group.reset_faults_once(now)
            self._finish_configuring(now)
        else:
            self._supervise(now)
            is_stopped = self.stop_reason or self.phase is CanDrivesPhase.IDLE
            demand = self._stop_demand(now) if is_stopped else Demand.DRIVE
            frames = self._axis_frames(demand, now)
        return self._record_sent([*before, *frames, *self._network.after(now)])

    def _record_sent(self, frames: list[CanFrame]) -> list[CanFrame]:
        self.host_detector.record_sent(frames)
        return frames

    # ---- a period -----------------------------------------------------------------------------

    def _detect_gap(self, now: float) -> bool:
        """Stop if this process itself was delayed, before frames of that time are used.

        The drives have stopped by themselves then. For those that have no ramp of their own, the
        ramp continues from the last period, not from now.
        """
        gap = now - self._last_tick
        if self.stop_reason or self.phase is not CanDrivesPhase.DRIVING:
            return False
        if gap <= self._parameters.heartbeat_timeout:
            return False
        self._latch(f"the bridge was held up for {gap:.2f} s", now)
        self._setpoints.begin_ramp(self._feedback.believed_velocity(), self._last_tick)
        return True

    def _listen(self, now: float) -> bool:
        """Return whether the bus is still listened to; when that ends, configure the drives."""
        if self._is_listening and now - self._phase_began_at >= LISTEN_TIME:
            self._is_listening, self._phase_began_at = False, now
            self._group.configure(now)
        return self._is_listening

    def _finish_configuring(self, now: float) -> None:
        if self.phase is not CanDrivesPhase.CONFIGURING:
            return
        if self._group.are_all(AxisState.READY) and self._group.have_reported:
            self.phase = CanDrivesPhase.IDLE
            self._at_rest_since = now - REST_TIME
        elif self._group.fault or now - self._phase_began_at > self._parameters.configure_timeout:
            self._give_up(self._group.describe_others_than(AxisState.READY))

    def _give_up(self, reason: str) -> None:
        self._is_listening = False
        self.stop_reason, self.phase = f"not configured: {reason}", CanDrivesPhase.UNCONFIGURED

    def _supervise(self, now: float) -> None:
        """Detect reasons to stop that come without a frame: faults, silence, disabled drives."""
        self._has_moved = self.may_have_moved
        if self.stop_reason:
            return
        if self._group.fault:
            self._latch(self._group.fault, now)
        elif self.phase is CanDrivesPhase.DRIVING:
            self._detect_lost_drives(now)
        elif self.phase is CanDrivesPhase.ENABLING:
            silence = self._group.silence(now, self._parameters.feedback_timeout)
            if self._group.are_all(AxisState.ENABLED) and not silence:
                self.phase = CanDrivesPhase.DRIVING
            elif now - self._phase_began_at > self._parameters.enable_timeout:
                others = self._group.describe_others_than(AxisState.ENABLED)
                self._latch(f"not enabled: {others}", now)

    def _detect_lost_drives(self, now: float) -> None:
        silence = self._group.silence(now, self._parameters.feedback_timeout)
        if silence:
            self._latch(silence, now)
        elif not self._group.are_all(AxisState.ENABLED):
            self._latch(f"lost: {self._group.describe_others_than(AxisState.ENABLED)}", now)

    def _stop_demand(self, now: float) -> Demand:
        """Return STOP until all wheels are at rest for `REST_TIME` or the stop is overdue."""
        # A drive that is offline may have its power on, and its wheel may rotate.
        if all(axis.state in (AxisState.READY, AxisState.FAULT) for axis in self.axes):
            return Demand.IDLE
        if self._rotates:
            self._at_rest_since = None
        elif self._at_rest_since is None:
            self._at_rest_since = now
        if self._at_rest_since is not None and now - self._at_rest_since >= REST_TIME:
            return Demand.IDLE
        is_overdue = now - self._phase_began_at > self.longest_stop
        return Demand.IDLE if is_overdue else Demand.STOP

    @property
    def _rotates(self) -> bool:
        return not bool((np.abs(self._feedback.velocity()) < REST_SPEED).all())

    def _axis_frames(self, demand: Demand, now: float) -> list[CanFrame]:
        """Return the frames of all axes; one axis that fails makes the others stop at once."""
        frames, failure = self._group.tick(demand, self._choose_setpoints(demand, now), now)
        if failure and self.phase is CanDrivesPhase.CONFIGURING:
            self._give_up(failure)
        if not failure or self.stop_reason:
            return frames
        self._latch(failure, now)
        return self._axis_frames(Demand.STOP, now)

    def _choose_setpoints(self, demand: Demand, now: float) -> list[DriveSetpoint]:
        if demand is Demand.STOP:
            return self._setpoints.stopping(now)
        if demand is Demand.IDLE or self.phase is not CanDrivesPhase.DRIVING:
            return self._setpoints.resting()
        return self._setpoints.driving(self._feedback.believed_velocity(), now)

    # ---- output -------------------------------------------------------------------------------

    def at_rest(self, now: float) -> bool:
        """Return whether all wheels that still report are at rest or an overdue stop ended."""
        if self.phase is CanDrivesPhase.UNCONFIGURED:
            return True
        is_overdue = self.stop_reason and now - self._phase_began_at > self.longest_stop
        return bool(
            all(
                abs(speed) < REST_SPEED or (is_overdue and now - axis.feedback.at > STOP_MARGIN)
                for speed, axis in zip(self._feedback.velocity().tolist(), self.axes, strict=True)
            )
        )

    @property
    def may_have_moved(self) -> bool:
        """Whether motion was commanded, or a wheel rotated while the drives had power."""
        has_power = self.phase in (CanDrivesPhase.ENABLING, CanDrivesPhase.DRIVING)
        return self._has_moved or (has_power and self._rotates)

    @property
    def longest_stop(self) -> float:
        """Longest time of a stop [s]; then the power is switched off regardless."""
        deceleration = self._parameters.quick_stop_deceleration
        return self._feedback.max_believed_speed / deceleration + STOP_MARGIN

    @property
    def is_off(self) -> bool:
        """Whether no drive reports power on its motor."""
        return self._group.are_off

    @property
    def restarts(self) -> tuple[int, ...]:
        """Number of restarts of each drive so far."""
        return self._group.restarts

    def take_states(self) -> WheelStates | None:
        """Return the states of all wheels if all have reported since the last call, else None."""
        return self._feedback.take_states(self._last_tick, self._tick_before)

    def electrical(self, dt: float) -> Array:
        """Return voltage [V], current [A], energy [J] grown over `dt` [s], of motors (n, 3)."""
        return self._feedback.electrical(dt)
