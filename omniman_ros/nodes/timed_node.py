"""Node with one clock for its whole life, and the times of messages on it."""

import math
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, suppress
from typing import Any

from builtin_interfaces.msg import Time as TimeMsg
from rcl_interfaces.msg import ParameterDescriptor, ParameterType
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from omniman_ros.conversions.headers import Stamp, is_stamped
from omniman_ros.core.errors import InputError
from omniman_ros.core.stamps import MAX_LEAD, REQUEST_LEAD, demand_not_ahead
from omniman_ros.nodes.clock_follower import ClockFollower
from omniman_ros.nodes.rclpy_compat import nanoseconds

CLOCK_READING_TIME = 1e-4  #: Time within which two clocks count as read simultaneously [s]
#: Number of attempts to read two clocks simultaneously: other threads may run in between
CLOCK_READING_ATTEMPTS = 5


class NoTimeError(InputError):
    """A stamp cannot be judged, because simulated time has not begun."""


class TimedNode(Node):
    """A node with one clock for its timers and timeouts: steady, or ROS time in simulation.

    Attributes:
        clock: That clock.
        lookahead: How far simulated time may be ahead of this node [s]: less than the lead that a
            stamp may have, and less than any timeout. Short for what is in a control loop, so that
            a busy machine does not change its figures; infinite for what only watches.
    """

    lookahead = 0.02

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        simulated = self.get_parameter("use_sim_time").value
        # A node has one clock for its whole life: with another one, all its times would be wrong.
        self.set_descriptor(
            "use_sim_time",
            ParameterDescriptor(
                type=ParameterType.PARAMETER_BOOL,
                description="Whether to run on /clock.",
                read_only=True,
            ),
        )
        self.clock = self.get_clock() if simulated else Clock(clock_type=ClockType.STEADY_TIME)
        self._read_clock, self._read_ros_time = self._clocks(simulated)
        self._follower: ClockFollower | None = None

    def _clocks(self, simulated: bool) -> tuple[Callable[[], int], Callable[[], int]]:
        """Return functions that return the time of the node's clock, and ROS time [ns].

        In real time they read the clocks of the system, which takes a twentieth of the time.
        """
        if not simulated:
            return time.monotonic_ns, time.time_ns
        return (lambda: nanoseconds(self.clock),) * 2

    @property
    def is_simulated(self) -> bool:
        """Whether the node runs on /clock."""
        return self.clock is self.get_clock()

    def now(self) -> float:
        """Return the time of the node's clock [s]."""
        return self._read_clock() * 1e-9

    def ros_time(self, instant: float | None = None) -> int:
        """Return the ROS time of an instant of the node's clock [s]; now if it is None [ns]."""
        if instant is None or not math.isfinite(instant):
            return self._read_ros_time()
        return max(round(self._ros_time_lead() + instant * 1e9), 0)

    def every(self, period: float, callback: Callable[[], None]) -> None:
        """Call `callback` every `period` seconds of the node's clock."""
        self.create_timer(period, callback, clock=self.clock)

    def time_passed(self) -> None:
        """Hand simulated time on; a node that has threads or processes overrides this."""

    def report_progress(self) -> None:
        """Let simulated time go on, after work that was not done by a callback of the clock."""
        if self._follower is not None:
            self._follower.report()

    def poll_clock(self) -> None:
        """Let simulated time pass while a callback waits for something."""
        if self._follower is not None:
            self._follower.poll()

    def clock_released(self) -> AbstractContextManager[None]:
        """Let simulated time run freely while a callback blocks, as nobody waits for this node."""
        return nullcontext() if self._follower is None else self._follower.released()

    @property
    def progress(self) -> float:
        """Simulated time up to which this node has done its work [s]; /clock waits for it.

        A node that has threads or processes at work overrides this.
        """
        return self.now()

    def follow_clock(self) -> ClockFollower | None:
        """Serve the timers by /clock instead of by an executor; None on a steady clock."""
        if self.is_simulated:
            self._follower = ClockFollower(
                self, self.lookahead, self.time_passed, lambda: self.progress
            )
        return self._follower

    def age(self, stamp: Stamp, max_lead: float = MAX_LEAD) -> float:
        """Return the age of a stamp in ROS time [s]; 0 for a zero stamp, which means now.

        Raises:
            InputError: The stamp is more than `max_lead` [s] ahead.
            NoTimeError: The node runs on /clock, on which no time has come yet.
        """
        if not is_stamped(stamp):
            return 0.0
        if self.is_simulated and not self._read_clock():
            raise NoTimeError("there is no time on /clock yet")
        # Time.from_msg raises on negative seconds; a stamp that old is merely stale.
        sent = stamp.sec * 1_000_000_000 + stamp.nanosec
        age: float = (self._read_ros_time() - sent) * 1e-9
        demand_not_ahead(-age, max_lead)
        return age

    def demand_not_ahead(self, stamp: Stamp) -> None:
        """Raise InputError if the stamp of a request is ahead by more than `REQUEST_LEAD`."""
        with suppress(NoTimeError):
            self.age(stamp, REQUEST_LEAD)

    def sent(self, source_time: int) -> float | None:
        """Return the instant of the node's clock [s] of a source timestamp [ns].

        It is right if both hosts' clocks agree. In simulation, whose time DDS does not know, it is
        None.
        """
        if self.is_simulated:
            return None
        return (source_time - self._ros_time_lead()) * 1e-9

    def stamp(self, instant: float | None = None) -> TimeMsg:
        """Return the ROS time of an instant of the node's clock [s]; now if it is None."""
        sec, nanosec = divmod(self.ros_time(instant), 10**9)
        return TimeMsg(sec=sec, nanosec=nanosec)

    def instant(self, stamp: Stamp, max_lead: float = MAX_LEAD) -> float:
        """Return the instant of the node's clock that a stamp means [s]; now for a zero stamp.

        Unlike the present minus the age, it does not depend on what this process or another one
        does between the readings of two clocks: messages keep their order.

        Raises:
            InputError: The stamp is more than `max_lead` [s] ahead.
        """
        if not is_stamped(stamp):
            return self.now()
        self.age(stamp, max_lead)
        instant: float = stamp.sec * 1_000_000_000 + stamp.nanosec - self._ros_time_lead()
        return instant * 1e-9

    def _ros_time_lead(self) -> float:
        """Return how far ROS time is ahead of the node's clock [ns]."""
        if self.is_simulated:
            return 0.0
        shortest, offset = math.inf, 0.0
        for _ in range(CLOCK_READING_ATTEMPTS):
            before, ros, after = self._read_clock(), self._read_ros_time(), self._read_clock()
            if after - before < shortest:
                shortest, offset = after - before, ros - 0.5 * (before + after)
            if shortest < 1e9 * CLOCK_READING_TIME:
                break
        return offset
