"""Life of a node: one clock, warnings with a rate limit, diagnostics, and an orderly end."""

import gc
import math
import signal
import sys
import time
from collections.abc import Callable, Iterable
from types import FrameType
from typing import Any

import rclpy
from builtin_interfaces.msg import Time as TimeMsg
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, SingleThreadedExecutor
from rclpy.experimental import EventsExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.time import Time

from omniman_ros.core.errors import InputError, OmnimanError
from omniman_ros.core.throttle import Throttle

RCLError = rclpy_implementation.RCLError
UnknownROSArgsError = rclpy_implementation.UnknownROSArgsError

FUTURE = 0.05
"""Stamps further ahead than this are refused [s]."""
WARNING_PERIOD = 1.0
"""Shortest time between two warnings on one subject [s]."""
TOGETHER, BOTH_CLOCKS = 1e-4, 5
"""Two clocks are read together when it takes no longer [s]; attempts: others may run between."""
TAKE_DOWN = 5
"""A node at rest that is not taken down after so long is ended by the kernel [s]."""
DELIVERY = 0.5
"""How long a node waits for its last messages to be acknowledged [s]; a dead reader never does."""


class OmnimanNode(Node):
    """A node with one clock for its timers and time-outs: steady, or ROS time in simulation.

    Attributes:
        clock: That clock.
    """

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        simulated = self.get_parameter("use_sim_time").value
        self.clock = self.get_clock() if simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._throttle = Throttle(WARNING_PERIOD)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._status = (b"", "")
        self.every(1.0, self.report)
        self.every(0.1, self.report_changes)

    def now(self) -> float:
        """Time of the node's clock [s]."""
        return self.clock.now().nanoseconds * 1e-9

    def every(self, period: float, callback: Callable[[], None]) -> None:
        """Call back each `period` seconds of the node's clock."""
        self.create_timer(period, callback, clock=self.clock)

    def age(self, stamp: TimeMsg, ahead: float = FUTURE) -> float:
        """How long ago a stamp was, in ROS time [s]; 0 for a zero stamp, which means now.

        Args:
            stamp: It.
            ahead: How far ahead it may be [s].

        Raises:
            InputError: It is further ahead.
        """
        if stamp.sec == 0 and stamp.nanosec == 0:
            return 0.0
        # Time.from_msg raises on negative seconds; so old a stamp is merely stale.
        sent = stamp.sec * 1_000_000_000 + stamp.nanosec
        age = (self.get_clock().now().nanoseconds - sent) * 1e-9
        if age < -ahead:
            raise InputError(f"the stamp is {-age:.3f} s ahead")
        return age

    def stamp(self, at: float | None = None) -> TimeMsg:
        """ROS time of an instant `at` of the node's clock [s], now if it is None."""
        if at is None or not math.isfinite(at):
            return self.get_clock().now().to_msg()
        nanoseconds = round(self._ahead() + at * 1e9)
        return Time(nanoseconds=max(nanoseconds, 0)).to_msg()

    def instant(self, stamp: TimeMsg, ahead: float = FUTURE) -> float:
        """Instant of the node's clock that a stamp means [s]; now for a zero stamp.

        Args:
            stamp: It.
            ahead: How far ahead it may be [s].

        Raises:
            InputError: It is further ahead.
        """
        if stamp.sec == 0 and stamp.nanosec == 0:
            return self.now()
        self.age(stamp, ahead)
        return (stamp.sec * 1_000_000_000 + stamp.nanosec - self._ahead()) * 1e-9

    def _ahead(self) -> float:
        """How far ROS time is ahead of the node's clock [ns]."""
        took, offset = math.inf, 0.0
        for _ in range(BOTH_CLOCKS):
            before, ros, after = self.now(), self.get_clock().now(), self.now()
            if after - before < took:
                took, offset = after - before, ros.nanoseconds - 0.5e9 * (before + after)
            if took < TOGETHER:
                break
        return offset

    def warn(self, subject: str, text: str) -> None:
        """Warn, at most once a second a subject, and count it for the diagnostics."""
        held = self._throttle.allow(subject, self.now())
        if held is not None:
            more = f" (and {held} more like it)" if held else ""
            self.get_logger().warning(text + more)

    def guarded(self, subject: str, handler: Callable[[Any], str | None]) -> Callable[[Any], None]:
        """Wrap a handler of messages: bad content or a refusal it returns is warned of."""

        def callback(message: Any) -> None:
            try:
                refusal = handler(message)
            except InputError as error:
                self.warn(subject, f"{subject} ignored: {error}")
            else:
                if refusal:
                    self.warn(f"{subject} refused", f"{subject} not used: {refusal}")

        return callback

    def status(self) -> tuple[bytes, str, Iterable[tuple[str, object]]]:
        """Level, message and values for the diagnostics; nodes say their own."""
        return DiagnosticStatus.OK, "running", ()

    def report(self) -> None:
        """Publish the diagnostics."""
        level, message, values = self.status()
        self._status = (level, message)
        counts = [(f"warned: {name}", n) for name, n in self._throttle.counts.items()]
        status = DiagnosticStatus(
            level=level, name=self.get_fully_qualified_name(), message=message,
            values=[KeyValue(key=key, value=str(value)) for key, value in [*values, *counts]],
        )  # fmt: skip
        array = DiagnosticArray(status=[status])
        array.header.stamp = self.stamp()
        self._diagnostics.publish(array)

    def report_changes(self) -> None:
        """Publish the diagnostics now if level or message changed since the last."""
        level, message, _ = self.status()
        if (level, message) != self._status:
            self.report()

    def begin_shutdown(self, reason: str) -> None:
        """Begin to come to rest; a node that moves something overrides this."""

    @property
    def finished(self) -> bool:
        """Whether the node has come to rest after :meth:`begin_shutdown`."""
        return True

    @property
    def patience(self) -> float:
        """How long coming to rest may take [s]."""
        return 0.0

    @property
    def last_words(self) -> tuple[Publisher, ...]:
        """Publishers whose last message the node must not take with it when it ends."""
        return ()


def run(make: Callable[[], OmnimanNode], args: list[str] | None = None) -> int:
    """Run a node until SIGINT or SIGTERM; it comes to rest before it ends. Returns an exit code.

    rclpy's own handlers would shut the context down first, and a last stop could not be sent.
    A second signal ends at once.
    """
    signals: list[int] = []

    def on_signal(number: int, frame: FrameType | None) -> None:
        signals.append(number)

    previous = {n: signal.signal(n, on_signal) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = make()
    except (OmnimanError, ParameterException, RCLError, UnknownROSArgsError) as error:
        print(f"cannot start: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        return 1
    executor = _executor(node)
    executor.add_node(node)
    try:
        while not signals:
            _spin(executor)
        node.begin_shutdown(signal.Signals(signals[0]).name)
        deadline = time.monotonic() + node.patience
        while not node.finished and time.monotonic() < deadline and len(signals) < 2:
            _spin(executor)
        _deliver(node.last_words)
        return 0 if node.finished else 1
    finally:
        # Taking down an executor of events while something is heard can lock up for ever in the
        # middleware, with Python's lock held: then the kernel ends the process.
        previous[signal.SIGALRM] = signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(TAKE_DOWN)
        executor.remove_node(node)
        node.destroy_node()
        rclpy.try_shutdown()
        del executor, node
        gc.collect()
        signal.alarm(0)
        for number, handler in previous.items():
            signal.signal(number, handler)


def _deliver(publishers: Iterable[Publisher]) -> None:
    """Let lost messages be sent again: what is not acknowledged yet dies with its publisher."""
    deadline = time.monotonic() + DELIVERY
    for publisher in publishers:
        while not publisher.wait_for_all_acked(Duration()) and time.monotonic() < deadline:
            time.sleep(0.005)  # without Python's lock, which a listener may wait for


def _executor(node: OmnimanNode) -> Executor:
    """Return the leanest executor; on ROS time the plain one, whose timers follow jumps."""
    if node.clock.clock_type is ClockType.ROS_TIME:
        return SingleThreadedExecutor()
    return EventsExecutor()


def _spin(executor: Executor) -> None:
    """Serve callbacks for a moment; EventsExecutor.spin() without a time-out hangs in Jazzy."""
    executor.spin_until_future_complete(rclpy.Future(), timeout_sec=0.05)
