"""Motions of platform and arm on one time base, in previews of both; the tool may be led."""

import numpy as np

from omniman_ros.core.arrays import Array
from omniman_ros.core.errors import InputError
from omniman_ros.motion.axes import JOINT_COLUMNS, PLATFORM_COLUMNS
from omniman_ros.motion.path.window import Window
from omniman_ros.nodes.motion_log import MotionInput
from omniman_ros.nodes.trajectory_interfaces.motion_context import BodyContext
from omniman_ros.nodes.trajectory_interfaces.motion_interface import (
    DrivenMotion,
    MotionInterface,
    WholeBodyOutput,
)
from omniman_ros.nodes.trajectory_interfaces.tool_stream import ToolPosePublisher, ToolStream

#: Shortest period of corrected previews of the arm between those of both parts [s]
MIN_CORRECTION_PERIOD = 0.018


class BodyInterface(MotionInterface):
    """Drives motions of the whole body; where the tool is led, the arm corrects the platform."""

    def __init__(self, context: BodyContext, core: DrivenMotion, kind: MotionInput) -> None:
        super().__init__(context, core, WholeBodyOutput(context), kind)
        self.limit_scale = 1.0
        self._tool: ToolStream | None = None
        self._corrected_at = float("-inf")
        self._tool_reference = ToolPosePublisher(
            self._node, "tool_reference", context.options.frames.odom.odom_frame
        )

    @property
    def max_pace(self) -> float:
        """Highest pace at which the motion may be driven, 0 to 1."""
        if self.idle:
            return 1.0
        return min(self.limit_scale, 1.0 if self._tool is None else self._tool.max_pace)

    def blocking_reason(self) -> str:
        """Return why no motion can start yet, or an empty string."""
        options, context = self._context.options, self._context
        why = context.arm_feed.blocking_reason(options.joint_trajectory, idle=self.idle)
        if why or not self.idle:
            return why
        why = context.odom.blocking_reason(options.odom_timeout)
        return why or context.control_wait_reason()

    def actual(self) -> tuple[Array, Array] | None:
        """Return measured positions and velocities (9,), with odom's heading as it is."""
        odom, arm = self._context.odom, self._context.arm_feed.state()
        if odom.pose is None or arm is None:
            return None
        return np.concatenate([odom.pose, arm[0]]), np.concatenate([odom.velocity, arm[1]])

    def rest_position(self) -> Array:
        """Return the positions (9,) at which platform and arm are at rest [m, m, rad, ...]."""
        tolerance = self._context.options.joint_trajectory.start_tolerance
        arm = self._context.arm_feed.start_position(tolerance)
        assert self._context.odom.pose is not None and arm is not None
        return np.concatenate([self._context.odom.pose, arm])

    def update_pose(self, pose: Array, at: float) -> None:
        """Correct the arm for the platform's pose (3,) in odom [m, m, rad] at a time [s]."""
        tool, pace = self._tool, self._context.time_base.pace
        if self.idle or tool is None or at <= tool.correction.time:
            return  # a controller that was held up repeats a measurement
        if not self.output.is_covered(self._node.now()):
            return  # the next tick gives the motion up
        reference = self.platform_reference(pace.motion(at))
        if deviation := tool.correct(at, pose, reference):
            self.give_up(f"the platform is {deviation} off its path", brake=True)
        elif self._node.now() - self._corrected_at >= MIN_CORRECTION_PERIOD:
            self.publish(self._context.options.horizon, platform=False)

    def platform_reference(self, motion_time: float) -> Array:
        """Return the planned pose (3,) of the platform in odom at a motion time [s]."""
        return self.core.sample(np.array([motion_time]))[0][0, PLATFORM_COLUMNS]

    def publish(self, horizon: float, *, platform: bool = True) -> None:
        """Publish previews that are `horizon` long [s], of both parts or of the arm alone."""
        if self.idle:
            return
        if self._tool is None:
            super().publish(horizon)
            return
        time_base = self._context.time_base
        times = time_base.sample_times(horizon)
        try:
            stretch = self._tool.corrected(times, time_base.pace, self.core)
        except InputError as error:
            self.give_up(str(error), brake=True)
            return
        self._tool_reference.send(float(times[0]), stretch.tool)
        self._corrected_at = self._node.now()
        if platform:
            self.output.send(stretch.window)
        else:
            self.output.send_arm(stretch.window.columns(JOINT_COLUMNS))

    def _stop_window(self, now: float) -> Window | None:
        """Return the stretch that leads to rest, on which the arm keeps its present correction."""
        window = super()._stop_window(now)
        return window if window is None or self._tool is None else self._tool.offset(window)
