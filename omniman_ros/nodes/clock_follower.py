"""Service of a node on simulated time: its timers, and its permits for time to go on."""

import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header

from omniman_ros.conversions.headers import time_seconds
from omniman_ros.nodes.rclpy_compat import subscribe_to_clock, take_timers

#: Topic on which nodes permit simulated time to go on; see :func:`permit_message`
PERMITS_TOPIC = "/clock/permits"

#: Number of times on /clock that a node keeps until it reads them, more than come at once
CLOCK_DEPTH = 200


def permit_message(name: str, until: float | None) -> Header:
    """Return a permit for simulated time to go on until a time [s], or for ever if None."""
    nanoseconds = 0 if until is None else round(until * 1e9)
    return Header(frame_id=name, stamp=Time(nanoseconds=nanoseconds).to_msg())


class ClockFollower:
    """Calls a node's timers when a message on /clock arrives, and then lets time go on.

    Args:
        lookahead: How far time may go on beyond what the node has done [s]; infinite if it need
            not wait for the node.
        progress: Returns the simulated time up to which the node has done its work [s].
    """

    def __init__(
        self,
        node: Node,
        lookahead: float,
        time_passed: Callable[[], None],
        progress: Callable[[], float],
    ) -> None:
        self._name, self._lookahead = node.get_fully_qualified_name(), lookahead
        self._time_passed, self._progress = time_passed, progress
        self._timers = take_timers(node)
        # A node that nobody waits for skips the times that it has missed.
        depth = 1 if math.isinf(lookahead) else CLOCK_DEPTH
        self._subscription = subscribe_to_clock(node, self._receive, depth)
        self.publisher: Publisher = node.create_publisher(Header, PERMITS_TOPIC, 10)
        self._time = self._reported = -math.inf
        self._arrival = time.monotonic()
        self._is_free = math.isinf(lookahead)
        self._is_waiting = False

    @property
    def silence(self) -> float:
        """Real time since the last message on /clock [s]."""
        return time.monotonic() - self._arrival

    def poll(self) -> None:
        """Take the time that has arrived; to be called by a callback that waits for something.

        Timers are not called, as a callback of the node is running.
        """
        self._is_waiting = True
        while (taken := self._subscription.handle.take_message(Clock, False)) is not None:
            self._subscription.callback(taken[0])
        self._is_waiting = False

    def report(self) -> None:
        """Permit time to go on if the node has come further since the last permit."""
        progress = self._progress()
        if progress - self._reported > 0.4 * self._lookahead:
            self._permit(progress)

    def leave(self) -> None:
        """Let time go on without this node."""
        self._is_free = True
        self.publisher.publish(permit_message(self._name, None))

    @contextmanager
    def released(self) -> Iterator[None]:
        """Let time go on without this node within a `with` block."""
        self.leave()
        try:
            yield
        finally:
            self._is_free = False

    def _receive(self, message: Clock) -> None:
        self._arrival = time.monotonic()
        self._time_passed()
        for timer in self._timers if not self._is_waiting else ():
            if timer.is_ready():
                timer.handle.call_timer()
                timer.callback()
        last, self._time = self._time, time_seconds(message.clock)
        if self._time <= last:  # it waits, or has begun anew: a permit may be lost, or be void
            self._permit(self._progress())
        else:
            self.report()

    def _permit(self, progress: float) -> None:
        self._reported = progress
        if not self._is_free:
            until = progress + self._lookahead
            self.publisher.publish(permit_message(self._name, until))
