"""Hooks through which the life cycle of a node reaches its hardware."""

from abc import ABC, abstractmethod

from omniman_ros.core.errors import OmnimanError


class HardwareError(OmnimanError):
    """The hardware does not make a transition; the message says why."""


class HardwareLostError(HardwareError):
    """The connection to the hardware has broken down and must be closed."""


class HardwareHooks(ABC):
    """What a node at real hardware implements, and `HardwareNode` calls.

    The hooks may wait for the hardware.
    """

    @property
    @abstractmethod
    def is_configured(self) -> bool:
        """Whether the hardware is open: `configure` has succeeded and nothing has undone it."""

    @property
    @abstractmethod
    def is_hardware_off(self) -> bool:
        """Whether the open hardware has come to its end: no power, or no program that runs."""

    @property
    @abstractmethod
    def may_have_moved(self) -> bool:
        """Whether the open hardware may have moved: its fault is a stop then."""

    @property
    def start_fault(self) -> str:
        """Why open hardware must be configured anew before it can be enabled, or empty."""
        return ""

    @abstractmethod
    def open_hardware(self) -> str:
        """Open the hardware, wait until it is configured, and return a line for the log."""

    @abstractmethod
    def enable_hardware(self) -> str:
        """Enable the open hardware, which then holds where it is, and return a line for the log.

        Raises:
            HardwareError: It could not be enabled; the hook has disabled it again.
            HardwareLostError: The connection has broken down; the hardware is then closed.
        """

    @abstractmethod
    def disable_hardware(self) -> None:
        """Bring the hardware to rest and disable it; do nothing where it is not open."""

    @abstractmethod
    def close_hardware(self) -> None:
        """Close the hardware; do nothing where it is not open."""

    @abstractmethod
    def reset_hardware(self) -> None:
        """Reset latch and hardware, which must not move by that, or raise ResetRefusedError."""

    @abstractmethod
    def follow_latch(self) -> None:
        """Stop or hold the hardware as the latch says; it may be called again and again."""

    @abstractmethod
    def receive(self) -> None:
        """Take what the hardware has sent and publish it; do nothing where it is not open."""
