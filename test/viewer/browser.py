"""The topics of a robot, and the mouse in its page, for tests with a browser."""

import math

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, Twist
from nav_msgs.msg import Odometry, Path

from omniman_ros.conversions.geometry import yaw_from_quaternion
from omniman_ros.conversions.headers import time_seconds
from test.running import PATIENCE
from test.viewer.screen import of_client

AT_REST = 0.005  #: Sum of speed and yaw rate below which the robot counts as standing [m/s, rad/s]
#: Time for which it must stand to be at rest [s]: where it reverses, it stands for a moment
REST_TIME = 0.3
STEPS = 6  #: Number of steps of the mouse in a drag
FRAME = 100  #: Time for a page to draw a frame [ms]


class Robot:
    """The robot's topics, spun while a test waits.

    Attributes:
        twists: All of `cmd_vel`.
        goals: All of `goal_pose`, as (x, y, heading).
        plan: The last `mpc/plan`, (k, 3).
        planner: State of the planner.
        at_rest: Whether the robot has been standing for `REST_TIME`.
    """

    def __init__(self, session):
        self.session = session
        self.odom = None
        self.at_rest, self._stands_since = False, None
        self.twists, self.goals = [], []
        self.plan = np.empty((0, 3))
        self.planner = ""
        listen = session.node.create_subscription
        listen(Odometry, "odom", self._on_odom, 1)
        listen(Twist, "cmd_vel", self.twists.append, 10)
        listen(PoseStamped, "goal_pose", self._on_goal, 10)
        listen(Path, "mpc/plan", self._on_plan, 1)
        listen(DiagnosticStatus, "mpc/status", self._on_status, 1)

    def _on_odom(self, message):
        self.odom = message
        stamp = time_seconds(message.header.stamp)
        if self.speed >= AT_REST or self._stands_since is None:
            self._stands_since = stamp
        self.at_rest = stamp - self._stands_since > REST_TIME

    def forget_rest(self):
        """Let the time for which the robot has been standing begin with the next message."""
        self.at_rest, self._stands_since = False, None

    def _on_goal(self, message):
        self.goals.append(_pose(message.pose))

    def _on_plan(self, message):
        self.plan = np.array([_pose(stamped.pose) for stamped in message.poses]).reshape(-1, 3)

    def _on_status(self, message):
        self.planner = {item.key: item.value for item in message.values}["state"]

    @property
    def x(self):
        return self.odom.pose.pose.position.x

    @property
    def pose(self):
        """(x, y, heading) in odom."""
        return _pose(self.odom.pose.pose)

    @property
    def speed(self):
        twist = self.odom.twist.twist
        return math.hypot(twist.linear.x, twist.linear.y) + abs(twist.angular.z)

    def ahead(self, forward, left=0.0):
        """Return the position (x, y) in `odom` ahead and to the left of the robot [m]."""
        x, y, heading = self.pose
        c, s = math.cos(heading), math.sin(heading)
        return x + c * forward - s * left, y + s * forward + c * left

    def wait(self, condition, what, timeout=PATIENCE):
        assert self.session.wait(condition, timeout), (
            f"waited {timeout} s for {what}; the planner: {self.planner}"
        )


class Mouse:
    """The mouse in a page that follows a robot and has its initial camera."""

    def __init__(self, page, robot, camera):
        self.page = page
        self._robot = robot
        self._camera = camera
        self._canvas = page.locator("canvas[data-engine]")

    def pixel(self, x, y, z):
        """Return the pixel of a position in `odom`."""
        box = self._canvas.bounding_box()
        here = self._robot.pose
        seen = x - here[0], y - here[1], z
        u, v = of_client(self._camera, seen, box["width"], box["height"])
        assert 0 < u < box["width"] and 0 < v < box["height"], f"({x}, {y}, {z}) is out of sight"
        return box["x"] + u, box["y"] + v

    def drag(self, place, to):
        """Drag from a position (x, y, z) in `odom` to another; the robot is at rest."""
        # A page behind another does not draw.
        self.page.bring_to_front()
        self.page.wait_for_timeout(5 * FRAME)
        start, end = self.pixel(*place), self.pixel(*to)
        self.page.mouse.move(*start)
        self.page.wait_for_timeout(FRAME)
        self.page.mouse.down()
        for step in range(1, STEPS + 1):
            way = step / STEPS
            self.page.mouse.move(*(a + way * (b - a) for a, b in zip(start, end, strict=True)))
            self.page.wait_for_timeout(FRAME)
        self.page.mouse.up()


def _pose(pose):
    return pose.position.x, pose.position.y, yaw_from_quaternion(pose.orientation)


#: Draws ten frames a second: without a graphics card, a browser that draws as fast as it can
#: leaves no processor to the robot that it shows, nor to its own events.
FRAMES = """
{
  const slow = (callback) => setTimeout(() => callback(performance.now()), 100);
  window.requestAnimationFrame = slow;
  window.cancelAnimationFrame = clearTimeout;
}
"""


def draw_slowly(page):
    """Limit the frames of a page to what software rendering can do; call it before `goto`."""
    page.add_init_script(FRAMES)
