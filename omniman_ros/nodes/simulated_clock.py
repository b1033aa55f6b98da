"""Simulated time that a node advances itself, and publishes on /clock."""

from collections.abc import Callable, Iterator

from builtin_interfaces.msg import Time as TimeMsg
from rclpy.node import Node
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header

from omniman_ros.conversions.headers import is_stamped, time_seconds
from omniman_ros.core.stamps import MAX_LEAD, demand_not_ahead
from omniman_ros.nodes.clock_follower import PERMITS_TOPIC
from omniman_ros.nodes.clock_parameters import ClockParameters
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.simulation.lockstep import Lockstep

PACE_PERIOD = 5.0  #: Real time between two looks at the pace of simulated time [s]
#: Key in the diagnostics of how fast simulated time passes, over real time
PACE_KEY = "real_time_factor"
#: Key in the diagnostics of the nodes for which simulated time stands, separated by spaces
AWAITED_KEY = "waiting_for"
CLOCK_START = 1.0  #: First time on /clock [s]: a stamp of zero would mean "now"
MAX_CATCH_UP = 4  #: Largest number of steps at once
#: Largest delay that simulated time catches up with [s]; it falls behind by what is more
MAX_DELAY = 0.1
SLOW = 0.9  #: Fraction of the requested pace below which simulated time is reported as slow
MIN_REPORT_TIME = 1.0  #: Shortest real time over which the pace is measured [s]
STANDSTILL = 0.5  #: Real time without a step after which simulated time counts as standing [s]
#: Real time after which a time is published again while others have to catch up with it [s]
REPEAT_PERIOD = 0.02


class SimulatedClock:
    """Advances simulated time in steps of one period, in proportion to real time.

    It waits for nodes that lag behind, as long as they are alive: see :class:`Lockstep`. While it
    waits, it repeats the time, so that they report how far they have come.

    Args:
        patience: Real time for which a node that lags behind is waited for [s].

    Attributes:
        now: Simulated time [s].
        pace: Ratio of simulated to real time between the last two reports.
        laggards: Names of the nodes that were waited for since the last report.
    """

    def __init__(
        self,
        node: Node,
        period: float,
        real_time_factor: float,
        patience: float,
        real_time: Callable[[], float],
    ) -> None:
        self.now = CLOCK_START
        self.pace = real_time_factor
        self.laggards: set[str] = set()
        self._period, self._real_time_factor = period, real_time_factor
        self._real_time = real_time
        self._started = real_time()
        self._published = self._stepped = self._started
        self._reported_at = (self._started, self.now)
        self._lockstep, self._is_free = Lockstep(patience), False
        self._logger = node.get_logger()
        self._publisher = node.create_publisher(Clock, "/clock", 10)
        node.create_subscription(Header, PERMITS_TOPIC, self._on_permit, 100)

    def _on_permit(self, message: Header) -> None:
        if is_stamped(message.stamp):
            self.permit(message.frame_id, time_seconds(message.stamp))
        else:
            self.leave(message.frame_id)

    def permit(self, name: str, until: float) -> None:
        """Let time go on to `until` [s] for a participant, and wait for it from then on."""
        self._lockstep.permit(name, until)

    def leave(self, name: str) -> None:
        """Stop waiting for a participant until it gives a permit again."""
        self._lockstep.leave(name)

    def steps(self) -> Iterator[None]:
        """Advance simulated time as far as real time demands, and yield after each step."""
        real_time = self._real_time()
        due = CLOCK_START + self._real_time_factor * (real_time - self._started)
        for _ in range(MAX_CATCH_UP):
            if self.now + self._period > due:
                return
            if self._must_wait(real_time):
                break
            self.now += self._period
            self._stepped = real_time
            self._publish(real_time)
            yield
        delay = (due - self.now) / self._real_time_factor
        self._started += max(delay - MAX_DELAY, 0.0)

    def _must_wait(self, real_time: float) -> bool:
        """Return whether the next step has to wait for a node, and ask how far it has come."""
        until = self.now + self._period
        for name in self._lockstep.drop_dead(until, real_time):
            self._logger.warning(f"{name} does not keep up with /clock, which goes on without it")
        laggards = self._lockstep.laggards(until)
        if not laggards or self._is_free:
            return False
        self.laggards.update(laggards)
        if real_time - self._published > REPEAT_PERIOD:
            self._publish(real_time)
        return True

    def _publish(self, real_time: float) -> None:
        self._published = real_time
        self._publisher.publish(Clock(clock=self.stamp()))

    def pace_report(self) -> str:
        """Return whom time waited for since the last report, as a sentence; may be empty."""
        real_time = self._real_time()
        elapsed = real_time - self._reported_at[0]
        if elapsed < MIN_REPORT_TIME:
            return ""  # a timer that was late is called twice at once
        self.pace = (self.now - self._reported_at[1]) / elapsed
        self._reported_at = (real_time, self.now)
        laggards, self.laggards = self.laggards, set()
        if self.pace > SLOW * self._real_time_factor:
            return ""
        awaited = f", waiting for {', '.join(sorted(laggards))}" if laggards else ""
        return f"simulated time passes at {self.pace:.2f} times real time{awaited}"

    @property
    def awaited(self) -> list[str]:
        """Names of the nodes for which simulated time stands; empty while it passes."""
        if self._is_free or self._real_time() - self._stepped < STANDSTILL:
            return []
        return sorted(self._lockstep.laggards(self.now + self._period))

    def release(self) -> None:
        """Wait for nobody any more."""
        self._is_free = True

    def stamp(self, at: float | None = None) -> TimeMsg:
        """Return the stamp of an instant of simulated time [s]; now if it is None."""
        return Time(nanoseconds=round((at or self.now) * 1e9)).to_msg()

    def age(self, stamp: TimeMsg, max_lead: float) -> float:
        """Return the age of a stamp [s]; 0 for a zero stamp, which means now.

        Raises:
            InputError: The stamp is more than `max_lead` [s] ahead.
        """
        if not is_stamped(stamp):
            return 0.0
        age = self.now - time_seconds(stamp)
        demand_not_ahead(-age, max_lead)
        return age


class ClockGiverNode(OmnimanNode):
    """A node that advances simulated time itself, and publishes it on /clock, if it is to."""

    #: Simulated time that the node advances; None on real time
    simulated_clock: SimulatedClock | None = None

    def give_clock(self, parameters: ClockParameters, period: float) -> None:
        """Give simulated time in steps of `period` [s], if the parameters say so."""
        p = parameters
        if p.publish_clock:
            self.simulated_clock = SimulatedClock(
                self, period, p.real_time_factor, p.clock_patience, super().now
            )
            self.every(PACE_PERIOD, self._report_pace)

    def now(self) -> float:
        """Return the time of the node's clock [s], or simulated time, if the node gives it."""
        return super().now() if self.simulated_clock is None else self.simulated_clock.now

    def stamp(self, instant: float | None = None) -> TimeMsg:
        """Return the ROS time of an instant of that clock [s]; now if it is None."""
        clock = self.simulated_clock
        return super().stamp(instant) if clock is None else clock.stamp(instant)

    def age(self, stamp: TimeMsg, max_lead: float = MAX_LEAD) -> float:
        """Return the age of a stamp [s]; see `TimedNode.age`."""
        clock = self.simulated_clock
        return super().age(stamp, max_lead) if clock is None else clock.age(stamp, max_lead)

    def instant(self, stamp: TimeMsg, max_lead: float = MAX_LEAD) -> float:
        """Return the instant of that clock that a stamp means [s]; see `TimedNode.instant`."""
        if self.simulated_clock is None:
            return super().instant(stamp, max_lead)
        return self.now() - self.age(stamp, max_lead)

    def _report_pace(self) -> None:
        report = self.simulated_clock.pace_report() if self.simulated_clock else ""
        if report:
            self.get_logger().info(report)

    def pace_values(self) -> list[tuple[str, object]]:
        """Return the pace of simulated time, and whom it waits for, for the diagnostics."""
        clock = self.simulated_clock
        if clock is None:
            return []
        return [(PACE_KEY, round(clock.pace, 2)), (AWAITED_KEY, " ".join(clock.awaited))]

    def begin_shutdown(self, reason: str) -> None:
        """Let simulated time wait for nobody any more."""
        super().begin_shutdown(reason)
        if self.simulated_clock is not None:
            self.simulated_clock.release()
