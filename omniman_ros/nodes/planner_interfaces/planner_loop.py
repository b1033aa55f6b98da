"""Drives of the node, from the request of a goal until the robot is at rest."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from omniman_ros.core.pending_start import StartAttempt, StartState
from omniman_ros.core.stamps import TIME_JUMP
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.planner_interfaces.goal_admission import GoalAdmission
from omniman_ros.nodes.planner_interfaces.goal_anchor import GoalAnchor, PlacedGoal
from omniman_ros.nodes.planner_interfaces.goal_log import GoalLog
from omniman_ros.nodes.planner_interfaces.motion_publisher import MotionPublisher
from omniman_ros.nodes.planner_interfaces.plan_publisher import PlanPublisher
from omniman_ros.nodes.planner_interfaces.planning_cycle import PlanningCycle
from omniman_ros.nodes.planner_interfaces.posture_interface import PostureInterface
from omniman_ros.nodes.planner_interfaces.sensor_interface import SensorInterface

if TYPE_CHECKING:
    from omniman_ros.planning.planner import Planner


class PlannerLoop:
    """Serves requests, supervises the drive, and runs one planning cycle per tick."""

    def __init__(
        self,
        node: OmnimanNode,
        planner: "Planner",
        anchor: GoalAnchor,
        sensors: SensorInterface,
        posture: PostureInterface,
        publisher: MotionPublisher,
        plans: PlanPublisher,
        monitor: StreamMonitor,
    ) -> None:
        self._node, self._planner, self._sensors = node, planner, sensors
        self._posture, self._publisher, self._monitor = posture, publisher, monitor
        self.goals = GoalLog()
        self.cycle = PlanningCycle(
            node, planner, anchor, sensors, posture, publisher, plans, self.goals
        )
        self._admission = GoalAdmission(
            node, planner, anchor, sensors, posture, monitor, self.goals, self.cycle.silence_reason
        )
        self._last_tick = node.now()

    @property
    def is_moving(self) -> bool:
        """Whether there is a goal to drive to, or the motion is not over."""
        return self._planner.active or self._planner.motion.end > self._node.now()

    # ---- requests -----------------------------------------------------------------------------

    def submit(self, make_goal: Callable[[], PlacedGoal]) -> str:
        """Drive to a goal as soon as possible; return or raise why it is refused."""
        return self._attended(self._admission.submit(make_goal))

    def _attended(self, attempt: StartAttempt) -> str:
        """Return why a goal is refused; one that starts ends the silence of the one before."""
        if attempt.state is StartState.STARTED:
            self.cycle.silence = ""
        return attempt.refusal

    def pause(self) -> str:
        """Bring the robot to rest and keep the goal; return any reason for refusal, or ""."""
        if not self._planner.active:
            return f"nothing to pause: {self._planner.state.value}"
        self.cycle.silence = ""
        now = self._node.now()
        self._planner.pause(now)
        self._publisher.send(now)
        return ""

    def resume(self) -> str:
        """Drive on after a pause; return any reason for refusal, or ""."""
        measured = self._sensors.measured
        if measured is None or not self._planner.resume(measured):
            return f"nothing to resume: {self._planner.state.value}"
        return ""

    def cancel(self) -> str:
        """Bring the robot to rest and discard the goal; return any reason for refusal, or ""."""
        if not self._admission.is_pending and self._planner.goal is None:
            return f"nothing to cancel: {self._planner.state.value}"
        self._admission.discard()
        self._brake_for_good()
        self.goals.cancel()
        return ""

    def begin_shutdown(self) -> None:
        """Bring the robot to rest, and accept no other goal."""
        self._admission.close()
        if self._planner.goal is not None:
            self._brake_for_good()
        if self.goals.has_goal:
            self.goals.cancel()

    # ---- end of a drive ------------------------------------------------------------------------

    def give_up_if_lost(self) -> None:
        """Give the goal up if the robot does not follow this planner any more."""
        reason = self._monitor.loss_reason(self._node.now())
        if not reason and self._planner.goal is not None:  # without a goal nothing is followed
            reason = self._monitor.blocking_reason
        if reason:
            self._give_up(reason)

    def _give_up(self, reason: str) -> None:
        """Discard goal and motion: nothing more is sent."""
        self._log_given_up(reason)
        self._planner.abort(self._node.now() - 1.0, self._sensors.measured)  # ended 1 s ago
        self._publisher.stop()
        self._monitor.end(lost=True)

    def _log_given_up(self, reason: str) -> None:
        self.cycle.silence = ""
        if self._planner.goal is not None:
            self.goals.give_up(reason)
            self._node.warn("given up", self.goals.text)

    def _brake_for_good(self) -> None:
        self.cycle.silence = ""
        now = self._node.now()
        self._planner.cancel(now)
        self._publisher.send(now)

    # ---- a cycle ------------------------------------------------------------------------------

    def tick(self) -> None:
        """Supervise the drive, start the goal that waits, and run one planning cycle."""
        now = self._node.now()
        elapsed, self._last_tick = now - self._last_tick, now
        if elapsed < -TIME_JUMP:
            self._restart(now)
        self.give_up_if_lost()
        self._planner.footprint = self._posture.footprint(now)
        self._sensors.update_map()
        refusal = self._attended(self._admission.attempt())
        if refusal:
            self._node.warn("goal refused", f"goal not used: {refusal}")
        measured, fault = self._sensors.measured, self._sensors.odom_fault(now)
        if not self._planner.active or measured is None:
            self.cycle.coast(now)
        elif fault:
            self._log_given_up(fault)
            self._brake_for_good()
        else:
            self.cycle.run(now, measured)

    def _restart(self, now: float) -> None:
        """Discard everything that was received, because time went back."""
        self._give_up("time went back")
        self._monitor.restart(now)
        self._sensors.measured = None
        self._posture.forget()
        self._admission.restart_timeout()
