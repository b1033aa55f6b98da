"""Node `viewer`: a page in the browser that shows the robot, and steers it."""

import queue
import sys
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.publisher import Publisher

from omniman_ros.core.errors import InputError
from omniman_ros.description.urdf import carries_arm
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import OmnimanNode, run
from omniman_ros.nodes.viewing.calls import CallPort
from omniman_ros.nodes.viewing.crowd_port import CrowdPort
from omniman_ros.nodes.viewing.driving import Driving
from omniman_ros.nodes.viewing.ears import Ears
from omniman_ros.nodes.viewing.parameters import ViewerParameters
from omniman_ros.nodes.viewing.places import Places
from omniman_ros.nodes.viewing.planner_senses import PlannerSenses
from omniman_ros.nodes.viewing.robot_senses import RobotSenses
from omniman_ros.nodes.viewing.tuning import Tuning
from omniman_ros.viewer import availability
from omniman_ros.viewer.events import (
    CaseChosen,
    Event,
    GoalDragged,
    Gone,
    Held,
    ObstacleChosen,
    ObstacleDeleted,
    ObstacleDragged,
    ObstacleSent,
    ObstacleShaped,
    Pressed,
    Released,
    StartDragged,
    Tuned,
)
from omniman_ros.viewer.state import Picture

PERIOD = 0.05
"""Of cmd_vel, and of looking for what was pressed [s]."""
EVENTS = 1000
"""Events of the page that are served in one period at most."""
TIME_BACK = 0.1
"""Simulated time that goes back by more than this is a new simulation [s]."""


class ViewerNode(OmnimanNode):
    """Ties topics, services and parameters to the page.

    The page has threads of its own; they put what is pressed into a queue, which this node
    empties in its own time. Nothing here waits for a browser.

    Args:
        make_page: Makes the page, see `viewer.page.Page`.
    """

    def __init__(self, make_page: Callable[..., Any] | None = None, **options: object) -> None:
        super().__init__("viewer", **options)
        self.settings = ParameterSet(self, ViewerParameters)
        p = self.settings.value
        constraints = p.robot.wheel_count - 3
        self.picture = Picture(p.robot.wheel_count, constraints)
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._driving = Driving(self, p)
        self._ears = Ears(self)
        self._robot = RobotSenses(self, self._ears, self.picture, p)
        self._crowd = CrowdPort(self, self.picture, p.odom_frame)
        self._planner = PlannerSenses(self, self._ears, self.picture, p.frames, self._crowd.ours)
        self._calls = CallPort(self, self.picture)
        self._tuning = Tuning(self, self.picture)
        self._places = Places(
            self, self.picture, self._ears, p.frames, self._robot, self._planner, self._crowd,
            self._calls, p.robot.body,
        )  # fmt: skip
        self._handlers = self._table()
        self._served_at = self.now()
        limits = (p.limits.linear_velocity, p.limits.angular_velocity)
        mount = p.mount if carries_arm(p.robot) else None
        if make_page is None:
            from omniman_ros.viewer.page import Page as make_page
        self.page = make_page(
            p.robot, mount, constraints, limits, p.host, p.port, self._events.put
        )
        self.get_logger().info(f"the page is at {self.page.address}")
        self.every(PERIOD, self.serve)
        self.every(1.0 / p.frame_rate, self.draw)
        self.every(1.0, self.survey)

    def _table(self) -> dict[type, Callable[[Any, float], None]]:
        """What serves each kind of event, at a time [s]."""
        return {
            **dict.fromkeys((Held, Released, Gone), self._driving.hold.hear),
            Pressed: self._on_pressed,
            GoalDragged: self._places.drag_goal,
            StartDragged: self._places.drag_start,
            CaseChosen: self._places.load,
            ObstacleDragged: self._crowd.drag,
            ObstacleSent: self._crowd.send,
            ObstacleShaped: self._crowd.shape,
            ObstacleChosen: self._crowd.choose,
            ObstacleDeleted: self._crowd.delete,
            Tuned: self._tuning.set,
        }

    # ---- the page -----------------------------------------------------------------------------

    def serve(self) -> None:
        """Serve what was pressed, drive while a button is held, and report the obstacles."""
        now = self.now()
        if now < self._served_at - TIME_BACK:
            self._start_over(now)
        self._served_at = now
        self._serve_events(now)
        self._driving.drive(self.page.speeds, now)
        self._calls.collect(now)
        self._tuning.collect(now)
        self._ears.take_in()
        self._places.step(now)
        self._crowd.publish(now)
        for senses in (self._robot, self._planner, self.picture):
            senses.sample(now)

    def _start_over(self, now: float) -> None:
        """What was held and what waits was so in another time."""
        self._driving.hold.release()
        self._places.start_over()
        self._crowd.start_over(now)
        self.picture.start_over()
        self._calls.start_over(now)

    def _serve_events(self, now: float) -> None:
        for _ in range(EVENTS):
            try:
                event = self._events.get_nowait()
            except queue.Empty:
                return
            try:
                self._handlers[type(event)](event, now)
            except InputError as error:
                self.picture.note = str(error)

    def _on_pressed(self, event: Pressed, now: float) -> None:
        action, places = event.action, self._places
        if action in ("stop", "reset"):
            self._driving.hold.release()
            places.give_up()
            self._calls.reach(action, now)
        elif action == "clear":
            self.picture.odom_trail.clear()
            self.picture.truth_trail.clear()
        elif action == "add":
            self._crowd.add(now)
        elif action in ("pause", "resume", "cancel", "go", "restart"):
            getattr(places, action)(now)
        else:
            raise InputError(f"there is no button '{action[:40]}'")

    def draw(self) -> None:
        """Draw a frame, if somebody looks."""
        watched = self.page.watched
        self._ears.watch(watched)
        if watched:
            now = self.now()
            self._ears.take_in()
            self._planner.show(now)
            self._crowd.show(now)
            self.page.draw(self.picture, now)

    def survey(self) -> None:
        """Look who is there."""
        self._calls.survey()
        self._crowd.survey()
        self._tuning.survey(self.now())

    # ---- life ---------------------------------------------------------------------------------

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Level, message and values for the diagnostics."""
        return DiagnosticStatus.OK, "running", [("page", self.page.address)]

    def begin_shutdown(self, reason: str) -> None:
        """Let go of what is held, for good; zeros follow. The obstacles of the page go too."""
        self._events = queue.SimpleQueue()
        self._driving.hold.release()
        self._places.give_up()
        self._crowd.end()

    @property
    def finished(self) -> bool:
        """Whether the zeros are sent."""
        return self._driving.silent

    @property
    def patience(self) -> float:
        """How long that may take [s]."""
        return 1.0

    @property
    def last_words(self) -> tuple[Publisher, ...]:
        """Whose last message takes the obstacles away."""
        return self._crowd.publishers

    def destroy_node(self) -> None:
        """End the page too."""
        self.page.close()
        super().destroy_node()


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros viewer`."""
    if not availability.is_available():
        print(f"cannot start: {availability.HINT}", file=sys.stderr)
        return 1
    return run(ViewerNode, args)
