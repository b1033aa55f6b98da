"""Admission of goals: from the request until the planner drives to it."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from omniman_ros.core.errors import InputError
from omniman_ros.core.pending_start import PendingStart, StartAttempt, StartState
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.planner_interfaces.goal_anchor import GoalAnchor, PlacedGoal
from omniman_ros.nodes.planner_interfaces.goal_log import GoalLog
from omniman_ros.nodes.planner_interfaces.posture_interface import PostureInterface
from omniman_ros.nodes.planner_interfaces.sensor_interface import SensorInterface

if TYPE_CHECKING:
    from omniman_ros.planning.planner import Planner


class GoalAdmission:
    """Has a goal wait until the robot is ready for it, and hands it to the planner then.

    Args:
        silence_reason: Returns why what the planner must know is not known at a time of the node's
            clock [s], or an empty string.
    """

    def __init__(
        self,
        node: OmnimanNode,
        planner: "Planner",
        anchor: GoalAnchor,
        sensors: SensorInterface,
        posture: PostureInterface,
        monitor: StreamMonitor,
        goals: GoalLog,
        silence_reason: Callable[[float], str],
    ) -> None:
        self._node, self._planner, self._anchor = node, planner, anchor
        self._sensors, self._posture, self._monitor = sensors, posture, monitor
        self._goals, self._silence_reason = goals, silence_reason
        self._pending = PendingStart(node.now, monitor)
        self._is_closed = False

    @property
    def is_pending(self) -> bool:
        """Whether a goal waits."""
        return bool(self._pending)

    def submit(self, make_goal: Callable[[], PlacedGoal]) -> StartAttempt:
        """Have a goal wait in place of the one that waits; start it, or raise InputError."""
        try:
            if self._is_closed:
                raise InputError("the node is shutting down")
            goal = make_goal()
        except InputError as error:
            self._goals.reject(str(error))
            raise
        self._sensors.obstacles.dismiss_silent_source()
        self._goals.receive()
        self._pending.put(lambda: self._start(goal))
        return self.attempt()

    def attempt(self) -> StartAttempt:
        """Start the goal that waits, if there is one and the robot is ready."""
        attempt = self._pending.attempt(self._monitor.blocking_reason, self._blocking_reason)
        if attempt.state is StartState.WAITING:
            self._goals.wait(attempt.reason)
        elif attempt.state is StartState.REFUSED:
            self._goals.refuse(attempt.reason)
        elif attempt.state is StartState.STARTED:
            self._goals.accept()
            self._node.get_logger().info("goal accepted")
        return attempt

    def discard(self) -> None:
        """Discard the goal that waits, if there is one."""
        self._pending.discard()

    def restart_timeout(self) -> None:
        """Let the goal wait for the whole timeout from now on."""
        self._pending.restart_timeout()

    def close(self) -> None:
        """Discard the goal that waits, and accept no other."""
        self._is_closed = True
        self.discard()

    def _blocking_reason(self) -> str:
        """Return why no goal can be driven to yet, or an empty string."""
        now = self._node.now()
        fault = self._sensors.odom_fault(now)
        if fault:
            return fault
        if self._monitor.waiting_time(now) > 0.0:
            return "control was lost a moment ago"
        return self._silence_reason(now)

    def _start(self, goal: PlacedGoal) -> None:
        measured = self._sensors.measured
        assert measured is not None
        now = self._node.now()
        self._planner.footprint = self._posture.footprint(now)
        self._anchor.drive(goal, measured, self._sensors.obstacles.ellipses())
