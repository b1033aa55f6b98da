"""A command's own ROS node, which the command spins without threads."""

import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

#: Time within which another process has to be discovered [s]; it usually takes 0.1 s
DISCOVERY_TIMEOUT = 15.0
#: Time after which all participants of a domain are known [s]: DDS announces them every 3 s
ANNOUNCEMENT_TIME = 3.5
#: Ratio of simulated to real time below which simulated time counts as standing
SLOWEST_PACE = 0.05
MAX_SPIN_TIME = 0.05  #: Longest time in the executor between two checks of a condition [s]


class Session:
    """A ROS node with a context and an executor of its own, as a context manager.

    Signals are left to the command: rclpy's handlers would shut the context down before a last
    message could be sent.

    Args:
        events: Whether to use the events executor, which is leaner and more punctual.
        sim_time: Whether time is that of /clock. All durations are then simulated.
        domain: ROS domain; None for that of the environment.
    """

    def __init__(
        self,
        name: str,
        namespace: str = "",
        events: bool = True,
        sim_time: bool = False,
        domain: int | None = None,
    ) -> None:
        self._name = name
        self._namespace = namespace
        self._events = events
        self._sim_time = sim_time
        self._domain = domain

    def __enter__(self) -> Self:
        self.context = rclpy.Context()
        rclpy.init(
            args=[],
            context=self.context,
            domain_id=self._domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self.node = Node(
            self._name,
            namespace=self._namespace,
            context=self.context,
            start_parameter_services=False,
            parameter_overrides=[Parameter("use_sim_time", value=self._sim_time)],
        )
        self._executor = self._make_executor()
        self._executor.add_node(self.node)
        return self

    def _make_executor(self) -> Any:
        if self._events:
            from rclpy.experimental import EventsExecutor

            return EventsExecutor(context=self.context)
        return SingleThreadedExecutor(context=self.context)

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._executor.remove_node(self.node)
        # An executor that lives keeps the node's participant in the domain until it is collected.
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self.context)

    @property
    def is_simulated(self) -> bool:
        """Whether time is that of /clock."""
        return self._sim_time

    def now(self) -> float:
        """Return the time from any origin [s]: monotonic, or that of /clock."""
        if self._sim_time:
            return float(self.node.get_clock().now().nanoseconds * 1e-9)
        return time.monotonic()

    def spin(self, seconds: float) -> None:
        """Serve callbacks for some time [s]; those that are ready are served in any case."""
        if self._sim_time:
            self._spin_for(0.0)
            self.wait(lambda: False, seconds)
        else:
            self._spin_for(max(seconds, 0.0))

    def _spin_for(self, seconds: float) -> None:
        # EventsExecutor.spin_once() serves a single event; this call serves all that are ready.
        future = rclpy.Future(executor=None)
        self._executor.spin_until_future_complete(future, timeout_sec=seconds)

    def wait(self, condition: Callable[[], bool], timeout: float) -> bool:
        """Serve callbacks until a condition holds; return whether it does.

        Args:
            condition: Checked after each callback, at least every `MAX_SPIN_TIME`.
            timeout: Longest time to wait [s]; where simulated time stands, the wait ends, too.
        """
        end, last_moment = self.now() + timeout, time.monotonic() + timeout / SLOWEST_PACE
        while not condition():
            remaining = min(end - self.now(), last_moment - time.monotonic())
            if remaining <= 0.0:
                return False
            self._spin_once(min(remaining, MAX_SPIN_TIME))
        return True

    def _spin_once(self, timeout: float) -> None:
        self._executor.spin_once(timeout_sec=timeout)


class PeriodicTicks:
    """Iterates at a fixed period for a duration, and serves callbacks meanwhile.

    Each iteration yields the time since the start [s]. Ticks that are missed by more than a period
    are skipped.

    Args:
        check: Called before each tick; it raises to end the iteration early.
    """

    def __init__(
        self, session: Session, duration: float, period: float, check: Callable[[], None]
    ) -> None:
        self._session = session
        self._period = period
        self._check = check
        self._start = session.now()
        self._end = self._start + duration
        self._next = self._start

    def __iter__(self) -> Self:
        return self

    def __next__(self) -> float:
        self._session.spin(self._next - self._session.now())
        self._check()
        now = self._session.now()
        if now >= self._end:
            raise StopIteration
        self._next = max(self._next + self._period, now)
        return now - self._start
