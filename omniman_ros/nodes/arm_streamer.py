"""Node `arm_streamer`: joint previews to a UR controller as setpoints, and its feedback back."""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from omniman_ros.conversions.arm import joint_preview
from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.motion_limit import MotionLimit, MotionLimitParameters
from omniman_ros.core.stop import StopState
from omniman_ros.nodes.arm_reports import ArmReportPublisher
from omniman_ros.nodes.arm_streamer_parameters import ArmStreamerParameters
from omniman_ros.nodes.hardware_node import HardwareError, HardwareLostError, HardwareNode
from omniman_ros.nodes.motion_limit_input import subscribe_to_motion_limit
from omniman_ros.nodes.omniman_node import OmnimanNode
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.ur.joint_preview import JointPreview
from omniman_ros.ur.reverse_interface import JOINTS
from omniman_ros.ur.streaming_client import KEEP_ALIVE_PERIOD, StartProcess, StreamingClient
from omniman_ros.ur.streaming_messages import StreamingCommand, StreamingPhase
from omniman_ros.ur.streaming_process import StreamingProcess
from omniman_ros.ur.streaming_supervisor import joint_limits

TOPIC = "arm/joint_reference"  #: Name of the topic
MAX_STAMP_LEAD = 1.0  #: How far in the future the stamp of a preview may be [s]
SHUTDOWN_TIMEOUT = 6.0  #: How long the arm and its program may take to stop on shutdown [s]


class ArmLimit:
    """Subscribes to `motion_limit`, and publishes on `motion_demand` what previews ask for."""

    def __init__(
        self,
        node: OmnimanNode,
        joints: list[str],
        options: MotionLimitParameters,
        send: Callable[[float], None],
    ) -> None:
        self._node, self._joints, self._send = node, joints, send
        self._limit, self._sent = MotionLimit(options), 1.0
        subscribe_to_motion_limit(node, arm=self._limit, on_update=self.send)
        self._demands = node.create_publisher(JointState, "motion_demand", QoSProfile(depth=1))

    def configure(self, options: MotionLimitParameters) -> None:
        """Use other parameters."""
        self._limit.parameters = options

    @property
    def fraction(self) -> float:
        """Fraction of the speed limits that the arm may use now, 0 to 1."""
        return self._limit.fraction(self._node.now())

    def send(self) -> None:
        """Send the fraction that applies now; again and again, as the process may be a new one."""
        fraction = self.fraction
        if self._limit.parameters.use or fraction != self._sent:
            self._sent = fraction
            self._send(fraction)

    def ask(self, velocities: Array) -> None:
        """Publish the joint rates that a preview with velocities (k, n) [rad/s] asks for first.

        It asks for them even if it is refused because of the limit.
        """
        if not self._limit.parameters.use:
            return
        moving = np.flatnonzero(np.abs(velocities).max(axis=1) > 0.0)
        first = velocities[moving[0] if len(moving) else 0]
        message = JointState(name=self._joints, velocity=first.tolist())
        message.header.stamp = self._node.stamp()
        self._demands.publish(message)


class ArmPreviewInput:
    """Sends the previews on `arm/joint_reference` to the streaming process.

    Args:
        node: Node that subscribes; nothing is sent unless it is active and released.
    """

    def __init__(
        self,
        node: HardwareNode,
        joints: Sequence[str],
        limit: ArmLimit,
        streaming: StreamingClient,
    ) -> None:
        self._node, self._joints = node, list(joints)
        self._limit, self._streaming = limit, streaming
        handler = node.guarded(TOPIC, self._on_preview)
        node.create_subscription(JointTrajectory, TOPIC, handler, QoSProfile(depth=1))

    def _on_preview(self, message: JointTrajectory) -> str:
        start = self._node.instant(message.header.stamp, MAX_STAMP_LEAD)
        arrays = joint_preview(message, start, self._joints)
        JointPreview(*arrays)  # raises here as well, so that a refusal is logged at once
        if not self._node.is_active:
            return "the streamer is not active"
        latch = self._node.latch
        if not latch.released:
            return f"{latch.status.state.value}: {latch.status.reason}"
        self._limit.ask(arrays[2])
        self._streaming.send(StreamingCommand.PREVIEW, *arrays)
        return ""


class ArmStreamerNode(HardwareNode):
    """Lifecycle node that passes previews to a streaming process and publishes its reports.

    configure starts the streaming process and waits for the controller's data; activate has the
    controller run our program, which holds the arm where it is; deactivate brings the arm to rest
    and ends the program; cleanup ends the process.
    """

    lookahead = 0.01

    def __init__(self, *, start_process: StartProcess = StreamingProcess, **options: Any) -> None:
        super().__init__("arm_streamer", allow_sim_time=True, **options)
        self.settings = ParameterSet(self, ArmStreamerParameters, robot=False)
        p = self.settings.value
        if self.is_simulated and not p.simulated_controller:
            raise ParameterError("use_sim_time", True, "a real arm runs on real time")
        joint_limits(p.arm, p.ur)  # refuse now what the streaming process would refuse
        if len(p.arm.joints) != JOINTS:
            raise ParameterError("arm.joints", p.arm.joints, f"must be {JOINTS} names")
        if self.is_simulated:
            start_process = partial(start_process, clock=self.now)
        self.streaming = StreamingClient(self.now, self.wake, self._receive_waiting, start_process)
        self._reports = ArmReportPublisher(self, p.arm.joints)
        send = partial(self.streaming.send, StreamingCommand.LIMIT)
        self.limit = ArmLimit(self, list(p.arm.joints), p.collision_monitor, send)
        ArmPreviewInput(self, p.arm.joints, self.limit, self.streaming)
        self.settings.on_change(self._configure)
        self.every(0.02, self._check_process)
        self.every(KEEP_ALIVE_PERIOD, lambda: self.streaming.send(StreamingCommand.KEEP_ALIVE))
        self.begin(p.autostart)

    @property
    def is_configured(self) -> bool:
        """Whether there is a streaming process."""
        return self.streaming.process is not None

    @property
    def is_hardware_off(self) -> bool:
        """Whether no program of ours runs on the controller."""
        return self.streaming.report.phase is StreamingPhase.IDLE

    @property
    def may_have_moved(self) -> bool:
        """Whether the node is active: whoever has a preview moves the arm at once."""
        return self.is_active

    def open_hardware(self) -> str:
        """Start the streaming process and wait for the controller's data."""
        p = self.settings.value
        process = self.streaming.open(p.arm, p.ur)
        if not self.streaming.report.connected:
            reason = self.streaming.failure or self.streaming.report.blocking_reason
            raise HardwareError(f"no data from {p.ur.host}: {reason}")
        self._reports.log_priority(process)
        return f"the controller at {p.ur.host} sends data"

    def enable_hardware(self) -> str:
        """Have the controller run our program, which holds the arm where it is."""
        if self.streaming.start_program(2.0 * self.settings.value.ur.connect_timeout + 1.0):
            return "the arm is held where it is"
        if self.streaming.failure:
            raise HardwareLostError(self.streaming.failure)
        failure = self.streaming.report.failure
        self.streaming.send(StreamingCommand.FINISH)
        raise HardwareError(failure or "no answer")

    def disable_hardware(self) -> None:
        """Bring the arm to rest and end the program."""
        if not self.streaming.finish_program():
            self.get_logger().error("the program on the controller does not end")

    def close_hardware(self) -> None:
        """End the streaming process."""
        self.receive()
        self.streaming.close()

    def receive(self) -> None:
        """Publish the reports of the streaming process, and latch the stops that they request."""
        if not self.is_configured:
            return
        for report in self.streaming.take():
            if self.is_active and report.stop_reason and report.resets == self.streaming.resets:
                self.latch.stop(report.stop_reason)
            self._reports.publish(report, self.is_active)
        self.report_progress()
        if self.streaming.failure and self.is_active:
            self.latch.stop(self.streaming.failure)
        self.stop_interface.publish()
        self.follow_latch()

    def _receive_waiting(self) -> None:
        """Receive reports, and simulated time, while the node waits for a report."""
        self.poll_clock()
        self.receive()

    def time_passed(self) -> None:
        """Let simulated time pass in the streaming process."""
        self.streaming.pass_time()

    @property
    def progress(self) -> float:
        """Simulated time up to which setpoints have been sent [s]."""
        return min(self.now(), self.streaming.progress)

    def _check_process(self) -> None:
        """Publish reports, send messages that had to wait, and stop if the process hangs."""
        self.receive()
        self.limit.send()
        self.streaming.flush()
        if self.is_active and self.streaming.hang_reason:
            self.latch.stop(self.streaming.hang_reason)
            self.stop_interface.publish()

    def _configure(self, new: ArmStreamerParameters) -> None:
        joint_limits(new.arm, new.ur)
        self.limit.configure(new.collision_monitor)
        self.streaming.send(StreamingCommand.CONFIGURE, new.arm, new.ur)

    def follow_latch(self) -> None:
        """Send the state of the latch to the process, once for each change."""
        status = self.latch.status
        stopped = status.state is StopState.STOPPED
        self.streaming.send_stop(not self.latch.released, status.reason if stopped else "")

    def reset_hardware(self) -> None:
        """Reset the latch, and replace a streaming process that has ended or hangs.

        By then, the program on the controller has stopped the arm for want of setpoints.
        """
        if not (self.is_configured and self.is_active):
            self.latch.reset(at_rest=True)
            return
        self.receive()
        p = self.settings.value
        if self.streaming.failure or self.streaming.hang_reason:
            self.streaming.replace(p.arm, p.ur)
        if self._reports.in_protective_stop and not self.latch.emergency:
            with self.clock_released():
                self.streaming.unlock_protective_stop(p.ur)
        report = self.streaming.report
        fault = self.streaming.failure or self.streaming.hang_reason or report.blocking_reason
        self.latch.reset(at_rest=report.at_rest, fault=fault)
        self.follow_latch()  # so that the same stop is sent again if it returns
        self.streaming.send_reset()

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Return level, message and values for the diagnostics."""
        process = self.streaming.process
        if process is None:
            return DiagnosticStatus.WARN, "unconfigured", []
        level, text, values = self._reports.status(process, self.stop_diagnostics())
        return level, text, [*values, ("motion_limit", round(self.limit.fraction, 3))]

    @property
    def stop_timeout(self) -> float:
        """How long the stop may take [s]."""
        return SHUTDOWN_TIMEOUT


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros arm_streamer`."""
    return run(ArmStreamerNode, args)
