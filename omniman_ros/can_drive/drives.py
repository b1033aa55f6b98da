"""All drives of a platform: one policy over any protocol. Frames in, frames out, time given.

Nothing but `tick` and the first moment of a stop makes frames: what hangs or is frozen falls
silent, and the drives' own watchdogs stop the wheels.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from omniman_ros.can_drive.axis import REST, Axis, AxisState, Demand, Network, Receipt, Setpoint
from omniman_ros.can_drive.frame import Frame
from omniman_ros.can_drive.lookout import Lookout
from omniman_ros.can_drive.monitor import WheelMonitor
from omniman_ros.can_drive.phase import Phase
from omniman_ros.can_drive.protocols import PROTOCOLS
from omniman_ros.can_drive.ramp import SpeedRamp
from omniman_ros.can_drive.transmission import axis_settings, max_wheel_speed, transmissions
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import InputError
from omniman_ros.core.robot import Robot
from omniman_ros.core.wheel_cascade import DriveMode, WheelCommand

Array = NDArray[np.float64]

REST_SPEED = 0.05
"""Wheel speed at which a wheel stands, rad/s."""
SETTLED = 0.2
"""How long all wheels must stand before a stop takes the power off, s."""
LEAST_STEP = 0.25
"""Periods between two times of measurement; of reports that come late in a bunch one counts."""
LISTEN = 0.2
"""How long the bus is listened to before anything is sent, s: two periods of the slowest host."""
GRACE = 0.5
"""How much longer than its ramp a stop may take before the power is taken off all the same, s."""


@dataclass(frozen=True)
class WheelStates:
    """Feedback of all wheels, arrays (n,), wheels in the robot's order.

    Attributes:
        at: When they were measured, s: at a SYNC, or else when the oldest of them was heard.
            It always increases.
        position: rad, not wrapped.
        velocity: rad/s.
        effort: Torque at the wheels, N m; NaN where the drive does not tell.
    """

    at: float
    position: Array
    velocity: Array
    effort: Array


class CanDrives:
    """The policy: who may move, when all stop, and when one is lost.

    * Setpoints and the host's heartbeat are made by `tick` alone, after the commands' age was
      looked at; a stale command becomes a ramp to rest on the curve the robot is on.
    * One wheel lost, for whatever reason, is a quick stop of all, latched until :meth:`reset`.
    * Held up itself for longer than the drives wait, it takes them for stopped: all stop.
    * After a stop, when all stand, the power is taken off. Enabling begins at zero speed.

    Args:
        robot: The robot.
        parameters: The installation.

    Attributes:
        axes: One per wheel, in the robot's order.
        phase: What is being done.
        stop_reason: Why all are stopped, or empty.
        lookout: Frames that were not used.

    Raises:
        ParameterError: The installation does not fit the robot.
    """

    def __init__(self, robot: Robot, parameters: CanParameters) -> None:
        settings = axis_settings(robot, parameters)
        entry = PROTOCOLS[parameters.protocol]
        self.axes: tuple[Axis, ...] = tuple(entry.axis(one) for one in settings)
        self._network: Network = entry.network(settings)
        self.phase = Phase.UNCONFIGURED
        self.stop_reason = ""
        ids = set(self._network.command_ids).union(*(axis.command_ids for axis in self.axes))
        self.lookout = Lookout(ids)
        self._monitors = tuple(WheelMonitor() for _ in self.axes)
        self._owners: dict[tuple[int, bool], int] = {}
        self._command: WheelCommand | None = None
        self._commanded = -math.inf
        self._ramp = SpeedRamp(len(self.axes))
        self._since = -math.inf
        self._listening = False
        self._stood: float | None = None
        self._taken = [0] * len(self.axes)
        self._seen = [0] * len(self.axes)
        self._retried = [False] * len(self.axes)
        self._ticked = (-math.inf, -math.inf)
        self._stamped = -math.inf
        self._energy = np.zeros(len(self.axes))
        self._fastest = 0.0
        self.configure_parameters(robot, parameters)

    def configure_parameters(self, robot: Robot, parameters: CanParameters) -> None:
        """Take other limits and time-outs; what is fixed stays as it was at the start."""
        self._robot, self._parameters = robot, parameters
        self._gears = transmissions(robot, parameters)
        self._max_speed = max_wheel_speed(robot, parameters)
        self._fastest = max(self._fastest, self._max_speed)  # wheels may turn as before
        self._mode = DriveMode(parameters.mode)

    # ---- what is asked for --------------------------------------------------------------------

    def configure(self, now: float) -> None:
        """Begin to configure all drives; `tick` goes on until the phase is IDLE.

        First the bus is listened to: drives that another host commands are left alone. A drive
        that says then that it has a fault is reset once: it may be that of the silence since the
        last host.
        """
        self.phase, self._since = Phase.CONFIGURING, now
        self.stop_reason = ""
        self._forget()
        self._retried = [False] * len(self.axes)
        self._listening = True

    def enable(self, now: float) -> None:
        """Begin to enable all drives at zero speed; `tick` goes on until the phase is DRIVING.

        Raises:
            InputError: They are not configured, or stopped.
        """
        if self.phase in (Phase.UNCONFIGURED, Phase.CONFIGURING):
            raise InputError(f"the drives are {self.phase.value}")
        if self.stop_reason:
            raise InputError(f"stopped: {self.stop_reason}")
        self._begin_enabling(now)

    def disable(self, now: float) -> None:
        """Stop the wheels, then take the power off."""
        if self.phase in (Phase.ENABLING, Phase.DRIVING):
            self.phase = Phase.IDLE
            self._begin_stop(now)

    def stop(self, reason: str, now: float) -> list[Frame]:
        """Stop all quickly and stay so until :meth:`reset`; return frames to send at once."""
        if self.stop_reason:
            return []
        self._latch(reason, now)
        if self.phase in (Phase.UNCONFIGURED, Phase.CONFIGURING):
            return []
        return self._noted(self._axis_frames(Demand.STOP, now))

    def _latch(self, reason: str, now: float) -> None:
        self.stop_reason = reason
        self._begin_stop(now)

    def reset(self, now: float) -> None:
        """Clear a stop: faults are reset, and drives that began anew are configured, by `tick`.

        This moves nothing; where the drives were to drive they are enabled again at zero speed.
        """
        was, self.stop_reason = self.stop_reason, ""
        if not was or self.phase in (Phase.UNCONFIGURED, Phase.CONFIGURING):
            return
        for axis in self.axes:
            axis.reset(now)
        self._forget()
        if self.phase in (Phase.ENABLING, Phase.DRIVING):
            self._begin_enabling(now)
        else:
            self._since = now

    def _begin_enabling(self, now: float) -> None:
        self.phase, self._since = Phase.ENABLING, now
        self._forget()

    def _begin_stop(self, now: float) -> None:
        self._forget()
        self._since, self._stood = now, None
        self._ramp.begin(self._believable())

    def _forget(self) -> None:
        """Drop the last command: nothing that was asked before moves a wheel."""
        self._command = None
        self._commanded = -math.inf
        self._ramp.rest()
        for monitor in self._monitors:
            monitor.restart()

    def command(self, command: WheelCommand, now: float) -> str:
        """Take a command, wheels in the robot's order.

        Returns:
            Why it is not used, or nothing.

        Raises:
            InputError: Its mode is not the installation's, or it has values that are not finite
                or beyond the limits. It is then no valid command: the last one goes on ageing.
        """
        asked = command.effort if command.velocity is None else command.velocity
        if command.mode not in (DriveMode.VELOCITY, self._mode):
            raise InputError(f"a {command.mode.value} command; can.mode is {self._mode.value}")
        if asked.shape != (len(self.axes),) or command.effort.shape != asked.shape:
            raise InputError(f"{asked.shape[0]} values, the robot has {len(self.axes)} wheels")
        if not (np.isfinite(asked).all() and np.isfinite(command.effort).all()):
            raise InputError(f"not finite: {asked.tolist()} {command.effort.tolist()}")
        if command.velocity is not None:
            fastest = float(np.abs(command.velocity).max())
            if fastest > self._max_speed:
                raise InputError(f"{fastest:.1f} rad/s; the limit is {self._max_speed:.1f} rad/s")
        if self.stop_reason or self.phase is not Phase.DRIVING:
            why = f"stopped: {self.stop_reason}" if self.stop_reason else self.phase.value
            return why if asked.any() else ""
        self._command, self._commanded = command, now
        return ""

    # ---- the bus ------------------------------------------------------------------------------

    def receive(self, frame: Frame, now: float) -> list[Frame]:
        """Take a frame from the bus; return frames to send at once: a stop, if it asks for one."""
        if self._notice_gap(now):
            return self._noted(self._axis_frames(Demand.STOP, now))
        if self.lookout.is_host(frame):
            if self.phase is Phase.UNCONFIGURED or self.lookout.is_echo(frame):
                return []
            reason = f"another host commands the drives: frame {frame}"
            if self.phase is Phase.CONFIGURING:
                self._give_up(reason)
            return self.stop(reason, now)
        key = (frame.id, frame.extended)
        owner = self._owners.get(key)
        if owner is not None:
            return self._taken_by(owner, frame, now)
        for k in range(len(self.axes)):
            receipt = self.axes[k].receive(frame, now)
            if receipt is not Receipt.FOREIGN:
                if receipt is Receipt.TAKEN:
                    self._owners[key] = k
                return self._after(k, receipt, now)
        self.lookout.counts["unknown"] += 1
        return []

    def _taken_by(self, k: int, frame: Frame, now: float) -> list[Frame]:
        receipt = self.axes[k].receive(frame, now)
        self.lookout.counts["unknown"] += receipt is Receipt.FOREIGN
        return self._after(k, receipt, now)

    def _after(self, k: int, receipt: Receipt, now: float) -> list[Frame]:
        if receipt is Receipt.MALFORMED:
            self.lookout.counts["malformed"] += 1
        axis = self.axes[k]
        wrong = axis.trouble
        if axis.feedback.count != self._seen[k]:
            self._seen[k] = axis.feedback.count
            p = self._parameters
            wrong = wrong or self._monitors[k].check(
                axis.feedback, self._gears[k].ratio, self._max_speed, p.min_bus_voltage
            )
        if not wrong or self.stop_reason or self.phase is Phase.CONFIGURING:
            return []
        return self.stop(f"{axis.settings.name}: {wrong}", now)

    def bus_failed(self, reason: str, now: float) -> list[Frame]:
        """Hear that the bus is off, or that a frame could not be sent: all stop, latched.

        While the drives are configured nothing moves, and that is given up instead.
        """
        if self.phase is Phase.CONFIGURING:
            self._give_up(f"bus: {reason}")
        return self.stop(f"bus: {reason}", now)

    def tick(self, now: float) -> list[Frame]:
        """Return the frames of one period, to be called at the installation's rate."""
        if self.phase is Phase.UNCONFIGURED or self._listens(now):
            return []
        self._notice_gap(now)
        self._ticked = (now, self._ticked[0])
        before = self._network.before(now)
        if self.phase is Phase.CONFIGURING:
            frames = self._axis_frames(Demand.IDLE, now)
            self._forgive(now)
            self._finish_configuring(now)
        else:
            self._look(now)
            held = self.stop_reason or self.phase is Phase.IDLE
            frames = self._axis_frames(self._stop_demand(now) if held else Demand.DRIVE, now)
        return self._noted([*before, *frames, *self._network.after(now)])

    def _noted(self, frames: list[Frame]) -> list[Frame]:
        self.lookout.note(frames)
        return frames

    # ---- a period -----------------------------------------------------------------------------

    def _notice_gap(self, now: float) -> bool:
        """Stop if this process itself was held up, before what waited meanwhile is believed.

        The drives stop by themselves then; a ramp for those that have none goes on from the last
        period, not from now.
        """
        last = self._ticked[0]
        gap = now - last
        if self.stop_reason or self.phase is not Phase.DRIVING:
            return False
        if gap <= self._parameters.heartbeat_timeout:
            return False
        self._latch(f"the bridge was held up for {gap:.2f} s", now)
        self._ramp.begin(self._believable(), last)
        return True

    def _listens(self, now: float) -> bool:
        """Whether nothing is sent yet."""
        if self._listening and now - self._since >= LISTEN:
            self._listening, self._since = False, now
            for axis in self.axes:
                axis.configure(now)
        return self._listening

    def _forgive(self, now: float) -> None:
        for k, axis in enumerate(self.axes):
            if (axis.trouble or axis.state is AxisState.FAULT) and not self._retried[k]:
                self._retried[k] = True
                axis.reset(now)

    def _finish_configuring(self, now: float) -> None:
        if self.phase is not Phase.CONFIGURING:
            return
        if self._all(AxisState.READY) and all(axis.feedback.count for axis in self.axes):
            self.phase = Phase.IDLE
            self._stood = now - SETTLED
        elif now - self._since > self._parameters.configure_timeout or any(
            axis.trouble for axis in self.axes
        ):
            self._give_up(self._who_is_not(AxisState.READY))

    def _give_up(self, reason: str) -> None:
        self._listening = False
        self.stop_reason, self.phase = f"not configured: {reason}", Phase.UNCONFIGURED

    def _who_is_not(self, state: AxisState) -> str:
        """Name the drives that are not in a state, and say what they say."""
        return ", ".join(
            f"{axis.settings.name} (node {axis.settings.node}): "
            f"{axis.trouble or (axis.state.value if axis.feedback.count else 'silent')}"
            for axis in self.axes
            if axis.state is not state or axis.trouble or not axis.feedback.count
        )

    def _look(self, now: float) -> None:
        """Look for what came to pass without a frame: troubles, silence, drives that give up."""
        if self.stop_reason:
            return
        for axis in self.axes:
            if axis.trouble:
                return self._latch(f"{axis.settings.name}: {axis.trouble}", now)
        if self.phase is Phase.DRIVING:
            self._look_for_lost(now)
        elif self.phase is Phase.ENABLING:
            oldest = min(axis.feedback.at for axis in self.axes)
            if self._all(AxisState.ENABLED) and now - oldest <= self._parameters.feedback_timeout:
                self.phase = Phase.DRIVING
            elif now - self._since > self._parameters.enable_timeout:
                self._latch(f"not enabled: {self._who_is_not(AxisState.ENABLED)}", now)

    def _look_for_lost(self, now: float) -> None:
        for axis in self.axes:
            age = now - axis.feedback.at
            if age > self._parameters.feedback_timeout:
                name = axis.settings.name
                return self._latch(f"{name}: no feedback for {1e3 * age:.0f} ms", now)
        if not self._all(AxisState.ENABLED):
            self._latch(f"lost: {self._who_is_not(AxisState.ENABLED)}", now)

    def _all(self, state: AxisState) -> bool:
        return all(axis.state is state for axis in self.axes)

    def _stop_demand(self, now: float) -> Demand:
        """STOP until all wheels have stood for a while or the stop takes too long, then IDLE."""
        # A drive that is offline may have its power on, and its wheel may turn.
        if all(axis.state in (AxisState.READY, AxisState.FAULT) for axis in self.axes):
            return Demand.IDLE
        standing = bool((np.abs(self._measured()) < REST_SPEED).all())
        if not standing:
            self._stood = None
        elif self._stood is None:
            self._stood = now
        if self._stood is not None and now - self._stood >= SETTLED:
            return Demand.IDLE
        return Demand.IDLE if now - self._since > self.longest_stop else Demand.STOP

    def _axis_frames(self, demand: Demand, now: float) -> list[Frame]:
        """Frames of all axes. One that fails is no reason not to stop the others, at once."""
        setpoints = self._setpoints(demand, now)
        frames: list[Frame] = []
        failed = ""
        for axis, setpoint in zip(self.axes, setpoints, strict=True):
            try:
                frames += axis.tick(demand, setpoint, now)
            except Exception as error:  # whatever it is: it must not keep a wheel moving
                failed = failed or f"{axis.settings.name}: {type(error).__name__}: {error}"
        if failed and self.phase is Phase.CONFIGURING:
            self._give_up(failed)
        if not failed or self.stop_reason:
            return frames
        self._latch(failed, now)
        return self._axis_frames(Demand.STOP, now)

    def _setpoints(self, demand: Demand, now: float) -> Sequence[Setpoint]:
        """Setpoints at the motors: a fresh command, else a ramp to rest."""
        p = self._parameters
        if demand is Demand.STOP:
            return self._speeds(self._ramp.down(p.quick_stop_deceleration, now))
        if demand is Demand.IDLE or self.phase is not Phase.DRIVING:
            self._ramp.rest()
            return [REST] * len(self.axes)
        command = self._command
        if command is None or now - self._commanded > p.command_timeout:
            self._command = None
            return self._speeds(self._ramp.down(p.deceleration, now))
        if command.velocity is not None:
            speeds = self._ramp.towards(command.velocity, p.acceleration, now)
            return self._speeds(speeds, command.effort)
        self._ramp.begin(self._believable())  # from where speeds go on, whatever asks for them
        return self._efforts(command)

    def _speeds(self, speeds: Array, efforts: Array | None = None) -> list[Setpoint]:
        wanted = speeds.tolist()
        torques = [0.0] * len(wanted) if efforts is None else efforts.tolist()
        mode = DriveMode.VELOCITY
        return [
            gear.setpoint(mode, speed, torque, 0.0)
            for gear, speed, torque in zip(self._gears, wanted, torques, strict=True)
        ]

    def _efforts(self, command: WheelCommand) -> list[Setpoint]:
        setpoints = []
        for gear, axis, value in zip(self._gears, self.axes, command.effort.tolist(), strict=True):
            speed = axis.feedback.velocity / gear.ratio
            setpoint = gear.setpoint(command.mode, 0.0, value, speed)
            if setpoint.mode not in axis.modes:
                setpoint = gear.as_torque(setpoint, axis.feedback)
            setpoints.append(setpoint)
        return setpoints

    def _measured(self) -> Array:
        """Wheel speeds (n,), rad/s; zero where none was heard."""
        speeds = [
            axis.feedback.velocity / gear.ratio
            for axis, gear in zip(self.axes, self._gears, strict=True)
        ]
        return np.array([speed if math.isfinite(speed) else 0.0 for speed in speeds])

    def _believable(self) -> Array:
        """Wheel speeds (n,), rad/s, without those of a wheel that runs away or reports nonsense.

        A ramp keeps the proportions of all speeds: none may hold up the others.
        """
        return np.clip(self._measured(), -self._fastest, self._fastest)

    # ---- what comes out -----------------------------------------------------------------------

    def at_rest(self, now: float) -> bool:
        """Whether no wheel that still reports turns; a stop that took its time counts as well."""
        if self.phase is Phase.UNCONFIGURED:
            return True
        long_ago = self.stop_reason and now - self._since > self.longest_stop
        return bool(
            all(
                abs(speed) < REST_SPEED or (long_ago and now - axis.feedback.at > GRACE)
                for speed, axis in zip(self._measured().tolist(), self.axes, strict=True)
            )
        )

    @property
    def longest_stop(self) -> float:
        """How long a stop takes at most, s; then the power is taken off all the same."""
        return self._fastest / self._parameters.quick_stop_deceleration + GRACE

    @property
    def is_off(self) -> bool:
        """Whether no drive has power on its motor, as far as the drives say."""
        powered = (AxisState.ENABLED, AxisState.STOPPING)
        return all(axis.state not in powered for axis in self.axes)

    def take_states(self) -> WheelStates | None:
        """Feedback of all wheels, each time all of them have reported anew; else None."""
        feedback = [axis.feedback for axis in self.axes]
        counts = [one.count for one in feedback]
        if any(count == taken for count, taken in zip(counts, self._taken, strict=True)):
            return None
        self._taken = counts
        at = self._measured_at(min(one.at for one in feedback))
        if at < self._stamped + LEAST_STEP * self._parameters.period:
            return None
        self._stamped = at
        rows = []
        for one, gear in zip(feedback, self._gears, strict=True):
            velocity = one.velocity / gear.ratio
            rows.append((one.position / gear.ratio, velocity, gear.to_wheel(one.torque, velocity)))
        table = np.array(rows).T
        table.flags.writeable = False
        return WheelStates(at, *table)

    def _measured_at(self, heard: float) -> float:
        """Time of the SYNC, s, that reports answer whose oldest was heard then."""
        last, before = self._ticked
        if not self._network.samples:
            return heard
        return last if heard >= last else min(heard, before)

    def electrical(self, dt: float) -> Array:
        """Voltage V, current A and energy J of each motor, (n, 3); the energy grows by dt, s."""
        rows = np.array(
            [g.electrical(axis.feedback) for g, axis in zip(self._gears, self.axes, strict=True)]
        )
        power = rows[:, 0] * rows[:, 1]
        self._energy = self._energy + np.where(np.isfinite(power), power, 0.0) * dt
        return np.column_stack([rows, self._energy])
