"""One cycle of planning: know, plan, check, send."""

import math
from typing import TYPE_CHECKING

from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.planner_interfaces.goal_anchor import GoalAnchor
from omniman_ros.nodes.planner_interfaces.goal_log import GoalLog
from omniman_ros.nodes.planner_interfaces.motion_publisher import MotionPublisher
from omniman_ros.nodes.planner_interfaces.plan_publisher import PlanPublisher
from omniman_ros.nodes.planner_interfaces.posture_interface import PostureInterface
from omniman_ros.nodes.planner_interfaces.sensor_interface import SensorInterface
from omniman_ros.planning.cycle import MeasuredState, PlannerState

if TYPE_CHECKING:
    from omniman_ros.planning.planner import Planner


class PlanningCycle:
    """Plans the next stretch of the motion from what is known now, and sends it.

    Attributes:
        silence: Why the surroundings, the arm's posture or the goal's place in odom are not known,
            while the robot waits for them, or empty.
        solve_time: Duration of the last planning [s]; NaN before the first.
    """

    def __init__(
        self,
        node: OmnimanNode,
        planner: "Planner",
        anchor: GoalAnchor,
        sensors: SensorInterface,
        posture: PostureInterface,
        publisher: MotionPublisher,
        plans: PlanPublisher,
        goals: GoalLog,
    ) -> None:
        self._node, self._planner, self._anchor = node, planner, anchor
        self._sensors, self._posture = sensors, posture
        self._publisher, self._plans, self._goals = publisher, plans, goals
        self.silence = ""
        self.solve_time = math.nan

    def silence_reason(self, now: float) -> str:
        """Return why the surroundings or the arm's posture are not known, or an empty string."""
        posture = self._posture.silence_reason(now)
        return self._sensors.blind_reason() or posture

    def run(self, now: float, measured: MeasuredState) -> None:
        """Plan towards the goal, check the plan and send it; brake while something is unknown."""
        planner = self._planner
        silence = self.silence_reason(now) or self._anchor.silence_reason()
        obstacles = self._sensors.obstacles.ellipses()
        if silence:
            if not self.silence:
                planner.brake(now)
            self.silence = silence
            self._node.warn("silent", f"the robot stops: {silence}")
            self._publisher.send(now)
            return
        self.silence = ""
        self._anchor.update(now, obstacles)
        proposal = planner.propose(now, measured, obstacles)
        done = self._node.now()
        self.solve_time = done - now
        planner.take(proposal, done, measured, obstacles)
        if planner.report.reason:
            self._goals.reject_plan(planner.report.reason)
            self._node.warn("plan", self._goals.text)
        if planner.state is PlannerState.ARRIVED:
            self._goals.arrive()
            self._node.get_logger().info("goal reached")
        self._publisher.send(done)
        self._plans.publish(done, obstacles)
        planner.update_route(done, obstacles)

    def coast(self, now: float) -> None:
        """Finish a motion without a goal, still watching the obstacles."""
        measured = self._sensors.measured
        if self._planner.motion.end > now and measured is not None:
            if self.silence_reason(now):
                self._planner.brake(now)
            else:
                self._planner.coast(now, measured, self._sensors.obstacles.ellipses())
        self._publisher.send(now)
