"""Goal and start of the robot: conversion of the page's requests into goals and relocations."""

from collections import deque

import numpy as np
from geometry_msgs.msg import PoseStamped

from omniman_ros.conversions.geometry import quaternion_from_yaw
from omniman_ros.conversions.poses import goal_pose_from_message
from omniman_ros.core import plausible, se2
from omniman_ros.core.errors import InputError
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.planning.cases import CASES
from omniman_ros.viewer.events import CaseSelected, GoalDragged, StartDragged
from omniman_ros.viewer.ros.obstacle_interface import ObstaclePublisher
from omniman_ros.viewer.ros.page_frames import PageFrames
from omniman_ros.viewer.ros.parameters import ViewerParameters
from omniman_ros.viewer.ros.relocation import RelocationStep, Relocator
from omniman_ros.viewer.ros.service_calls import ServiceCalls
from omniman_ros.viewer.view_state import PATH_NODES, Pose, ViewState

GOAL_PERIOD = 0.2  #: Shortest time between two goals while the goal is dragged [s]
REMEMBERED_GOALS = 20  #: Number of own goals that are recognised when they come back


class PoseCommands:
    """Sends goals, moves a simulated robot to the start, and loads the test cases.

    What is not possible, or implausible, raises an InputError.
    """

    def __init__(
        self,
        node: OmnimanNode,
        parameters: ViewerParameters,
        state: ViewState,
        obstacles: ObstaclePublisher,
        calls: ServiceCalls,
        frames: PageFrames,
    ) -> None:
        self._node = node
        self._odom_frame, self._frames = parameters.odom_frame, frames
        self._placed_goal: tuple[str, Pose] | None = None
        self._body = parameters.robot.body
        self._state = state
        self._obstacles = obstacles.obstacles
        self._load_obstacles = obstacles.load
        self._calls = calls
        self._relocator = Relocator(node, state, parameters.odom_frame)
        self._goals = node.create_publisher(PoseStamped, "goal_pose", 10)
        on_goal = frames.transforms.deferred(
            "goal_pose", lambda message: [message.header], self._on_goal
        )
        node.create_subscription(PoseStamped, "goal_pose", node.guarded("goal_pose", on_goal), 10)
        self._sent_goals: deque[tuple[float, ...]] = deque(maxlen=REMEMBERED_GOALS)
        self._sent_at = -np.inf
        self._has_unsent_goal = False
        self._keeps_start = False
        self._goes_after_relocation = False

    def drag_goal(self, event: GoalDragged, now: float) -> None:
        """Move the goal; send it unless the obstacles are paused or the robot is relocated."""
        pose = _checked(event.pose, "goal")
        self._state.goal, self._placed_goal = pose, None
        if self._obstacles.paused:
            self._has_unsent_goal = True
            if event.done:
                self._state.note = "the goal is placed; Go sends it"
        elif self._relocator.active:
            self._goes_after_relocation = self._goes_after_relocation or event.done
        elif event.done or self._follows_drag(now):
            self._send(pose, now)

    def _follows_drag(self, now: float) -> bool:
        return self._state.planner_is_driving(now) and now - self._sent_at >= GOAL_PERIOD

    def go(self, now: float) -> None:
        """Send the displayed goal, and let the obstacles continue."""
        if self._state.goal is None:
            raise InputError("there is no goal yet: drag one")
        if self._relocator.active:
            self._goes_after_relocation = True
            self._state.note = "go: waiting until the robot is at the start"
            return
        self._obstacles.resume(now)
        self._send(self._state.goal, now)

    def resume(self, now: float) -> None:
        """Let planner, path and obstacles continue, to the new goal if it was moved meanwhile."""
        self._obstacles.resume(now)
        state = self._state
        if self._has_unsent_goal and state.planner_is_paused(now) and state.goal is not None:
            self._calls.request("resume", now, nodes=PATH_NODES, report=False)
            self._send(state.goal, now)
        else:
            self._calls.request("resume", now)

    def pause(self, now: float) -> None:
        """Pause planner, path and obstacles."""
        self.abort()
        self._obstacles.pause(now)
        self._calls.request("pause", now)

    def cancel(self, now: float) -> None:
        """Cancel path and planner, and a relocation that is under way."""
        self.abort()
        self._calls.request("cancel", now)

    def _send(self, pose: Pose, now: float) -> None:
        self._begin_drive()
        message = PoseStamped()
        message.header.stamp, message.header.frame_id = self._node.stamp(), self._odom_frame
        message.pose.position.x, message.pose.position.y = pose[:2]
        message.pose.orientation = quaternion_from_yaw(pose[2])
        self._sent_goals.append(_key(message))
        self._goals.publish(message)
        self._sent_at = now
        has_planner = self._state.is_fresh("planner", now)
        self._state.note = "goal sent" if has_planner else "goal sent; no mpc_planner reports"

    def _on_goal(self, message: PoseStamped) -> None:
        """Display a goal of another node, but not an own one: the next may be dragged already."""
        if _key(message) in self._sent_goals:
            return
        place = self._frames.placement("goal_pose", message.header)
        local = goal_pose_from_message(message, (message.header.frame_id.lstrip("/"),))
        x, y, theta = local.tolist()
        self._placed_goal = place.frame, se2.compose(place.transform.planar(), (x, y, theta))
        self._begin_drive()
        self.update_state()

    def update_state(self) -> None:
        """Display a goal of another node where its frame is in odom now."""
        if self._placed_goal is None:
            return
        frame, pose = self._placed_goal
        try:
            self._state.goal = se2.compose(self._frames.pose(frame), pose)
        except InputError:  # where the frame is, is not known any more: the goal stays
            return

    def _begin_drive(self) -> None:
        """Set the start to the robot's pose, unless it is driving or the start was chosen."""
        state = self._state
        state.begin_run()
        is_driving = state.planner_is_driving(self._node.now())
        if not (self._keeps_start or is_driving) and state.odom is not None:
            state.start = state.odom
        self._keeps_start = self._has_unsent_goal = False

    def drag_start(self, event: StartDragged, now: float) -> None:
        """Move the start once it is released, and with it a simulated robot that is at rest."""
        pose = _checked(event.pose, "start")
        if not event.done:
            return
        reason = self._relocator.simulation_reason(now) or self._relocator.motion_reason(now)
        if reason:
            raise InputError(f"the start stays: {reason}")
        self._state.start, self._keeps_start = pose, True
        self._relocator.begin(pose, now)
        self.step(now)

    def load(self, event: CaseSelected, now: float) -> None:
        """Load a test case: start, goal, paused obstacles, and a simulated robot at the start."""
        case = CASES.get(event.name)
        if case is None:
            raise InputError(f"there is no case '{event.name[:40]}': {', '.join(CASES)}")
        case = case.fitting(self._body.length, self._body.width)
        self._load_obstacles(case, now)
        self._state.start, self._state.goal = case.start, case.goal
        self._placed_goal = None
        self._state.case = case.name
        self._return_to_start(f"case {case.name}", now)

    def restart(self, now: float) -> None:
        """Cancel all motions; move the obstacles home and a simulated robot to the start."""
        self._obstacles.pause(now)
        self._obstacles.restart(now)
        self._return_to_start("restart", now)

    def _return_to_start(self, action: str, now: float) -> None:
        self._has_unsent_goal = self._keeps_start = True
        self.abort()
        self._calls.request("cancel", now, report=False)
        self._state.clear_trails()
        self._state.begin_run()
        start = self._state.start
        reason = self._relocator.simulation_reason(now)
        if start is None:
            reason = "there is no start yet"
        elif not reason:
            self._relocator.begin(start, now)
        stays = f"; the robot stays: {reason}" if reason else ""
        self._state.note = f"{action}: held until Go{stays}"

    def step(self, now: float) -> None:
        """Continue a relocation; call this once per period."""
        result = self._relocator.step(now, sources_released=self._calls.answered)
        if result is RelocationStep.WAIT:
            return
        goes = self._goes_after_relocation
        self.abort()
        self._state.clear_trails()
        if result is not RelocationStep.DONE:
            self._state.note = f"the robot is not at the start: {result.value}"
        elif goes:
            self.go(now)

    def reset_time(self) -> None:
        """Discard pending requests after time went back; a goal may then be sent at once."""
        self.abort()
        self._sent_at = -np.inf

    def abort(self) -> None:
        """End a relocation, and do not send the goal that waits for it."""
        self._relocator.abort()
        self._goes_after_relocation = False


def _key(message: PoseStamped) -> tuple[float, ...]:
    position, orientation = message.pose.position, message.pose.orientation
    return position.x, position.y, orientation.z, orientation.w


def _checked(pose: Pose, label: str) -> Pose:
    plausible.demand(np.array(pose[:2]), plausible.LENGTH, f"{label}: position")
    plausible.demand(np.array(pose[2:]), plausible.ANGLE, f"{label}: heading")
    x, y, theta = (float(value) for value in pose)
    return x, y, theta
