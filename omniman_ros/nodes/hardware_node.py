"""Hardware behind a life cycle: what a node implements, and what brings it up and down."""

import math
from abc import ABC, abstractmethod
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from omniman_ros.core.errors import OmnimanError, ParameterError
from omniman_ros.core.stop import StopLatch, StopState
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.rclpy_compat import RCLError, log_exceptions
from omniman_ros.nodes.stop_interface import StopInterface

RETRY_PERIOD = 2.0  #: Time between two automatic attempts to start [s]
MAX_RETRIES = 5  #: Number of faults after which hardware that has not moved yet is started again


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


class AutomaticStart:
    """Decides when hardware is started, until it may have moved or somebody has taken it down.

    Hardware that is missing is waited for without a limit. A fault of hardware that is there, be
    it enabled or not, leads to another start, but at most :data:`MAX_RETRIES` times: a fault that
    stays is a stop.
    """

    def __init__(self) -> None:
        self.faults = 0
        self._next_attempt = -math.inf
        self._has_ended = False

    @property
    def is_retrying(self) -> bool:
        """Whether a fault leads to another start; otherwise it is a stop."""
        return not self._has_ended and self.faults < MAX_RETRIES

    def is_due(self, now: float) -> bool:
        """Return whether an attempt is to be made at the time `now` [s]."""
        return not self._has_ended and now >= self._next_attempt

    def postpone(self, now: float) -> None:
        """Make the next attempt :data:`RETRY_PERIOD` after the time `now` [s]."""
        self._next_attempt = now + RETRY_PERIOD

    def retry(self, now: float) -> str:
        """Count a fault at `now` [s], postpone the next attempt, and return "n of m"."""
        self.faults += 1
        self.postpone(now)
        return f"{self.faults} of {MAX_RETRIES}"

    def end(self) -> None:
        """End the automatic start for good."""
        self._has_ended = True


class HardwareNode(OmnimanNode, LifecycleNodeMixin, HardwareHooks):
    """Lifecycle node that moves real hardware, with its stop and its orderly end.

    A subclass implements the hooks of :class:`HardwareHooks`. configure opens the hardware,
    activate enables it, deactivate brings it to rest and disables it, cleanup closes it. A stopped
    node is not activated, and hardware that may have moved is never started again automatically.
    The constructor of a subclass ends with :meth:`begin`.

    Raises:
        ParameterError: `use_sim_time` is set and not allowed.
    """

    def __init__(self, name: str, *, allow_sim_time: bool = False, **options: Any) -> None:
        OmnimanNode.__init__(self, name, **options)
        LifecycleNodeMixin.__init__(self)
        # rclpy lets a transition that the current state does not have end the node.
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        if self.get_parameter("use_sim_time").value and not allow_sim_time:
            raise ParameterError("use_sim_time", True, "real drives run on real time")
        self.latch = StopLatch()
        self.is_active = False
        self._automatic_start = AutomaticStart()

    def begin(self, autostart: bool) -> None:
        """Open the stop interface; a subclass calls this at the end of its constructor."""
        self.stop_interface = StopInterface(self, self.latch, self._reset, self.follow_latch)
        if autostart:
            self.every(0.1, self._start)
        else:
            self._automatic_start.end()

    @log_exceptions
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Open the hardware."""
        try:
            self.get_logger().info(f"configured: {self.open_hardware()}")
        except HardwareError as error:
            self.warn("configure", f"not configured: {error}")
            self.close_hardware()
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    @log_exceptions
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Enable the hardware, unless the node is stopped."""
        try:
            if self.latch.status.state is StopState.STOPPED:
                raise HardwareError(f"stopped: {self.latch.status.reason}")
            text = self.enable_hardware()
        except HardwareError as error:
            self.warn("activate", f"not activated: {error}")
            lost = isinstance(error, HardwareLostError)
            return TransitionCallbackReturn.ERROR if lost else TransitionCallbackReturn.FAILURE
        self.is_active = True
        self.get_logger().info(f"active: {text}")
        return TransitionCallbackReturn.SUCCESS

    @log_exceptions
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the hardware to rest and disable it."""
        self.is_active = False
        self.disable_hardware()
        return TransitionCallbackReturn.SUCCESS

    @log_exceptions
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Close the hardware."""
        self.close_hardware()
        return TransitionCallbackReturn.SUCCESS

    @log_exceptions
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the hardware to rest, disable it, and close it."""
        self._automatic_start.end()
        return self.on_error(state)

    @log_exceptions
    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Take the hardware down after an error in a transition: the node is unconfigured."""
        self.is_active = False
        self.disable_hardware()
        self.close_hardware()
        return TransitionCallbackReturn.SUCCESS

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Make a requested transition, or refuse it if the current state does not have it."""
        before = self.is_configured, self.is_active
        try:
            self._change_state(request, response)
        except RCLError:
            requested = request.transition.label or request.transition.id
            state = self._state_machine.current_state[1]
            self.warn("transition", f"transition {requested} refused: the node is {state}")
            response.success = False
        if response.success and (self.is_configured, self.is_active) < before:
            self._automatic_start.end()
        return response

    @property
    def is_starting(self) -> bool:
        """Whether a fault leads to another start: nothing has moved, and nobody stopped it."""
        is_stopped = self.latch.status.state is StopState.STOPPED
        return self._automatic_start.is_retrying and not (self.may_have_moved or is_stopped)

    def _start(self) -> None:
        """Bring the hardware up when that is due; take it down after a fault, to do so again."""
        if self.may_have_moved:
            self._automatic_start.end()
        elif not self.is_active and self._automatic_start.is_due(self.now()):
            if not self.is_configured:
                self.trigger_configure()
            if self.is_configured:
                self.trigger_activate()
            self._automatic_start.postpone(self.now())
        if self.start_fault and self.is_starting:
            count = self._automatic_start.retry(self.now())
            self.warn("start", f"{self.start_fault}: starting again, retry {count}")
            if self.is_active:
                self.trigger_deactivate()
            if self.is_configured:
                self.trigger_cleanup()

    def _reset(self) -> None:
        """Reset the hardware, and give the automatic start all its retries again."""
        self.reset_hardware()
        self._automatic_start.faults = 0

    def wake(self) -> None:
        """Have the executor call :meth:`receive`; to be called from another thread."""
        if self.executor is not None:
            self.executor.create_task(self.receive)

    def stop_diagnostics(self) -> tuple[bytes, str] | None:
        """Level and message for the diagnostics while the latch forbids motion, else None."""
        status = self.latch.status
        if status.state is StopState.STOPPED:
            return DiagnosticStatus.ERROR, status.reason
        return None if self.latch.released else (DiagnosticStatus.WARN, status.reason)

    def begin_shutdown(self, reason: str) -> None:
        """Latch a stop, which brings the hardware to its end."""
        self._automatic_start.end()
        self.latch.shut_down(reason)
        self.stop_interface.publish()
        self.follow_latch()

    @property
    def finished(self) -> bool:
        """Whether the hardware is off or closed."""
        self.receive()
        return not self.is_configured or self.is_hardware_off

    def destroy_node(self) -> None:
        """Close the hardware, then destroy the node."""
        self.close_hardware()
        super().destroy_node()
