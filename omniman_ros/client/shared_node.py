"""A node that one thread spins while others wait for what its callbacks bring."""

import math
import threading
import time
from collections.abc import Callable
from typing import Any

from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_srvs.srv import Trigger

from omniman_ros.client.state import RobotError

#: Shortest time that is waited for [s]: no clock moves by less, which rounding leaves. A float of
#: seconds since 1970 resolves 0.2 us.
RESOLUTION = 1e-6
POLL_PERIOD = 0.05  #: Longest time between two looks at a condition that is waited for [s]


class SharedNode:
    """A node, the lock of all that its callbacks change, and its time.

    On a node with `use_sim_time` durations are those of simulated time.

    Args:
        prefix: Absolute namespace of the robot, without a slash at its end.
        serve: Spins the node for a time [s], in the thread that waits for something; None if
            another thread spins it.

    Attributes:
        lock: Held by callbacks, and by who reads or changes what they share.
    """

    def __init__(
        self, node: Node, prefix: str, serve: Callable[[float], object] | None = None
    ) -> None:
        self.node, self.prefix, self._serve = node, prefix, serve
        self.lock = threading.Condition(threading.RLock())
        self.is_simulated = bool(node.get_parameter("use_sim_time").value)
        self._failure: BaseException | None = None
        self._undo: list[Callable[[], object]] = []

    def name(self, topic: str) -> str:
        """Return the absolute name of a topic or a service of the robot."""
        return f"{self.prefix}/{topic}"

    def subscribe(self, kind: type, topic: str, handler: Callable[[Any], None], qos: Any) -> None:
        """Subscribe to a topic of the robot; who waits looks again after each message."""

        def receive(message: Any) -> None:
            with self.lock:
                try:
                    handler(message)
                except (ValueError, OverflowError) as error:  # a message of nonsense is as none
                    text = f"{topic}: {error}"
                    self.node.get_logger().warning(text, throttle_duration_sec=5.0)
                self.lock.notify_all()

        made = self.node.create_subscription(kind, self.name(topic), receive, qos)
        self._undo.append(lambda: self.node.destroy_subscription(made))

    def publisher(self, kind: type, topic: str, depth: int) -> Publisher:
        """Return a publisher of a topic of the robot."""
        made = self.node.create_publisher(kind, self.name(topic), depth)
        self._undo.append(lambda: self.node.destroy_publisher(made))
        return made

    def client(self, service: str) -> Client:
        """Return a client of a service of the robot, which is a Trigger."""
        made = self.node.create_client(Trigger, self.name(service))
        self._undo.append(lambda: self.node.destroy_client(made))
        return made

    def every(self, period: float, call: Callable[[], None]) -> None:
        """Call a function each period [s]."""
        clock = self.node.get_clock()
        if not self.is_simulated:
            clock = Clock(clock_type=ClockType.STEADY_TIME)
        made = self.node.create_timer(period, call, clock=clock)
        self._undo.append(lambda: self.node.destroy_timer(made))

    def detach(self) -> None:
        """Take everything off the node that was put there."""
        while self._undo:
            self._undo.pop()()

    def now(self) -> float:
        """Return the time from any origin [s]: steady, or that of the node if it is simulated."""
        if self.is_simulated:
            return float(self.node.get_clock().now().nanoseconds * 1e-9)
        return time.monotonic()

    def wait(self, condition: Callable[[], bool], timeout: float | None) -> bool:
        """Wait until a condition holds, up to a time [s] or for ever; return whether it does.

        Raises:
            RobotError: Nobody spins the node any more.
        """
        now = time.monotonic if self._serve is None else self.now
        end = math.inf if timeout is None else now() + timeout
        while True:
            with self.lock:
                if condition():
                    return True
                if self._failure is not None:
                    raise RobotError(f"no connection: {self._failure}") from self._failure
                remaining = min(end - now(), POLL_PERIOD)
                if remaining < RESOLUTION:
                    return False
                if self._serve is None:
                    self.lock.wait(remaining)
            if self._serve is not None:
                self._serve(remaining)

    def fail(self, error: BaseException) -> None:
        """Make all that wait fail: nobody spins the node any more."""
        with self.lock:
            self._failure = error
            self.lock.notify_all()
