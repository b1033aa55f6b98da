"""Publisher of the stream that moves the robot: `mpc/reference` or `mpc/voltages`."""

from typing import TYPE_CHECKING

from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import MultiDOFJointTrajectory

from omniman_ros.conversions.trajectories import preview_message
from omniman_ros.core.stream_monitor import StreamMonitor
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.planner_interfaces.parameters import MpcPlannerParameters

if TYPE_CHECKING:
    from omniman_ros.planning.planner import Planner


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
