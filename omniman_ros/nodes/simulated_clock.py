"""Simulated time that a node advances itself, and publishes on /clock."""

from collections.abc import Callable, Iterator

from builtin_interfaces.msg import Time as TimeMsg
from rclpy.node import Node
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from omniman_ros.conversions.headers import is_stamped, time_seconds
from omniman_ros.core.errors import InputError

CLOCK_START = 1.0
"""First time on /clock [s]: a stamp of zero would mean "now"."""
MAX_CATCH_UP = 4
"""Largest number of steps at once; simulated time falls behind where more would be due."""


class SimulatedClock:
    """Advances simulated time in steps of one period, in proportion to real time.

    Args:
        node: Node that owns the publisher of /clock.
        period: Step of simulated time [s].
        real_time_factor: Speed of simulated over real time.
        real_time: Returns real time, from any origin [s].

    Attributes:
        now: Simulated time [s].
    """

    def __init__(
        self,
        node: Node,
        period: float,
        real_time_factor: float,
        real_time: Callable[[], float],
    ) -> None:
        self.now = CLOCK_START
        self._period, self._real_time_factor = period, real_time_factor
        self._real_time = real_time
        self._started = real_time()
        self._publisher = node.create_publisher(Clock, "/clock", 10)

    def steps(self) -> Iterator[None]:
        """Advance and publish simulated time step by step, as far as real time demands.

        Yields:
            Once after each step, with `now` at its end.
        """
        due = CLOCK_START + self._real_time_factor * (self._real_time() - self._started)
        for _ in range(MAX_CATCH_UP):
            if self.now + self._period > due:
                return
            self.now += self._period
            self._publisher.publish(Clock(clock=self.stamp()))
            yield
        elapsed = (self.now - CLOCK_START) / self._real_time_factor
        self._started = self._real_time() - elapsed

    def stamp(self, at: float | None = None) -> TimeMsg:
        """Return the stamp of an instant of simulated time [s]; now if it is None."""
        return Time(nanoseconds=round((at or self.now) * 1e9)).to_msg()

    def age(self, stamp: TimeMsg, max_lead: float) -> float:
        """Return the age of a stamp [s]; 0 for a zero stamp, which means now.

        Args:
            stamp: Stamp of a message.
            max_lead: Largest time that it may be ahead of now [s].

        Raises:
            InputError: The stamp is further ahead.
        """
        if not is_stamped(stamp):
            return 0.0
        age = self.now - time_seconds(stamp)
        if age < -max_lead:
            raise InputError(f"the stamp is {-age:.3f} s ahead")
        return age
