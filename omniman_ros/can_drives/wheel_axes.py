"""The drives of all wheels, received, commanded and described together."""

from collections.abc import Sequence

from omniman_ros.can_drives.axis import AxisState, Demand, DriveAxis, DriveSetpoint, Receipt
from omniman_ros.can_drives.frame import CanFrame


class WheelAxes:
    """Passes frames and demands to the axes of all wheels, in the robot's order."""

    def __init__(self, axes: Sequence[DriveAxis]) -> None:
        self.axes = tuple(axes)
        self._owners: dict[tuple[int, bool], int] = {}
        self._was_reset = [False] * len(self.axes)

    def configure(self, now: float) -> None:
        """Begin to configure all drives."""
        self._was_reset = [False] * len(self.axes)
        for axis in self.axes:
            axis.configure(now)

    def reset(self, now: float) -> None:
        """Reset all drives."""
        for axis in self.axes:
            axis.reset(now)

    def reset_faults_once(self, now: float) -> None:
        """Reset each drive that has a fault, unless that was done since they were configured."""
        for k, axis in enumerate(self.axes):
            has_fault = axis.fault_reason or axis.state is AxisState.FAULT
            if has_fault and not self._was_reset[k]:
                self._was_reset[k] = True
                axis.reset(now)

    def receive(self, frame: CanFrame, now: float) -> tuple[int, Receipt] | None:
        """Pass a frame to the axis whose drive has sent it; return its number and receipt."""
        key = (frame.id, frame.extended)
        owner = self._owners.get(key)
        candidates = range(len(self.axes)) if owner is None else (owner,)
        for k in candidates:
            receipt = self.axes[k].receive(frame, now)
            if receipt is Receipt.ACCEPTED:
                self._owners[key] = k
            if receipt is not Receipt.FOREIGN:
                return k, receipt
        return None

    def tick(
        self, demand: Demand, setpoints: Sequence[DriveSetpoint], now: float
    ) -> tuple[list[CanFrame], str]:
        """Return the frames of all axes, and why one of them made none, or an empty string."""
        frames: list[CanFrame] = []
        failure = ""
        for axis, setpoint in zip(self.axes, setpoints, strict=True):
            try:
                frames += axis.tick(demand, setpoint, now)
            except Exception as error:  # whatever it is: it must not keep a wheel moving
                failure = failure or f"{axis.settings.name}: {type(error).__name__}: {error}"
        return frames, failure

    def are_all(self, state: AxisState) -> bool:
        """Return whether all drives are in a state."""
        return all(axis.state is state for axis in self.axes)

    def describe_others_than(self, state: AxisState) -> str:
        """Name the drives that are not in a state, with what they report instead."""
        return ", ".join(
            f"{axis.settings.name} (node {axis.settings.node}): "
            f"{axis.fault_reason or (axis.state.value if axis.feedback.count else 'silent')}"
            for axis in self.axes
            if axis.state is not state or axis.fault_reason or not axis.feedback.count
        )

    @property
    def fault(self) -> str:
        """Name and fault reason of the first drive that has one, or an empty string."""
        for axis in self.axes:
            if axis.fault_reason:
                return f"{axis.settings.name}: {axis.fault_reason}"
        return ""

    def silence(self, now: float, timeout: float) -> str:
        """Name the first drive whose feedback is older than a timeout [s]; or an empty string."""
        for axis in self.axes:
            age = now - axis.feedback.at
            if age > timeout:
                return f"{axis.settings.name}: no feedback for {1e3 * age:.0f} ms"
        return ""

    @property
    def restarts(self) -> tuple[int, ...]:
        """Number of restarts of each drive so far."""
        return tuple(axis.feedback.restarts for axis in self.axes)

    @property
    def have_reported(self) -> bool:
        """Whether position and velocity were received from all drives."""
        return all(axis.feedback.count for axis in self.axes)

    @property
    def are_off(self) -> bool:
        """Whether no drive has power on its motor, as far as the drives report."""
        powered = (AxisState.ENABLED, AxisState.STOPPING)
        return all(axis.state not in powered for axis in self.axes)
