"""Publishers of the stream that moves the robot, and of plans for people."""

from typing import TYPE_CHECKING

import numpy as np
from nav_msgs.msg import Path
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from omniman_ros.conversions.obstacles import ellipse_markers
from omniman_ros.conversions.poses import path_message
from omniman_ros.conversions.trajectories import preview_message
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.planner_interfaces.parameters import MpcPlannerParameters
from omniman_ros.surroundings.ellipses import Ellipses

if TYPE_CHECKING:  # needs casadi, which is optional
    from omniman_ros.planning.planner import Planner

PREDICTION_TIMES = (0.5, 1.0, 1.5)  #: Times ahead at which predicted obstacles are shown [s]


class PlanPublisher:
    """Publishes `mpc/plan`, `mpc/route` and `mpc/predicted_obstacles`."""

    def __init__(self, node: OmnimanNode, frame: str, planner: "Planner") -> None:
        self._node, self._frame, self._planner = node, frame, planner
        self._plan = node.create_publisher(Path, "mpc/plan", 10)
        self._route = node.create_publisher(Path, "mpc/route", 10)
        self._predicted = node.create_publisher(MarkerArray, "mpc/predicted_obstacles", 10)

    def publish(self, now: float, obstacles: Ellipses) -> None:
        """Publish the plan, the route and the predicted obstacles from the time `now` [s] on."""
        stamp, motion = self._node.stamp(now), self._planner.motion
        if self._plan.get_subscription_count():
            part = motion.between(now, max(motion.end, now + 0.01))
            plan = path_message(part.poses, self._frame)
            plan.header.stamp = stamp
            self._plan.publish(plan)
        route_planner = self._planner.route_planner
        route = None if route_planner is None else route_planner.route
        if route is not None and self._route.get_subscription_count():
            message = path_message(route.poses, self._frame)
            message.header.stamp = stamp
            self._route.publish(message)
        if self._predicted.get_subscription_count():
            times = now + np.array(PREDICTION_TIMES)
            self._predicted.publish(ellipse_markers(obstacles, times, self._frame, stamp))


class MotionPublisher:
    """Publishes the motion of the planner as references or as motor voltages."""

    def __init__(
        self,
        node: OmnimanNode,
        settings: ParameterSet[MpcPlannerParameters],
        planner: "Planner",
        monitor: StreamMonitor,
    ) -> None:
        self._node, self._settings = node, settings
        self._planner, self._monitor = planner, monitor
        qos = QoSProfile(depth=1)
        self.reference = node.create_publisher(MultiDOFJointTrajectory, "mpc/reference", qos)
        self._voltages = node.create_publisher(JointState, "mpc/voltages", qos)
        self._sends_voltages = False

    def send(self, now: float) -> None:
        """Send the motion from now on, unless it is driven by voltages.

        The stream ends with its motion: it is no loss of control that the controller then releases
        the robot, which is at rest.
        """
        planner, motion = self._planner, self._planner.motion
        with_voltages = self._settings.value.output == "voltages"
        self._sends_voltages = (
            with_voltages and planner.active and planner.voltages(now) is not None
        )
        if motion.end <= now:
            self._monitor.end(lost=False)
            return
        if not self._sends_voltages:
            self._send_reference(now)

    def stop(self) -> None:
        """Send no more voltages until the next `send`."""
        self._sends_voltages = False

    def _send_reference(self, now: float) -> None:
        p, preview = self._settings.value, self._planner.preview
        # The preview lasts at least one period: one that ends in transit arrives stale.
        part = preview.between(now, max(preview.end, now + p.period))
        message = preview_message(
            p.frames.odom.odom_frame,
            self._node.stamp(now),
            part.times,
            part.poses,
            part.velocities,
        )
        self.reference.publish(message)
        self._note_sent(now)

    def send_voltages(self) -> None:
        """Send the present voltages if the motion is driven by voltages."""
        if not self._sends_voltages:
            return
        now, p = self._node.now(), self._settings.value
        volts = self._planner.voltages(now + 0.5 * p.voltages_period)
        if volts is None:
            self.send(now)
            return
        message = JointState(name=list(p.core.robot.wheels.names))
        message.header.stamp = self._node.stamp(now)
        message.effort = volts.tolist()
        self._voltages.publish(message)
        self._note_sent(now)

    def _note_sent(self, now: float) -> None:
        self._monitor.begin(now)
        self._monitor.sent(now)
