"""A ROS node of a command's own, spun by the command: no threads, no sleeps."""

import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

DISCOVERY = 15.0
"""How long to wait for another process to be found [s]; mostly it takes 0.1 s."""
ANNOUNCED = 3.5
"""Time after which all that is in a domain is known: DDS announces each part every 3 s [s]."""
SLICE = 0.05
"""Longest time in the executor before a condition is looked at again [s]."""


class Session:
    """A node with a context and an executor of its own, as a context manager.

    Signals are left to the command: rclpy's handlers would shut the context down before a last
    message could be sent.

    Args:
        name: Of the node.
        namespace: Of the node, relative or absolute.
        events: Whether to use the events executor: leaner and more punctual.
    """

    def __init__(self, name: str, namespace: str = "", events: bool = True) -> None:
        self._options = {"node_name": name, "namespace": namespace}
        self._events = events

    def __enter__(self) -> Self:
        self.context = rclpy.Context()
        rclpy.init(args=[], context=self.context, signal_handler_options=SignalHandlerOptions.NO)
        self.node = Node(**self._options, context=self.context, start_parameter_services=False)
        self._executor = self._make_executor()
        self._executor.add_node(self.node)
        return self

    def _make_executor(self) -> Any:
        if self._events:
            from rclpy.experimental import EventsExecutor

            return EventsExecutor(context=self.context)
        return SingleThreadedExecutor(context=self.context)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:  # fmt: skip
        self._executor.remove_node(self.node)
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    def spin(self, seconds: float) -> None:
        """Serve callbacks for a while; at least those that are ready."""
        # EventsExecutor.spin_once() serves one event; this serves all that come in the time.
        future = rclpy.Future(executor=None)
        self._executor.spin_until_future_complete(future, timeout_sec=max(seconds, 0.0))

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Serve callbacks until a condition holds; False if it does not in time [s]."""
        end = time.monotonic() + timeout
        while not condition():
            left = end - time.monotonic()
            if left <= 0.0:
                return False
            self._spin_once(min(left, SLICE))
        return True

    def _spin_once(self, timeout: float) -> None:
        self._executor.spin_once(timeout_sec=timeout)
