"""Base of the nodes that can give simulated time."""

from builtin_interfaces.msg import Time as TimeMsg

from omniman_ros.core.stamps import MAX_LEAD
from omniman_ros.nodes.clock_parameters import ClockParameters
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.simulated_clock import AWAITED_KEY, PACE_KEY, SimulatedClock

PACE_PERIOD = 5.0  #: Real time between two looks at the pace of simulated time [s]


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
