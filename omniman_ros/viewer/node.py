"""Node `viewer`: a page in the browser that displays the robot and commands it."""

import math
import sys
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from omniman_ros.core.stamps import TIME_JUMP
from omniman_ros.description.urdf import carries_arm
from omniman_ros.extras import VIEWER
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.viewer.ros.lazy_subscriptions import LazySubscriptions
from omniman_ros.viewer.ros.manual_drive import ManualDrive
from omniman_ros.viewer.ros.obstacle_interface import ObstaclePublisher
from omniman_ros.viewer.ros.page_commands import PageCommands
from omniman_ros.viewer.ros.page_frames import PageFrames
from omniman_ros.viewer.ros.parameters import ViewerParameters
from omniman_ros.viewer.ros.perception_topics import PerceptionTopics
from omniman_ros.viewer.ros.planner_parameters import PlannerParameterClient
from omniman_ros.viewer.ros.planner_topics import PlannerTopics
from omniman_ros.viewer.ros.pose_commands import PoseCommands
from omniman_ros.viewer.ros.robot_topics import RobotTopics
from omniman_ros.viewer.ros.service_calls import ServiceCalls
from omniman_ros.viewer.ros.tool_commands import ToolCommands
from omniman_ros.viewer.view_state import ViewState

PERIOD = 0.05  #: Period of `cmd_vel`, and of processing the events of the page [s]


class ViewerNode(OmnimanNode):
    """Connects topics, services and parameters to the page.

    The page has threads of its own, which put events into a queue; a timer of this node empties
    it. Nothing here waits for a browser.
    """

    lookahead = math.inf

    def __init__(self, make_page: Callable[..., Any] | None = None, **options: object) -> None:
        super().__init__("viewer", **options)
        self.settings = ParameterSet(self, ViewerParameters)
        p = self.settings.value
        constraints = p.robot.wheel_count - 3
        self.state = ViewState(p.robot.wheel_count, constraints)
        self._topics = LazySubscriptions(self)
        frames = PageFrames(self, p, self.state)
        self._drive = ManualDrive(self, p)
        self._robot = RobotTopics(self, self._topics, self.state, p, frames, self.draw_status)
        self._obstacles = ObstaclePublisher(self, self.state, p.odom_frame)
        self._planner = PlannerTopics(
            self, self._topics, self.state, p.frames, frames, self._obstacles.owns
        )
        self._perception = PerceptionTopics(self, self._topics, self.state, p, frames.transforms)
        self._calls = ServiceCalls(self, self.state)
        self._planner_parameters = PlannerParameterClient(self, self.state)
        self._poses = PoseCommands(self, p, self.state, self._obstacles, self._calls, frames)
        self._commands = PageCommands(
            self.state,
            self._drive.buttons,
            self._poses,
            self._obstacles,
            self._planner_parameters,
            self._calls,
            ToolCommands(self, self._topics, p, self.state),
        )
        self._served_at = self.now()
        if make_page is None:
            from omniman_ros.viewer.page.page import Page

            make_page = Page
        limits = (p.limits.linear_velocity, p.limits.angular_velocity)
        mount = p.mount if carries_arm(p.robot) else None
        self.page = make_page(p.robot, mount, constraints, limits, p.access, self._commands.post)
        self.get_logger().info(f"the page is at {self.page.link}")
        self.every(PERIOD, self.serve)
        self.every(1.0 / p.frame_rate, self.draw)
        self.every(1.0, self.survey)

    def serve(self) -> None:
        """Process the events of the page, drive while a button is held, publish the obstacles."""
        self._topics.process_latest()
        # What was received until now is not newer than that.
        now = self.now()
        if now < self._served_at - TIME_JUMP:
            self._reset_time(now)
        self._served_at = now
        self._commands.carry_out(now)
        self._drive.step(self.page.speeds, now)
        self._calls.collect(now)
        self._planner_parameters.collect(now)
        self._poses.step(now)
        self._obstacles.publish(now)
        for source in (self._robot, self.state):
            source.sample(now)

    def _reset_time(self, now: float) -> None:
        """Discard held buttons and pending requests: they belong to another simulation."""
        self._drive.buttons.release_all()
        self._poses.reset_time()
        self._obstacles.reset_time(now)
        self.state.reset_time()
        self._calls.reset_time(now)

    def draw(self) -> None:
        """Draw a frame if a browser is connected."""
        watched = self.page.watched
        self._topics.set_watched(watched)
        if watched:
            self._topics.process_latest()
            now = self.now()
            self._planner.update_state(now)
            self._poses.update_state()
            self._obstacles.update_state(now)
            self._perception.update_state(self.page.layers)
            self.state.tour = self._commands.tour.text
            self.page.draw(self.state, now)

    def draw_status(self) -> None:
        """Draw the robot's state in words, if a browser is connected."""
        if self.page.watched:
            self.page.draw_status(self.state, self.now())

    def survey(self) -> None:
        """Check which other nodes are running."""
        self._calls.survey()
        self._obstacles.survey()
        self._planner_parameters.survey(self.now())

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for the diagnostics."""
        return DiagnosticStatus.OK, "running", [("page", self.page.address)]

    def begin_shutdown(self, reason: str) -> None:
        """Release the held buttons for good, and delete the page's obstacles.

        Zero twists follow from `serve`.
        """
        self._commands.close()
        self._drive.buttons.release_all()
        self._poses.abort()
        self._obstacles.end()

    @property
    def finished(self) -> bool:
        """Whether the final zero twists are sent."""
        return self._drive.silent

    @property
    def stop_timeout(self) -> float:
        """Time within which the final zero twists are sent [s]."""
        return 1.0

    def destroy_node(self) -> None:
        """Close the page, then destroy the node."""
        self.page.close()
        super().destroy_node()


def main(args: list[str] | None = None) -> int:
    """Run the node: entry point of `ros2 run omniman_ros viewer`."""
    if not VIEWER.is_available:
        sys.stderr.write(f"cannot start: {VIEWER.hint}\n")
        return 1
    return run(ViewerNode, args)
