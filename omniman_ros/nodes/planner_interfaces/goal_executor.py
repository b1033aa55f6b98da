"""Goals of the action `navigate_to_pose`, which the planner drives to."""

from typing import TYPE_CHECKING, Any

from omniman_ros.conversions.headers import duration_message
from omniman_ros.conversions.poses import pose_message
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.planner_interfaces.goal_interface import GoalInterface
from omniman_ros.nodes.planner_interfaces.planner_loop import PlannerLoop
from omniman_ros.nodes.planner_interfaces.sensor_interface import SensorInterface

if TYPE_CHECKING:
    from omniman_ros.planning.planner import Planner


class GoalExecutor:
    """Hands goals of an action to the planner; see `NavigationExecutor`."""

    def __init__(
        self,
        node: OmnimanNode,
        goals: GoalInterface,
        loop: PlannerLoop,
        sensors: SensorInterface,
        planner: "Planner",
        frame: str,
    ) -> None:
        self._node, self._goals, self._loop = node, goals, loop
        self._sensors, self._planner, self._frame = sensors, planner, frame

    def send(self, request: Any) -> int:
        """Drive to a goal's pose and return its number; raise InputError if it is refused."""
        if request.behavior_tree:
            raise InputError(f"behavior_tree must be empty, not '{request.behavior_tree}'")
        refusal = self._goals.submit_pose(request.pose)
        if refusal:
            raise InputError(refusal)
        return self._loop.goals.latest

    def outcome(self, motion: int) -> str | None:
        """Return why a goal ended: empty if it was reached; None until the robot is at rest."""
        log = self._loop.goals
        is_coming_to_rest = not log.has_goal and self._loop.is_moving
        return None if is_coming_to_rest else log.outcome_of(motion)

    def cancel(self, motion: int) -> None:
        """Bring the robot to rest if it waits for this goal or drives to it."""
        if self._loop.goals.outcome_of(motion) is None:
            self._loop.cancel()

    def fill_feedback(self, feedback: Any) -> bool:
        """Write the pose, and the rest of the way, into the feedback."""
        measured = self._sensors.measured
        if measured is None:
            return False
        feedback.current_pose.header.stamp = self._node.stamp(measured.time)
        feedback.current_pose.header.frame_id = self._frame
        feedback.current_pose.pose = pose_message(measured.pose)
        route = self._planner.route_planner
        if route is None or route.route is None:
            feedback.distance_remaining = self._planner.error(measured)[0]
        else:
            feedback.distance_remaining = route.remaining_length
            feedback.estimated_time_remaining = duration_message(route.remaining)
        return True
