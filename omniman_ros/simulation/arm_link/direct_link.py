"""A link without sockets, for a controller and a world in one process."""

from typing import Protocol

from omniman_ros.simulation.arm_link.frames import (
    ArmSetpoint,
    ArmState,
    SetpointReader,
    StateReader,
    encode_setpoint,
    encode_state,
)


class WorldEnd(Protocol):
    """The world's end of the link; see `ArmServo`."""

    def follow(self, setpoint: ArmSetpoint) -> None:
        """Take a setpoint."""

    def state(self) -> ArmState:
        """Return what the joints measure now."""

    def take_states(self) -> list[ArmState]:
        """Return the states since the last call."""


class DirectLink:
    """The controller's end of the link, an `ArmLink`; bytes come and go at once."""

    def __init__(self, world: WorldEnd) -> None:
        self._world = world
        self._greeting: list[ArmState] = []
        self._setpoints, self._states = SetpointReader(), StateReader()
        self.is_open, self.failure = False, "not connected yet"

    def open(self) -> bool:
        """Connect; return True."""
        self._greeting = [self._world.state()]
        self._setpoints, self._states = SetpointReader(), StateReader()
        self.is_open, self.failure = True, ""
        return True

    def receive(self) -> list[ArmState]:
        """Return the states since the last call; none if there is no connection."""
        states, self._greeting = [*self._greeting, *self._world.take_states()], []
        if not self.is_open:
            return []
        return self._states.receive(b"".join(map(encode_state, states)))

    def send(self, setpoint: ArmSetpoint) -> None:
        """Send a setpoint."""
        for read in self._setpoints.receive(encode_setpoint(setpoint)):
            self._world.follow(read)

    def wait(self, timeout: float) -> bool:
        """Return False at once, as nothing can arrive meanwhile."""
        return False

    def close(self, reason: str) -> None:
        """Close the connection, for a reason."""
        self.is_open, self.failure = False, reason
