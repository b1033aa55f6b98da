"""Node `odometry`: the platform's odometry without a controller.

It serves recordings, controllers other than `platform_controller`, and robots whose odometry shall
run in a process of its own.
"""

from collections.abc import Iterable
from typing import Any

from diagnostic_msgs.msg import DiagnosticStatus

from omniman_ros.control.wheel_feedback import MAX_GAP
from omniman_ros.control.wheel_odometry import WheelOdometry
from omniman_ros.conversions.headers import SerializedStamp, is_stamped
from omniman_ros.conversions.wheels import reported_idle_wheels
from omniman_ros.nodes.odometry_interface import (
    OdometryInputs,
    OdometryOutputs,
    imu_fault,
    imu_values,
)
from omniman_ros.nodes.odometry_parameters import OdometryNodeParameters
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.stop_interface import LATCHED


class Cadence:
    """Selects reports for a topic of a lower rate [Hz]: one of k, the nearest to that rate."""

    def __init__(self, rate: float) -> None:
        self._period = 1.0 / rate
        self._before = self._selected = 0.0

    def is_due(self, time: float) -> bool:
        """Return whether the report measured at `time` [s] is selected; time may go back."""
        half_a_report = 0.5 * (time - self._before)
        is_due = half_a_report <= 0.0 or time - self._selected >= self._period - half_a_report
        self._before = time
        if is_due:
            self._selected = time
        return is_due


class OdometryNode(OmnimanNode):
    """Connects the odometry to its topics; it publishes when the wheels have reported."""

    def __init__(self, **options: Any) -> None:
        super().__init__("odometry", **options)
        self.settings = ParameterSet(self, OdometryNodeParameters)
        p = self.settings.value
        self.core = WheelOdometry(p.core)
        self.settings.on_change(lambda new: self.core.configure(new.core))
        self._names = p.core.robot.wheels.names
        self._odom_cadence = Cadence(p.topics.odom_rate)
        self._coupling_cadence = Cadence(p.topics.monitor_rate)
        self._outputs = OdometryOutputs(self, self.core, lambda: self.settings.value.topics)
        self._inputs = OdometryInputs(
            self, self.core, self._names, lambda: self.settings.value.topics, self._publish
        )
        on_health = self.guarded("wheel_health", self._on_wheel_health)
        self.create_subscription(DiagnosticStatus, "wheel_health", on_health, LATCHED)

    def _on_wheel_health(self, message: DiagnosticStatus) -> None:
        self.core.leave_out(reported_idle_wheels(message, self._names))

    def _publish(self, stamp: SerializedStamp) -> None:
        """Publish what is due after a report of the wheels, with the stamp of the report."""
        time = self.core.feedback.time
        ros_time = stamp.nanoseconds if is_stamped(stamp) else self.ros_time(time)
        if self._odom_cadence.is_due(time):
            self._outputs.publish_odometry(ros_time)
        if self._coupling_cadence.is_due(time):
            self._outputs.publish_coupling_error(ros_time)

    def status(self) -> tuple[bytes, str, Iterable[tuple[str, object]]]:
        """Return level, message and values for the diagnostics."""
        core = self.core
        level, message = self._level()
        values: list[tuple[str, object]] = [
            ("wheels_slipping", core.odometry.slipping),
            ("coupling_error_rad", core.coupling_error.round(4).tolist()),
            *imu_values(core),
            ("wheels_left_out", [self._names[i] for i in core.idle]),
        ]
        return level, message, values

    def _level(self) -> tuple[bytes, str]:
        feedback = self.core.feedback
        if not feedback.received:
            return DiagnosticStatus.WARN, "waiting for wheel_states"
        for topic in ("odom", "wheel_states"):
            if self.count_publishers(topic) > 1:
                return DiagnosticStatus.WARN, f"{topic} has more than one publisher"
        if feedback.age(self.now()) > MAX_GAP:
            return DiagnosticStatus.WARN, "no wheel_states any more"
        if feedback.suspect is not None:
            wheel = self._names[feedback.suspect]
            return DiagnosticStatus.WARN, f"wheel '{wheel}': position and velocity disagree"
        doubt = imu_fault(self.core) or ("the wheels slip" if self.core.odometry.slipping else "")
        if doubt:
            return DiagnosticStatus.WARN, doubt
        return DiagnosticStatus.OK, "running"


def main(args: list[str] | None = None) -> int:
    """Run the node: entry point of `ros2 run omniman_ros odometry`."""
    return run(OdometryNode, args)
