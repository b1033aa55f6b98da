"""Nodes with a life cycle that also bring themselves up: those at real hardware."""

import functools
import traceback
from collections.abc import Callable
from typing import Any

from lifecycle_msgs.srv import ChangeState
from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from omniman_ros.core.errors import ParameterError
from omniman_ros.nodes.runtime import OmnimanNode, RCLError

RETRY = 2.0
"""Time between two attempts to start by itself, until the first success [s]."""
SUCCESS, FAILURE = TransitionCallbackReturn.SUCCESS, TransitionCallbackReturn.FAILURE
ERROR = TransitionCallbackReturn.ERROR
Callback = Callable[[Any, LifecycleState], TransitionCallbackReturn]


def told(callback: Callback) -> Callback:
    """Have what a transition raises logged: rclpy drops it, and goes on with `on_error`."""

    @functools.wraps(callback)
    def transition(node: Any, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            return callback(node, state)
        except Exception:
            node.get_logger().error(f"{callback.__name__} failed:\n{traceback.format_exc()}")
            return TransitionCallbackReturn.ERROR

    return transition


class HardwareNode(OmnimanNode, LifecycleNodeMixin):
    """A lifecycle node on real time.

    Raises:
        ParameterError: `use_sim_time` is set.
    """

    def __init__(self, name: str, **options: Any) -> None:
        OmnimanNode.__init__(self, name, **options)
        LifecycleNodeMixin.__init__(self)
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._on_change_state
        if self.get_parameter("use_sim_time").value:
            raise ParameterError("use_sim_time", True, "real drives run on real time")
        self._attempt: float | None = -RETRY

    @property
    def is_configured(self) -> bool:
        """Whether `configure` has succeeded, and nothing undid it."""
        raise NotImplementedError

    def autostart(self) -> None:
        """Configure and activate by itself, again and again until the first success."""
        self.every(0.1, self._start)

    def leave_alone(self) -> None:
        """Do not bring itself up any more: it was up once, or was taken down by hand."""
        self._attempt = None

    def _start(self) -> None:
        if self._attempt is None or self.now() - self._attempt < RETRY:
            return
        if not self.is_configured:
            self.trigger_configure()
        if self.is_configured:
            self.trigger_activate()
        if self._attempt is not None:
            self._attempt = self.now()

    def _on_change_state(
        self, request: ChangeState.Request, response: ChangeState.Response
    ) -> ChangeState.Response:
        """Refuse a transition that its state does not have: rclpy lets it end the node."""
        try:
            return self._change_state(request, response)
        except RCLError:
            asked = request.transition.label or request.transition.id
            state = self._state_machine.current_state[1]
            self.warn("transition", f"transition {asked} refused: the node is {state}")
            response.success = False
            return response
