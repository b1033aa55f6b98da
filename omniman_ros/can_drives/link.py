"""Policy over the drives on an open bus, as the node `can_bridge` uses it."""

from collections.abc import Callable, Iterable
from functools import partial

from omniman_ros.can_drives.bus import Bus, CanBus
from omniman_ros.can_drives.drives import CanDrives, CanDrivesPhase
from omniman_ros.can_drives.frame import CanFrame
from omniman_ros.control.wheel_cascade import WheelCommand
from omniman_ros.core.can_parameters import CanParameters
from omniman_ros.core.errors import InputError
from omniman_ros.core.platform import Platform

NO_TIMEOUT = 1e9  #: Timeout of actions that end by the policy's own timeouts [s]
#: Time after the longest stop within which the drives must report that their power is off [s]
POWER_OFF_MARGIN = 1.0

Wake = Callable[[], None]  #: Called from another thread when frames have arrived
#: Opens a bus; raises BusError if that fails
OpenBus = Callable[[CanParameters, Wake | None], Bus]


class CanLink:
    """Runs the policy over all drives on an open bus.

    Args:
        wake: Called from another thread when frames wait for :meth:`receive`; None if unused.

    Raises:
        ParameterError: The installation does not fit the robot.
        BusError: The bus cannot be opened.
    """

    def __init__(
        self,
        robot: Platform,
        p: CanParameters,
        clock: Callable[[], float],
        wake: Wake | None = None,
        open_bus: OpenBus = CanBus,
    ) -> None:
        self.drives = CanDrives(robot, p)
        self._protocol = p.protocol
        self._period = p.period
        self._clock = clock
        self.sent = self.received = 0
        self._open_bus = partial(open_bus, p, wake)
        self.bus = self._open_bus()
        self._has_bus_failed = False

    def configure(self) -> str:
        """Configure the drives and wait for them; return why that failed, or an empty string."""
        drives = self.drives
        drives.configure(self._clock())
        self.run_until(lambda: drives.phase is not CanDrivesPhase.CONFIGURING, NO_TIMEOUT)
        failed = drives.phase is not CanDrivesPhase.IDLE
        return drives.stop_reason.removeprefix("not configured: ") if failed else ""

    def enable(self) -> str:
        """Enable the drives at zero speed and wait for them; return why that failed, or "".

        If not all drives could be enabled, their power is switched off again.
        """
        drives = self.drives
        try:
            drives.enable(self._clock())
        except InputError as error:
            return str(error)
        self.run_until(lambda: self.is_driving or bool(drives.stop_reason), NO_TIMEOUT)
        if drives.stop_reason and not self.power_off():
            return f"{drives.stop_reason}; a drive does not report that its power is off"
        return drives.stop_reason

    def power_off(self) -> bool:
        """Stop the wheels and switch the power off; return whether all drives report that."""
        self.drives.disable(self._clock())
        return self.run_until(lambda: self.drives.is_off, self.stop_timeout)

    def stop(self, reason: str) -> None:
        """Latch a quick stop of all drives until :meth:`reset`."""
        self.send(self.drives.stop(reason, self._clock()))

    def reset(self) -> None:
        """Clear a stop; nothing moves."""
        self.drives.reset(self._clock())

    def reopen_failed_bus(self) -> None:
        """Open the bus anew if it has failed, or raise BusError; the next call tries again."""
        if self._has_bus_failed:
            self.bus.close()
            self.bus = self._open_bus()
            self._has_bus_failed = False

    def set_command(self, command: WheelCommand, age: float) -> str:
        """Set the command to follow; see :meth:`CanDrives.set_command`."""
        return self.drives.set_command(command, self._clock(), age)

    @property
    def is_driving(self) -> bool:
        """Whether the drives are enabled and follow commands."""
        return self.drives.phase is CanDrivesPhase.DRIVING

    @property
    def at_rest(self) -> bool:
        """Whether no wheel rotates; see :meth:`CanDrives.at_rest`."""
        return self.drives.at_rest(self._clock())

    @property
    def stop_reason(self) -> str:
        """Why all drives are stopped, or an empty string."""
        return self.drives.stop_reason

    @property
    def stop_timeout(self) -> float:
        """Time within which the drives report that their power is off after a stop [s]."""
        return self.drives.longest_stop + POWER_OFF_MARGIN

    @property
    def description(self) -> str:
        """Number of drives and their protocol, for the log."""
        return f"{len(self.drives.axes)} drives ({self._protocol})"

    def diagnostics(self) -> list[tuple[str, object]]:
        """Return keys and values for the diagnostics."""
        now = self._clock()
        values: list[tuple[str, object]] = [("phase", self.drives.phase.value)]
        for axis in self.drives.axes:
            name, feedback = axis.settings.name, axis.feedback
            values += [
                (f"{name} (node {axis.settings.node})", axis.fault_reason or axis.state.value),
                (f"{name} feedback age ms", f"{1e3 * (now - feedback.at):.1f}"),
                (f"{name} supply V", f"{feedback.bus_voltage:.1f}"),
            ]
        values += [("frames sent", self.sent), ("frames received", self.received)]
        values += [("frames invalid", self.bus.invalid)]
        counts = self.drives.host_detector.counts
        return values + [(f"frames {kind}", count) for kind, count in counts.items()]

    def receive(self) -> None:
        """Process the received frames; if one makes the drives stop, send the stop at once."""
        for item in self.bus.take():
            if isinstance(item, str):
                self.send(self._on_bus_failure(item))
                continue
            self.received += 1
            stop_frames = self.drives.receive(item, self._clock())
            if stop_frames:
                self.send(stop_frames)

    def tick(self) -> None:
        """Run one period: receive frames, check the bus, and send the frames of the drives."""
        self.receive()
        if self.bus.failure:
            self.send(self._on_bus_failure(self.bus.failure))
        self.send(self.drives.tick(self._clock()))

    def send(self, frames: Iterable[CanFrame]) -> None:
        """Send frames; if one cannot be sent, stop all drives and try to send the stop."""
        frames = list(frames)
        self.sent += len(frames)
        failure = self.bus.send(frames)
        if failure:
            self.bus.send(self._on_bus_failure(failure))

    def _on_bus_failure(self, reason: str) -> list[CanFrame]:
        """Stop all drives because of the bus; return the frames to send at once."""
        self._has_bus_failed = True
        return self.drives.on_bus_failure(reason, self._clock())

    def run_until(self, done: Callable[[], bool], timeout: float) -> bool:
        """Run periods for up to `timeout` [s]; return whether a condition held in time."""
        now = self._clock()
        end, due = now + timeout, now
        while not done():
            now = self._clock()
            if now >= end:
                return False
            if now >= due:
                self.tick()
                due = max(due + self._period, now)
            else:
                self.bus.wait(min(due, end) - now)
                self.receive()
        return True

    def close(self) -> None:
        """Close the bus."""
        self.bus.close()
