"""The stop of a node that moves something: latched stops, the emergency stop, stopped peers."""

from dataclasses import dataclass
from enum import Enum

from omniman_ros.core.errors import OmnimanError


class StopState(Enum):
    """State of a node that moves something, as published on `stop_state`."""

    RUNNING = "running"
    HOLDING = "holding"
    STOPPED = "stopped"


class ResetRefusedError(OmnimanError):
    """A reset was refused; the message says why."""


@dataclass(frozen=True)
class StopStatus:
    """A state with its reason.

    Attributes:
        state: The state.
        reason: Why the node is in that state; empty while it is running.
    """

    state: StopState
    reason: str


class StopLatch:
    """Latches stops until a reset, and holds while a peer is stopped.

    A node is STOPPED by causes of its own (a service call, the emergency stop, a fault): only
    :meth:`reset` clears that. It is HOLDING while a peer is STOPPED, without a latch of its own,
    so that two nodes never wait for each other's reset. In both states nothing may move.
    """

    def __init__(self) -> None:
        self._cause = ""
        self._emergency = False
        self._peers: dict[str, str] = {}

    @property
    def released(self) -> bool:
        """Whether motion is allowed."""
        return not (self._cause or self._peers)

    @property
    def emergency(self) -> bool:
        """Whether the emergency stop is active."""
        return self._emergency

    @property
    def status(self) -> StopStatus:
        """State and reason."""
        if self._cause:
            return StopStatus(StopState.STOPPED, self._cause)
        if self._peers:
            reasons = "; ".join(
                f"{name}: {reason}" for name, reason in sorted(self._peers.items())
            )
            return StopStatus(StopState.HOLDING, f"stopped peer {reasons}")
        return StopStatus(StopState.RUNNING, "")

    def stop(self, cause: str) -> bool:
        """Latch a stop; the first cause is kept.

        Returns:
            Whether the node was not stopped before.
        """
        new = not self._cause
        self._cause = self._cause or cause
        return new

    def set_emergency(self, active: bool) -> bool:
        """Set the state of the emergency stop; an inactive one releases nothing.

        Returns:
            Whether the call latched a stop.
        """
        self._emergency = active
        return self.stop("emergency_stop") if active else False

    def set_peer(self, name: str, stopped: bool, reason: str = "") -> None:
        """Set the state of a peer; this node holds for as long as the peer is stopped.

        Args:
            name: Full name of the peer.
            stopped: Whether the peer is stopped.
            reason: Why the peer is stopped.
        """
        if stopped:
            self._peers[name] = reason
        else:
            self._peers.pop(name, None)

    @property
    def peers(self) -> tuple[str, ...]:
        """Full names of the stopped peers."""
        return tuple(self._peers)

    def reset(self, *, at_rest: bool, fault: str = "") -> None:
        """Clear the latch; this moves nothing by itself.

        Args:
            at_rest: Whether everything has come to rest.
            fault: Fault that is still present, or empty.

        Raises:
            ResetRefusedError: The emergency stop is active, a fault is present, or something
                moves.
        """
        if self._emergency:
            raise ResetRefusedError("emergency_stop is true: publish false first")
        if fault:
            raise ResetRefusedError(f"the fault is still present: {fault}")
        if not at_rest:
            raise ResetRefusedError("still moving: wait for the stop to end")
        self._cause = ""
