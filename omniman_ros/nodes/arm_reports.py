"""Publish what the streaming process of the arm reports, and summarise it for the diagnostics."""

import math
from collections import deque
from collections.abc import Sequence

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension

from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.ur.feedback import ArmSample, SafetyMode
from omniman_ros.ur.streaming_messages import SendTiming, StreamingPhase, StreamingReport
from omniman_ros.ur.streaming_process import StreamingProcess

SCALING_PERIOD = 0.1  #: Longest time between two messages on arm/speed_scaling [s]
#: Number of send intervals that the diagnostics summarise: those of the last 10 s
TIMING_WINDOW = 1250


class ArmReportPublisher:
    """Publishes arm/joint_states, arm/speed_scaling and arm/timing, and logs problems."""

    def __init__(self, node: OmnimanNode, joint_names: Sequence[str]) -> None:
        self._node = node
        self._joint_names = list(joint_names)
        self._joint_states = node.create_publisher(JointState, "arm/joint_states", 5)
        self._speed_scaling = node.create_publisher(Float64, "arm/speed_scaling", 10)
        self._timing = node.create_publisher(Float64MultiArray, "arm/timing", 10)
        self._scaling = math.nan
        self._scaling_time = -math.inf
        self._intervals: deque[float] = deque(maxlen=TIMING_WINDOW)
        self._safety_mode = int(SafetyMode.UNDEFINED)

    def publish(self, report: StreamingReport, is_active: bool) -> None:
        """Publish a report; the speed scaling is published only while the node is active."""
        for sample in report.samples:
            self._publish_joint_state(sample)
        for reason in report.refusals:
            self._node.warn("arm/joint_reference", f"arm/joint_reference not used: {reason}")
        for text in report.texts:
            self._node.get_logger().info(f"the controller reports: {text}")
        if report.timing is not None:
            self._publish_timing(report.timing)
        if is_active and report.samples:
            # An arm that no setpoints reach does not move, whatever its speed slider says.
            streaming = report.phase is StreamingPhase.STREAMING
            self._publish_scaling(report.samples[-1].speed_scaling if streaming else 0.0)

    def log_priority(self, process: StreamingProcess) -> None:
        """Log why the streaming process has no real-time priority, if it has none."""
        if process.priority_warning:
            self._node.get_logger().info(f"no real-time priority: {process.priority_warning}")

    @property
    def in_protective_stop(self) -> bool:
        """Whether the last sample reports a protective stop."""
        return self._safety_mode == SafetyMode.PROTECTIVE_STOP

    def status(
        self, process: StreamingProcess, stop: tuple[bytes, str] | None
    ) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for the diagnostics; a `stop` goes first."""
        report, values = process.report, self._values(process)
        if process.failure:
            return DiagnosticStatus.ERROR, process.failure, values
        if stop is not None:
            return *stop, values
        if report.phase is not StreamingPhase.STREAMING:
            return DiagnosticStatus.WARN, report.blocking_reason or report.phase.value, values
        return DiagnosticStatus.OK, "streaming", values

    def _values(self, process: StreamingProcess) -> list[tuple[str, object]]:
        report = process.report
        return [
            ("phase", report.phase.value),
            ("controller", report.blocking_reason or "ready"),
            ("real-time priority", process.priority_warning or "yes"),
            *((f"data {kind}", count) for kind, count in report.counts),
            *self._interval_percentiles(),
        ]

    def _interval_percentiles(self) -> list[tuple[str, object]]:
        if not self._intervals:
            return []
        values = np.percentile(np.array(self._intervals), [50, 99, 100])
        names = ("send interval p50 ms", "send interval p99 ms", "send interval max ms")
        return [(name, f"{1e3 * value:.2f}") for name, value in zip(names, values, strict=True)]

    def _publish_joint_state(self, sample: ArmSample) -> None:
        self._safety_mode = sample.safety_mode
        message = JointState(
            name=self._joint_names,
            position=list(sample.position),
            velocity=list(sample.velocity),
        )
        message.header.stamp = self._node.stamp(sample.at)
        self._joint_states.publish(message)

    def _publish_scaling(self, scaling: float) -> None:
        now = self._node.now()
        if scaling != self._scaling or now - self._scaling_time > SCALING_PERIOD:
            self._speed_scaling.publish(Float64(data=scaling))
            self._scaling, self._scaling_time = scaling, now

    def _publish_timing(self, timing: SendTiming) -> None:
        message = Float64MultiArray(data=[*timing.intervals, *timing.ages])
        for label, values in (("intervals", timing.intervals), ("ages", timing.ages)):
            size = len(values)
            message.layout.dim.append(MultiArrayDimension(label=label, size=size, stride=size))
        self._timing.publish(message)
        self._intervals.extend(timing.intervals)
