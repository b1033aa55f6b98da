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
    """A state with its reason."""

    state: StopState
    reason: str  #: Why the node is in that state; empty while it is running
    #: Whether the node is stopped because it ends in order, and by nothing else
    is_ending: bool = False


class StopLatch:
    """Latches stops until a reset, and holds while a peer is stopped.

    A node is STOPPED by causes of its own (a service call, the emergency stop, a fault): only
    :meth:`reset` clears that. It is HOLDING while a peer is STOPPED, without a latch of its own,
    so that two nodes never wait for each other's reset. In both states nothing may move.
    A stopped peer that vanishes is a stop of its own, unless it has ended in order.
    """

    def __init__(self) -> None:
        self._cause = ""
        self._is_ending = False
        self._emergency = False
        self._peers: dict[str, str] = {}
        self._ending_peers: set[str] = set()

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
            return StopStatus(StopState.STOPPED, self._cause, self._is_ending)
        if self._peers:
            reasons = "; ".join(
                f"{name}: {reason}" for name, reason in sorted(self._peers.items())
            )
            return StopStatus(StopState.HOLDING, f"stopped peer {reasons}")
        return StopStatus(StopState.RUNNING, "")

    def stop(self, cause: str) -> bool:
        """Latch a stop, whose first cause is kept; return whether there was none before."""
        new = not self._cause
        self._cause = self._cause or cause
        return new

    def shut_down(self, reason: str) -> None:
        """Latch a stop because the node ends in order; an earlier cause is kept."""
        self._is_ending |= self.stop(f"shutting down: {reason}")

    def set_emergency(self, active: bool) -> bool:
        """Set the emergency stop, whose end releases nothing; return whether it latched a stop."""
        self._emergency = active
        return self.stop("emergency_stop") if active else False

    def set_peer(
        self, name: str, stopped: bool, reason: str = "", is_ending: bool = False
    ) -> None:
        """Set the state of a peer; this node holds for as long as the peer is stopped.

        Args:
            is_ending: Whether it is stopped because it ends in order, and by nothing else.
        """
        self._ending_peers.discard(name)
        if stopped:
            self._peers[name] = reason
            self._ending_peers |= {name} if is_ending else set()
        else:
            self._peers.pop(name, None)

    def lose_peer(self, name: str) -> None:
        """End the hold by a stopped peer that has vanished.

        Unless the peer has ended in order, that latches a stop: nobody can reset the peer.
        """
        if name not in self._ending_peers:
            self.stop(f"peer {name} vanished while it was stopped")
        self.set_peer(name, False)

    @property
    def peers(self) -> tuple[str, ...]:
        """Full names of the stopped peers."""
        return tuple(self._peers)

    def reset(self, *, at_rest: bool, fault: str = "") -> None:
        """Clear the latch; this moves nothing by itself.

        Args:
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
        self._cause, self._is_ending = "", False
