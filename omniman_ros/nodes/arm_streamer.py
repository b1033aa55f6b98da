"""Node `arm_streamer`: previews of joint motion to a UR controller every 8 ms, feedback back."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray, MultiArrayDimension
from trajectory_msgs.msg import JointTrajectory

from omniman_ros import arm_conversions
from omniman_ros.arm import dashboard
from omniman_ros.arm.feedback import ArmSample, SafetyMode
from omniman_ros.arm.joint_preview import JointPreview
from omniman_ros.arm.parameters import UrParameters
from omniman_ros.arm.process import StreamProcess
from omniman_ros.arm.report import ArmReport, Phase, Timing
from omniman_ros.arm.reverse import JOINTS
from omniman_ros.arm.sockets import LinkError
from omniman_ros.arm.streamer import joint_limits
from omniman_ros.core.arm_parameters import ArmParameters
from omniman_ros.core.errors import ParameterError
from omniman_ros.core.parameters import parameter
from omniman_ros.core.stop import ResetRefusedError, StopLatch, StopState
from omniman_ros.nodes.lifecycle import ERROR, FAILURE, SUCCESS, HardwareNode, told
from omniman_ros.nodes.parameters import ParameterSet
from omniman_ros.nodes.runtime import run
from omniman_ros.nodes.stopping import StopPort

SCALING_PERIOD = 0.1
"""Longest time between two messages on arm/speed_scaling [s]."""
SILENT = 0.5
"""Silence of the streaming process after which it is taken for hung [s]."""
AHEAD = 1.0
"""Stamps of previews may be so far ahead [s]."""
TIMED = 1250
"""Setpoints whose punctuality the diagnostics tell: of the last 10 s."""
PATIENCE = 6.0
"""How long the end may take [s]."""
LIVING = 0.1
"""Longest time between two messages to the streaming process, which are its sign of life [s]."""
UNLOCKED = 1.0
"""How long the controller may take to say that it is unlocked [s]."""


@dataclass(frozen=True, kw_only=True)
class ArmStreamerParameters:
    """Parameters of the node: the arm, its controller, and how it starts."""

    arm: ArmParameters
    ur: UrParameters
    autostart: bool = parameter(
        True, "Whether it configures and activates itself, again and again until the controller "
        "is there.", read_only=True,
    )  # fmt: skip


class ArmStreamerNode(HardwareNode):
    """Message plumbing and life cycle around `arm.process.StreamProcess`.

    configure starts the streaming process and waits for the controller's data; activate has the
    controller run our program, which holds the arm where it is; deactivate brings the arm to rest
    and ends the program; cleanup ends the process.
    """

    def __init__(self, **options: object) -> None:
        super().__init__("arm_streamer", **options)
        self.settings = ParameterSet(self, ArmStreamerParameters, robot=False)
        p = self.settings.value
        joint_limits(p.arm, p.ur)  # what it would refuse, it refuses now
        if len(p.arm.joints) != JOINTS:
            raise ParameterError("arm.joints", p.arm.joints, f"a UR has {JOINTS} joints")
        self.process: StreamProcess | None = None
        self.latch = StopLatch()
        self._active = False
        self._resets = 0
        self._told = (False, "")
        self._heard = math.inf
        self._scaling, self._scaled = math.nan, -math.inf
        self._mode = int(SafetyMode.UNDEFINED)
        self._punctuality: deque[float] = deque(maxlen=TIMED)
        self._names = list(p.arm.joints)
        self._states = self.create_publisher(JointState, "arm/joint_states", 5)
        self._speed_scaling = self.create_publisher(Float64, "arm/speed_scaling", 10)
        self._timing = self.create_publisher(Float64MultiArray, "arm/timing", 10)
        handler = self.guarded("arm/joint_reference", self._on_preview)
        self.create_subscription(
            JointTrajectory, "arm/joint_reference", handler, QoSProfile(depth=1)
        )
        self._stop = StopPort(self, self.latch, self._reset, self._follow_latch)
        self.settings.on_change(self._configure)
        self.every(0.02, self._check)
        self.every(LIVING, self._live)
        if p.autostart:
            self.autostart()

    # ---- life cycle -----------------------------------------------------------------------------

    @property
    def is_configured(self) -> bool:
        """Whether the streaming process runs and hears the controller."""
        return self.process is not None

    @told
    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Start the streaming process, and wait for the controller's data."""
        p = self.settings.value
        self._open()
        if self.process.report.connected:
            self.get_logger().info(f"configured: the controller at {p.ur.host} sends data")
            if self.process.punctual:
                self.get_logger().info(f"no real-time priority: {self.process.punctual}")
            return SUCCESS
        why = self.process.failure or self.process.report.trouble
        self.warn("configure", f"not configured: no data from {p.ur.host}: {why}")
        self._close()
        return FAILURE

    @told
    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Have the controller run our program, which holds the arm where it is."""
        if self.latch.status.state is StopState.STOPPED:
            self.warn("activate", f"not activated: stopped: {self.latch.status.reason}")
            return FAILURE
        self.process.order("start")
        patience = 2.0 * self.settings.value.ur.connect_timeout + 1.0
        self._await(lambda r: r.phase is Phase.STREAMING or bool(r.failure), patience)
        report = self.process.report
        if report.phase is Phase.STREAMING:
            self._active = True
            self.leave_alone()
            self.get_logger().info("active: the arm is held where it is")
            return SUCCESS
        why = self.process.failure or report.failure or "no answer"
        self.warn("activate", f"not activated: {why}")
        if self.process.failure:
            return ERROR
        self.process.order("finish")
        return FAILURE

    @told
    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the arm to rest and end the program."""
        self._finish()
        return SUCCESS

    @told
    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """End the process."""
        self.leave_alone()
        self._close()
        return SUCCESS

    @told
    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Bring the arm to rest, end program and process."""
        self.leave_alone()
        return self.on_error(state)

    @told
    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Do the same after an error in a transition; the node is then unconfigured."""
        self._finish()
        self._close()
        return SUCCESS

    def _open(self) -> None:
        """Start the process, and wait for the controller's data."""
        p = self.settings.value
        self.process, self._resets = StreamProcess(p.arm, p.ur, self._wake), 0
        self._told = (False, "")
        self._heard = self.now()
        self._await(lambda report: report.connected, p.ur.connect_timeout + 1.0)

    def _finish(self) -> None:
        self._active = False
        if self.process is not None:
            self.process.order("finish")
            if not self._await(lambda report: report.phase is Phase.IDLE, 5.0):
                self.get_logger().error("the program on the controller does not end")

    def _close(self) -> None:
        self._hear()
        if self.process is not None:
            self.process.close(hung=bool(self._hung))
        self.process = None

    def _await(self, done: Callable[[ArmReport], bool], timeout: float) -> bool:
        """Hear the process until something is reported; False if it is not in time [s]."""
        end = self.now() + timeout
        while True:
            self._hear()
            if done(self.process.report):
                return True
            left = end - self.now()
            if left <= 0.0 or self.process.failure:
                return False
            self.process.wait(min(left, 0.05))

    # ---- what comes in --------------------------------------------------------------------------

    def _wake(self) -> None:
        """Have the executor hear what the process' thread has."""
        if self.executor is not None:
            self.executor.create_task(self._hear)

    def _hear(self) -> None:
        if self.process is None:
            return
        for report in self.process.take():
            self._heard = self.now()
            self._take(report)
        if self.process.failure and self._active:
            self.latch.stop(self.process.failure)
        self._stop.publish()
        self._follow_latch()

    def _take(self, report: ArmReport) -> None:
        for sample in report.samples:
            self._publish(sample)
        for why in report.refusals:
            self.warn("arm/joint_reference", f"arm/joint_reference not used: {why}")
        for text in report.texts:
            self.get_logger().info(f"the controller says: {text}")
        if report.timing is not None:
            self._report_timing(report.timing)
        if self._active and report.stop_reason and report.resets == self._resets:
            self.latch.stop(report.stop_reason)
        self._report_scaling(report)

    def _on_preview(self, message: JointTrajectory) -> str:
        start = self.instant(message.header.stamp, AHEAD)
        arrays = arm_conversions.joint_preview(message, start, self._names)
        JointPreview(*arrays)  # it is checked here: a refusal is told at once
        if not self._active:
            return "the streamer is not active"
        if not self.latch.released:
            return f"{self.latch.status.state.value}: {self.latch.status.reason}"
        self.process.order("preview", *arrays)
        return ""

    def _configure(self, new: ArmStreamerParameters) -> None:
        joint_limits(new.arm, new.ur)
        if self.process is not None:
            self.process.order("configure", new.arm, new.ur)

    def _check(self) -> None:
        """Notice a process that hangs, and a latch that was released."""
        self._hear()  # what waits, where this node was held up itself
        if self.process is not None:
            self.process.flush()
        if self.process is not None and self._active and self._hung:
            self.latch.stop(self._hung)
            self._stop.publish()

    def _live(self) -> None:
        """Show the process that this node does not hang."""
        if self.process is not None:
            self.process.order("live")

    @property
    def _hung(self) -> str:
        """Why the process seems to hang, or an empty string."""
        silent = self.now() - self._heard
        if self.process is None or self.process.failure or silent <= SILENT:
            return ""
        return f"the streaming process says nothing for {silent:.2f} s"

    # ---- stops ----------------------------------------------------------------------------------

    def _follow_latch(self) -> None:
        """Tell the process of the latch, once for each change."""
        stopped = self.latch.status.state is StopState.STOPPED
        told = (not self.latch.released, self.latch.status.reason if stopped else "")
        if self.process is None or told == self._told:
            return
        self._told = told
        if stopped:
            self.process.order("stop", self.latch.status.reason)
        self.process.order("hold", told[0])

    def _reset(self) -> None:
        if self.process is None or not self._active:
            self.latch.reset(at_rest=True)
            return
        self._hear()
        if self.process.failure:
            self._begin_anew()
        self._unlock()
        report = self.process.report
        fault = self.process.failure or self._hung or report.trouble
        self.latch.reset(at_rest=report.at_rest, fault=fault)
        self._follow_latch()  # so that the same stop is told again
        self._resets += 1
        self.process.order("reset", self._resets)

    def _begin_anew(self) -> None:
        """Replace a streaming process that has ended by one that is stopped as it was."""
        self._close()
        self._open()
        self._follow_latch()
        self.process.order("resume")

    def _unlock(self) -> None:
        ur = self.settings.value.ur
        if self._mode != SafetyMode.PROTECTIVE_STOP or self.latch.emergency:
            return
        if not ur.unlock:
            raise ResetRefusedError(
                "protective stop: look at the arm, and unlock it on the pendant (or set ur.unlock)"
            )
        try:
            refusal = dashboard.unlock(ur)
        except LinkError as error:
            raise ResetRefusedError(f"the dashboard server: {error}") from error
        if refusal:
            raise ResetRefusedError(f"the controller says: {refusal}")
        self._await(lambda report: not report.trouble, UNLOCKED)

    # ---- output ---------------------------------------------------------------------------------

    def _publish(self, sample: ArmSample) -> None:
        self._mode = sample.safety_mode
        message = JointState(
            name=self._names, position=list(sample.position), velocity=list(sample.velocity)
        )
        message.header.stamp = self.stamp(sample.at)
        self._states.publish(message)

    def _report_scaling(self, report: ArmReport) -> None:
        """Say how fast the arm may move: what it does not do while it is stopped is 0."""
        if not self._active or not report.samples:
            return
        moves = report.phase is Phase.STREAMING
        scaling = report.samples[-1].speed_scaling if moves else 0.0
        now = self.now()
        if scaling != self._scaling or now - self._scaled > SCALING_PERIOD:
            self._speed_scaling.publish(Float64(data=scaling))
            self._scaling, self._scaled = scaling, now

    def _report_timing(self, timing: Timing) -> None:
        message = Float64MultiArray(data=[*timing.intervals, *timing.ages])
        for label, values in (("intervals", timing.intervals), ("ages", timing.ages)):
            size = len(values)
            message.layout.dim.append(MultiArrayDimension(label=label, size=size, stride=size))
        self._timing.publish(message)
        self._punctuality.extend(timing.intervals)

    # ---- life -----------------------------------------------------------------------------------

    def status(self) -> tuple[bytes, str, list[tuple[str, object]]]:
        """Level, message and values for the diagnostics."""
        if self.process is None:
            return DiagnosticStatus.WARN, "unconfigured", []
        report = self.process.report
        values: list[tuple[str, object]] = [
            ("phase", report.phase.value),
            ("controller", report.trouble or "ready"),
            ("real-time priority", self.process.punctual or "yes"),
            *((f"data {kind}", count) for kind, count in report.counts),
            *self._timing_values(),
        ]
        if self.process.failure:
            return DiagnosticStatus.ERROR, self.process.failure, values
        if self.latch.status.state is StopState.STOPPED:
            return DiagnosticStatus.ERROR, self.latch.status.reason, values
        if not self.latch.released:
            return DiagnosticStatus.WARN, self.latch.status.reason, values
        if report.phase is not Phase.STREAMING:
            return DiagnosticStatus.WARN, report.trouble or report.phase.value, values
        return DiagnosticStatus.OK, "streaming", values

    def _timing_values(self) -> list[tuple[str, object]]:
        if not self._punctuality:
            return []
        shares = np.percentile(np.array(self._punctuality), [50, 99, 100])
        names = ("send interval p50 ms", "send interval p99 ms", "send interval max ms")
        return [(name, f"{1e3 * v:.2f}") for name, v in zip(names, shares, strict=True)]

    def begin_shutdown(self, reason: str) -> None:
        """Bring the arm to rest, and end the program."""
        self.leave_alone()
        self.latch.stop(f"shutting down: {reason}")
        self._stop.publish()
        self._follow_latch()

    @property
    def finished(self) -> bool:
        """Whether no program of ours runs."""
        self._hear()
        return self.process is None or self.process.report.phase is Phase.IDLE

    @property
    def patience(self) -> float:
        """How long the stop may take [s]."""
        return PATIENCE

    def destroy_node(self) -> None:
        """End the process, then the node."""
        self._close()
        super().destroy_node()


def main(args: list[str] | None = None) -> int:
    """Entry point of `ros2 run omniman_ros arm_streamer`."""
    return run(ArmStreamerNode, args)
